"""Sums, products and quotients together with their rounding errors, which tell how to round.

The error of a sum or product is itself a floating-point number: Knuth, *The Art of Computer
Programming* II (1997), section 4.2.2, and Dekker, *Numerische Mathematik* 18 (1971), 224-242. Where
it is not known, near overflow and underflow, it is NaN.
"""

from __future__ import annotations

from typing import Any

import numpy as np

Array = Any  # arrays of float64; NumPy's functions take and return scalars as well

# Splits 53 bits into halves.
_SPLITTER = 2.0**27 + 1
# Errors of smaller products may be too small to be a number.
_SMALLEST = 2.0**-960


def total(x: Array, y: Array) -> tuple[Array, Array]:
    """Return the rounded sum and what is missing to the sum."""
    rounded = x + y
    shift = rounded - x
    return rounded, (x - (rounded - shift)) + (y - shift)


def product(x: Array, y: Array) -> tuple[Array, Array]:
    """Return the rounded product and what is missing to the product."""
    rounded = x * y
    (a, b), (c, d) = _halves(x), _halves(y)
    error = ((a * c - rounded) + a * d + b * c) + b * d
    known = (np.abs(rounded) > _SMALLEST) | (x == 0) | (y == 0)
    return rounded, np.where(known, error, np.nan)


def quotient(x: Array, y: Array) -> tuple[Array, Array]:
    """Return the rounded quotient and a number of the sign of what is missing to the quotient."""
    rounded = x / y
    back, error = product(rounded, y)
    known = (np.abs(rounded) > _SMALLEST) | (x == 0)
    return rounded, np.where(known, ((x - back) - error) / y, np.nan)


def outward(value: Array, error: Array, toward: float) -> Array:
    """Return a rounded value, moved on towards an infinity if it was rounded away from there.

    What underflows to a zero keeps the sign that the zero carries.
    """
    sign = np.sign(toward)
    underflow = (value == 0) & (np.signbit(value) == (sign > 0))
    return np.where((error * sign <= 0) | underflow, value, np.nextafter(value, toward))


def _halves(x: Array) -> tuple[Array, Array]:
    large = _SPLITTER * x
    high = large - (large - x)
    return high, x - high
