"""Fields of a volume: their names and arrays, and the coordinates that every grid has."""

from __future__ import annotations

import keyword
import unicodedata
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import InputError, UnitsError, VoluminousError, how_to_take
from .expressions import CONSTANTS, FUNCTIONS
from .geometry import CARTESIAN, CYLINDRICAL, SPHERICAL
from .units import as_quantity, is_quantity, parse_unit, plain

if TYPE_CHECKING:
    from .grids.contract import Grid

# Cells processed at once.
_CHUNK = 1 << 20
# Layers copied at once: written cache lines stay in the cache until they are full.
_LAYERS = 16
# The coordinates that every grid has.
COORDINATES = ("x", "y", "z", "r")


def coordinate_names(grid: Grid) -> tuple[str, ...]:
    """Return the coordinates that expressions know on a grid: x, y, z, r and the grid's own."""
    return tuple(dict.fromkeys((*COORDINATES, *grid.coordinates)))


def coordinates(grid: Grid, names: Iterable[str], first: int, last: int) -> dict[str, np.ndarray]:
    """Return coordinates of the centres of consecutive cells, each of shape (n,).

    Lengths are in the grid's unit, angles in radians.
    """
    names, values = tuple(names), {}
    if not set(names) <= set(COORDINATES):
        from .grids.contract import native_centers

        values = dict(zip(grid.coordinates, native_centers(grid, first, last), strict=True))
    if not set(names).isdisjoint(COORDINATES):
        x, y, z = grid.cell_centers(first, last)
        values |= {"x": x, "y": y, "z": z}
        if "r" in names:
            values["r"] = np.sqrt(x * x + y * y + z * z)
    return {name: values[name] for name in names}


def coordinate_extremes(grid: Grid, name: str) -> tuple[float, float]:
    """Return bounds of a coordinate of cell centres."""
    low, high = grid.bounds.T
    if name == "r":
        return 0.0, float(np.linalg.norm(np.maximum(abs(low), abs(high))))
    if name in COORDINATES:
        axis = COORDINATES.index(name)
        return float(low[axis]), float(high[axis])
    parts = [
        coordinates(grid, [name], first, min(first + _CHUNK, grid.size))[name]
        for first in range(0, grid.size, _CHUNK)
    ]
    return min(float(p.min()) for p in parts), max(float(p.max()) for p in parts)


def is_angle(coordinate: str) -> bool:
    """Return True for coordinates in radians, False for those in the grid's unit."""
    return coordinate in ("theta", "phi")


def split_unit(value: Any) -> tuple[Any, Any]:
    """Return plain values and their unit, None if they have none; also of a list of Quantities."""
    value = as_quantity(value)
    if isinstance(value, (list, tuple)):
        value = [as_quantity(part) for part in value]
    if is_quantity(value):
        return value.value, parse_unit(value.unit)
    if not isinstance(value, (list, tuple)) or not any(is_quantity(part) for part in value):
        return value, None
    if lacking := [k for k, part in enumerate(value) if not is_quantity(part)]:
        raise UnitsError(
            f"parts of a field must all have a unit, or none of them; part {lacking[0]} (counted "
            "from 0) has none, others have: give each of them a unit"
        )
    unit = value[0].unit
    parts = [p.value if p.unit == unit else plain(p, unit, "part of a field") for p in value]
    return parts, parse_unit(unit)


def unit_quantity(array: np.ndarray, unit: Any) -> Any:
    """Return an array as a Quantity without copying it."""
    from astropy import units as u

    return u.Quantity(array, unit, copy=False, subok=True)


def checked_grid(grid: Grid) -> Any:
    """Return a grid; refuse other objects."""
    from .grids.contract import Grid

    if isinstance(grid, Grid):
        return grid
    cells, advice = (grid.shape, "") if isinstance(grid, np.ndarray) else (8, how_to_take(grid))
    raise InputError(
        "a Volume is a grid and its fields, such as vm.Volume(vm.CartesianGrid.uniform("
        f"{cells}, (-1, 1)), density=array); got {type(grid).__name__} first{advice}"
    )


def checked_name(name: Any, reserved: tuple[str, ...] = COORDINATES) -> str:
    """Return a field's name as expressions know it (Unicode-normalised, as in Python)."""
    if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
        raise InputError(
            f"a field's name must be an identifier (letters, digits, _), got {name!r}; "
            "expressions refer to fields by it"
        )
    if name in FUNCTIONS or name in CONSTANTS or name in reserved:
        raise InputError(f"{name!r} is reserved for expressions; give the field another name")
    return unicodedata.normalize("NFKC", name)


def without_mask(value: Any) -> Any:
    """Return masked arrays (of NumPy or astropy), or a list of them, with NaN where masked.

    Other values are returned unchanged.
    """
    if isinstance(value, (list, tuple)):
        masked = any(isinstance(getattr(part, "mask", None), np.ndarray) for part in value)
        return [without_mask(part) for part in value] if masked else value
    mask = getattr(value, "mask", None)
    if not hasattr(value, "filled") or mask is None:
        return value
    if not np.any(mask):
        return value.filled(0)  # nothing is filled
    return (value if value.dtype.kind == "f" else value.astype(np.float64)).filled(np.nan)


def packed(name: str, values: Any, grid: Grid) -> np.ndarray:
    """Return the values of a field as an array."""
    try:
        array: np.ndarray = grid.pack(values)
    except VoluminousError:
        raise
    except (TypeError, ValueError) as error:
        raise InputError(f"field {name!r} must be an array of numbers: {error}") from None
    return array


def check_order(name: str, values: Any) -> None:
    """Refuse arrays (of xarray) with named axes in another order: their shape may not tell."""
    axes = getattr(values, "dims", None)
    for order in (CARTESIAN, SPHERICAL, CYLINDRICAL):
        if isinstance(axes, tuple) and set(axes) == set(order) and axes != order:
            listed, wanted = ("(" + ", ".join(names) + ")" for names in (axes, order))
            named = ", ".join(map(repr, order))
            raise InputError(
                f"field {name!r} has its axes in the order {listed}, expected {wanted}: "
                f".transpose({named}), or vm.Volume.from_xarray, which knows their names"
            )


def held_dtype(dtype: Any) -> np.dtype[Any]:
    """Return the type in which volumes hold numbers of a type: one that kernels have."""
    held: np.dtype[Any] = np.dtype(dtype).newbyteorder("=")
    if held.kind == "f":
        held = np.dtype(np.float32 if held.itemsize <= 4 else np.float64)
    return held


def checked_array(name: str, array: np.ndarray, grid: Grid) -> np.ndarray:
    """Return an array as volumes hold it: C-contiguous, and of a type that kernels have."""
    if array.dtype.kind not in "fiub":
        raise InputError(
            f"field {name!r} must be real numbers, got dtype {array.dtype}"
            + ("; give its real and imaginary parts" if array.dtype.kind == "c" else "")
        )
    if array.shape != grid.shape:
        raise InputError(
            f"field {name!r} has shape {array.shape}, expected the grid's {grid.shape}"
            + _advice(name, array.shape, grid)
        )
    dtype = held_dtype(array.dtype)
    if array.ndim != 3 or array.flags.c_contiguous or array.strides[0] >= array.strides[2]:
        return np.ascontiguousarray(array, dtype=dtype)
    # Where x is fastest, layer by layer of z: three times as fast as all at once (64 MiB).
    out = np.empty(array.shape, dtype)
    for first in range(0, array.shape[2], _LAYERS):
        out[:, :, first : first + _LAYERS] = array[:, :, first : first + _LAYERS]
    return out


def _advice(name: str, shape: tuple[int, ...], grid: Grid) -> str:
    index = f"index is [{', '.join(f'i{axis}' for axis in grid.coordinates)}]"
    if shape[::-1] == grid.shape:
        return f"; transpose it ({index})"
    if shape == tuple(n + 1 for n in grid.shape):
        return "; grids are made of the walls of cells, one more than cells: were these centres?"
    if shape[:-1] == grid.shape:
        return f"; give each component a field of its own, such as {name}_x"
    if shape == ():
        return "; one number everywhere is np.full(grid.shape, number)"
    if shape == (int(np.prod(grid.shape)),):
        return f"; reshape it ({index}, the last one fastest)"
    return ""
