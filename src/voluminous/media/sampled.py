"""Means over a stretch on which a medium is smooth, from a few samples: how far they are off.

Shapes whose sixth derivative is known take four nodes, both ends among them, which are exact for
polynomials of degree five (Lobatto's rule; Abramowitz & Stegun 1964, 25.4.32); where that is not
enough, eight of Gauss and Legendre, the error of which follows from how large the shape is in the
complex plane around the stretch (Trefethen 2008, SIAM Review 50, 67). Piecewise-linear tables take
two nodes of Gauss and Legendre (`table_bends`). Of other smooth functions
nothing is known: five nodes of Lobatto's rule (degree seven) are compared with the three of
Simpson's (degree three) among them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..backend import dr
from ..backend.functions import decay, horner, precision_of
from .stretch import extremes

# Gauss and Legendre's places and weights on [0, 1].
EIGHT, WEIGHTS_OF_EIGHT = (
    tuple(float(v) for v in values)
    for values in (
        0.5 + 0.5 * np.polynomial.legendre.leggauss(8)[0],
        0.5 * np.polynomial.legendre.leggauss(8)[1],
    )
)
# Ellipses around [0, 1], with half axes of (ρ ± 1/ρ)/4, and parts of a cubic's first three
# derivatives on the stretch that no imaginary part on them is above. For functions no larger than
# one there eight samples are off by 64/15 ρ^-16/(1 - ρ^-2) at most. The second is for tolerances of
# 1e-7 and less, which the first never meets: in double precision alone.
_SMALL, _LARGE = (3.0, (2 / 3, 0.073, 0.05)), (6.0, (1.46, 1.13, 0.6))
_ELLIPSES = {"single": [_SMALL], "double": [_SMALL, _LARGE]}
# With more of it nothing is known: 3 % for a line of seven and a half σ.
_MOST_ASIDE = 5.0
# Lobatto's places and weights on [0, 1], and what is off: the sixth derivative over this.
PLACES = (0.0, 0.5 - math.sqrt(0.05), 0.5 + math.sqrt(0.05), 1.0)
WEIGHTS = (1 / 12, 5 / 12, 5 / 12, 1 / 12)
_OFF = 1_512_000.0
# The same with five nodes, and the weights of Simpson's rule with the first, third and fifth.
FIVE = (0.0, 0.5 - math.sqrt(3 / 28), 0.5, 0.5 + math.sqrt(3 / 28), 1.0)
WEIGHTS_OF_FIVE = (1 / 20, 49 / 180, 16 / 45, 49 / 180, 1 / 20)
_SIMPSON = (1 / 6, 2 / 3)
# What two rules may agree about by accident, of how sharply the function turns at inner nodes.
_BY_ACCIDENT = 0.06
# Those of Gauss and Legendre, equal weights.
PAIR = (0.5 - math.sqrt(1 / 12), 0.5 + math.sqrt(1 / 12))
# The same with both ends and the middle: exact for polynomials of degree five.
_WEIGHTS_OF_PAIR = (1 / 15, 3 / 10, 4 / 15)
# The second to sixth derivative of exp(-z²/2) are below these times its square root.
_DERIVATIVES = (1.15, 1.95, 3.75, 8.3, 20.0)
# A Gaussian is smooth where its argument changes by less than this along a stretch, in σ.
_SMOOTH = 3.0


@dataclass
class Sampled:
    """The mean over a stretch, from samples: of a shape, or of all coefficients.

    Attributes
    ----------
    mean : array or Coefficients
        The mean.
    first, last : array or Coefficients
        What it begins and ends with, or a line through the samples does.
    off : array or Coefficients
        How far the mean may be off; infinite where nothing is known.
    """

    mean: Any
    first: Any
    last: Any
    off: Any

    def __iter__(self) -> Iterator[Any]:
        """Yield all four."""
        return iter((self.mean, self.first, self.last, self.off))


def compared(values: list[Any]) -> Sampled:
    """Return the mean of a function with these values at five nodes, its ends, and the error.

    The latter is the difference of two rules, of which the better is used: in truth it is off by
    far less, unless both agree by accident, as they do about a step at some places.
    """
    first, second, middle, fourth, last = values
    ends, inner = first + last, second + fourth
    outer, between, central = WEIGHTS_OF_FIVE[:3]
    mean = dr.fma(outer, ends, dr.fma(between, inner, central * middle))
    simpson = dr.fma(_SIMPSON[0], ends, _SIMPSON[1] * middle)
    wide, narrow = FIVE[2] - FIVE[1], FIVE[1]
    turns = [
        dr.abs((c - b) * before - (b - a) * after)
        for a, b, c, before, after in (
            (first, second, middle, narrow, wide),
            (second, middle, fourth, wide, wide),
            (middle, fourth, last, wide, narrow),
        )
    ]
    off = dr.fma(_BY_ACCIDENT, turns[0] + turns[1] + turns[2], dr.abs(mean - simpson))
    return Sampled(mean, first, last, off)


def missed_by_pair(nodes: list[Any], pair: list[Any]) -> Any:
    """Return how far the mean of a function at the places `PAIR` is off: with three more.

    Parameters
    ----------
    nodes : three arrays
        The function at both ends and, between them, in the middle.
    pair : two arrays
        The function at `PAIR`.
    """
    first, middle, last = nodes
    ends, inner, central = _WEIGHTS_OF_PAIR
    both = pair[0] + pair[1]
    mean = dr.fma(ends, first + last, dr.fma(inner, both, central * middle))
    return dr.abs(mean - 0.5 * both)


def sampled_gaussian(nodes: list[Any], derivatives: list[Any]) -> Sampled:
    """Return the mean of exp(-z²/2) over a stretch, with a bound of its error.

    The latter is made of the sixth derivative by the place: with numbers for derivatives, T₂ … T₆
    of the Gaussian by z and z₁ … z₃ of z by the place, T₆ z₁⁶ + 15 T₅ z₁⁴ z₂ + T₄ (45 z₁² z₂² +
    20 z₁³ z₃) + T₃ (15 z₂³ + 60 z₁ z₂ z₃) + 10 T₂ z₃² (Faà di Bruno's formula).

    Parameters
    ----------
    nodes : four arrays
        z at Lobatto's `PLACES`.
    derivatives : three arrays
        Bounds of |z₁|, |z₂| and |z₃|.
    """
    values = [decay(0.5 * (z * z)) for z in nodes]
    largest = extremes(values)[1]
    z1, z2, z3 = derivatives
    t2, t3, t4, t5, t6 = (t / _OFF for t in _DERIVATIVES)
    square = z1 * z1
    straight = horner(square, [15.0 * t3 * z2 * z2 * z2, 45.0 * t4 * z2 * z2, 15.0 * t5 * z2, t6])
    turning = dr.fma(z1, 20.0 * t4 * square + 60.0 * t3 * z2, 10.0 * t2 * z3)
    off = dr.sqrt(largest) * dr.fma(z3, turning, straight)
    start, *inner, end = values
    mean = dr.fma(WEIGHTS[0], start + end, WEIGHTS[1] * (inner[0] + inner[1]))
    return Sampled(mean, start, end, dr.select(z1 <= _SMOOTH, off, dr.inf))


def finely_sampled_gaussian(nodes: list[Any], derivatives: list[Any]) -> Sampled:
    """Return the same from z at the places `EIGHT`: good for slopes of up to five σ.

    In an ellipse the Gaussian is at most exp(y²/2), with y the imaginary part of z.
    """
    values = [decay(0.5 * (z * z)) for z in nodes]
    mean, lean = values[0] * 0.0, values[0] * 0.0
    for place, weight, value in zip(EIGHT, WEIGHTS_OF_EIGHT, values, strict=True):
        mean = dr.fma(weight, value, mean)
        lean = dr.fma(6.0 * (place - 0.5) * weight, value, lean)
    off = mean + dr.inf
    for rho, parts in _ELLIPSES[precision_of(type(mean))]:
        y = sum(part * d for part, d in zip(parts, derivatives, strict=True))
        least = 64 / 15 * rho**-16 / (1 - rho**-2)
        here = dr.select(y < _MOST_ASIDE, least / decay(0.5 * (y * y)), dr.inf)
        off = dr.select(here < off, here, off)
    return Sampled(mean, mean - lean, mean + lean, off)
