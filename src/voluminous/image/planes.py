"""Checks of the arrays an image holds, and arrays that are the same in every channel."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..units import as_quantity, is_quantity, plain

Array = NDArray[np.floating[Any]]

# What an image may hold beside intensities, by the names of its properties and arguments.
PLANES = ("transparency", "optical_depth", "error", "lower", "upper")


def intensity(values: Any, unit: Any) -> tuple[Array, str]:
    """Return intensities as an array (ny, nx, channel) of floats, and the name of their unit.

    Raises
    ------
    InputError
        If they do not have two or three axes, are empty, or are not real numbers.
    """
    values = as_quantity(values)
    if is_quantity(values):
        unit = unit or values.unit
        converted = values.value if values.unit == unit else plain(values, unit, "intensity")
        return intensity(converted, str(unit))
    array = _floats(values, "intensity")
    array = array[..., None] if array.ndim == 2 else array
    if array.ndim != 3 or array.size == 0:
        raise InputError(
            f"intensity has shape {array.shape}, expected (ny, nx, channel) or (ny, nx), not empty"
        )
    return array, str(unit or "")


def plane(values: Any, shape: tuple[int, ...], what: str) -> Array | None:
    """Return an array of shape (ny, nx, channel), or (ny, nx, 1) if the same in every channel.

    Raises
    ------
    InputError
        If it cannot be broadcast to `shape`.
    """
    if values is None:
        return None
    values = as_quantity(values)
    array = _floats(plain(values, None, what) if is_quantity(values) else values, what)
    array = array[..., None] if array.ndim == 2 else array
    grey = array.ndim == 0 or array.shape[-1] == 1
    wanted = (*shape[:2], 1) if grey else shape
    try:
        return np.broadcast_to(array, wanted)
    except ValueError:
        raise InputError(
            f"{what} has shape {np.shape(values)}, expected one that broadcasts to {shape}, "
            f"or {shape[:2]}"
        ) from None


def spread(array: Array | None, shape: tuple[int, ...]) -> Array | None:
    """Return a read-only view with a value for every channel."""
    return None if array is None else np.broadcast_to(array, shape)


def gathered(array: Array) -> Array:
    """Undo `spread`: one channel if all share the same memory, as grey extinction does."""
    shared = array.ndim == 3 and array.strides[-1] == 0
    return array[..., :1] if shared else array


def _floats(values: Any, what: str) -> Array:
    if hasattr(values, "to_rgb"):
        raise InputError(
            f"{what} is an Image, and its array is the picture it shows; give image.intensity"
        )
    try:
        array = np.asarray(values)
    except ValueError as error:  # rows of several lengths
        raise InputError(f"{what} must be an array of real numbers: {error}") from None
    if array.dtype.kind not in "fiub":
        raise InputError(f"{what} must be real numbers, got an array of {array.dtype}")
    single = array.dtype.kind == "f" and array.dtype.itemsize <= 4
    return array.astype(np.float32 if single else np.float64, copy=False)


def narrowed(values: Array, kind: type[np.floating[Any]], what: str) -> Array:
    """Round to a narrower kind of float, refusing what it cannot hold.

    Raises
    ------
    InputError
        If the greatest value is beyond its range, or so small that few digits would be left.
    """
    if values.dtype == kind:
        return values  # nothing is lost, however small
    info = np.finfo(kind)
    top = np.abs(values, where=np.isfinite(values), out=np.zeros_like(values)).max()
    if top > info.max or 0 < top < info.tiny:
        raise InputError(
            f"{what} reaches {top:.3g}, but {info.dtype} holds {info.tiny:.2g} to {info.max:.2g}; "
            f"save as .fits or .npz, or scale it"
        )
    with np.errstate(under="ignore"):
        return values.astype(kind)
