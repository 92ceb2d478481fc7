"""What one ray saw, as a table to read in a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from .result import Probe

# The most fields and scalars that fit beside the other columns.
_FIELDS = 3


def text(probe: Probe, rows: int | None) -> str:
    """Return a table of the columns that say most; see `Probe.text`."""
    channel = int(np.argmax(np.abs(probe.intensity)))
    lines = _heading(probe, channel)
    if not len(probe):
        return "\n".join([*lines, "The ray meets nothing."])
    columns = _columns(probe, channel)
    width = [max(map(len, column)) for column in columns]
    table = [
        "  ".join(cell.rjust(w) for cell, w in zip(row, width, strict=True))
        for row in zip(*columns, strict=True)
    ]
    return "\n".join([*lines, "", *table[:2], *_some(table[2:], rows)])


def _heading(probe: Probe, channel: int) -> list[str]:
    unit, how = probe.units["intensity"], probe.provenance
    scheme = f"{how['scheme']}, {how['precision']} precision"
    lines = [
        f"Pixel {probe.pixel}: {len(probe)} segments, {scheme}",
        f"intensity {_listed(probe.intensity)}{unit and ' ' + unit}"
        f" = {_listed(probe.gathered[-1:].ravel()) or '0'} gathered + "
        f"{_listed(probe.transparency)} x {_listed(probe.background)} behind; "
        f"optical depth {_listed(probe.optical_depth)}",
    ]
    if len(probe.intensity) > 1:
        lines.append(f"below: channel {channel} of {len(probe.intensity)}")
    if probe.stopped:
        lines.append("stopped early: nothing behind can be seen (cutoff=0 goes on)")
    return lines


def _columns(probe: Probe, channel: int) -> list[list[str]]:
    length, light = probe.units["length"], probe.units["intensity"]
    extinction = min(channel, probe.tau.shape[1] - 1)
    columns: list[list[str]] = [
        ["distance", length, *_numbers(0.5 * (probe.begin + probe.end), digits=6)],
        ["length", length, *_numbers(probe.end - probe.begin, digits=3)],
        ["cell", "", *_cells(probe)],
    ]
    if probe.level.any():
        columns.append(["level", "", *map(str, probe.level)])
    shown = {**probe.fields, **probe.scalars}
    for name in list(shown)[:_FIELDS]:
        columns.append([name, probe.units[name], *_numbers(shown[name])])
    columns += [
        ["j", _per(light, length), *_numbers(probe.j[:, channel])],
        ["alpha", _per("", length), *_numbers(probe.alpha[:, extinction])],
        ["tau", "", *_numbers(probe.tau[:, extinction])],
        ["depth", "", *_numbers(probe.depth[:, extinction])],
        ["b", light, *_numbers(probe.b[:, channel])],
        ["gathered", light, *_numbers(probe.gathered[:, channel])],
        ["arriving", light, *_numbers(probe.arriving[:, channel])],
    ]
    return columns


def _cells(probe: Probe) -> list[str]:
    where = probe.cell[:, None] if probe.index is None else probe.index
    names = [",".join(map(str, index)) for index in where]
    return ["hidden" if h else name for h, name in zip(probe.hidden, names, strict=True)]


def _per(unit: str, length: str) -> str:
    return f"{unit or '1'} / {length}" if length else unit


def _numbers(values: Any, digits: int = 4) -> list[str]:
    return [f"{value:.{digits}g}" for value in values]


def _listed(values: np.ndarray) -> str:
    texts = _numbers(values, digits=6)
    return texts[0] if len(texts) == 1 else f"({', '.join(texts)})" if texts else ""


def _some(table: list[str], rows: int | None) -> list[str]:
    if rows is None or len(table) <= rows:
        return table
    half = max(1, rows // 2)
    left_out = f"… {len(table) - 2 * half} segments …"
    return [*table[:half], left_out.center(len(table[0])).rstrip(), *table[-half:]]
