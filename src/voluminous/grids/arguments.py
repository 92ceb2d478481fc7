"""What users give to make grids, checked: points, walls, extents, arrays."""

from __future__ import annotations

import reprlib
from typing import Any

import numpy as np

from ..errors import InputError
from ..units import is_quantity, plain, space_unit, unit_of


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


def length_unit(lengths: tuple[Any, ...], unit: Any) -> Any:
    """Return the unit of the first lengths that have one, or the one given."""
    own = next((own for own in map(unit_of, lengths) if own is not None), None)
    return space_unit(unit) if own is None else own


def cell_edges(values: Any, unit: Any, name: str) -> np.ndarray:
    """Return the walls of cells along an axis, in a unit, as a new array of float64."""
    if is_quantity(values) or unit_of(values) is not None:
        values = plain(values, unit, f"{name} edges")
    try:
        edges = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} edges must be numbers, got {values!r}") from error
    if edges.ndim != 1 or len(edges) < 2:
        raise InputError(
            f"{name} edges must be a 1-D array of at least two cell edges, got shape {edges.shape}"
        )
    if not np.all(np.isfinite(edges)):
        bad = int(np.argmin(np.isfinite(edges)))
        raise InputError(f"{name} edges must be finite; edge {bad} is {edges[bad]}")
    if np.any(np.diff(edges) <= 0):
        bad = int(np.argmax(np.diff(edges) <= 0))
        raise InputError(
            f"{name} edges must increase strictly; edge {bad} is {edges[bad]:g} and edge {bad + 1} "
            f"is {edges[bad + 1]:g}. Flip the axis (and the fields) if they decrease"
        )
    return edges


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
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{name} must be an array of numbers, all rows equally long, got {reprlib.repr(values)}"
        ) from error
