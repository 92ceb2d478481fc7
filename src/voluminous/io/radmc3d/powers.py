"""Whole numbers times powers of ten as the nearest doubles: proven to be, or told not to be.

A product is computed as an unevaluated sum of two doubles (T. J. Dekker, Numer. Math. 18, 224,
1971), with an error below 2^-103. If it rounds to the same double with that much added and taken
away, this is the nearest one (A. Ziv, ACM TOMS 17, 410, 1991).
"""

from __future__ import annotations

import functools
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

# Between these nothing overflows, and no part of a product is denormal.
LEAST, MOST = -270, 270
# 2^27 + 1: a double times this splits it into two halves, whose products are exact.
_SPLIT = 134217729.0
# Sum of all errors: of the table 2^-107, of what is neglected 2^-106, of four roundings 2^-104.
_MARGIN = 2.0**-101


@functools.cache
def _tables() -> tuple[NDArray[np.float64], ...]:
    """Return powers of ten as sums of two doubles, and the upper halves of the first ones."""
    exact = [Fraction(10) ** q for q in range(LEAST, MOST + 1)]
    high = [float(f) for f in exact]
    low = [float(f - Fraction(h)) for f, h in zip(exact, high, strict=True)]
    power = np.array(high)
    return power, np.array(low), _upper_half(power)


def _upper_half(x: NDArray[np.float64]) -> NDArray[np.float64]:
    half = x * _SPLIT
    half -= half - x
    return half


def scaled(
    whole: NDArray[np.uint64], exponent: NDArray[np.int64], unsure: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return ``whole * 10**exponent`` rounded to nearest, ties to even.

    Parameters
    ----------
    whole : array of uint64
        Below 10^19.
    exponent : array of int64
        From `LEAST` to `MOST`; results for others are wrong.
    unsure : array of bool
        Set where the result may not be the nearest; never where it is.
    """
    power, rest, upper = _tables()
    row = exponent - LEAST
    a = whole.astype(np.float64)
    a_rest = (whole - a.astype(np.uint64)).view(np.int64).astype(np.float64)
    b, b_up = power.take(row, mode="clip"), upper.take(row, mode="clip")
    b_low, a_up = b - b_up, _upper_half(a)
    a_low, product = a - a_up, a * b
    error = a_up * b_up  # minus the product: what its rounding took away, exactly
    error -= product
    error += a_up * b_low
    error += a_low * b_up
    error += a_low * b_low
    error += a * rest.take(row, mode="clip") + a_rest * b
    margin = product * _MARGIN
    result: NDArray[np.float64] = product + (error - margin)
    error += margin
    error += product
    unsure |= result != error
    return result
