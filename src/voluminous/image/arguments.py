"""Validation of the arguments of `Image`: arrays, coordinates, units and world coordinates."""

from __future__ import annotations

import json
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, UnitsError
from ..units import as_quantity, is_quantity, parse_unit, plain, shown, unit_of

if TYPE_CHECKING:
    from astropy import units as u
    from astropy.wcs import WCS

Array = NDArray[np.floating[Any]]
Axis = NDArray[np.float64]

# Names of the arrays that an image may hold beside intensities (properties and arguments).
PLANES = ("transparency", "optical_depth", "error", "lower", "upper")


def intensity(values: Any, unit: Any) -> tuple[Array, str]:
    """Return intensities as an array (ny, nx, channel) of floats, and the name of their unit."""
    values = as_quantity(values)
    if is_quantity(values):
        unit = values.unit if unit is None or _is_empty(unit) else unit
        values = values.value if values.unit == unit else plain(values, unit, "intensity")
    array = _floats(values, "intensity")
    array = array[..., None] if array.ndim == 2 else array
    if array.ndim != 3 or array.size == 0:
        raise InputError(
            f"intensity has shape {array.shape}, expected (ny, nx, channel) or (ny, nx), not empty"
        )
    return array, "" if unit is None else str(unit)


def _is_empty(unit: Any) -> bool:
    return isinstance(unit, str) and not unit


def plane(values: Any, shape: tuple[int, ...], what: str) -> Array | None:
    """Return an array of shape (ny, nx, channel), or (ny, nx, 1) if the same in every channel."""
    if values is None:
        return None
    values = as_quantity(values)
    array = _floats(plain(values, None, what) if is_quantity(values) else values, what)
    array = array[..., None] if array.ndim == 2 else array
    grey = array.ndim == 0 or array.shape[-1] == 1
    try:
        return np.broadcast_to(array, (*shape[:2], 1) if grey else shape)
    except ValueError:
        raise InputError(
            f"{what} has shape {np.shape(values)}, expected one that broadcasts to {shape}, "
            f"or {shape[:2]}"
        ) from None


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


def known_unit(unit: Any) -> u.UnitBase | None:
    """Return the unit of a picture; None if astropy cannot parse it."""
    try:
        known: u.UnitBase | None = parse_unit(unit)
    except UnitsError:
        return None
    return known


def length_unit(unit: Any, x: Any, y: Any) -> str:
    """Return the name of the unit of the image plane: `unit`, or else that of `x` or `y`."""
    present = unit_of(x) or unit_of(y) if unit is None or _is_empty(unit) else unit
    return "" if present is None else str(present)


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
    if given is None:
        steps = [(a[-1] - a[0]) / (a.size - 1) if a.size > 1 else None for a in (x, y)]
        square = next((abs(step) for step in steps if step is not None), 1.0)
        given = [square if step is None else step for step in steps]
    size = np.asarray(plain(given, unit or None, "pixel_size"))
    if size.shape != (2,) or not np.isfinite(size).all() or (size == 0).any():
        raise InputError(f"pixel_size must be two finite lengths (width, height), got {given!r}")
    return float(size[0]), float(size[1])


def distance(value: Any) -> float | None:
    """Return a distance in cm; plain numbers are cm."""
    if value is None:
        return None
    length = plain(value, "cm", "distance")
    if not isinstance(length, float) or not 0.0 < length < np.inf:
        raise InputError(
            f"distance must be one positive length such as 140 * u.pc, got {shown(value)}"
        )
    return length


def as_wcs(value: WCS | str | None, shape: tuple[int, ...]) -> WCS | None:
    """Return the WCS of an image: an astropy WCS of two axes, or one as the text of a header."""
    if value is None:
        return None
    wcs: Any = value
    if isinstance(value, str):
        from astropy.io.fits import Header
        from astropy.wcs import WCS

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            wcs = WCS(Header.fromstring(value), relax=True)
    if getattr(wcs, "pixel_n_dim", None) != 2 or not hasattr(wcs, "to_header"):
        raise InputError(f"wcs must be an astropy.wcs.WCS of two axes, got {value!r}")
    nx, ny = wcs.pixel_shape = wcs.pixel_shape or (shape[1], shape[0])
    if (ny, nx) != tuple(shape[:2]):
        raise InputError(f"wcs is for {nx} x {ny} pixels, the image has {shape[1]} x {shape[0]}")
    checked: WCS = wcs
    return checked


def json_value(value: Any, what: str) -> Any:
    """Return `value` as it will be after saving and loading: dicts, lists, strings and numbers."""
    if value is None:
        return None
    try:
        return json.loads(json.dumps(value, default=_plain_number))
    except (TypeError, ValueError, NotImplementedError) as error:
        raise InputError(
            f"{what} must be made of dicts, lists, strings, numbers, booleans and None, "
            f"so that it can be saved: {error}"
        ) from error


def _plain_number(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    raise TypeError(f"{value!r} is a {type(value).__name__}")
