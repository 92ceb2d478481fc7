"""What users give for tables, brought into one form: values, colours, opacities."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..colormaps import without_alpha
from ..errors import InputError
from .color_by import ColorBy
from .given import check_plain, color_values, listed


def shared_colors(opacities: np.ndarray, by: ColorBy) -> np.ndarray:
    """Return the opacity times the brightness in three channels, to be coloured."""
    if opacities.shape[1] not in (1, 3):
        raise InputError(f"opacities must have one column or 3, got {opacities.shape[1]}")
    return by.brightness * np.broadcast_to(opacities, (len(opacities), 3))


def given_values(values: Any) -> np.ndarray:
    """Return the values of the scalar, checked."""
    nodes = np.asarray(values, dtype=np.float64)
    if nodes.ndim != 1 or len(nodes) < 2:
        raise InputError(f"values must be at least two numbers, got shape {nodes.shape}")
    if not np.all(np.isfinite(nodes)):
        raise InputError("values must be finite")
    if np.any(np.diff(nodes) < 0):
        bad = int(np.flatnonzero(np.diff(nodes) < 0)[0])
        raise InputError(f"values must increase; {nodes[bad]:g} is followed by {nodes[bad + 1]:g}")
    return nodes


def given_colors(colors: Any, rows: int) -> np.ndarray:
    """Return colours, one row per value; their names stand for red, green and blue."""
    if listed(colors) and any(isinstance(color, str) for color in colors):
        colors = [color_values(color) for color in colors]
        if len({len(color) for color in colors}) > 1:
            raise InputError("colors given by names go with others of red, green and blue only")
    if listed(colors) and any(map(listed, colors)):
        colors = without_alpha(colors, "colors")
    return given_columns(colors, rows, "colors")


def given_columns(data: Any, rows: int, what: str) -> np.ndarray:
    """Return colours or opacities, one row per value and one column per channel."""
    check_plain(data, what)
    try:
        array = np.asarray(data, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{what} must be numbers, got {data!r}") from error
    if array.ndim == 0:
        array = np.full(rows, float(array))
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2 or len(array) != rows or array.size == 0:
        raise InputError(f"{what} must have {rows} rows (one per value), got shape {array.shape}")
    if not np.all(np.isfinite(array)):
        raise InputError(f"{what} must be finite")
    return np.ascontiguousarray(array)
