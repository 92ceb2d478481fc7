"""What users give for surfaces, brought into one form: levels, colours, opacities."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..colormaps import get_color, get_colormap, is_color, is_name_and_alpha, mapped_colors
from ..errors import InputError, UnknownNameError
from .color_by import ColorBy
from .given import channel_values, check_extinction, color_values, listed, scalar
from .modulation import Modulation, modulated

# The optical depth of an opaque surface: what shows through is below all rounding.
_OPAQUE = 40.0


def given_levels(level: Any, levels: Any) -> tuple[Any, ...]:
    """Return the levels, from one or several.

    Raises
    ------
    InputError
        If both are given, or none.
    """
    if (level is None) == (levels is None):
        raise InputError("an Isosurface needs level=…, or levels=[…] for several, and not both")
    given = level if levels is None else levels
    several = isinstance(given, (list, tuple)) or np.ndim(getattr(given, "value", given))
    listed = list(given) if several else [given]
    if not listed:
        raise InputError("levels is empty; give at least one value")
    return tuple(scalar(value, "level") for value in listed)


def modulated_colors(
    color: Any, where: Any, count: int
) -> tuple[tuple[tuple[float, ...], ...], Modulation]:
    """Return one colour per level, and what varies them."""
    if isinstance(color, ColorBy):
        row, modulation = modulated(color, where)
        return (row,) * count, modulation
    rows = _colors(color, count)
    return rows, Modulation(where, None, len(rows[0]))


def _colors(color: Any, count: int) -> tuple[tuple[float, ...], ...]:
    if isinstance(color, str) and not (count == 1 and is_color(color)):
        return _mapped(color, count)
    several = listed(color) and len(color) and not is_name_and_alpha(color)
    nested = several and (np.ndim(color[0]) == 1 or isinstance(color[0], str))
    rows = [color_values(row) for row in (color if nested else [color] * count)]
    if len(rows) != count or len({len(row) for row in rows}) != 1:
        raise InputError(
            f"color must be one colour, or {count} (one per level) with the same number of "
            f"channels, got {color!r}"
        )
    return tuple(rows)


def _mapped(name: str, count: int) -> tuple[tuple[float, ...], ...]:
    try:
        colormap = get_colormap(name)
    except UnknownNameError:
        if is_color(name):
            return (get_color(name),) * count
        raise
    places = np.linspace(0.3, 1.0, count) if count > 1 else np.array([1.0])
    return tuple(tuple(map(float, row)) for row in mapped_colors(colormap, places))


def given_opacities(opacity: Any, count: int, channels: int) -> tuple[tuple[float, ...], ...]:
    """Return one row of opacities per level; all of one number where that is all there is (grey).

    Raises
    ------
    InputError
        If they are not from 0 to 1, or as many as levels or channels.
    """
    rows = [channel_values(row, "opacity") for row in _opacity_rows(opacity, count, channels)]
    for row in rows:
        check_extinction(row, channels, "opacity")
        if max(row) > 1:
            raise InputError(
                "opacity is the part of the light that one crossing takes away: from 0 to 1, "
                f"got {max(row):g}"
            )
    if all(len(set(row)) == 1 for row in rows):
        return tuple(row[:1] for row in rows)
    return tuple(row if len(row) > 1 else row * channels for row in rows)


def _opacity_rows(opacity: Any, count: int, channels: int) -> list[Any]:
    several = listed(opacity)
    nested = several and any(np.ndim(row) for row in opacity)
    if nested and len(opacity) != count:
        raise InputError(
            f"opacity must be one row per level (there are {count}), got {len(opacity)} rows"
        )
    if several and not nested and count > 1 and len(opacity) not in (1, channels, count):
        raise InputError(
            f"opacity must be one number, {count} (one per level) or {channels} (one per channel), "
            f"got {len(opacity)}"
        )
    return list(opacity) if nested or (several and len(opacity) == count > 1) else [opacity] * count


def depth_of(opacity: float) -> float:
    """Return the optical depth of a crossing."""
    return min(-math.log1p(-opacity), _OPAQUE) if opacity < 1 else _OPAQUE


def plain_opacities(opacities: tuple[tuple[float, ...], ...]) -> Any:
    """Return opacities as short as they can be given: a number, or a row (of them) per level."""
    rows = [row[0] if len(row) == 1 else list(row) for row in opacities]
    alike = len(set(opacities)) == 1 and (len(rows) == 1 or not isinstance(rows[0], list))
    return rows[0] if alike else rows
