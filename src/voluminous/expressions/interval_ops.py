"""The operations of expressions on intervals: which values an expression can have in a box.

Between the ends of an interval lie any number of entries of a table. Their extremes are those of
two blocks of 2^k entries that may overlap, and the extremes of all such blocks are tabulated
(Bender & Farach-Colton, *The LCA problem revisited*, 2000, section 3).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from .interval import Array, Interval, Own, TablePosition, Truth
from .ops import NumpyOps, Ops, Value

# Error of a library's functions in ε: NumPy's 2, Dr.Jit's 4, both at the end of an interval and at
# the place inside; and as much again for safety.
_LOSS = 16.0
# Error of an interpolated value in ε of the largest value around: 1.5 from the position, 1 from the
# difference of two values, 0.5 from their sum, and as much again for safety.
_LOSS_OF_TABLES = 8.0


class IntervalOps(Ops):
    """Evaluation with `Interval`: an enclosure of all values in a box of field values.

    The fields are independent of each other: each takes every value of its interval. The result
    contains every value of the expression, computed with real numbers, or in double precision by
    `NumpyOps` or `DrjitOps` (in single precision, a value may lie outside by that rounding). It is
    tight to some ε where each field occurs once and the expression is continuous, except for ``//``
    and ``%``; elsewhere it may be too large, but never too small.
    """

    loss_of_angles: ClassVar[float] = _LOSS

    def __init__(self) -> None:
        self._real: type[Array] = np.float64
        self._at: Ops = NumpyOps()

    def of(self, value: Any) -> Interval:
        return Interval.of(value)

    def prepare(self, values: Mapping[str, Value]) -> tuple[Ops, dict[str, Value]]:
        return self, {name: self.of(value) for name, value in values.items()}

    def constant(self, value: float) -> Value:
        return Interval(value)

    def interp(self, x: Value, places: tuple[float, ...], entries: tuple[float, ...]) -> Value:
        return interpolate_ranges(x, np.array(places), [np.array(entries)])[0]

    def is_mask(self, value: Value) -> bool:
        return isinstance(value, Truth)

    def number(self, value: Value) -> Value:
        if not isinstance(value, Truth):
            return self.of(value)
        zero, one, interval = self._real(0.0), self._real(1.0), type(self.literal(1.0))
        select = interval.ends.select
        return interval(select(value.false, zero, one), select(value.true, one, zero))

    def ones_like(self, value: Value) -> Value:
        return Interval(np.ones_like(value.lo))

    def where(self, mask: Truth, chosen: Own, otherwise: Own) -> Own:
        """Return the one, the other, or the hull of both where the mask can be either."""
        ends = chosen.ends
        lo, hi = (
            ends.select(mask.true, ends.select(mask.false, extreme(one, other), one), other)
            for extreme, one, other in (
                (ends.smaller, chosen.lo, otherwise.lo),
                (ends.larger, chosen.hi, otherwise.hi),
            )
        )
        return type(chosen)(lo, hi, (mask.true & chosen.nan) | (mask.false & otherwise.nan))

    def minimum(self, left: Own, right: Own) -> Own:
        smaller = left.ends.smaller
        limits = smaller(left.lo, right.lo), smaller(left.hi, right.hi)
        return type(left)(*limits, left.nan | right.nan)

    def maximum(self, left: Own, right: Own) -> Own:
        larger = left.ends.larger
        limits = larger(left.lo, right.lo), larger(left.hi, right.hi)
        return type(left)(*limits, left.nan | right.nan)

    def integer_power(self, base: Value, exponent: int) -> Value:
        if exponent < 3 or exponent % 2 == 0:
            return super().integer_power(base, exponent)
        ends = (Interval(base.lo), Interval(base.hi))
        low, high = (end * self.integer_power(end, exponent - 1) for end in ends)
        return Interval(low.lo, high.hi, base.nan)

    def power(self, base: Own, exponent: Own) -> Own:
        """Return base**exponent; undefined for a negative base unless the exponent is whole."""
        floor, make = base.ends.floor, type(base)
        whole = (exponent.lo == exponent.hi) & (floor(exponent.lo) == exponent.lo)
        odd = whole & ~(floor(exponent.lo / 2) * 2 == exponent.lo)
        up = self._positive_power(base, exponent)
        down = self._positive_power(make(-base.hi, -base.lo), exponent)
        down = self.where(Truth(~odd, ~whole | odd), down, -down)
        down = make(down.lo, down.hi, ~whole)
        found = self.where(Truth(base.hi >= 0, base.lo < 0), up, down)
        # The reciprocal of a zero has its sign, which ends do not have, unless it is squared.
        anything = base.contains(0) & (exponent.lo < 0) & ~(whole & ~odd)
        return found.unknown_where(anything, base.nan | exponent.nan)

    def _positive_power(self, base: Own, exponent: Own) -> Own:
        """Return a power of the part of the base that is not negative: monotonic in both."""
        ends = base.ends
        base = _from_zero(type(base)(ends.positive(base.lo), ends.positive(base.hi)))
        lows, highs = [], []
        for b, e in base.corners(exponent):
            value, doublings = self._at.power(b, e), ends.abs(e * ends.log2(b))
            # The power is 2**(e log2 b), which turns the rounding of the product into a factor.
            loss = _LOSS + 2 * ends.select(ends.isfinite(doublings), doublings, 0)
            exact = (b == 0) | (b == 1) | (e == 0)
            lows.append(ends.select(exact, value, ends.lowered(value, loss)))
            highs.append(ends.select(exact, value, ends.raised(value, loss)))
        return type(base)(ends.positive(ends.extremes(lows)[0]), ends.extremes(highs)[1])

    def floor_divide(self, left: Own, right: Own) -> Own:
        """Return the quotient rounded down; undefined for an infinite numerator."""
        quotient, floor = left / right, left.ends.floor
        undefined = left.nan | right.nan | left.infinite | (right.contains(0) & left.contains(0))
        rounded = type(left)(floor(quotient.lo), floor(quotient.hi), undefined)
        # The limit of a quotient of two infinities is 0 or -1.
        return rounded.unknown_where(left.infinite & right.infinite, undefined)

    def remainder(self, left: Own, right: Own) -> Own:
        """Return the remainder, which lies between zero and the divisor."""
        quotient, ends, make = self.floor_divide(left, right), left.ends, type(left)
        rest = left - make(quotient.lo) * right
        least, most = -ends.positive(-right.lo), ends.positive(right.hi)
        same = quotient.lo == quotient.hi
        lo = ends.select(same, ends.larger(rest.lo, least), least)
        hi = ends.select(same, ends.smaller(rest.hi, most), most)
        # From here on a quotient and its neighbours are hard to tell apart.
        vague = quotient.size > 0.25 / float(ends.info(left.lo).eps)
        undefined = left.nan | right.nan | left.infinite | right.contains(0)
        return make(lo, hi, undefined).unknown_where(vague, undefined)

    def exp(self, x: Own) -> Own:
        return _increasing(self._at.exp, x, exact_at=0, least=0.0)

    def tanh(self, x: Own) -> Own:
        return _increasing(self._at.tanh, x, exact_at=0, least=-1.0, most=1.0)

    def log(self, x: Own) -> Own:
        return _increasing(self._at.log, _from_zero(x), exact_at=1)

    def log10(self, x: Own) -> Own:
        return _increasing(self._at.log10, _from_zero(x), exact_at=1)

    def sqrt(self, x: Own) -> Own:
        return _increasing(self._at.sqrt, _from_zero(x), exact_at=0, least=0.0)

    def sin(self, x: Own) -> Own:
        return _wave(self._at.sin, x, highest_at=0.5 * math.pi)

    def cos(self, x: Own) -> Own:
        return _wave(self._at.cos, x, highest_at=0.0)

    def tan(self, x: Own) -> Own:
        """Return the tangent; all numbers if there may be a pole in the interval."""
        low, high, select = self._at.tan(x.lo), self._at.tan(x.hi), x.ends.select
        # Its slope is 1 + tan².
        low, high = low - _angle_loss(x, low * low, x.lo), high + _angle_loss(x, high * high, x.hi)
        pole = _meets(x, 0.5 * math.pi, math.pi)
        lo, hi = select(pole, -np.inf, low), select(pole, np.inf, high)
        return type(x)(lo, hi, _undefined_angle(x))

    def atan2(self, y: Own, x: Own) -> Own:
        """Return the angle of the point (x, y); from -π to π if the box meets the branch cut."""
        # Along the edges of a box that neither holds the origin nor is cut, angles are monotonic.
        ends = x.ends
        lo, hi = ends.extremes([self._at.atan2(first, second) for first, second in y.corners(x)])
        cut = y.contains(0) & (x.lo <= 0)
        lo = ends.lowered(ends.select(cut, -math.pi, lo), self.loss_of_angles)
        hi = ends.raised(ends.select(cut, math.pi, hi), self.loss_of_angles)
        lo = ends.select((y.lo >= 0) & ~cut & (lo < 0), 0, lo)
        # Dr.Jit has no value for two infinities.
        return type(x)(lo, hi, y.nan | x.nan | (y.infinite & x.infinite))


def _increasing(
    function: Callable[[Array], Array],
    x: Own,
    exact_at: float,
    least: float = -math.inf,
    most: float = math.inf,
) -> Own:
    low, high, ends = function(x.lo), function(x.hi), x.ends
    low = ends.select(x.lo == exact_at, low, ends.lowered(low, _LOSS))
    high = ends.select(x.hi == exact_at, high, ends.raised(high, _LOSS))
    low, high = ends.select(low < least, least, low), ends.select(high > most, most, high)
    return type(x)(low, high, x.nan)


def _from_zero(x: Own) -> Own:
    """Return the part that is not negative, for functions that are undefined elsewhere.

    Its ends are zero or normal numbers, because functions may lose all digits of subnormal ones.
    """
    tiny, select = float(x.ends.info(x.lo).tiny), x.ends.select
    hi = select((x.hi > 0) & (x.hi < tiny), tiny, x.hi)
    return type(x)(select(x.lo < tiny, 0, x.lo), hi, x.nan | (x.lo < 0))


def _wave(function: Callable[[Array], Array], x: Own, highest_at: float) -> Own:
    moved: list[Array] = []
    for angle in (x.lo, x.hi):
        value = function(angle)
        loss = _angle_loss(x, value, angle)
        moved += [value - loss, value + loss]
    lo, hi = x.ends.extremes(moved)
    lo = x.ends.select(_meets(x, highest_at + math.pi, math.tau) | (lo < -1), -1, lo)
    hi = x.ends.select(_meets(x, highest_at, math.tau) | (hi > 1), 1, hi)
    return type(x)(lo, hi, _undefined_angle(x))


def _angle_loss(x: Interval, value: Array, angle: Array) -> Array:
    # Taking off whole turns loses ε; of small angles none are taken off.
    eps, size = float(x.ends.info(x.lo).eps), x.ends.abs(angle)
    return _LOSS * eps * (x.ends.abs(value) + x.ends.select(size < 1, size, 1))


def _undefined_angle(x: Interval) -> Array:
    # Rounding exceeds one turn from here on, and Dr.Jit gives NaN.
    return x.nan | (x.size > 1 / float(x.ends.info(x.lo).eps))


def _meets(x: Interval, place: float, period: float) -> Array:
    """Return where the interval may contain `place`, or that some periods further."""
    ends, loss = x.ends, 4 * float(x.ends.info(x.lo).eps)
    first, last = (x.lo - place) / period, (x.hi - place) / period
    before = ends.ceil(first - loss * (1 + ends.abs(first)))
    after = ends.floor(last + loss * (1 + ends.abs(last)))
    return ~(before > after)


def interpolate_ranges(x: Own, nodes: np.ndarray, columns: Sequence[np.ndarray]) -> list[Own]:
    """Return enclosures of columns interpolated anywhere in x: from both ends and all between."""
    places = [x.ends.locate(end, nodes) for end in (x.lo, x.hi)]
    return [_enclosure(x, column, *places) for column in columns]


def _enclosure(x: Own, column: np.ndarray, first: TablePosition, last: TablePosition) -> Own:
    ends, data = x.ends, x.ends.data(column, x.lo)
    pieces = [
        (ends.gather(data, place.upper - 1), ends.gather(data, place.upper))
        for place in (first, last)
    ]
    values = [
        ends.fma(place.fraction, after - before, before)
        for place, (before, after) in zip((first, last), pieces, strict=True)
    ]
    # The entries between are among those around: with none between, any of the values will do.
    between = [
        extreme_between(x, column, extreme, first.passed, last.passed, values[0])
        for extreme in (np.minimum, np.maximum)
    ]
    least, most = ends.extremes([*pieces[0], *pieces[1], *between])
    lo, hi = ends.extremes([*values, *between])
    info = ends.info(x.lo)
    largest = ends.larger(ends.abs(least), ends.abs(most))
    loss = ends.fma(largest, _LOSS_OF_TABLES * float(info.eps), float(info.tiny))
    loss = ends.select(least < most, loss, 0)  # equal entries lose nothing
    lo, hi = lo - loss, hi + loss
    # Rounding never carries a value across zero.
    lo = ends.select(least >= 0, ends.positive(lo), lo)
    hi = ends.select(most <= 0, -ends.positive(-hi), hi)
    return type(x)(lo, hi, x.nan)


def extreme_between(
    x: Interval, column: np.ndarray, extreme: np.ufunc, start: Array, stop: Array, otherwise: Array
) -> Array:
    """Return the extreme of ``column[start:stop]``; `otherwise` where that is empty."""
    ends, rows, half = x.ends, [np.ascontiguousarray(column)], 1
    while 2 * half <= len(column):  # the extremes of 1, 2, 4 … entries from each entry on
        row = rows[-1].copy()
        row[:-half] = extreme(row[:-half], row[half:])
        rows.append(row)
        half *= 2
    data = ends.data(np.concatenate(rows), x.lo)
    first, last, some = ends.two_blocks(start, stop, len(column))
    pair = ends.gather(data, first, some), ends.gather(data, last, some)
    larger = extreme is np.maximum
    return ends.select(some, (ends.larger if larger else ends.smaller)(*pair), otherwise)
