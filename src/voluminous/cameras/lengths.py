"""Vectors and lengths that a camera is given, with or without units."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from ..units import as_given, degrees, is_quantity, parse_unit, plain, unit_name, unit_of


def point(value: Any, unit: Any, what: str) -> np.ndarray:
    """Return a point as three floats in `unit`."""
    return as_vector(plain(value, unit, what), 3, what)


def vector_of(value: Any, what: str) -> np.ndarray:
    """Return three plain floats, whatever their unit: only the direction counts."""
    return as_vector(plain(value, unit_of(value), what), 3, what)


def common_unit(value: Any, what: str) -> Any:
    """Return the unit of all lengths of a vector; None for plain numbers.

    Raises
    ------
    InputError
        If some have a unit and others, which are in the volume's, have none. Zeros need none.
    """
    unit = unit_of(as_given(value, what))
    parts = value if unit is not None and isinstance(value, (list, tuple)) else ()
    if any(unit_of(part) is None and np.any(plain(part, None, what)) for part in parts):
        raise InputError(f"{what} must have units for all of its numbers or none, got {value!r}")
    return unit


def as_vector(value: Any, length: int, what: str) -> np.ndarray:
    """Return `length` finite floats.

    Raises
    ------
    InputError
        If there are more or fewer, or one is not finite.
    """
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (length,) or not np.all(np.isfinite(array)):
        raise InputError(f"{what} must be {length} finite numbers, got {value!r}")
    return array


def finite_degrees(value: Any, what: str) -> float:
    """Return an angle in degrees; plain numbers are degrees.

    Raises
    ------
    InputError
        If it is not finite.
    """
    angle = degrees(value, what)
    if not np.isfinite(angle):
        raise InputError(f"{what} must be finite, got {angle}")
    return angle


def described(value: Any) -> Any:
    """Return a length or a vector of lengths as plain values: numbers, or texts such as "1 pc"."""
    if isinstance(value, (list, tuple)) and not all(is_quantity(v) for v in value):
        return [described(v) for v in value]  # what has no unit is in the volume's
    unit = unit_of(value)
    numbers = np.asarray(plain(value, unit, "length"))
    if unit is None and not is_quantity(value):
        return numbers.tolist()
    name = unit_name(parse_unit(unit))
    texts = [f"{float(n)!r} {name}".strip() for n in np.atleast_1d(numbers)]
    return texts[0] if numbers.ndim == 0 else texts
