"""Coefficients at the nodes of Lobatto's rule on a stretch, and how far the rule is off there.

Four nodes, both ends among them, are exact for polynomials of degree five (Abramowitz & Stegun
1964, 25.4.32).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..backend.functions import decay, horner
from .stretch import extremes

if TYPE_CHECKING:
    from .contract import Coefficients

# Places and weights on [0, 1], and what the rule is off by: the sixth derivative over this.
PLACES = (0.0, 0.5 - math.sqrt(0.05), 0.5 + math.sqrt(0.05), 1.0)
WEIGHTS = (1 / 12, 5 / 12, 5 / 12, 1 / 12)
_OFF = 1_512_000.0
# The second to sixth derivative of exp(-z²/2) are below these times its square root.
_DERIVATIVES = (1.15, 1.95, 3.75, 8.3, 20.0)
# A Gaussian is smooth where its argument changes by less than this along a stretch, in σ.
_SMOOTH = 3.0


@dataclass
class AtNodes:
    """Coefficients at the nodes of a stretch.

    Attributes
    ----------
    nodes : list of four Coefficients
        At `PLACES`.
    off : Coefficients
        How far their mean may be off; infinite where nothing is known.
    """

    nodes: list[Coefficients]
    off: Coefficients


@dataclass
class ShapeAtNodes:
    """A shape at the nodes of a stretch, and how far its mean may be off."""

    nodes: list[Any]
    off: Any

    def times(self, factor: Any) -> ShapeAtNodes:
        """Return all of it times a number that is not negative."""
        return ShapeAtNodes([factor * value for value in self.nodes], factor * self.off)


def mean(values: Sequence[Any]) -> Any:
    """Return the mean of a function with these values at the nodes."""
    first, second, third, last = values
    return dr.fma(WEIGHTS[0], first + last, WEIGHTS[1] * (second + third))


def gaussian_at_nodes(nodes: list[Any], derivatives: list[Any]) -> ShapeAtNodes:
    """Return exp(-z²/2) at nodes, with a bound of the error of its mean.

    That is made of the sixth derivative by the place: with numbers for derivatives, T₂ … T₆ of the
    Gaussian by z and z₁ … z₃ of z by the place, T₆ z₁⁶ + 15 T₅ z₁⁴ z₂ + T₄ (45 z₁² z₂² +
    20 z₁³ z₃) + T₃ (15 z₂³ + 60 z₁ z₂ z₃) + 10 T₂ z₃² (Faà di Bruno's formula).

    Parameters
    ----------
    nodes : four arrays
        z at the nodes.
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
    return ShapeAtNodes(values, dr.select(z1 <= _SMOOTH, off, dr.inf))
