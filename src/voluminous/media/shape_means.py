"""Means of shapes over a stretch on which their argument is linear (pre-integration).

The segment integrals of Engel, Kraus & Ertl (2001, Graphics Hardware, equation 8) in closed form
instead of in a table: they hold for shells much thinner than a stretch, and much thicker.
"""

from __future__ import annotations

import functools
import math
from typing import Any

from ..backend import dr
from ..backend.functions import decay, horner, polynomial, precision_of

# Half width of a stretch, in σ, up to which the series is taken, and its terms. What is left out is
# 2e-6 and 1e-18 of the peak; beyond it the difference of areas loses 3e-6 and 4e-15.
_SERIES = {"single": (0.3, 3), "double": (0.25, 8)}
# Of tails the series is good where their logarithm changes by less than twice that.
_CHANGE = 0.7
# What is fainter than that, as a fraction of the peak, a difference of error functions cannot tell.
_TAILS = 1e-8
# erf(x) = 1 - (Σ a_k x^k)^-16 to 3e-7 (Abramowitz & Stegun 1964, 7.1.28), in x √2.
_ERF = (0.0705230784, 0.0422820123, 0.0092705272, 0.0001520143, 0.0002765672, 0.0000430638)
# With t = 1/(1 + c z): half the area beyond z over exp(-z²/2) t, in powers of t - ½, fitted to 3e-7
# for z up to 13, and to 4e-16 up to 39, where exp(-z²/2) is below all numbers. First c.
_BEYOND = {
    "single": (
        0.3,
        0.278198916,
        0.412539199,
        0.433896566,
        0.278376371,
        0.0362760572,
        -0.0979481487,
        -0.0420702447,
        0.0471526816,
    ),
    "double": (
        0.25,
        0.2366523829135606,
        0.38094272770499343,
        0.48520477743387014,
        0.4675409629992524,
        0.3027835246113774,
        0.07560180334613241,
        -0.06977836123926959,
        -0.06540568592044091,
        0.01069579247979477,
        0.037073102156410624,
        -0.0006114863050250722,
        -0.022550394042529065,
        0.0009090685944465406,
        0.01517893260377236,
        -0.003137031207924928,
        -0.010398477970885731,
        0.005030898012882874,
        0.0061302197551617345,
        -0.00505127360829725,
        -0.002164024807046733,
        0.002524557738911338,
    ),
}


def gaussian_mean(first: Any, last: Any, faint: float = 0.0) -> Any:
    """Return the mean of exp(-z²/2) for z from `first` to `last`.

    Parameters
    ----------
    first, last : Dr.Jit float arrays
        Distances from the centre in units of σ.
    faint : float
        Means below that may be off as much as those near the peak: in single precision, thin shells
        in noise take 0.85 of the time then.
    """
    half = 0.5 * (last - first)
    kind = precision_of(type(half))
    narrow = dr.abs(half) <= _SERIES[kind][0]
    tails = kind == "double" or faint < _TAILS
    if tails:
        narrow &= dr.abs(half * (0.5 * (first + last))) <= _CHANGE
    mean = dr.if_stmt(
        args=(first, last, half),
        cond=narrow,
        true_fn=_series,
        false_fn=_difference_of_tails if tails else _difference,
    )
    return dr.select(dr.isnan(half), 0.0, mean)  # both ends infinite: log10 where nothing is


def _difference(first: Any, last: Any, half: Any) -> Any:
    """Return the difference of error functions at the ends, over the distance."""
    return dr.abs((_area(last) - _area(first)) * (1.0 / half))


def _difference_of_tails(first: Any, last: Any, half: Any) -> Any:
    """Return the same from the areas beyond the ends.

    Of an opaque shell only the tail shows: there error functions are one but for rounding.
    """
    apart = (first < 0.0) ^ (last < 0.0)
    one, other = _beyond(first), _beyond(last)
    area = dr.select(apart, math.sqrt(math.pi / 2) - one - other, dr.abs(one - other))
    return area / dr.abs(half)


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
    size = dr.abs(z)
    base = polynomial(size, [1.0, *(a * 0.5 ** (0.5 * k) for k, a in enumerate(_ERF, start=1))])
    power = base * base
    power = power * power
    power = power * power
    value = scale - scale / (power * power)
    return dr.select(z < 0.0, -value, value)


def _beyond(z: Any) -> Any:
    """Return half the integral of exp(-z²/2) from |z| to infinity, with all its digits."""
    bend, *powers = _BEYOND[precision_of(type(z))]
    size = dr.abs(z)
    t = 1.0 / dr.fma(size, bend, 1.0)
    return decay(0.5 * (z * z)) * t * polynomial(t - 0.5, powers)


def box_mean(first: Any, last: Any) -> Any:
    """Return the mean of a shape that is one where |z| <= 1 and zero elsewhere."""
    low, high = dr.select(first < last, first, last), dr.select(first < last, last, first)
    inside = dr.select(high < 1.0, high, 1.0) - dr.select(low > -1.0, low, -1.0)
    way = high - low
    flat = dr.select(dr.abs(first) <= 1.0, 1.0, 0.0)
    mean = dr.select(inside > 0.0, inside, 0.0) / dr.select(way > 0.0, way, 1.0)
    return dr.select(way > 0.0, mean, flat * 1.0)
