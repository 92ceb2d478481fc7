"""What a notebook shows of a volume: three slices, and a table of its fields."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..notebook import page, picture, table
from .slices import THUMBNAIL_PIXELS, cells_on, make_plane, values_png

_MOST_FIELDS = 40
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
        plane = make_plane(volume.grid, axis, None, None, None, None, THUMBNAIL_PIXELS)
        try:
            cells = cells_on(volume.grid, plane)
        except ValueError:  # a gap of the grid is there
            cells = np.full(plane.pixels[::-1], -1)
        slices.append(np.where(cells >= 0, values[cells].astype(np.float64), np.nan))
    return values_png(slices)
