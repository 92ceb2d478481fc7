"""What users give to make grids, checked: points, extents, arrays."""

from __future__ import annotations

import reprlib
from typing import Any

import numpy as np

from ..errors import InputError
from ..units import plain


def plain_points(points: Any, unit: Any) -> np.ndarray:
    """Return points as float64, shape (n, 3), in a grid's unit; plain numbers are in it already."""
    array = np.asarray(plain(points, unit, "points"))
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(
            f"points must have shape (n, 3), one row of x, y and z for each, got {array.shape}"
            + ("; give [[x, y, z]] for one point" if array.shape == (3,) else "")
            + ("; transpose them" if array.ndim == 2 and array.shape[0] == 3 else "")
        )
    return array


# Volumes, and volumes times densities, must be within 1e-308 to 1e308.
_SHORTEST, _LONGEST = 1e-100, 1e100


def check_extent(**axes: np.ndarray) -> None:
    """Refuse domains that are too small or too large for double precision."""
    for name, edges in axes.items():
        if np.abs(edges).max() > _LONGEST or edges[-1] - edges[0] < _SHORTEST:
            raise InputError(
                f"the domain must be between {_SHORTEST:g} and {_LONGEST:g} long, and its walls "
                f"within {_LONGEST:g}; {name} runs from {edges[0]:g} to {edges[-1]:g}. Give "
                "lengths in another unit, e.g. in that of the domain's size"
            )


def as_array(values: Any, name: str, dtype: Any = None) -> np.ndarray:
    """Return values as an array."""
    try:
        return np.asarray(values, dtype=dtype)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{name} must be an array of numbers, all rows equally long, got {reprlib.repr(values)}"
        ) from error
