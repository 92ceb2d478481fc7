"""Means of shapes over a stretch on which their argument is linear (pre-integration).

The segment integrals of Engel, Kraus & Ertl (2001, Graphics Hardware, equation 8) in closed form
instead of in a table: they hold for shells much thinner than a stretch, and much thicker.
"""

from __future__ import annotations

import functools
import math
from typing import Any

from ..backend import dr
from ..backend.functions import decay, horner, precision_of

# Half width of a stretch, in σ, up to which the series is taken, and its terms. What is left out is
# 2e-6 and 1e-18 of the peak; beyond it the difference of error functions loses 3e-6 and 4e-16.
_SERIES = {"single": (0.3, 3), "double": (0.25, 8)}
# erf(x) = 1 - (Σ a_k x^k)^-16 to 3e-7 (Abramowitz & Stegun 1964, 7.1.28), in x √2.
_ERF = (0.0705230784, 0.0422820123, 0.0092705272, 0.0001520143, 0.0002765672, 0.0000430638)


def gaussian_mean(first: Any, last: Any) -> Any:
    """Return the mean of exp(-z²/2) for z from `first` to `last`.

    Parameters
    ----------
    first, last : Dr.Jit float arrays
        Distances from the centre in units of σ.
    """
    half = 0.5 * (last - first)
    limit, _ = _SERIES[precision_of(type(half))]
    mean = dr.if_stmt(
        args=(first, last, half), cond=dr.abs(half) <= limit, true_fn=_series, false_fn=_difference
    )
    return dr.select(dr.isnan(half), 0.0, mean)  # both ends infinite: log10 where nothing is


def _difference(first: Any, last: Any, half: Any) -> Any:
    """Return the difference of error functions at the ends, over the distance."""
    return dr.abs((_area(last) - _area(first)) / half)


def _series(first: Any, last: Any, half: Any) -> Any:
    """Integrate e^{-(m + h t)²/2} = e^{-m²/2} Σ He_k(m) (-h t)^k / k! term by term over t.

    The generating function of Hermite's polynomials (Abramowitz & Stegun 1964, 22.9.17).
    """
    _, terms = _SERIES[precision_of(type(half))]
    middle = 0.5 * (first + last)
    square = middle * middle
    total = horner(half * half, [horner(square, row) for row in _hermite_rows(terms)])
    return decay(0.5 * square) * total


@functools.cache
def _hermite_rows(terms: int) -> tuple[tuple[float, ...], ...]:
    """Return He_{2k}(m)/(2k + 1)! as polynomials of m², for k below `terms`."""
    rows = []
    for k in range(terms):
        n = 2 * k
        row = [0.0] * (k + 1)
        for j in range(k + 1):
            down = math.factorial(j) * math.factorial(n - 2 * j) * 2.0**j * (n + 1)
            row[k - j] = (-1.0) ** j / down
        rows.append(tuple(row))
    return tuple(rows)


def _area(z: Any) -> Any:
    """Return half the integral of exp(-z²/2) from 0 to z, by a rational function in single.

    Dr.Jit's error function takes 42 cycles per vector, this one 8.
    """
    scale = math.sqrt(math.pi / 8)
    if precision_of(type(z)) == "double":
        return scale * dr.erf(z * math.sqrt(0.5))
    size = dr.abs(z)
    base = horner(size, [1.0, *(a * 0.5 ** (0.5 * k) for k, a in enumerate(_ERF, start=1))])
    power = base * base
    power = power * power
    power = power * power
    value = scale - scale / (power * power)
    return dr.select(z < 0.0, -value, value)


def box_mean(first: Any, last: Any) -> Any:
    """Return the mean of a shape that is one where |z| <= 1 and zero elsewhere."""
    low, high = dr.select(first < last, first, last), dr.select(first < last, last, first)
    inside = dr.select(high < 1.0, high, 1.0) - dr.select(low > -1.0, low, -1.0)
    way = high - low
    flat = dr.select(dr.abs(first) <= 1.0, 1.0, 0.0)
    mean = dr.select(inside > 0.0, inside, 0.0) / dr.select(way > 0.0, way, 1.0)
    return dr.select(way > 0.0, mean, flat * 1.0)
