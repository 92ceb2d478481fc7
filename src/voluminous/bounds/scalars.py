"""Enclosures of scalars on a panel of a ray, and bounds of their distance from the chord."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from ..backend import dr
from ..backend.types import Float
from ..expressions import Expression
from ..expressions.interval_ops import interpolate_ranges
from ..expressions.taylor import Derivative, TracedJet, TracedJetOps
from ..expressions.traced_interval import (
    TracedInterval,
    TracedIntervalOps,
    extremes,
    larger,
    lowered,
    raised,
    smaller,
    traced,
)
from ..media.context import Context, completed


class TracedRangeContext(Context):
    """How a medium is evaluated on intervals inside a kernel.

    `number` turns a finite Python float into run-time data of `float_type`, that of the ends.
    """

    def __init__(
        self,
        float_type: Any,
        number: Callable[[float], Any],
        unit: Any,
        unit_of: Callable[[Expression], Any],
        faint: float = 1e-8,
    ) -> None:
        self._float, self._constant = float_type, number

        def constant(value: float) -> TracedInterval:
            return TracedInterval.constant(number(value))

        real = functools.partial(traced, float_type)
        super().__init__(real, constant, unit, unit_of, faint=faint)

    @property
    def ops(self) -> TracedIntervalOps:
        return TracedIntervalOps(self._float, self._constant)

    def interpolate(
        self, x: Float, nodes: np.ndarray, columns: Sequence[np.ndarray]
    ) -> list[TracedInterval]:
        return interpolate_ranges(x, nodes, columns)


_AXES = ("x", "y", "z")


class Piece(Protocol):
    """Guaranteed bounds of a field on a panel."""

    def end(self, number: int) -> TracedInterval:
        """Return the value where the panel begins (0) or ends (1)."""

    def jet(self) -> TracedJet:
        """Return values and derivatives over the panel, scaled to length one."""


@dataclass
class CubicPiece:
    """A cubic, enclosed by its Bézier control points, off by `slack` at most, and by limits."""

    points: list[Float]
    slack: Float
    low: Float
    high: Float

    def end(self, number: int) -> TracedInterval:
        point = self.points[3 * number]
        return self._within(point, point)

    def jet(self) -> TracedJet:
        # Cubics and their derivatives stay within their points (Farin 2002, sections 5.1 and 5.3).
        p = self.points
        rises = [b - a for a, b in pairwise(p)]
        bends = [b - a for a, b in pairwise(rises)]
        return TracedJet(
            self._within(*extremes(p)), self._times(3.0, rises, 2.0), self._times(6.0, bends, 4.0)
        )

    def _within(self, low: Float, high: Float) -> TracedInterval:
        low, high = low - self.slack, high + self.slack
        return TracedInterval(
            dr.select(low < self.low, self.low, low), dr.select(high > self.high, self.high, high)
        )

    def _times(self, factor: float, values: list[Float], slacks: float) -> TracedInterval:
        low, high = extremes(values)
        slack = slacks * self.slack
        return factor * TracedInterval(low - slack, high + slack)


@dataclass
class Course:
    """A scalar on a panel, u from 0 to 1: at both ends, and on the whole panel.

    `slope` is its derivative by u, `bow` a bound of its second derivative: it is within u(1-u)/2
    times this of the chord.
    """

    first: TracedInterval
    last: TracedInterval
    values: TracedInterval
    slope: TracedInterval
    bow: Float

    def middles(self) -> list[Float]:
        """Return the middles of both ends."""
        return [0.5 * (end.lo + end.hi) for end in (self.first, self.last)]

    @property
    def off(self) -> Float:
        """Bound of the mean distance from the chord between the middles of both ends."""
        return self.bow * (1.0 / 12.0) + self._doubt

    @property
    def farthest(self) -> Float:
        """Bound of the largest distance from that chord."""
        return self.bow * 0.125 + self._doubt

    @property
    def _doubt(self) -> Float:
        return larger(self.first.hi - self.first.lo, self.last.hi - self.last.lo)


class CourseContext(TracedRangeContext):
    """Evaluation with the enclosures (`Course`) of scalars: tighter than with ranges of fields."""

    def __init__(
        self,
        float_type: Any,
        number: Callable[[float], Any],
        unit: Any,
        unit_of: Callable[[Expression], Any],
    ) -> None:
        super().__init__(float_type, self.plain, unit, unit_of)
        self._opaque = number
        self.courses: Courses | None = None

    def plain(self, value: float) -> Float:
        """Return a number as a cached kernel constant."""
        return self.keep(("number", value), lambda: self._opaque(value))

    def evaluate(self, expression: Any, fields: dict[str, Any]) -> Any:
        assert self.courses is not None
        return self.courses.course(expression).values


class Courses:
    """All scalars on a panel with a length in the volume's unit."""

    def __init__(self, pieces: dict[str, Piece], length: Float, context: CourseContext) -> None:
        self.real = type(length)
        # Ends of segments are differences of distances, which round.
        self.length = TracedInterval(lowered(length), raised(length))
        self._ops, self._jets = context.ops, TracedJetOps(self.real, context.plain)
        self._ends = [
            completed(self._ops, {n: p.end(k) for n, p in pieces.items()}, context) for k in (0, 1)
        ]
        jets = {name: piece.jet() for name, piece in pieces.items()}
        self._whole = completed(self._jets, jets, context)
        self._found: dict[str, Course] = {}
        self.fields = {name: jet.value for name, jet in self._whole.items()}

    def course(self, expr: Expression) -> Course:
        """Return the enclosure of an expression; computed once."""
        if expr.text not in self._found:
            self._found[expr.text] = self._course(expr)
        return self._found[expr.text]

    def _course(self, expr: Expression) -> Course:
        first, last = (self._ops.number(expr.evaluate(self._ops, end)) for end in self._ends)
        jet = self._jets.number(expr.evaluate(self._jets, self._whole))
        bow = self._interval(jet.second).size
        sag = 0.125 * bow
        chord_low = lowered(smaller(first.lo, last.lo) - sag)
        chord_high = raised(larger(first.hi, last.hi) + sag)
        values = TracedInterval(
            larger(jet.value.lo, chord_low), smaller(jet.value.hi, chord_high), jet.value.nan
        )
        return Course(first, last, values, self._interval(jet.first), bow)

    def _interval(self, derivative: Derivative) -> TracedInterval:
        if derivative is None:
            return TracedInterval.constant(self.real(0))
        # Undefined values have no bounds.
        return derivative.unknown_where(derivative.nan, False)
