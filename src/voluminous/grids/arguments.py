"""What users give to make grids, checked: points, walls, extents, arrays."""

from __future__ import annotations

import reprlib
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ..errors import InputError
from ..units import is_quantity, plain, shown, space_unit, unit_name, unit_of

if TYPE_CHECKING:
    from .contract import Grid

# Plain lengths of more than so many boxes, pictures narrower than this part of a cell, and lengths
# between these parts of the box were meant in another unit: rounding of numbers as large as the box
# leaves more than the last, and no two units of length differ more than by the first.
_FAR, _THIN, _ROUNDING = 1e6, 1e-3, (1e-28, 1e-17)


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


def on_grid(value: Any, grid: Grid, what: str, *, across: bool = False) -> Any:
    """Return lengths as plain floats in a grid's unit, see `plain`; `across` is to show cells.

    Raises
    ------
    InputError
        If plain numbers are so small or large in that unit that another one was meant.
    """
    found = plain(value, grid.unit, what)
    size = float(np.max(np.abs(found), initial=0.0))
    if grid.unit is None or not size or unit_of(value) is not None:
        return found
    box = float(np.abs(grid.bounds).max())
    rounding = _ROUNDING[0] * box < size < _ROUNDING[1] * box
    if size > _FAR * box or rounding or (across and size < _THIN * _thinnest(grid)):
        raise InputError(
            f"plain numbers are in the volume's unit, {unit_name(grid.unit)}, and {what} is "
            f"{shown(value)}: far {'more' if size > box else 'less'} than the volume, whose walls "
            f"are up to {box:.3g} {unit_name(grid.unit)} from its origin. If another unit was "
            f"meant, give it, such as {what}={shown(value)} * u.pc"
        )
    return found


def _thinnest(grid: Grid) -> float:
    """Return the length of the shortest side of a cell; angles do not count on grids of arrays."""
    if len(grid.shape) != 3:
        return float(grid.cell_sizes().min())
    walls = zip(grid.coordinates, cast(Any, grid).edges, strict=True)
    return min(float(np.diff(e).min()) for name, e in walls if name not in ("theta", "phi"))


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
