"""What can be a field of a volume: names, arrays, and the coordinates that are always there."""

from __future__ import annotations

import keyword
import unicodedata
from typing import Any

import numpy as np

from .errors import InputError
from .expressions import CONSTANTS, FUNCTIONS

COORDINATES = ("x", "y", "z", "r")


def coordinate(centers: Any, name: str, part: slice) -> np.ndarray:
    """Return a coordinate of cell centres for layers of the first axis."""
    x, y, z = centers[0][part, None, None], centers[1][None, :, None], centers[2][None, None, :]
    if name == "r":
        return np.sqrt(x * x + y * y + z * z)
    shape = (x.shape[0], y.shape[1], z.shape[2])
    return np.broadcast_to({"x": x, "y": y, "z": z}[name], shape)


def unit_quantity(array: np.ndarray, unit: Any) -> Any:
    """Return an array as a Quantity without copying it."""
    from astropy import units as u

    return u.Quantity(array, unit, copy=False, subok=True)


def checked_name(name: Any) -> str:
    """Return the name as expressions know it (Unicode-normalised, as in Python).

    Raises
    ------
    InputError
        If it is no identifier, or means something else in expressions.
    """
    if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
        raise InputError(
            f"a field's name must be an identifier (letters, digits, _), got {name!r}; "
            "expressions refer to fields by it"
        )
    if name in FUNCTIONS or name in CONSTANTS or name in COORDINATES:
        raise InputError(f"{name!r} is reserved for expressions; give the field another name")
    return unicodedata.normalize("NFKC", name)


def checked_array(name: str, array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return an array as volumes keep it: C-contiguous, and of a type that kernels know.

    Raises
    ------
    InputError
        If it has another shape, or does not hold real numbers.
    """
    if array.dtype.kind not in "fiub":
        raise InputError(
            f"field {name!r} must be real numbers, got dtype {array.dtype}"
            + ("; give its real and imaginary parts" if array.dtype.kind == "c" else "")
        )
    if array.shape != shape:
        raise InputError(
            f"field {name!r} has shape {array.shape}, expected the grid's {shape}"
            + ("; transpose it (index is [ix, iy, iz])" if array.T.shape == shape else "")
        )
    if array.dtype == np.float16:
        array = array.astype(np.float32)
    elif array.dtype.kind == "f" and array.dtype.itemsize > 8:
        array = array.astype(np.float64)
    return np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("="))
