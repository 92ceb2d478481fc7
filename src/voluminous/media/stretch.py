"""Ray segments, and enclosures of the expressions on them.

A monotonic function of a sum of fields is enclosed by its values at the fields' Bézier control
points. All other expressions are enclosed by interval arithmetic for the value and its derivatives:
where the slope has one sign, the values at both ends are the extremes; elsewhere the second
derivative bounds the distance from the chord. As `bounds.scalars`, but in the precision of the
picture, for schemes that estimate errors.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeVar

from ..backend import dr
from ..backend.functions import horner
from ..backend.types import Float, Mask
from ..expressions import Expression
from ..expressions.expression import Monotonicity
from ..expressions.taylor import Derivative, TracedJet, TracedJetOps
from ..expressions.traced_interval import TracedInterval, TracedIntervalOps, larger, smaller
from ..expressions.traced_interval import extremes as without_nan
from .context import Context, completed

T = TypeVar("T")
# Intervals are useful on a stretch if those at a single place are narrower by this factor.
_LESS = 0.25
# Second difference over difference of the ends: 0.5 for s², 0.75 for s³, nearly 1 for high powers.
_LOPSIDED = 0.85


@dataclass
class Turning:
    """Enclosure of an expression on a stretch.

    Bounds of its value (infinite where it is undefined on a part of the stretch), of its distance
    `apart` from the chord (zero where the slope has one sign, unless nearly all of the change is in
    one half), and of the magnitudes of the first and second derivative by s.
    """

    low: Float
    high: Float
    apart: Float
    slope: Float
    bend: Float


def may_turn(expr: Expression, context: Context) -> bool:
    """Return whether the values at the fields' control points do not enclose an expression."""
    return _kind(expr, context) == Monotonicity.ANY


def enclosed(stretch: Stretch, expr: Expression) -> Turning:
    """Return an enclosure of an expression on a stretch."""
    if not may_turn(expr, stretch.context):
        return _by_controls(stretch, expr)
    return _by_ranges(stretch, expr) if stretch.rough else _by_derivatives(stretch, expr)


def is_cubic(expr: Expression, context: Context) -> bool:
    """Return whether an expression is a cubic along a stretch, as fields are."""
    return _kind(expr, context) <= Monotonicity.SUM


def _kind(expr: Expression, context: Context) -> Monotonicity:
    return expr.kind(("r", *context.coordinates))


def _by_controls(stretch: Stretch, expr: Expression) -> Turning:
    controls = stretch.controls(expr)
    low, high = without_nan(controls)
    apart = stretch.length * 0.0
    if _kind(expr, stretch.context) == Monotonicity.MONOTONIC:
        missing = [dr.isnan(b) for b in controls]
        # No bound holds between values of which some, but not all, are undefined.
        every, some = (functools.reduce(op, missing) for op in (operator.and_, operator.or_))
        partly = some & ~every
        low, high = dr.select(partly, -dr.inf, low), dr.select(partly, dr.inf, high)
        apart = dr.select(partly, dr.inf, apart if stretch.rough else _lopsided(stretch, expr))
    return Turning(low, high, apart, *_of_cubic(controls))


def _by_ranges(stretch: Stretch, expr: Expression) -> Turning:
    """Return an enclosure from the ranges of the fields alone: a third of the work.

    The derivatives of smooth expressions are estimated by those of a cubic through their values.
    """
    found = within(stretch, expr)
    low, high = _seen_if_undecided(stretch, expr, found.lo, found.hi, found.hi - found.lo)
    apart = high - low
    slope, bend = _of_cubic(stretch.controls(expr))
    slope = larger(slope, apart)
    if not expr.smooth:
        slope = bend = apart + dr.inf
    return Turning(low, high, apart, slope, bend)


def _of_cubic(controls: list[Float]) -> tuple[Float, Float]:
    """Return bounds of the first two derivatives of a cubic with these control points.

    Differences of them bound the second derivative (Farin 2002, section 5.3); the first departs
    from its mean by at most half of that.
    """
    b0, b1, b2, b3 = controls
    rise, middle, last = b1 - b0, b2 - b1, b3 - b2
    start, end = middle - rise, last - middle
    bend = 3.0 * (dr.abs(start + end) + dr.abs(end - start))
    return dr.fma(bend, 0.5, dr.abs(b3 - b0)), bend


def _by_derivatives(stretch: Stretch, expr: Expression) -> Turning:
    """Return an enclosure from intervals of the value and its derivatives."""
    found = _derived(stretch, expr)
    first, last = stretch.scalar(expr, 0.0), stretch.scalar(expr, 1.0)
    slope, bow = _interval(found.first, first), _interval(found.second, first).size
    least, largest = without_nan([first, last])
    value = found.value
    sag = 0.125 * bow
    low, high = larger(value.lo, least - sag), smaller(value.hi, largest + sag)
    one_way = ((slope.lo >= 0.0) | (slope.hi <= 0.0)) & ~value.nan
    low, high = dr.select(one_way, least, low), dr.select(one_way, largest, high)
    # No bound holds where it is undefined in parts; where all of it is undefined, it is invisible.
    nowhere = dr.isnan(first) & dr.isnan(stretch.scalar(expr, 0.5)) & dr.isnan(last)
    partly = value.nan & ~nowhere
    low, high = dr.select(partly, -dr.inf, low), dr.select(partly, dr.inf, high)
    low, high = _seen_if_undecided(stretch, expr, low, high, value.hi - value.lo)
    apart = dr.select(one_way, _lopsided(stretch, expr), smaller(sag, high - low))
    return Turning(low, high, apart, slope.size, bow)


def spread(stretch: Stretch, expr: Expression) -> tuple[Any, Any, Any]:
    """Return bounds of an expression's range (its width) and of its first two derivatives.

    All may be infinite: the second derivative at kinks, the first at jumps.
    """
    found, zero = _derived(stretch, expr), stretch.length
    slope, bow = (_interval(d, zero).size for d in (found.first, found.second))
    return found.value.hi - found.value.lo, slope, bow


def _derived(stretch: Stretch, expr: Expression) -> TracedJet:
    context = stretch.context
    ops = TracedJetOps(context.real, context.kept_number)
    jets = {name: _jet(stretch.field_points(name)) for name in stretch.cubics}
    return ops.number(expr.evaluate(ops, completed(ops, jets, context)))


def within(stretch: Stretch, expr: Expression) -> TracedInterval:
    """Return an expression's interval while the fields are between their control points.

    Wider than `enclosed`, in a third of the time.
    """
    ranges = {name: TracedInterval(*ends) for name, ends in stretch.ranges().items()}
    return _in_box(stretch, expr, ranges)


def at_places(stretch: Stretch, expr: Expression) -> list[TracedInterval]:
    """Return the expression's intervals at both ends and in the middle."""
    return [
        _in_box(stretch, expr, {name: TracedInterval(value) for name, value in place.items()})
        for place in stretch.places()
    ]


def _in_box(stretch: Stretch, expr: Expression, fields: dict[str, Any]) -> TracedInterval:
    """Return an expression's interval while the fields are in theirs."""
    context = stretch.context
    ops = TracedIntervalOps(context.real, context.kept_number)
    found: TracedInterval = ops.number(expr.evaluate(ops, completed(ops, fields, context)))
    return found


def _lopsided(stretch: Stretch, expr: Expression) -> Float:
    """Return an expression's distance from its chord where most of its change is in one half.

    Beside a vacuum ``temperature/density`` becomes nearly infinite in the last part of a cell: its
    linear interpolant crosses shells in a tiny fraction of the panel, and step doubling misses it.
    """
    first, middle, last = stretch.nodes(expr)
    off = dr.abs(first - 2.0 * middle + last)
    return dr.select(off > _LOPSIDED * dr.abs(last - first), 0.5 * off, 0.0)


def undecided(stretch: Stretch, expr: Expression, width: Float) -> Mask:
    """Return where intervals at single places are as wide as on the stretch: 1/n where n is zero.

    Halving panels does not help there: without this test all panels in a vacuum had the minimal
    width, and a picture of 64 x 64 pixels took 20 to 40 s. Both ends and the middle are tested,
    because beside a vacuum one of them has a narrower interval.
    """
    if not expr.partial:
        return stretch.length < 0.0
    vain = width > 0.0
    for found in at_places(stretch, expr):
        vain &= ~(found.hi - found.lo < _LESS * width)
    return vain


def _seen_if_undecided(
    stretch: Stretch, expr: Expression, low: Float, high: Float, width: Float
) -> tuple[Float, Float]:
    """Return the ends of a range; where intervals are useless, those of the values at nodes."""
    least, largest = without_nan(stretch.nodes(expr))
    vain = undecided(stretch, expr, width)
    return dr.select(vain, least, low), dr.select(vain, largest, high)


def _jet(points: list[Float]) -> TracedJet:
    """Return a cubic and its derivatives, from its control points (Farin 2002, section 5.3)."""
    rises = [3.0 * (b - a) for a, b in pairwise(points)]
    bends = [2.0 * (b - a) for a, b in pairwise(rises)]
    return TracedJet(*(TracedInterval(*without_nan(v)) for v in (points, rises, bends)))


def _interval(derivative: Derivative, like: Any) -> TracedInterval:
    if derivative is None:
        return TracedInterval.constant(like * 0.0)
    return derivative.unknown_where(derivative.nan, False)


# Places s at which scalars are evaluated: panels extend between two of these.
NODES = (0.0, 0.5, 1.0)
# The least length, in cells, that a surface without width is divided by.
_SHORTEST = 1e-20
Cubic = Sequence[Any]  # coefficients of 1, s, s², s³; or fewer


class Stretch:
    """A segment of a ray, with s from 0 to 1 along it, and its length in units of the grid's scale.

    `cubics` has the coefficients of every field as a polynomial of s, lowest power first. A `rough`
    one only serves to test for visibility, with wide enclosures. Once it is `edgeless`, no
    discontinuity of the medium is inside: the state in the middle holds all along.
    """

    def __init__(
        self, cubics: Mapping[str, Cubic], context: Context, length: Float, *, rough: bool = False
    ) -> None:
        self.cubics, self.context, self.length, self.rough = cubics, context, length, rough
        self.edgeless = False
        self.cache: dict[Hashable, Any] = {}
        self._scalars: dict[tuple[str, float], Any] = {}
        self._controls: dict[str, list[Any]] = {}
        self._turnings: dict[str, Turning] = {}
        self._spreads: dict[str, tuple[Any, Any, Any]] = {}

    def fields(self, s: Float) -> dict[str, Any]:
        """Return all fields at s, and the coordinates derived from x, y and z."""
        return self._complete(self._own_fields(s))

    def places(self) -> list[dict[str, Any]]:
        """Return the fields alone at both ends and in the middle, in order."""
        return [within_limits(self._own_fields(s), self.context) for s in NODES]

    def ranges(self) -> dict[str, tuple[Any, Any]]:
        """Return (low, high) of each field."""
        ends = {name: extremes(self.field_points(name)) for name in self.cubics}
        low, high = (
            within_limits({name: pair[k] for name, pair in ends.items()}, self.context)
            for k in (0, 1)
        )
        return {name: (low[name], high[name]) for name in ends}

    def _own_fields(self, s: Float) -> dict[str, Any]:
        s = self.context.real(s)
        return {name: horner(s, c) for name, c in self.cubics.items()}

    def scalar(self, expr: Expression, s: float) -> Float:
        """Return an expression at 0, ½ or 1; computed once."""
        key = (expr.text, s)
        if key not in self._scalars:
            if s == 0.0:
                fields = self._complete({name: c[0] for name, c in self.cubics.items()})
            elif s == 1.0:
                fields = self._complete({n: sum(c[1:], c[0]) for n, c in self.cubics.items()})
            else:
                fields = self.fields(s)
            self._scalars[key] = self.context.evaluate(expr, fields)
        return self._scalars[key]

    def nodes(self, expr: Expression) -> list[Float]:
        """Return an expression at both ends and the middle, in order."""
        return [self.scalar(expr, s) for s in NODES]

    def set_scalar(self, expr: Expression, s: float, value: Float) -> None:
        """Set the value of an expression at s: that at the end of the previous stretch, say.

        The integrals over a ray's stretches then join without rounding differences.
        """
        self._scalars[expr.text, s] = value

    def set_controls(self, expr: Expression, values: list[Float]) -> None:
        """Restore the values that `controls` returned for this stretch in another kernel scope."""
        self._scalars[expr.text, 0.0], self._scalars[expr.text, 1.0] = values[0], values[-1]
        self._controls[expr.text] = values

    def hull(self, expr: Expression) -> tuple[Float, Float]:
        """Return bounds of an expression; infinite where it is undefined in a part."""
        found = self.turning(expr)
        return found.low, found.high

    def turns(self, expr: Expression, least: Float) -> Mask:
        """Return where an expression may depart from its chord by more than `least`."""
        return self.turning(expr).apart > least

    def is_cubic(self, expr: Expression) -> bool:
        """Return whether an expression is a cubic of s, as fields are."""
        return is_cubic(expr, self.context)

    def turning(self, expr: Expression) -> Turning:
        """Return the enclosure of an expression; computed once."""
        if expr.text not in self._turnings:
            self._turnings[expr.text] = enclosed(self, expr)
        return self._turnings[expr.text]

    def spread(self, expr: Expression) -> tuple[Any, Any, Any]:
        """Return bounds of an expression's range and of two derivatives; computed once."""
        if expr.text not in self._spreads:
            self._spreads[expr.text] = spread(self, expr)
        return self._spreads[expr.text]

    def controls(self, expr: Expression) -> list[Float]:
        """Return an expression at the four Bézier control points of the fields."""
        if expr.text not in self._controls:
            places = (
                self._complete({name: control_point(c, k) for name, c in self.cubics.items()})
                for k in (1, 2)
            )
            inner = [self.context.evaluate(expr, place) for place in places]
            self._controls[expr.text] = [self.scalar(expr, 0.0), *inner, self.scalar(expr, 1.0)]
        return self._controls[expr.text]

    def derivatives(self, expr: Expression) -> list[Float]:
        """Return bounds of an expression's first three derivatives by s.

        The third is that of a cubic with its values at the control points.
        """
        b0, b1, b2, b3 = self.controls(expr)
        found = self.turning(expr)
        return [found.slope, found.bend, 6.0 * dr.abs(b3 - b0 + 3.0 * (b1 - b2))]

    def field_points(self, name: str) -> list[Float]:
        """Return the Bézier control points of a field."""
        cubic = self.cubics[name]
        inner = [control_point(cubic, number) for number in (1, 2)]
        return [cubic[0], *inner, sum(cubic[1:], cubic[0])]

    def part(self, start: Float, width: Float) -> Stretch:
        """Return the part from `start` to ``start + width`` as a stretch."""
        begin, part = self.context.real(start), self.context.real(width)
        cubics = {name: shifted(c, begin, part) for name, c in self.cubics.items()}
        return Stretch(cubics, self.context, self.length * width)

    def with_constants(self, values: Mapping[str, Any]) -> Stretch:
        """Return the stretch with additional, constant fields."""
        cubics = {**self.cubics, **{name: [value] for name, value in values.items()}}
        found = Stretch(cubics, self.context, self.length, rough=self.rough)
        found.edgeless = self.edgeless
        return found

    def panel(self, first: float, last: float) -> Panel:
        """Return the panel between two of the places 0, ½ and 1."""
        return Panel(self, first, last)

    def _complete(self, fields: dict[str, Any]) -> dict[str, Any]:
        return completed(self.context.ops, within_limits(fields, self.context), self.context)


class Straight(Stretch):
    """A stretch on which scalars are interpolated linearly between its ends."""

    def scalar(self, expr: Expression, s: float) -> Float:
        if 0.0 < s < 1.0:
            return (1.0 - s) * self.scalar(expr, 0.0) + s * self.scalar(expr, 1.0)
        return super().scalar(expr, s)

    def controls(self, expr: Expression) -> list[Float]:
        return [self.scalar(expr, 0.0), self.scalar(expr, 1.0)]

    def ranges(self) -> dict[str, tuple[Any, Any]]:
        first, _, last = self.places()
        return {name: extremes([first[name], last[name]]) for name in first}

    def turning(self, expr: Expression) -> Turning:
        first, last = self.controls(expr)
        zero = self.length * 0.0
        return Turning(*extremes([first, last]), zero, dr.abs(last - first), zero)


@dataclass
class Panel:
    """A part of a stretch, between two of 0, ½ and 1, with scalars interpolated linearly."""

    stretch: Stretch
    first: float
    last: float

    @property
    def length(self) -> Float:
        """Its length, in units of the grid's scale."""
        return self.stretch.length * (self.last - self.first)

    @property
    def per_length(self) -> Float:
        """One over its length, limited so that a surface between two segments is not lost."""
        return 1.0 / dr.select(self.length > _SHORTEST, self.length, _SHORTEST)

    def ends(self, expr: Expression) -> tuple[Float, Float]:
        """Return an expression at both ends."""
        return self.stretch.scalar(expr, self.first), self.stretch.scalar(expr, self.last)

    def fields(self, f: Float) -> dict[str, Any]:
        """Return all fields at a fraction of the panel."""
        return self.stretch.fields(self.place(f))

    def place(self, f: Float) -> Float:
        """Return the place s in the stretch of a fraction of the panel."""
        return self.first + f * (self.last - self.first)


def extremes(values: Sequence[Any]) -> tuple[Float, Float]:
    """Return the least and the largest of some arrays."""
    low = functools.reduce(lambda a, b: dr.select(b < a, b, a), values)
    high = functools.reduce(lambda a, b: dr.select(b > a, b, a), values)
    return low, high


def within_limits(fields: dict[str, Any], context: Context) -> dict[str, Any]:
    """Return interpolated fields, each clipped to the least and largest of its values."""
    for name, (low, high) in context.limits.items():
        if name in fields:
            value = dr.select(fields[name] < low, low, fields[name])
            fields[name] = dr.select(value > high, high, value)
    return fields


def control_point(cubic: Cubic, number: int) -> Float:
    """Return a Bézier control point of a polynomial of at most third degree.

    It is the coefficient of the Bernstein polynomial `number` of degree 3: Σ c_k C(n, k) / C(3, k).
    """
    ratios = {1: (1.0, 1 / 3), 2: (1.0, 2 / 3, 1 / 3)}[number]
    total = cubic[0]
    for c, ratio in zip(cubic[1:], ratios[1:], strict=False):
        total = dr.fma(c, ratio, total)
    return total


def shifted(cubic: Cubic, start: Float, width: Float) -> list[Float]:
    """Return the coefficients of p(start + width s) (Horner's rule for all derivatives)."""
    own = list(cubic)
    count = len(own)
    for first in range(count - 1):
        for k in range(count - 2, first - 1, -1):
            own[k] = dr.fma(own[k + 1], start, own[k])
    power = width
    for k in range(1, count):
        own[k] = own[k] * power
        power = power * width
    return own


@dataclass
class Middle:
    """Centre of mass of a profile in a panel, as a fraction of it, and variance.

    The `spread` is the variance over that of equal masses at both ends: 0 for a thin shell, 1/3 for
    a constant.
    """

    place: Float
    spread: Float


def kept(stretch: Stretch, key: Hashable, make: Callable[[], T]) -> T:
    """Return the cached result of `make` for a stretch, which its panels share."""
    if key not in stretch.cache:
        stretch.cache[key] = make()
    result: T = stretch.cache[key]
    return result


def middle_of(t: Float, variance: Any) -> Middle:
    """Return the `Middle` for a centre of mass and a variance on [-1, 1]."""
    t = dr.select(dr.isnan(t), 0.0, t)  # of infinite ends: log10 where nothing is
    t = dr.select(t < -1.0, -1.0, dr.select(t > 1.0, 1.0, t))
    # The variance is at most that of masses at both ends, 1 - t².
    room = 1.0 - t * t
    spread = variance / dr.select(room > 0.0, room, 1.0)
    return Middle(0.5 + 0.5 * t, dr.select(spread < 1.0 / 3.0, spread, 1.0 / 3.0))
