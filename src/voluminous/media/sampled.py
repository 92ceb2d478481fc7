"""Means over a stretch on which a medium is smooth, from a few samples, with error estimates.

Shapes whose sixth derivative is known take four nodes, both ends among them, which are exact for
polynomials of degree five (Lobatto's rule; Abramowitz & Stegun 1964, 25.4.32); where that is not
enough, eight of Gauss and Legendre, the error of which follows from how large the shape is in the
complex plane around the stretch (Trefethen 2008, SIAM Review 50, 67). Piecewise-linear tables take
two Gauss-Legendre nodes (`table_bends`). Other smooth functions have no bounds: five
nodes of Lobatto's rule (degree seven) are compared with the three of Simpson's rule (degree
three) among them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..backend import dr
from ..backend.types import Float
from .stretch import extremes

# Gauss and Legendre's places and weights on [0, 1].
EIGHT, WEIGHTS_OF_EIGHT = (
    tuple(float(v) for v in values)
    for values in (
        0.5 + 0.5 * np.polynomial.legendre.leggauss(8)[0],
        0.5 * np.polynomial.legendre.leggauss(8)[1],
    )
)
# Lobatto's places and weights on [0, 1].
PLACES = (0.0, 0.5 - math.sqrt(0.05), 0.5 + math.sqrt(0.05), 1.0)
WEIGHTS = (1 / 12, 5 / 12, 5 / 12, 1 / 12)
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


@dataclass
class Sampled:
    """The mean over a stretch, from samples: of a shape, or of all coefficients (`MediumSample`).

    With the values at both ends, of the function or of a line through the samples, and the error
    of the mean; infinite where it is unknown.
    """

    mean: Float
    first: Float
    last: Float
    off: Float

    def __iter__(self) -> Iterator[Any]:
        """Yield all four."""
        return iter((self.mean, self.first, self.last, self.off))


def compared(values: list[Float]) -> Sampled:
    """Return the mean of a function with these values at five nodes, its ends, and the error.

    The error is the difference of two rules, the better of which gives the mean. The true error is
    far smaller, unless both agree by accident, as they do for a step at some places.
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


def missed_by_pair(nodes: list[Float], pair: list[Float]) -> Float:
    """Return the error of the mean of a function at the places `PAIR`, by its three nodes."""
    first, middle, last = nodes
    ends, inner, central = _WEIGHTS_OF_PAIR
    both = pair[0] + pair[1]
    mean = dr.fma(ends, first + last, dr.fma(inner, both, central * middle))
    return dr.abs(mean - 0.5 * both)


# What the polynomial through five values may be off by, in units of `unseen`. With 0.5 0.8 % of
# the pixels of coloured sheets in noise were beyond their error, with 2 0.3 %, in 1.05 of the time.
UNKNOWN = 2.0


def _lagrange(nodes: Sequence[float], places: Sequence[float]) -> np.ndarray:
    """Return by what values at nodes are multiplied to have their polynomial at places."""
    return np.array(
        [[np.prod([(s - b) / (a - b) for b in nodes if b != a]) for a in nodes] for s in places]
    )


# Weights of Gauss and Legendre for the mean, and for half of what a line through it rises by.
_MEAN = np.array(WEIGHTS_OF_EIGHT)
_LEAN = 6.0 * (np.array(EIGHT) - 0.5) * _MEAN
_AT_EIGHT = _lagrange(FIVE, EIGHT)
# Values at the five places to the coefficients of Legendre's second to fourth polynomials.
_LEGENDRE = np.linalg.inv(np.polynomial.legendre.legvander(2.0 * np.array(FIVE) - 1.0, 4))[2:]


def products(shape: list[Float], off: Float, factors: list[list[Any]]) -> list[Sampled]:
    """Return the means of a shape at the places `EIGHT` times each of some factors at `FIVE`.

    `off` bounds the error of the shape's mean.
    """
    whole = dot(_MEAN, shape)
    mean, lean = (
        [dot(weights * column, shape) for column in _AT_EIGHT.T] for weights in (_MEAN, _LEAN)
    )
    found = []
    for values in factors:
        center, rise = dot(mean, values), dot(lean, values)
        largest = extremes([dr.abs(v) for v in values])[1]
        error = dr.fma(UNKNOWN * unseen(values), whole, off * largest)
        found.append(Sampled(center, center - rise, center + rise, error))
    return found


def unseen(values: list[Float]) -> Float:
    """Return how far a function with these values may be from their polynomial, by its decay.

    Coefficients of smooth functions fall by about the same factor from one to the next.
    """
    second, third, fourth = (dr.abs(dot(row, values)) for row in _LEGENDRE)
    other = second + third
    return dr.fma(third, third / dr.select(other > 0.0, other, 1.0), fourth)


def dot(weights: Any, values: list[Float]) -> Any:
    """Return the sum of values times numbers, or arrays."""
    total = 0.0 * values[0]
    # NumPy's own numbers would look into arrays of Dr.Jit's.
    own = weights.tolist() if isinstance(weights, np.ndarray) else weights
    for weight, value in zip(own, values, strict=True):
        total = dr.fma(weight, value, total)
    return total
