"""Enclosures on a panel of a ray: intervals of scalars, of media, and of what they amount to.

A scalar is within u(1-u)/2 sup|x''| of its chord, so within sup|x''|/12 in the mean: the mean of a
function of it is that on the chord, in closed form, up to this distance times the largest slope of
the function.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol, TypeAlias

import numpy as np

from ..backend import dr
from ..backend.types import Float, Mask
from ..expressions import Expression
from ..expressions.interval_ops import interpolate_ranges
from ..expressions.taylor import Derivative, TracedJet, TracedJetOps
from ..expressions.traced_interval import (
    TracedInterval,
    TracedIntervalOps,
    extremes,
    float_info,
    larger,
    lowered,
    positive,
    raised,
    smaller,
    traced,
)
from ..media.context import Context, MediumSample, completed
from ..media.piecewise_linear import PiecewiseLinear

Ends: TypeAlias = tuple[Float, Float]
# Rounding errors of closed forms in double precision, relative to the peak, with safety factor.
_SHAPE_LOSS = 1e-14
_TABLE_LOSS = 1e-12
# Replaces the slope of a jump, so that products with it stay finite.
_STEEPEST = 1e150


class EnclosureContext(Context):
    """How a medium is evaluated on intervals inside a kernel; on a panel, if there is one.

    `number` turns a finite Python float into run-time data of `float_type`, that of the ends.
    """

    encloses = True

    def __init__(
        self,
        float_type: Any,
        number: Callable[[float], Any],
        faint: float = 1e-8,
    ) -> None:
        self._float, self._opaque = float_type, number
        self.panel: EnclosedPanel | None = None

        def constant(value: float) -> TracedInterval:
            return TracedInterval.constant(self.plain(value))

        real = functools.partial(traced, float_type)
        super().__init__(real, constant, faint=faint)

    def plain(self, value: float) -> Float:
        """Return a number as a cached kernel constant."""
        return self.keep(("plain", value), lambda: self._opaque(value))

    @property
    def ops(self) -> TracedIntervalOps:
        return TracedIntervalOps(self._float, self.plain)

    def evaluate(self, expression: Expression, fields: dict[str, Any]) -> Any:
        """Return an interval of an expression: on the panel, tighter than by ranges of fields."""
        if self.panel is None:
            return super().evaluate(expression, fields)
        return self.panel.enclosure(expression).values

    def interpolate(
        self, x: Float, nodes: np.ndarray, columns: Sequence[np.ndarray]
    ) -> list[TracedInterval]:
        return interpolate_ranges(x, nodes, columns)


class Segment(Protocol):
    """Guaranteed bounds of a field on a panel."""

    def end(self, number: int) -> TracedInterval:
        """Return the value where the panel begins (0) or ends (1)."""

    def jet(self) -> TracedJet:
        """Return values and derivatives over the panel, scaled to length one."""


@dataclass
class CubicSegment:
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
class Enclosure:
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
    def mean(self) -> TracedInterval:
        """Bounds of the mean: that of the chord, ± sup|x''|/12."""
        chord = 0.5 * (self.first + self.last)
        return _around(chord, self.bow * (1.0 / 12.0))

    def around(self, mean: Float, off: Float) -> TracedInterval:
        """Return all that is near the mean of a shape, from 0 to 1, in closed form."""
        return _unit_range(_around(mean, off * (1.0 + 1e-12) + _SHAPE_LOSS))

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

    @property
    def monotonic(self) -> Mask:
        """Where it neither rises and falls."""
        return (self.slope.lo >= 0.0) | (self.slope.hi <= 0.0)

    def in_widths(self, center: Float, width: Float) -> tuple[Float, Float, Float, Float]:
        """Return the distances of both ends from a centre, and the mean and largest chord error.

        In units of the width. The errors include the rounding of the distances.
        """
        middles = self.middles()
        first, last = ((x - center) / width for x in middles)
        sizes = dr.abs(middles[0]) + dr.abs(middles[1]) + 2.0 * dr.abs(center)
        rounding = 8.0 * float(float_info(type(first)).eps) * (sizes / width + 1.0)
        return first, last, self.off / width + rounding, self.farthest / width + rounding

    def crossings(self, level: Float) -> tuple[TracedInterval, Float]:
        """Return bounds of the number of crossings of a level, and their density: 0 or infinite."""
        first, last, x = self.first, self.last, self.values
        above, below = (
            (first.hi < level) & (last.lo >= level),
            (last.hi < level) & (first.lo >= level),
        )
        never = (x.hi < level) | (x.lo >= level)
        one = type(level)(1)
        many = dr.select(self.monotonic, one, dr.inf)
        crossed = TracedInterval(dr.select(above | below, one, 0), dr.select(never, 0, many))
        return crossed, dr.select(never, type(level)(0), dr.inf)

    def layer(self, level: Float, width: Float) -> tuple[TracedInterval, Float]:
        """Return bounds of the widths passed around a level, and of their density."""
        first, last, x = self._places(level, width)
        never = (x.hi <= 0.0) | (x.lo >= 1.0)
        densest = dr.select(never, 0.0, raised(self.slope.size / width))
        passed = abs(last - first)
        most = dr.select(self.monotonic, smaller(passed.hi, densest), densest)
        return TracedInterval(dr.select(never, 0.0, passed.lo), most), densest

    def sheet(
        self, level: Float, width: Float, steep: TracedInterval, oblique: TracedInterval
    ) -> tuple[TracedInterval, Float]:
        """Return bounds of the amount of a sheet of finite thickness, and its largest density.

        `steep` is |∇x|, `oblique` the amount by crossings. A panel parallel to the sheet may be
        inside it without a crossing.
        """
        first, _, x = self._places(level, width)
        never = (x.hi <= 0.0) | (x.lo >= 1.0)
        dense = steep / TracedInterval.constant(width)
        densest = dr.select(never, 0.0, raised(larger(dense.hi, self.slope.size / width)))
        always = (x.lo > 0.0) & (x.hi < 1.0)
        least = dr.select(always, larger(oblique.lo, positive(dense.lo)), oblique.lo)
        # A panel outside the sheet or parallel to it has no crossing.
        along = (oblique.hi <= 0.0) & (first.hi > 0.0) & (first.lo < 1.0)
        most = dr.select(along, densest, smaller(oblique.hi, densest))
        return TracedInterval(dr.select(never, 0.0, least), most), densest

    def oblique(self, steep: TracedInterval, crossed: TracedInterval) -> TracedInterval:
        """Return an amount of crossings times |∇x| over the slope along the ray, at least one."""
        ratio = steep / abs(self.slope)
        one = type(self.bow)(1)
        result = crossed * TracedInterval(larger(ratio.lo, one), larger(ratio.hi, one))
        # Without a crossing an infinite ratio does not matter.
        none = crossed.hi <= 0.0
        low, high = (dr.select(none, 0.0, end) for end in (positive(result.lo), result.hi))
        return TracedInterval(low, high)

    def _places(self, level: Float, width: Float) -> list[TracedInterval]:
        """Return where in a layer it is at both ends and throughout, from 0 to 1."""
        extent = TracedInterval.constant(width)
        return [
            _unit_range((x - level) / extent + 0.5) for x in (self.first, self.last, self.values)
        ]


class EnclosedPanel:
    """All scalars on a panel with a length in the volume's unit."""

    def __init__(
        self, segments: dict[str, Segment], length: Float, context: EnclosureContext
    ) -> None:
        self.real, self._context = type(length), context
        # Ends of segments are differences of distances, which round.
        self.length = TracedInterval(lowered(length), raised(length))
        self._ops, self._jets = context.ops, TracedJetOps(self.real, context.plain)
        self._ends = [
            completed(self._ops, {n: s.end(k) for n, s in segments.items()}, context)
            for k in (0, 1)
        ]
        jets = {name: segment.jet() for name, segment in segments.items()}
        self._whole = completed(self._jets, jets, context)
        self._enclosures: dict[str, Enclosure] = {}
        self.fields = {name: jet.value for name, jet in self._whole.items()}

    def enclosure(self, expr: Expression) -> Enclosure:
        """Return the enclosure of an expression; computed once."""
        if expr.text not in self._enclosures:
            self._enclosures[expr.text] = self._enclosure(expr)
        return self._enclosures[expr.text]

    def _enclosure(self, expr: Expression) -> Enclosure:
        first, last = (self._ops.number(expr.evaluate(self._ops, end)) for end in self._ends)
        jet = self._jets.number(expr.evaluate(self._jets, self._whole))
        bow = self._interval(jet.second).size
        sag = 0.125 * bow
        chord_low = lowered(smaller(first.lo, last.lo) - sag)
        chord_high = raised(larger(first.hi, last.hi) + sag)
        values = TracedInterval(
            larger(jet.value.lo, chord_low), smaller(jet.value.hi, chord_high), jet.value.nan
        )
        return Enclosure(first, last, values, self._interval(jet.first), bow)

    def table_means(
        self, expr: Expression, nodes: np.ndarray, columns: np.ndarray
    ) -> list[TracedInterval]:
        """Return bounds of the means of piecewise-linear columns, scaled to the order of one."""
        enclosure, keep = self.enclosure(expr), self._context.keep
        table = keep((id(columns), "sums"), lambda: PiecewiseLinear(self.real, nodes, columns))
        first, last = enclosure.middles()
        means = table.means(table.at(first), table.at(last))
        rounding = 8.0 * float(float_info(self.real).eps)
        off = enclosure.off + rounding * (dr.abs(first) + dr.abs(last) + float(np.abs(nodes).max()))
        doubled, slopes = _steepness(nodes, columns)
        steep = self._context.interpolate(enclosure.values, doubled, list(slopes.T))
        return [
            _around(mean, raised(slope.hi * off) + _TABLE_LOSS)
            for mean, slope in zip(means, steep, strict=True)
        ]

    def mean_product(
        self, f: TracedInterval, mean_f: TracedInterval, g: TracedInterval, mean_g: TracedInterval
    ) -> TracedInterval:
        """Return bounds of the mean of f g: the product of means ± Δf Δg / 4 (Grüss 1935)."""
        product = mean_f * meet(g, mean_g)
        return meet(_around(product, 0.25 * (f.hi - f.lo) * (g.hi - g.lo)), f * g)

    def gated_mean(
        self, gate: TracedInterval, f: TracedInterval, mean: TracedInterval
    ) -> TracedInterval:
        """Return bounds of the mean of a gate, from 0 to 1, times f.

        Unbounded if f changes sign.
        """
        one_sign, product = (f.lo >= 0.0) | (f.hi <= 0.0), gate * mean
        ends = dr.select(one_sign, product.lo, -dr.inf), dr.select(one_sign, product.hi, dr.inf)
        return TracedInterval(*ends)

    def bounds(
        self,
        ranges: MediumSample,
        means: MediumSample,
        sources: Sequence[TracedInterval | None] = (),
    ) -> PanelBounds:
        """Return bounds from ranges and means of the coefficients, and from ranges of j/α."""
        rows = (ranges.emissivity, ranges.extinction)
        j, alpha = ([self.length * v for v in values] for values in rows)
        emitted, depth = (
            [meet(self.length * v, most) for v, most in zip(values, row, strict=True)]
            for values, row in ((means.emissivity, j), (means.extinction, alpha))
        )
        return self.amounts(j, alpha, emitted, depth, sources or [None] * len(j))

    def amounts(
        self,
        emissivity: list[TracedInterval],
        extinction: list[TracedInterval],
        emitted: list[TracedInterval],
        depth: list[TracedInterval],
        sources: Sequence[TracedInterval | None],
    ) -> PanelBounds:
        """Return bounds from what they are made of: as in `PanelBounds`, but for j/α."""
        ends = [None if source is None else (source.lo, source.hi) for source in sources]
        return PanelBounds(emissivity, extinction, emitted, depth, ends)

    def _interval(self, derivative: Derivative) -> TracedInterval:
        if derivative is None:
            return TracedInterval.constant(self.real(0))
        # Undefined values have no bounds.
        return derivative.unknown_where(derivative.nan, False)


@dataclass
class PanelBounds:
    """Intervals of a medium's coefficients on a panel, times the panel's length.

    Of j per channel and α (one if grey): their values anywhere, and their integrals `emitted` and
    `depth`. `source` has bounds of j/α per channel; None where those of j and α give them.
    """

    emissivity: list[TracedInterval]
    extinction: list[TracedInterval]
    emitted: list[TracedInterval]
    depth: list[TracedInterval]
    source: Sequence[Ends | None]

    def source_of(self, channel: int) -> Ends:
        """Return bounds of j/α; infinite where there are none."""
        given = self.source[channel]
        if given is not None:
            return given
        alpha = self.extinction[channel if len(self.extinction) > 1 else 0]
        quotient = self.emissivity[channel] / alpha
        return quotient.lo, quotient.hi


def meet(a: TracedInterval, b: TracedInterval) -> TracedInterval:
    """Return the intersection of two intervals that hold the same number."""
    return TracedInterval(larger(a.lo, b.lo), smaller(a.hi, b.hi), a.nan & b.nan)


def _around(middle: Any, off: Float) -> TracedInterval:
    middle = middle if isinstance(middle, TracedInterval) else TracedInterval(middle)
    off = raised(off)
    return TracedInterval(lowered(middle.lo - off), raised(middle.hi + off), middle.nan)


def _unit_range(x: TracedInterval) -> TracedInterval:
    """Return an interval limited to 0 … 1; all of that where it is undefined."""
    ends = [dr.select(v < 0.0, 0.0, dr.select(v > 1.0, 1.0, v)) for v in (x.lo, x.hi)]
    return TracedInterval(*ends)


def _steepness(nodes: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the magnitudes of columns' slopes as a table with jumps; zero beyond both ends."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        slopes = np.abs(np.diff(columns, axis=0) / np.diff(nodes)[:, None])
    slopes = np.minimum(np.nan_to_num(slopes, nan=0.0, posinf=_STEEPEST), _STEEPEST)
    none = np.zeros((1, columns.shape[1]))
    return np.repeat(nodes, 2), np.concatenate([none, np.repeat(slopes, 2, axis=0), none])
