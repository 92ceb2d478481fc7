"""Means of a shape times factors that vary along a stretch: gates, and colours of another field.

The shape is known at the eight places of Gauss and Legendre, the factors at five: what multiplies
the samples is the polynomial through these. How far that is from the factors is not known: they are
taken to be off by about as much as the next of its coefficients would be.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..backend import dr
from .sampled import EIGHT, FIVE, WEIGHTS_OF_EIGHT, Sampled
from .stretch import extremes

# What the polynomial through five values may be off by, in what `unseen` tells. With 0.5 0.8 % of
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


def products(shape: list[Any], off: Any, factors: list[list[Any]]) -> list[Sampled]:
    """Return the means of a shape times each of some factors.

    Parameters
    ----------
    shape : eight arrays
        The shape at `sampled.EIGHT`.
    off : array
        How far its mean may be off.
    factors : list of five arrays each
        The factors at `sampled.FIVE`.
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


def unseen(values: list[Any]) -> Any:
    """Return how far a function with these values may be from their polynomial, by its decay.

    Coefficients of smooth functions fall by about the same factor from one to the next.
    """
    second, third, fourth = (dr.abs(dot(row, values)) for row in _LEGENDRE)
    other = second + third
    return dr.fma(third, third / dr.select(other > 0.0, other, 1.0), fourth)


def dot(weights: Any, values: list[Any]) -> Any:
    """Return the sum of values times numbers, or arrays."""
    total = 0.0 * values[0]
    # NumPy's own numbers would look into arrays of Dr.Jit's.
    own = weights.tolist() if isinstance(weights, np.ndarray) else weights
    for weight, value in zip(own, values, strict=True):
        total = dr.fma(weight, value, total)
    return total
