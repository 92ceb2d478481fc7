"""What can be a field of a volume: names, arrays, and the coordinates that are always there."""

from __future__ import annotations

import keyword
import unicodedata
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from . import packages
from .errors import InputError, UnitsError, VoluminousError, how_to_take
from .expressions import CONSTANTS, FUNCTIONS
from .units import as_quantity, is_quantity, parse_unit, plain

if TYPE_CHECKING:
    from .grids.contract import Grid

# Cells looked at at once.
_CHUNK = 1 << 20
# Layers copied at once: what is written stays in the cache until its lines are full.
_LAYERS = 16
# Axes in the order of the index, where data know their names.
_AXES = (("x", "y", "z"), ("r", "theta", "phi"), ("R", "phi", "z"))
# What every grid has.
COORDINATES = ("x", "y", "z", "r")


def coordinate_names(grid: Grid) -> tuple[str, ...]:
    """Return the coordinates that expressions know on a grid: x, y, z, r and the grid's own."""
    return tuple(dict.fromkeys((*COORDINATES, *grid.coordinates)))


def coordinates(grid: Grid, names: Iterable[str], first: int, last: int) -> dict[str, np.ndarray]:
    """Return coordinates of the centres of consecutive cells, each of shape (n,).

    Lengths are in the grid's unit, angles in radians.
    """
    names = tuple(names)
    found: dict[str, np.ndarray] = {}
    own = [name for name in names if name not in COORDINATES]
    if own:
        native = grid.native_centers(first, last)
        found = {name: native[grid.coordinates.index(name)] for name in own}
    if len(own) < len(names):
        x, y, z = grid.cell_centers(first, last)
        found |= {"x": x, "y": y, "z": z}
        if "r" in names:
            found["r"] = np.sqrt(x * x + y * y + z * z)
    return {name: found[name] for name in names}


def coordinate_extremes(grid: Grid, name: str) -> tuple[float, float]:
    """Return numbers that a coordinate of cell centres is between."""
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
    if isinstance(value, (list, tuple)) and any(is_quantity(part) for part in value):
        _check_all_have_units(value)
        unit = value[0].unit
        parts = [p.value if p.unit == unit else plain(p, unit, "part of a field") for p in value]
        return parts, parse_unit(unit)
    return value, None


def _check_all_have_units(parts: Any) -> None:
    lacking = [k for k, part in enumerate(parts) if not is_quantity(part)]
    if lacking:
        raise UnitsError(
            f"parts of a field must all have a unit, or none of them; part {lacking[0]} (counted "
            "from 0) has none, others have: give each of them a unit"
        )


def unit_quantity(array: np.ndarray, unit: Any) -> Any:
    """Return an array as a Quantity without copying it."""
    from astropy import units as u

    return u.Quantity(array, unit, copy=False, subok=True)


def checked_grid(grid: Grid) -> Any:
    """Return a grid, or refuse what is none."""
    if isinstance(grid, packages.room("grids.contract").Grid):
        return grid
    advice = "vm.Volume(vm.CartesianGrid.uniform(8, (-1, 1)), density=array)"
    if isinstance(grid, np.ndarray):
        advice = f"vm.Volume(vm.CartesianGrid.uniform({grid.shape}, (-1, 1)), density=array)"
    raise InputError(
        f"a Volume is a grid and its fields, such as {advice}; got {type(grid).__name__} first"
        + ("" if isinstance(grid, np.ndarray) else how_to_take(grid))
    )


def checked_name(name: Any, reserved: tuple[str, ...] = COORDINATES) -> str:
    """Return the name as expressions know it (Unicode-normalised, as in Python).

    Parameters
    ----------
    name : str
        Of a field.
    reserved : tuple of str
        The coordinates that there are.
    """
    if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
        raise InputError(
            f"a field's name must be an identifier (letters, digits, _), got {name!r}; "
            "expressions refer to fields by it"
        )
    if name in FUNCTIONS or name in CONSTANTS or name in reserved:
        raise InputError(f"{name!r} is reserved for expressions; give the field another name")
    return unicodedata.normalize("NFKC", name)


def without_mask(value: Any) -> Any:
    """Return what is given for a field with NaN where it is masked; most things as they are.

    Parameters
    ----------
    value : array_like, or a list of them
        NumPy's masked arrays and astropy's `Masked` have masks.
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
    """Return what is given for a field as an array."""
    try:
        array: np.ndarray = grid.pack(values)
    except VoluminousError:
        raise
    except (TypeError, ValueError) as error:
        raise InputError(f"field {name!r} must be an array of numbers: {error}") from None
    return array


def check_order(name: str, values: Any) -> None:
    """Refuse arrays that know the names of their axes, in another order (xarray).

    Where there are as many cells along all axes, their shape does not tell.
    """
    axes = getattr(values, "dims", None)
    for order in _AXES:
        if isinstance(axes, tuple) and set(axes) == set(order) and axes != order:
            listed, wanted = ("(" + ", ".join(names) + ")" for names in (axes, order))
            named = ", ".join(map(repr, order))
            raise InputError(
                f"field {name!r} has its axes in the order {listed}, expected {wanted}: "
                f".transpose({named}), or vm.Volume.from_xarray, which knows their names"
            )


def checked_array(name: str, array: np.ndarray, grid: Grid) -> np.ndarray:
    """Return an array as volumes keep it: C-contiguous, and of a type that kernels know."""
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
    if array.dtype == np.float16:
        array = array.astype(np.float32)
    elif array.dtype.kind == "f" and array.dtype.itemsize > 8:
        array = array.astype(np.float64)
    return _contiguous(array, array.dtype.newbyteorder("="))


def _advice(name: str, shape: tuple[int, ...], grid: Grid) -> str:
    """Return what to do with an array of another shape than the grid's, as far as it shows."""
    index = f"index is [{', '.join(f'i{axis}' for axis in grid.coordinates)}]"
    if shape[::-1] == grid.shape:
        return f"; transpose it ({index})"
    if shape == tuple(n + 1 for n in grid.shape):
        return "; grids are made of the walls of cells, one more than cells: were these centres?"
    if shape[:-1] == grid.shape:
        return f"; give each component a field of its own, such as {name}_x"
    if shape == ():
        return "; one number everywhere is np.full(grid.shape, number)"
    if shape == (np.prod(grid.shape),):
        return f"; reshape it ({index}, the last one fastest)"
    return ""


def _contiguous(array: np.ndarray, dtype: Any) -> np.ndarray:
    """Return an array with its last axis fastest, itself if it is so already."""
    if array.ndim != 3 or array.flags.c_contiguous or array.strides[0] >= array.strides[2]:
        return np.ascontiguousarray(array, dtype=dtype)
    # Where x is fastest, layer by layer of z: three times as fast as all at once (64 MiB).
    out = np.empty(array.shape, dtype)
    for first in range(0, array.shape[2], _LAYERS):
        out[:, :, first : first + _LAYERS] = array[:, :, first : first + _LAYERS]
    return out
