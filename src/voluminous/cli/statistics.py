"""Ranges and histograms of arrays, computed in pieces so that temporary arrays stay small."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

_PIECE = 1 << 20
_BARS = " ▁▂▃▄▅▆▇█"
_WIDTH = 48
# Maximum number of values in a histogram; larger arrays are subsampled (the range is exact).
_COUNTED = 1 << 24
# A histogram is logarithmic if maximum / smallest positive value exceeds this.
_WIDE = 1e2
_BAD = {"NaN": np.isnan, "infinite": np.isinf}


@dataclass
class ValueSummary:
    """Statistics of an array: numbers of values, and the range of the finite values.

    `positive` is the smallest positive value; `bad` has the number of "NaN" and of "infinite"
    values, and the flat index of the first, where there are any.
    """

    size: int = 0
    finite: int = 0
    least: float = np.inf
    greatest: float = -np.inf
    positive: float = np.inf
    total: float = 0.0
    bad: dict[str, tuple[int, int]] = field(default_factory=dict)

    @property
    def varies(self) -> bool:
        """True if there are two different finite values or more."""
        return self.least < self.greatest


def statistics(array: np.ndarray) -> ValueSummary:
    """Return range, mean, and numbers and first places of NaN and infinities of an array."""
    summary = ValueSummary()
    for piece in _pieces(array):
        good = piece[np.isfinite(piece)]
        if good.size < piece.size:
            for name, test in _BAD.items():
                places = np.flatnonzero(test(piece))
                if places.size:
                    count, first = summary.bad.get(name, (0, summary.size + int(places[0])))
                    summary.bad[name] = count + places.size, first
        summary.size += piece.size
        if good.size:
            summary.finite += good.size
            summary.least = min(summary.least, float(good.min()))
            summary.greatest = max(summary.greatest, float(good.max()))
            if (above := good[good > 0]).size:
                summary.positive = min(summary.positive, float(above.min()))
            summary.total += float(good.sum(dtype=np.float64))
    return summary


def numbers(summary: ValueSummary, shape: tuple[int, ...] | None = None) -> str:
    """Describe range, mean and non-finite values, with first indices in an array of `shape`.

    Examples
    --------
    >>> numbers(statistics(np.array([[1.0, 3.0], [np.nan, np.nan]])), (2, 2))
    '1 … 3, mean 2, 2 NaN (first at [1, 0])'
    """
    bad = []
    for name, (count, first) in sorted(summary.bad.items()):
        place = "" if shape is None else [int(i) for i in np.unravel_index(first, shape)]
        bad.append(f"{count} {name}" + (f" (first at {place})" if place else ""))
    if not summary.finite:
        return ", ".join(["no finite value", *bad])
    mean = summary.total / summary.finite
    text = f"{summary.least:.6g} … {summary.greatest:.6g}, mean {mean:.6g}"
    return ", ".join([text, *(bad or ["all finite"])])


def histogram(array: np.ndarray, summary: ValueSummary) -> str:
    """Return a histogram between minimum and maximum as text bars, and its scale.

    Every non-empty bin is visible. A logarithmic histogram shows the positive values.
    """
    step = -(-summary.size // _COUNTED)
    step += step > 1 and step % 2 == 0  # odd, so that it does not align with an axis
    wide = summary.greatest > _WIDE * summary.positive
    logarithmic = array.dtype.kind == "f" and summary.least >= 0 and wide
    low, high = summary.least, summary.greatest
    if logarithmic:
        low, high = np.log10(summary.positive), np.log10(high)
    counts = np.zeros(_WIDTH, dtype=np.int64)
    for piece in _pieces(array, step):
        good = piece[np.isfinite(piece)].astype(np.float64)
        values = np.log10(good[good > 0]) if logarithmic else good
        # Rounding must not push the end values out of the range.
        counts += np.histogram(np.clip(values, low, high), _WIDTH, (low, high))[0]
    heights = np.ceil(counts / max(1, counts.max()) * (len(_BARS) - 1)).astype(int)
    scale = "logarithmic" if logarithmic else "linear"
    scale += ", of those above zero" * (logarithmic and not summary.least)
    scale += f", of one value in {step}" * (step > 1)
    return f"|{''.join(_BARS[h] for h in heights)}|  {scale}"


def _pieces(array: np.ndarray, step: int = 1) -> Iterator[np.ndarray]:
    flat = array.reshape(-1)
    for start in range(0, flat.size, step * _PIECE):
        yield flat[start : start + step * _PIECE : step]
