"""What the formulas of own coordinates are computed with: numbers, or anything else.

Where a point is between the walls of its cell is written once (`Surfaces.fraction`); guaranteed
bounds evaluate the same formulas with intervals and their derivatives (`bounds.curved`).
"""

from __future__ import annotations

from typing import Any, Protocol

from ...backend import dr
from ...backend.functions import sharp_angle, unit_interval
from ...backend.types import Float
from .edges import FULL_CIRCLE


class Arithmetic(Protocol):
    """Operations on coordinates of points; other operands are numbers of the kernel."""

    def length(self, x: Float, y: Float, z: Float = None) -> Any:
        """Return the length of a vector."""

    def mixed(self, a: Float, p: Any, b: Float, q: Any) -> Any:
        """Return a p + b q, of coordinates a and b and numbers p and q."""

    def angle(self, y: Float, x: Float, length: Float = None) -> Any:
        """Return the angle of a vector from the x axis, from -π to π.

        Its length is given where the angle is at most π/4 in size.
        """

    def magnitude(self, a: Float) -> Any:
        """Return a coordinate without its sign."""

    def part(self, value: Float, lower: Float, inverse: Any) -> Any:
        """Return where between two walls a coordinate is: zero at `lower`, and one at most."""

    def stretched(self, part: Any, factor: Any) -> Any:
        """Return a part times a number, one at most."""

    def upward(self, angle: Any) -> Any:
        """Return an angle from a wall, which the point is above: from 0 to 2π."""


class PlainNumbers:
    """The arithmetic of plain numbers."""

    def length(self, x: Float, y: Float, z: Float = None) -> Any:
        """Return the length of a vector."""
        square = y * y if z is None else dr.fma(y, y, z * z)
        return dr.sqrt(dr.fma(x, x, square))

    def mixed(self, a: Float, p: Any, b: Float, q: Any) -> Any:
        """Return a p + b q."""
        return dr.fma(a, p, b * q)

    def angle(self, y: Float, x: Float, length: Float = None) -> Any:
        """Return the angle of a vector."""
        return dr.atan2(y, x) if length is None else sharp_angle(y, x, length)

    def magnitude(self, a: Float) -> Any:
        """Return a number without its sign."""
        return dr.abs(a)

    def part(self, value: Float, lower: Float, inverse: Any) -> Any:
        """Return where between two walls a coordinate is, from 0 to 1."""
        return unit_interval((value - lower) * inverse)

    def stretched(self, part: Any, factor: Any) -> Any:
        """Return a part times a number, one at most."""
        return unit_interval(part * factor)

    def upward(self, angle: Any) -> Any:
        """Return an angle from a wall, from 0 to 2π."""
        # Rounding puts points a hair below their wall.
        return dr.select(angle < -1e-3, angle + FULL_CIRCLE, angle)


NUMBERS = PlainNumbers()
