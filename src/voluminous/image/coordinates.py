"""Coordinates of pixel centres on the image plane, the size of a pixel and the outer edges."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, UnitsError
from ..units import parse_unit, plain, unit_of

Axis = NDArray[np.float64]


def length_unit(unit: Any, x: Any, y: Any) -> str:
    """Return the name of the unit of the image plane: `unit`, or else that of `x` or `y`."""
    if unit:
        return unit if isinstance(unit, str) else str(unit)
    found = unit_of(x) or unit_of(y)
    return "" if found is None else str(found)


def known_unit(unit: Any) -> Any:
    """Return the unit of a picture; None for one that is not known, as another program may name."""
    try:
        return parse_unit(unit)
    except UnitsError:
        return None


def axis(values: Any, count: int, unit: str, name: str) -> Axis:
    """Return `count` pixel-centre coordinates as float64; pixel indices for None.

    Raises
    ------
    InputError
        If their number is wrong, or they are not finite and strictly monotonic.
    """
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
    """Return the width and height of a pixel, in `unit`, that of the image plane.

    Of an axis with a single pixel only `given` can tell the size; without it the pixel is taken as
    square, and as 1 by 1 if there is only one.
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
