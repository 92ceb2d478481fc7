"""Pieces of rays as a medium sees them: fields at a few places, and what is between them."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from ..backend import dr
from ..backend.functions import precision_of
from ..backend.types import Float, Mask
from ..expressions import Expression
from ..expressions.expression import Monotonicity
from ..expressions.taylor import Derivative, TracedJet, TracedJetOps
from ..expressions.traced_interval import TracedInterval, TracedIntervalOps, larger, smaller
from .context import Context, completed

T = TypeVar("T")
# Places s at which fields and scalars are evaluated: both ends and the middle, and those of halves.
NODES = (0.0, 0.5, 1.0)
PLACES = (0.0, 0.25, 0.5, 0.75, 1.0)
# The least length, in cells, that a surface without width is divided by.
_SHORTEST = 1e-20
# A scalar has no extremum between the nodes if its ends differ by this many second differences; a
# parabola has none from 2 on.
_MONOTONIC = 3.0
# How far an extremum between the nodes is beyond them, in second differences: 1/8 for a parabola.
_OVERSHOOT = 0.25
# And how far a quartic is beyond the cubic through four of five nodes, in fourth differences.
_BEYOND_CUBIC = 0.05
# Inner Bézier control points of a cubic from its values at 0, 1/3, 2/3 and 1.
_INNER = ((-5 / 6, 3.0, -1.5, 1 / 3), (1 / 3, -1.5, 3.0, -5 / 6))
# Intervals are useful on a panel if those at a single place are narrower by this factor.
_LESS = 0.25
# Second differences below this fraction of a scalar may be nothing but rounding.
_NOISE = {"single": 2e-6, "double": 4e-15}


class Panel:
    """A piece of a ray, with s from 0 to 1 along it, and its length in units of the grid's scale.

    Once it is `without_jumps`, the medium does not jump inside: the state in the middle holds all
    along. `culling_only`: only the scalars are evaluated, to reject segments.

    Attributes
    ----------
    where : sequence of float
        The places at which it is known: `NODES`, or `PLACES`.
    places : sequence of dict
        The fields there.
    many : mask
        It extends over many cells, at whose walls fields have kinks.
    between : callable, optional
        Returns the fields at any other s.
    ahead : list of arrays
        From its beginning to its end, in the volume's coordinates; None if it is not known.
    """

    def __init__(
        self,
        places: Sequence[Mapping[str, Any]],
        context: Context,
        length: Float,
        *,
        between: Callable[[Float], dict[str, Any]] | None = None,
        where: Sequence[float] = NODES,
        ahead: Sequence[Float] | None = None,
        culling_only: bool = False,
        many: Mask = False,
    ) -> None:
        self.places, self.context, self.length, self.between = places, context, length, between
        self.where, self.ahead, self.culling_only, self.many = where, ahead, culling_only, many
        self.without_jumps = False
        self.cache: dict[Hashable, Any] = {}
        self._scalars: dict[tuple[str, float], Any] = {}

    @property
    def per_length(self) -> Float:
        """One over its length, limited so that a surface between two segments is not lost."""
        return 1.0 / dr.select(self.length > _SHORTEST, self.length, _SHORTEST)

    def fields(self, s: Float) -> dict[str, Any]:
        """Return all fields at s, and the coordinates derived from x, y and z."""
        if isinstance(s, float) and s in self.where:
            fields = dict(self.places[self.where.index(s)])
        else:
            assert self.between is not None
            fields = self.between(s)
        return completed(self.context.ops, fields, self.context)

    def scalar(self, expr: Expression, s: float) -> Float:
        """Return an expression at one of its places; computed once."""
        key = (expr.text, s)
        if key not in self._scalars:
            self._scalars[key] = self.context.evaluate(expr, self.fields(s))
        return self._scalars[key]

    def nodes(self, expr: Expression) -> list[Float]:
        """Return an expression at both ends and the middle, in order."""
        return [self.scalar(expr, s) for s in NODES]

    def known(self, expr: Expression) -> list[Float]:
        """Return an expression at all places, in order."""
        return [self.scalar(expr, s) for s in self.where]

    def ends(self, expr: Expression) -> tuple[Float, Float]:
        return self.scalar(expr, 0.0), self.scalar(expr, 1.0)

    def set_scalar(self, expr: Expression, s: float, value: Float) -> None:
        """Set the value of an expression at s: that at the end of the previous panel, say.

        The integrals over a ray's panels then join without rounding differences.
        """
        self._scalars[expr.text, s] = value

    def hull(self, expr: Expression) -> tuple[Float, Float]:
        """Return the least and the largest value that an expression may have."""
        return kept(self, (expr.text, "hull"), lambda: self._hull(expr))

    def _hull(self, expr: Expression) -> tuple[Float, Float]:
        if may_turn(expr, self.context):
            return _within(self, expr) if self.culling_only else _by_derivatives(self, expr)
        values = self.known(expr)
        low, high = beyond(values)
        missing = [dr.isnan(x) for x in values]
        # No bound holds between values of which some, but not all, are undefined.
        partly = functools.reduce(operator.or_, missing) & ~functools.reduce(operator.and_, missing)
        return dr.select(partly, -dr.inf, low), dr.select(partly, dr.inf, high)

    def halves(self) -> list[Panel]:
        """Return both halves of a panel with five places."""
        return kept(self, "halves", lambda: [self._half(k) for k in (0, 2)])

    def _half(self, k: int) -> Panel:
        def between(s: Float) -> dict[str, Float]:
            assert self.between is not None
            return self.between(0.5 * s + 0.25 * k)

        places, length = self.places[k : k + 3], 0.5 * self.length
        half = Panel(places, self.context, length, between=between, ahead=self.ahead)
        half.without_jumps = self.without_jumps
        nodes = dict(zip(self.where[k : k + 3], NODES, strict=True))
        for (text, s), value in self._scalars.items():
            if s in nodes:
                half._scalars[text, nodes[s]] = value
        return half

    def controls(self, expr: Expression) -> list[Float]:
        """Return an expression at the Bézier control points of the fields, taken as cubics.

        Cubics are between their control points, and cross a level no more often (Farin 2002,
        section 5.3); so do monotonic functions of one.
        """
        assert self.between is not None
        thirds = [self.between(self.context.real(k / 3)) for k in (1, 2)]
        rows = [self.places[0], *thirds, self.places[-1]]
        found = []
        for weights in _INNER:
            fields = {
                name: sum(w * row[name] for w, row in zip(weights, rows, strict=True))
                for name in rows[0]
            }
            fields = completed(self.context.ops, within_limits(fields, self.context), self.context)
            found.append(self.context.evaluate(expr, fields))
        return [self.scalar(expr, 0.0), *found, self.scalar(expr, 1.0)]

    def range(self, expr: Expression) -> tuple[Float, Float]:
        """Return the least and the largest value at the places."""
        return without_nan(self.known(expr))

    def beyond(self, expr: Expression) -> Float:
        """Return how far an expression may be beyond its values at the nodes."""
        (low, high), (least, largest) = self.hull(expr), self.range(expr)
        over, under = high - largest, least - low
        return dr.select(over > under, over, under)

    def turns(self, expr: Expression, least: Float) -> Mask:
        """Return where an expression may be beyond its values at the nodes by more than `least`."""
        return self.beyond(expr) > least


class Straight(Panel):
    """A panel on which scalars are interpolated linearly between its ends."""

    def known(self, expr: Expression) -> list[Float]:
        return list(self.ends(expr))

    def scalar(self, expr: Expression, s: float) -> Float:
        if 0.0 < s < 1.0:
            return (1.0 - s) * self.scalar(expr, 0.0) + s * self.scalar(expr, 1.0)
        return super().scalar(expr, s)

    def _hull(self, expr: Expression) -> tuple[Float, Float]:
        return extremes(self.ends(expr))


def may_turn(expr: Expression, context: Context) -> bool:
    """Return whether an expression may have extrema where the fields have none."""
    return expr.kind(("r", *context.coordinates)) == Monotonicity.ANY


def overshoot(first: Float, middle: Float, last: Float) -> Float:
    """Return how far what is near to a parabola may be beyond three values; 0 if monotonic."""
    bow = dr.abs(first - 2.0 * middle + last)
    bow = dr.select(bow > noise_of(first, last), bow, 0.0)
    return dr.select(dr.abs(last - first) < _MONOTONIC * bow, _OVERSHOOT * bow, 0.0)


def third_differences(values: Sequence[Float]) -> list[Float]:
    """Return those of the first four, and of the last four, of five evenly spaced values."""
    return [d - a + 3.0 * (b - c) for a, b, c, d in (values[:4], values[1:])]


def beyond(values: list[Float]) -> tuple[Float, Float]:
    """Return bounds of what is between three values, near to a parabola, or five, near to a cubic.

    A cubic is within the hull of its Bézier control points (Farin 2002, section 4.3).
    """
    low, high = without_nan(values)
    if len(values) == 3:
        more = overshoot(*values)
        return low - more, high + more
    cubics = third_differences(values)
    quartic = _BEYOND_CUBIC * dr.abs(cubics[1] - cubics[0])
    for (a, m, b), cubic in zip((values[:3], values[2:]), cubics, strict=True):
        rise, bow = b - a, 2.0 * (a - 2.0 * m + b)
        noise = noise_of(a, b)
        bow = dr.select(dr.abs(bow) > 2.0 * noise, bow, 0.0)
        slope = dr.fma(2 / 3, dr.select(dr.abs(cubic) > 2.0 * noise, cubic, 0.0), rise)
        turns = dr.abs(bow) >= dr.abs(slope)
        more = dr.select(turns, quartic, 0.0)
        one, other = a + (slope - bow) * (1 / 3), b - (slope + bow) * (1 / 3)
        lower, upper = dr.select(one < other, one, other), dr.select(one < other, other, one)
        low = dr.select(lower - more < low - noise, lower - more, low)
        high = dr.select(upper + more > high + noise, upper + more, high)
    return low, high


def in_box(panel: Panel, expr: Expression) -> TracedInterval:
    """Return an expression's interval while each field has any value of its range."""
    return _in_box(panel, expr, dict(kept(panel, "box", lambda: _box(panel))))


def _box(panel: Panel) -> dict[str, TracedInterval]:
    names = panel.places[0]
    rows = {name: [place[name] for place in panel.places] for name in names}
    return {name: TracedInterval(*beyond(values)) for name, values in rows.items()}


def _in_box(panel: Panel, expr: Expression, fields: dict[str, Any]) -> TracedInterval:
    context = panel.context
    ops = TracedIntervalOps(context.real, context.kept_number)
    found: TracedInterval = ops.number(expr.evaluate(ops, completed(ops, fields, context)))
    return found


def _within(panel: Panel, expr: Expression) -> tuple[Float, Float]:
    found, (least, largest) = in_box(panel, expr), panel.range(expr)
    vain = _undecided(panel, expr, found.hi - found.lo)
    return dr.select(vain, least, found.lo), dr.select(vain, largest, found.hi)


def _by_derivatives(panel: Panel, expr: Expression) -> tuple[Float, Float]:
    """Return bounds of an expression from intervals of its value and its derivatives.

    Where the slope has one sign, the values at both ends are the extremes; elsewhere the second
    derivative bounds the distance from the chord.
    """
    context, jets = panel.context, {}
    for name, value in _box(panel).items():
        values = [place[name] for place in panel.places]
        slopes, bows = [], []
        for k in range(0, len(values) - 1, 2):
            first, middle, last = values[k : k + 3]
            bow = 2.0 * (first - 2.0 * middle + last)
            parts = 0.5 * (len(values) - 1)
            slopes += [parts * (last - first - bow), parts * (last - first + bow)]
            bows.append(2.0 * parts * parts * bow)
        jets[name] = TracedJet(
            value, TracedInterval(*extremes(slopes)), TracedInterval(*extremes(bows))
        )
    ops = TracedJetOps(context.real, context.kept_number)
    found = ops.number(expr.evaluate(ops, completed(ops, jets, context)))
    first, middle, last = panel.nodes(expr)
    value, least_largest = found.value, without_nan([first, last])
    slope, bow = (_interval(d, first) for d in (found.first, found.second))
    least, largest = least_largest
    sag = 0.125 * bow.size
    low, high = larger(value.lo, least - sag), smaller(value.hi, largest + sag)
    one_way = ((slope.lo >= 0.0) | (slope.hi <= 0.0)) & ~value.nan
    low, high = dr.select(one_way, least, low), dr.select(one_way, largest, high)
    # No bound holds where it is undefined in parts; where all of it is undefined, it is invisible.
    nowhere = dr.isnan(first) & dr.isnan(middle) & dr.isnan(last)
    partly = value.nan & ~nowhere
    low, high = dr.select(partly, -dr.inf, low), dr.select(partly, dr.inf, high)
    vain = _undecided(panel, expr, value.hi - value.lo)
    least, largest = panel.range(expr)
    return dr.select(vain, least, low), dr.select(vain, largest, high)


def _interval(derivative: Derivative, like: Any) -> TracedInterval:
    if derivative is None:
        return TracedInterval.constant(like * 0.0)
    return derivative.unknown_where(derivative.nan, False)


def _undecided(panel: Panel, expr: Expression, width: Float) -> Mask:
    """Return where intervals at single places are as wide as on the panel: 1/n where n is zero.

    Halving panels does not help there: without this test all panels in a vacuum had the minimal
    width, and a picture of 64 x 64 pixels took 20 to 40 s.
    """
    if not expr.partial:
        return panel.length < 0.0
    vain = width > 0.0
    for place in panel.places[:: len(panel.places) // 2]:
        found = _in_box(panel, expr, {name: TracedInterval(v) for name, v in place.items()})
        vain &= ~(found.hi - found.lo < _LESS * width)
    return vain


def noise_of(first: Float, last: Float) -> Float:
    """Return the second difference that is nothing but rounding."""
    return _NOISE[precision_of(type(first))] * (dr.abs(first) + dr.abs(last))


def extremes(values: Sequence[Any]) -> tuple[Float, Float]:
    """Return the least and the largest of some arrays."""
    low = functools.reduce(lambda a, b: dr.select(b < a, b, a), values)
    high = functools.reduce(lambda a, b: dr.select(b > a, b, a), values)
    return low, high


def without_nan(values: Sequence[Any]) -> tuple[Float, Float]:
    """Return the same of those that are numbers; NaN if none is."""
    low = functools.reduce(lambda a, b: dr.select((b < a) | dr.isnan(a), b, a), values)
    high = functools.reduce(lambda a, b: dr.select((b > a) | dr.isnan(a), b, a), values)
    return low, high


def within_limits(fields: dict[str, Any], context: Context) -> dict[str, Any]:
    """Return interpolated fields, each clipped to the least and largest of its values."""
    for name, (low, high) in context.limits.items():
        if name in fields:
            value = dr.select(fields[name] < low, low, fields[name])
            fields[name] = dr.select(value > high, high, value)
    return fields


@dataclass
class Middle:
    """Centre of mass of a profile in a panel, as a fraction of it, and variance.

    The `spread` is the variance over that of equal masses at both ends: 0 for a thin shell, 1/3 for
    a constant.
    """

    place: Float
    spread: Float


def kept(panel: Panel, key: Hashable, make: Callable[[], T]) -> T:
    """Return the cached result of `make` for a panel, which its panels share."""
    if key not in panel.cache:
        panel.cache[key] = make()
    result: T = panel.cache[key]
    return result


def middle_of(t: Float, variance: Any) -> Middle:
    """Return the `Middle` for a centre of mass and a variance on [-1, 1]."""
    t = dr.select(dr.isnan(t), 0.0, t)  # of infinite ends: log10 where nothing is
    t = dr.select(t < -1.0, -1.0, dr.select(t > 1.0, 1.0, t))
    # The variance is at most that of masses at both ends, 1 - t².
    room = 1.0 - t * t
    spread = variance / dr.select(room > 0.0, room, 1.0)
    return Middle(0.5 + 0.5 * t, dr.select(spread < 1.0 / 3.0, spread, 1.0 / 3.0))
