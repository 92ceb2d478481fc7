"""Intervals with derivatives along a line: how much a value bends, and so how straight it is.

A jet contains, for all places u from 0 to 1 of a segment, intervals of a value and of its first and
second derivative with respect to u (Moore, Kearfott & Cloud 2009, *Introduction to Interval
Analysis*, chapter 9).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from ..backend import Float, dr
from .interval import Truth
from .ops import Ops, Value
from .traced_interval import TracedInterval, TracedIntervalOps, slopes_in_ranges

Derivative: TypeAlias = TracedInterval | None
"""All values of a derivative; None where it is zero everywhere, so that constants cost nothing."""


class TracedJet(NamedTuple):
    """Intervals of a value and of its derivatives; (-∞, ∞) where nothing is known of them."""

    value: TracedInterval
    first: Derivative = None
    second: Derivative = None

    @property
    def fixed(self) -> bool:
        """Whether this is known to be one number."""
        return self.first is None and self.second is None


def plus(a: Derivative, b: Derivative) -> Derivative:
    """Return the sum of two derivatives."""
    if a is None or b is None:
        return b if a is None else a
    return a + b


def times(a: Derivative, b: Derivative) -> Derivative:
    """Return the product of two derivatives, or of one and a value."""
    return None if a is None or b is None else a * b


def negative(a: Derivative) -> Derivative:
    """Return minus a derivative."""
    return None if a is None else -a


def over(a: Derivative, b: TracedInterval) -> Derivative:
    """Return a derivative divided by a value."""
    return None if a is None else a / b


def chain(
    x: TracedJet, value: TracedInterval, slope: TracedInterval, bend: TracedInterval
) -> TracedJet:
    """Return f(x) from f, f' and f'' over the range of x: (f' x')' = f'' x'² + f' x''."""
    second = times(slope, x.second)
    if x.first is not None:
        second = plus(times(bend, x.first * x.first), second)
    return TracedJet(value, times(slope, x.first), second)


class TracedJetOps(Ops):
    """Evaluation with `TracedJet`.

    Values are those of `TracedIntervalOps`. Derivatives are known of arithmetic, powers, roots,
    exponentials, logarithms, sines, hyperbolic tangents and angles; of the rest, and where a kink
    or jump may be, they may be anything.
    """

    def __init__(
        self, float_type: type[Float], constant: Callable[[float], Float] | None = None
    ) -> None:
        self._float = float_type
        self._at = TracedIntervalOps(float_type, constant)
        comparisons = ("less", "less_equal", "greater", "greater_equal", "equal", "not_equal")
        for rule, names in (
            (self._comparison, comparisons),
            (self._function, _DERIVATIVES),
            (self._rough, ("tan", "remainder")),
        ):
            for name in names:
                setattr(self, name, functools.partial(rule, name))

    def prepare(self, values: Mapping[str, Value]) -> tuple[Ops, dict[str, Value]]:
        return self, dict(values)

    def constant(self, value: float) -> TracedJet:
        return TracedJet(self._at.constant(value))

    def interp(
        self, x: TracedJet, places: tuple[float, ...], entries: tuple[float, ...]
    ) -> TracedJet:
        value = self._at.interp(x.value, places, entries)
        slope, straight = slopes_in_ranges(x.value, np.array(places), np.array(entries))
        return chain(x, value, slope, self._zero().unknown_where(~straight, False))

    def is_mask(self, value: Value) -> bool:
        return isinstance(value, Truth)

    def number(self, value: Value) -> TracedJet:
        if not isinstance(value, Truth):
            jet: TracedJet = value
            return jet
        jump = self._zero().unknown_where(value.either, False)
        return TracedJet(self._at.number(value), jump, jump)

    def mask(self, value: Value) -> Truth:
        truth: Truth = value if isinstance(value, Truth) else self._at.mask(value.value)
        return truth

    def ones_like(self, value: TracedJet) -> TracedJet:
        return TracedJet(self._at.ones_like(value.value))

    def add(self, a: TracedJet, b: TracedJet) -> TracedJet:
        return TracedJet(a.value + b.value, plus(a.first, b.first), plus(a.second, b.second))

    def negative(self, a: TracedJet) -> TracedJet:  # type: ignore[override]
        return TracedJet(-a.value, negative(a.first), negative(a.second))

    def positive(self, a: TracedJet) -> TracedJet:  # type: ignore[override]
        return a

    def subtract(self, a: TracedJet, b: TracedJet) -> TracedJet:
        return self.add(a, self.negative(b))

    def multiply(self, a: TracedJet, b: TracedJet) -> TracedJet:
        """Return the product: (ab)'' = a'' b + 2 a' b' + a b''."""
        cross = times(a.first, b.first)
        outer = plus(times(a.second, b.value), times(a.value, b.second))
        return TracedJet(
            a.value * b.value,
            plus(times(a.first, b.value), times(a.value, b.first)),
            plus(plus(cross, cross), outer),
        )

    def divide(self, a: TracedJet, b: TracedJet) -> TracedJet:
        """Return the quotient; its value is that of intervals, tighter than a product's."""
        value = a.value / b.value
        if b.fixed:
            return TracedJet(value, over(a.first, b.value), over(a.second, b.value))
        return self.multiply(a, self.integer_power(b, -1))._replace(value=value)

    def integer_power(self, base: TracedJet, exponent: int) -> TracedJet:
        at = self._at
        value = at.integer_power(base.value, exponent)
        if base.fixed:
            return TracedJet(value)
        slope = float(exponent) * at.integer_power(base.value, exponent - 1)
        bend = float(exponent * (exponent - 1)) * at.integer_power(base.value, exponent - 2)
        return chain(base, value, slope, bend)

    def power(self, base: TracedJet, exponent: TracedJet) -> TracedJet:
        """Return base**exponent; nothing is known of the derivatives if both vary."""
        at = self._at
        value, p = at.power(base.value, exponent.value), exponent.value
        if base.fixed:
            growth = at.log(base.value)  # undefined for negative numbers, as most powers are
            return chain(exponent, value, growth * value, growth * (growth * value))
        if not exponent.fixed:
            return self._of_unknown_shape(value, (base, exponent))
        slope = p * at.power(base.value, p - 1.0)
        bend = p * (p - 1.0) * at.power(base.value, p - 2.0)
        return chain(base, value, slope, bend)

    def atan2(self, y: TracedJet, x: TracedJet) -> TracedJet:
        """Return the angle; it jumps by a turn where y changes its sign left of the origin."""
        value, *derivatives = self.turning_angle(y, x)
        if y.fixed and x.fixed:
            return TracedJet(value)
        cut = (y.value.lo < 0.0) & (y.value.hi >= 0.0) & (x.value.lo <= 0.0)
        unknown = (self._interval(d).unknown_where(cut, False) for d in derivatives)
        return TracedJet(value, *unknown)

    def turning_angle(self, y: TracedJet, x: TracedJet) -> TracedJet:
        """Return the angle: α' = (y'x - yx')/r², α'' = (y''x - yx'' - α'(r²)')/r².

        The derivatives are those of an angle that continues where this one jumps by a turn.
        """
        value = self._at.atan2(y.value, x.value)
        if y.fixed and x.fixed:
            return TracedJet(value)

        def cross(dy: Derivative, dx: Derivative) -> Derivative:
            return plus(times(dy, x.value), negative(times(y.value, dx)))

        square = x.value * x.value + y.value * y.value
        turn = over(cross(y.first, x.first), square)
        growth = plus(times(x.value, x.first), times(y.value, y.first))
        bend = cross(y.second, x.second)
        twice = times(turn, plus(growth, growth))
        return TracedJet(value, turn, over(plus(bend, negative(twice)), square))

    def floor_divide(self, left: TracedJet, right: TracedJet) -> TracedJet:
        """Return the quotient rounded down: constant, but for jumps."""
        value = self._at.floor_divide(left.value, right.value)
        if left.fixed and right.fixed:
            return TracedJet(value)
        jump = self._zero().unknown_where(~(value.lo == value.hi), False)
        return TracedJet(value, jump, jump)

    def abs(self, x: TracedJet) -> TracedJet:  # type: ignore[override]
        """Return the magnitude; it has a kink where the sign changes."""
        return self._kinked(abs(x.value), x.value >= 0.0, x, self.negative(x))

    def minimum(self, left: TracedJet, right: TracedJet) -> TracedJet:
        value = self._at.minimum(left.value, right.value)
        return self._kinked(value, left.value < right.value, left, right)

    def maximum(self, left: TracedJet, right: TracedJet) -> TracedJet:
        value = self._at.maximum(left.value, right.value)
        return self._kinked(value, left.value > right.value, left, right)

    def where(self, mask: Truth, chosen: TracedJet, otherwise: TracedJet) -> TracedJet:
        """Return the one or the other; where it can be either, derivatives may be anything."""
        value = self._at.where(mask, chosen.value, otherwise.value)
        found = self._kinked(value, mask, chosen, otherwise)
        return found._replace(first=self._interval(found.first).unknown_where(mask.either, False))

    def _kinked(
        self, value: TracedInterval, mask: Truth, chosen: TracedJet, otherwise: TracedJet
    ) -> TracedJet:
        """Return the one or the other, equal where it changes: slopes are between those of both."""
        first, second = (
            self._at.where(mask, self._interval(a), self._interval(b))
            for a, b in ((chosen.first, otherwise.first), (chosen.second, otherwise.second))
        )
        return TracedJet(value, first, second.unknown_where(mask.either, False))

    def _function(self, name: str, x: TracedJet) -> TracedJet:
        value = getattr(self._at, name)(x.value)
        return (
            TracedJet(value)
            if x.fixed
            else chain(x, value, *_DERIVATIVES[name](self, x.value, value))
        )

    def _comparison(self, name: str, a: TracedJet, b: TracedJet) -> Truth:
        truth: Truth = getattr(self._at, name)(a.value, b.value)
        return truth

    def _rough(self, name: str, *xs: TracedJet) -> TracedJet:
        return self._of_unknown_shape(getattr(self._at, name)(*(x.value for x in xs)), xs)

    def _of_unknown_shape(self, value: TracedInterval, inputs: Sequence[TracedJet]) -> TracedJet:
        if all(x.fixed for x in inputs):
            return TracedJet(value)
        anything = TracedInterval(self._float(-dr.inf), self._float(dr.inf))
        return TracedJet(value, anything, anything)

    def _interval(self, derivative: Derivative) -> TracedInterval:
        return self._zero() if derivative is None else derivative

    def _zero(self) -> TracedInterval:
        return TracedInterval.constant(self._float(0))


def _around(ops: TracedJetOps, number: float) -> TracedInterval:
    return TracedInterval(*(ops._float(float(np.nextafter(number, end))) for end in (0, np.inf)))


_Rule: TypeAlias = Callable[
    [TracedJetOps, TracedInterval, TracedInterval], tuple[TracedInterval, TracedInterval]
]
# The first two derivatives of a function f, from the ranges of x and f.
_DERIVATIVES: dict[str, _Rule] = {
    "exp": lambda ops, x, f: (f, f),
    "log": lambda ops, x, f: (slope := _around(ops, 1.0) / x, -(slope / x)),
    "log10": lambda ops, x, f: (slope := _around(ops, 1.0 / math.log(10.0)) / x, -(slope / x)),
    "sqrt": lambda ops, x, f: (slope := 0.5 / f, -0.5 * (slope / x)),
    "sin": lambda ops, x, f: (ops._at.cos(x), -f),
    "cos": lambda ops, x, f: (-ops._at.sin(x), -f),
    "tanh": lambda ops, x, f: (slope := 1.0 - f * f, -2.0 * (f * slope)),
}
