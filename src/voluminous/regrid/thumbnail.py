"""What a notebook shows of a volume: three slices, and a table of its fields."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..colormaps import get_colormap
from ..notebook import page, picture, png, table
from .plane import cells_on, make_plane

_PIXELS, _GAP, _MOST_FIELDS = 96, 4, 40
# Positive numbers that are no whole ones, and wider, are shown by logarithms, but the faintest.
_WIDE, _FAINT = 100.0, 2.0
# Of fields with more values than that, so many are looked at.
_ALL, _VALUES = 1 << 22, 1 << 17
_FIRST = ("density", "gas_density", "rho", "dens")
_HEAD = ("field", "unit", "least", "greatest", "NaN")


def volume_html(volume: Any) -> str:
    """Return grid, fields and slices as HTML; what waits in a file is not read for it."""
    rows = [_row(volume, name) for name in list(volume)[:_MOST_FIELDS]]
    more = "" if len(volume) <= _MOST_FIELDS else f"and {len(volume) - _MOST_FIELDS} more"
    name = shown_field(volume)
    slices = ""
    if name is not None:
        slices = picture(slices_png(volume, name), f"{name}, across x, y and z")
    return page(f"Volume on {volume.grid!r}", slices, table(rows, _HEAD), more)


def shown_field(volume: Any) -> str | None:
    """Return the field whose slices are shown: a density, or the first that has been read."""
    ready = [name for name in volume if name not in volume.waiting]
    return next((name for name in (*_FIRST, *ready) if name in ready), None)


def _row(volume: Any, name: str) -> tuple[str, ...]:
    unit = volume.units[name]
    if name in volume.waiting:
        return name, unit, "not read yet", "", ""
    array = volume.array(name).reshape(-1)
    step = 1 if array.size <= _ALL else array.size // _VALUES | 1  # of no usual side a part
    values = array[::step]
    lacking = np.isnan(values) if values.dtype.kind == "f" else np.zeros(values.shape, bool)
    about = "≈ " if step > 1 else ""
    part = f"{about}{100 * lacking.mean():.3g} %" if lacking.any() else f"{about}0 %"
    if lacking.all():
        return name, unit, "", "", part
    good = values[~lacking]
    return name, unit, f"{about}{good.min():.4g}", f"{about}{good.max():.4g}", part


def slices_png(volume: Any, name: str) -> bytes:
    """Return slices through the middle of a field, across x, y and z, beside each other."""
    values = volume.array(name).reshape(-1)
    slices = []
    for axis in "xyz":
        plane = make_plane(volume.grid, axis, None, None, None, None, _PIXELS)
        try:
            cells = cells_on(volume.grid, plane)
        except ValueError:  # a gap of the grid is there
            cells = np.full(plane.pixels[::-1], -1)
        slices.append(np.where(cells >= 0, values[cells].astype(np.float64), np.nan))
    return values_png(slices)


def values_png(slices: list[np.ndarray]) -> bytes:
    """Return pictures of values beside each other; logarithmic if they are wide."""
    every = np.concatenate([own[np.isfinite(own)] for own in slices])
    low, high = (float(every.min()), float(every.max())) if every.size else (0.0, 1.0)
    if low >= 0.0 and np.any(every % 1):
        least = float(np.percentile(every[every > 0.0], _FAINT))
        if high > _WIDE * least:
            slices = [np.log10(np.maximum(own, least)) for own in slices]
            low, high = np.log10(least), np.log10(high)
    colormap = get_colormap("viridis").with_extremes(bad=(0.9, 0.9, 0.9))
    height = max(len(own) for own in slices)
    columns: list[np.ndarray] = []
    for own in slices:
        scaled = np.ma.masked_invalid((own - low) / ((high - low) or 1.0))
        above = np.ones((height - len(own), own.shape[1], 4))
        columns += [np.concatenate([colormap(scaled), above]), np.ones((height, _GAP, 4))]
    page = np.concatenate(columns[:-1], axis=1)
    zoom = max(1, 2 * _PIXELS // height)
    return png(np.repeat(np.repeat(page, zoom, axis=0), zoom, axis=1))
