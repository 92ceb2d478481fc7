"""Fair timing on a machine that others use too: warm up, then take turns, then compare.

Load changes slowly compared with one picture. If the contestants take turns, each round meets the
same load, and ratios are steadier than the times themselves.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence


def take_turns(
    draws: Mapping[str, Callable[[], float]], repeats: Mapping[str, int]
) -> dict[str, list[float]]:
    """Return the seconds of each contestant, drawn in interleaved rounds after one warm-up.

    A contestant with fewer repeats than the others takes part in the first rounds only.
    """
    for draw in draws.values():
        draw()
    seconds: dict[str, list[float]] = {name: [] for name in draws}
    for turn in range(max(repeats.values(), default=0)):
        for name, draw in draws.items():
            if turn < repeats[name]:
                seconds[name].append(draw())
    return seconds


def summary(seconds: Sequence[float]) -> dict[str, float]:
    """Return median and minimum in seconds, and the number of repeats."""
    return {
        "median": statistics.median(seconds),
        "min": min(seconds),
        "repeats": len(seconds),
    }


def ratios(seconds: Sequence[float], reference: Sequence[float]) -> dict[str, float]:
    """Return the ratios to a reference: of medians, of minima, and the median of each round's."""
    rounds = [ours / theirs for ours, theirs in zip(seconds, reference, strict=False)]
    return {
        "median": statistics.median(seconds) / statistics.median(reference),
        "min": min(seconds) / min(reference),
        "round": statistics.median(rounds),
    }


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return rows of text as aligned columns, the first to the left, the others to the right."""
    lines = [list(header), *[list(row) for row in rows]]
    widths = [max(len(line[k]) for line in lines) for k in range(len(header))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if k == 0 else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(line, widths, strict=True))
        )
        for line in lines
    )
