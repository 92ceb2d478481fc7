"""Validation of the arguments of `Image`: arrays, coordinates, units and world coordinates."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, UnitsError
from ..units import as_quantity, is_quantity, parse_unit, plain, unit_of

if TYPE_CHECKING:
    from astropy.wcs import WCS

Array = NDArray[np.floating[Any]]

# Names of the arrays that an image may hold beside intensities (properties and arguments).
PLANES = ("transparency", "optical_depth", "error", "lower", "upper")


def intensity(values: Any, unit: Any) -> tuple[Array, str]:
    """Return intensities as an array (ny, nx, channel) of floats, and the name of their unit."""
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
    """Return an array of shape (ny, nx, channel), or (ny, nx, 1) if the same in every channel."""
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
    """Return a read-only view broadcast to every channel."""
    return None if array is None else np.broadcast_to(array, shape)


def gathered(array: Array) -> Array:
    """Undo `spread`: return one channel if all share the same memory (grey extinction)."""
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
    """Convert to a narrower float type; raise if a value does not fit."""
    if values.dtype == kind:
        return values  # no conversion, so subnormal values are exact too
    info = np.finfo(kind)
    top = np.abs(values, where=np.isfinite(values), out=np.zeros_like(values)).max()
    if top > info.max or 0 < top < info.tiny:
        raise InputError(
            f"{what} reaches {top:.3g}, but {info.dtype} holds {info.tiny:.2g} to {info.max:.2g}; "
            f"save as .fits or .npz, or scale it"
        )
    with np.errstate(under="ignore"):
        return values.astype(kind)


Axis = NDArray[np.float64]


def length_unit(unit: Any, x: Any, y: Any) -> str:
    """Return the name of the unit of the image plane: `unit`, or else that of `x` or `y`."""
    if unit:
        return unit if isinstance(unit, str) else str(unit)
    found = unit_of(x) or unit_of(y)
    return "" if found is None else str(found)


def known_unit(unit: Any) -> Any:
    """Return the unit of a picture; None if astropy cannot parse it."""
    try:
        return parse_unit(unit)
    except UnitsError:
        return None


def axis(values: Any, count: int, unit: str, name: str) -> Axis:
    """Return `count` pixel-centre coordinates as float64; pixel indices for None."""
    if values is None:
        return np.arange(count, dtype=np.float64)
    centres = np.atleast_1d(np.array(plain(values, unit or None, name), dtype=np.float64))
    if centres.shape != (count,):
        raise InputError(
            f"{name} has shape {centres.shape}, expected ({count},): one coordinate per pixel"
        )
    steps = np.diff(centres)
    if not np.isfinite(centres).all() or not ((steps > 0).all() or (steps < 0).all()):
        raise InputError(f"{name} must be finite and strictly increasing (or decreasing)")
    return centres


def pixel_size(x: Axis, y: Axis, given: Any, unit: str) -> tuple[float, float]:
    """Return the width and height of a pixel, in `unit`, the unit of the image plane.

    Along an axis with a single pixel the size comes from `given`; without it the pixel is assumed
    square, and 1 by 1 if the image has only one pixel.
    """
    if given is not None:
        return _checked_size(given, unit)
    width, height = _mean_step(x), _mean_step(y)
    square = next((abs(step) for step in (width, height) if step is not None), 1.0)
    return (square if width is None else width, square if height is None else height)


def _checked_size(given: Any, unit: str) -> tuple[float, float]:
    size = np.asarray(plain(given, unit or None, "pixel_size"))
    if size.shape != (2,) or not np.isfinite(size).all() or (size == 0).any():
        raise InputError(f"pixel_size must be two finite lengths (width, height), got {given!r}")
    return float(size[0]), float(size[1])


def _mean_step(centres: Axis) -> float | None:
    if centres.size < 2:
        return None
    return float((centres[-1] - centres[0]) / (centres.size - 1))


def extent(x: Axis, y: Axis, size: tuple[float, float]) -> tuple[float, float, float, float]:
    """Return the outer edges of the outermost pixels: left, right, bottom, top."""
    width, height = size
    return (
        float(x[0] - width / 2),
        float(x[-1] + width / 2),
        float(y[0] - height / 2),
        float(y[-1] + height / 2),
    )


def as_wcs(value: Any, shape: tuple[int, ...]) -> Any:
    """Return the WCS of an image: an astropy WCS of two axes, or one as the text of a header.

    Parameters
    ----------
    value : astropy.wcs.WCS, str or None
        WCS of the pixels; the centre of the lower left pixel is (0, 0).
    shape : tuple of int
        Rows and columns of the image.
    """
    if value is None:
        return None
    wcs = _from_text(value) if isinstance(value, str) else value
    if getattr(wcs, "pixel_n_dim", None) != 2 or not hasattr(wcs, "to_header"):
        raise InputError(f"wcs must be an astropy.wcs.WCS of two axes, got {value!r}")
    if wcs.pixel_shape is None:
        wcs.pixel_shape = (shape[1], shape[0])
    if tuple(wcs.pixel_shape) != (shape[1], shape[0]):
        raise InputError(
            f"wcs is for {wcs.pixel_shape[0]} x {wcs.pixel_shape[1]} pixels, the image has "
            f"{shape[1]} x {shape[0]}"
        )
    return wcs


def text_of(wcs: WCS) -> str:
    """Return a WCS as the text of a FITS header."""
    return str(wcs.to_header_string(relax=True))


def _from_text(text: str) -> Any:
    from astropy.io.fits import Header
    from astropy.wcs import WCS

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return WCS(Header.fromstring(text), relax=True)


def json_value(value: Any, what: str) -> Any:
    """Return `value` as it will be after saving and loading: dicts, lists, strings and numbers."""
    if value is None:
        return None
    try:
        return json.loads(json.dumps(value, default=_plain_number))
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{what} must be made of dicts, lists, strings, numbers, booleans and None, "
            f"so that it can be saved: {error}"
        ) from error


def _plain_number(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    raise TypeError(f"{value!r} is a {type(value).__name__}")


def refuse_renamed(options: Mapping[str, Any]) -> None:
    """Raise the error for an unknown or renamed argument."""
    for name in options:
        if name == "position_angle":
            raise InputError("position_angle is now posang, as that of cameras")
        raise TypeError(f"unexpected argument {name!r}")
