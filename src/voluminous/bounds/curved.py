"""Enclosures along rays of fields that are multilinear in curvilinear coordinates.

x, y and z are linear along a ray; the curvilinear coordinates follow from them by roots and angles.
The grid's formulas are evaluated with intervals of values and derivatives (`TracedJet`), which
gives bounds of a field on a panel and of its distance from the chord.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..backend import Mask, dr
from ..backend.types import Float
from ..expressions.taylor import Derivative, TracedJet, TracedJetOps
from ..expressions.traced_interval import TracedInterval, extremes, lowered, raised
from ..grids.curvilinear.surfaces import FULL_CIRCLE, Arithmetic

_EPS = float(np.finfo(np.float64).eps)
# Rounding errors of a point of a ray, and of the derivatives of fields, in ε.
_LOSS = 16.0
# Rounding puts points above their wall below it by less (as `grids.curvilinear.surfaces` has it).
_BELOW = -1e-3


class JetArithmetic(Arithmetic):
    """Coordinates of a grid computed with jets; see `grids.curvilinear.surfaces.Arithmetic`."""

    def __init__(self, ops: TracedJetOps, real: Any) -> None:
        self.ops, self.real = ops, real

    def constant(self, value: Float) -> TracedJet:
        """Return a number of the kernel."""
        return TracedJet(TracedInterval.constant(self.real(value)))

    def length(self, x: TracedJet, y: TracedJet, z: TracedJet | None = None) -> TracedJet:
        """Return the length of a vector."""
        ops, others = self.ops, (y,) if z is None else (y, z)
        square = ops.multiply(x, x)
        for other in others:
            square = ops.add(square, ops.multiply(other, other))
        result: TracedJet = ops.sqrt(square)
        return result

    def mixed(self, a: TracedJet, p: Any, b: TracedJet, q: Any) -> TracedJet:
        """Return a p + b q."""
        first, second = (self.ops.multiply(c, self.constant(k)) for c, k in ((a, p), (b, q)))
        return self.ops.add(first, second)

    def angle(self, y: TracedJet, x: TracedJet, length: TracedJet | None = None) -> TracedJet:
        """Return the angle of a vector; `upward` takes care of where it jumps by a turn."""
        return self.ops.turning_angle(y, x)

    def magnitude(self, a: TracedJet) -> TracedJet:
        """Return a coordinate that keeps its sign, but for rounding, without it."""
        sign: Any = dr.select(a.value.lo + a.value.hi >= 0.0, 1.0, -1.0)
        return self.ops.multiply(a, self.constant(sign))

    def part(self, value: TracedJet, lower: Float, inverse: Any) -> TracedJet:
        """Return where between two walls a coordinate is, from 0 to 1."""
        above = self.ops.subtract(value, self.constant(lower))
        return self.stretched(above, inverse)

    def stretched(self, part: TracedJet, factor: Any) -> TracedJet:
        """Return a part times a number, from 0 to 1."""
        found = self.ops.multiply(part, self.constant(factor))
        value, undefined = found.value, found.value.nan | ~(found.value.lo <= found.value.hi)
        ends = [dr.clip(end, 0.0, 1.0) for end in (value.lo, value.hi)]
        low, high = dr.select(undefined, 0.0, ends[0]), dr.select(undefined, 1.0, ends[1])
        return TracedJet(TracedInterval(low, high), _sure(found.first), _sure(found.second))

    def upward(self, angle: TracedJet) -> TracedJet:
        """Return an angle from a wall, from 0 to 2π but for rounding.

        Half a turn from the wall it goes over to -π: a point there, on the upper wall of a cell of
        that width, may be beyond by rounding, and an enclosure may hold what is on both sides.
        """
        value = angle.value
        below, around = value.hi < _BELOW, (value.lo < _BELOW) & (value.hi > 3.0)
        low = dr.select(below, value.lo + FULL_CIRCLE, value.lo)
        high = dr.select(below, value.hi + FULL_CIRCLE, value.hi)
        high = dr.select(around, FULL_CIRCLE, high)
        return TracedJet(TracedInterval(low, high, value.nan), angle.first, angle.second)

    def multilinear(self, values: Float, place: list[Float]) -> TracedJet:
        """Return a field with given values[x][y][z] at the corners of the unit cube."""
        if not place:
            return self.constant(values)
        low, high = (self.multilinear(v, place[1:]) for v in values)
        rise = self.ops.subtract(high, low)
        return self.ops.add(low, self.ops.multiply(place[0], rise))


@dataclass
class CurvedSegment:
    """A field on a panel; see `bounds.enclosure.Segment`."""

    ends: list[TracedInterval]
    whole: TracedJet

    def end(self, number: int) -> TracedInterval:
        """Return the value where the panel begins (0) or ends (1)."""
        return self.ends[number]

    def jet(self) -> TracedJet:
        """Return values and derivatives over the panel."""
        return self.whole

    def after(self, before: TracedInterval, jumps: Any) -> CurvedSegment:
        """Return, for lanes that jump, how the field comes to this panel's beginning: straight."""
        start, value = self.ends[0], self.whole.value
        zero = TracedInterval.constant(type(value.lo)(0))
        among = TracedInterval(*extremes([before.lo, before.hi, start.lo, start.hi]))
        ends = [_either(jumps, before, start), _either(jumps, start, self.ends[1])]
        whole = TracedJet(
            _either(jumps, among, value),
            _either(jumps, start - before, self.whole.first or zero),
            _either(jumps, zero, self.whole.second or zero),
        )
        return CurvedSegment(ends, whole)


class CurvedField:
    """A field along a segment, from its values [x][y][z] at the corners of a cell.

    Rounding of the walls may change values by `doubt` times their differences.
    """

    def __init__(self, chord: Any, corners: Any, doubt: Any, constant: Any) -> None:
        self.chord, self.corners = chord, corners
        values = [v for face in corners for edge in face for v in edge]
        real = type(values[0])
        self.arithmetic = JetArithmetic(TracedJetOps(real, constant), real)
        low, high = extremes(values)
        unknown = dr.isnan(sum(values[1:], values[0]))
        self.low, self.high = dr.select(unknown, dr.nan, low), dr.select(unknown, dr.nan, high)
        self.before: TracedInterval  # where the previous segment ended: `Bracketed.jumps` sets it
        self.slack = doubt * (high - low) + _LOSS * _EPS * (dr.abs(low) + dr.abs(high))

    def on_panel(self, begin: Float, width: Float) -> CurvedSegment:
        """Return the field on a panel of the segment."""
        first, last = self.chord.point(begin), self.chord.point(begin + width)
        ends = [self._value(point) for point in (first, last)]
        whole = self._field([_line(a, b) for a, b in zip(first, last, strict=True)])
        return CurvedSegment(ends, whole)

    def end(self, s: float) -> TracedInterval:
        """Return the value at the segment's beginning (0) or end (1)."""
        return self._value(self.chord.point(s))

    def _value(self, point: list[Float]) -> TracedInterval:
        return self._field([_point(p, p) for p in point]).value

    def _field(self, point: list[TracedJet]) -> TracedJet:
        place = self.chord.place(point, self.arithmetic)
        place = [p if isinstance(p, TracedJet) else self.arithmetic.constant(p) for p in place]
        found = self.arithmetic.multilinear(self.corners, place)
        low, high = found.value.lo - self.slack, found.value.hi + self.slack
        value = TracedInterval(
            dr.select(low < self.low, self.low, low), dr.select(high > self.high, self.high, high)
        )
        return TracedJet(value, _sure(found.first), _sure(found.second))


def _point(a: Float, b: Float) -> TracedJet:
    low, high = extremes([a, b])
    slack = _LOSS * _EPS * (dr.abs(a) + dr.abs(b))
    return TracedJet(TracedInterval(low - slack, high + slack))


def _line(a: Float, b: Float) -> TracedJet:
    slack = _LOSS * _EPS * (dr.abs(a) + dr.abs(b))
    return TracedJet(_point(a, b).value, TracedInterval(b - a - slack, b - a + slack))


def _either(mask: Mask, a: TracedInterval, b: TracedInterval) -> TracedInterval:
    pairs = ((a.lo, b.lo), (a.hi, b.hi), (a.nan, b.nan))
    return TracedInterval(*(dr.select(mask, *pair) for pair in pairs))


def _sure(derivative: Derivative) -> Derivative:
    """Return a derivative, moved out by rounding; anything where it is undefined."""
    if derivative is None:
        return None
    undefined = derivative.nan | ~(derivative.lo <= derivative.hi)
    ends = TracedInterval(lowered(derivative.lo, _LOSS), raised(derivative.hi, _LOSS))
    return ends.unknown_where(undefined, False)
