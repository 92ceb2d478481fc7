"""The operations of expressions on intervals: which values an expression can have in a box."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from .error_free import Array
from .interval import Interval, Truth, corners, extremes
from .interval_functions import (
    angle_of,
    enclosed,
    from_zero,
    increasing,
    positive_power,
    relative_loss,
    tangent,
    unknown_where,
    wave,
)
from .interval_interpolation import interpolate_ranges
from .ops import Ops

# From here on a quotient and its neighbours are hard to tell apart.
_LARGEST_QUOTIENT = 0.25 / float(np.finfo(np.float64).eps)


class IntervalOps(Ops):
    """Evaluation with `Interval`: an enclosure of all values in a box of field values.

    The fields are independent of each other: each takes every value of its interval. The result
    holds every value of the expression, computed with real numbers, or in double precision by
    `NumpyOps` or `DrjitOps` (in single precision, it may lie outside by that rounding). It is tight
    to a few ε where each field occurs once and the expression is continuous; elsewhere, it may be
    too large, but never too small.
    """

    def prepare(self, values: Mapping[str, Any]) -> tuple[Ops, dict[str, Any]]:
        return self, {name: Interval.of(value) for name, value in values.items()}

    def constant(self, value: float) -> Interval:
        return Interval(value)

    def interpolate(self, x: Interval, places: np.ndarray, entries: np.ndarray) -> Interval:
        return interpolate_ranges(x, places, [entries])[0]

    def is_mask(self, value: Any) -> bool:
        return isinstance(value, Truth)

    def number(self, value: Any) -> Interval:
        if isinstance(value, Truth):
            return Interval(np.where(value.false, 0.0, 1.0), np.where(value.true, 1.0, 0.0))
        return Interval.of(value)

    def ones_like(self, value: Interval) -> Interval:
        """Return ones, as many as `value` has."""
        return Interval(np.ones_like(value.lo))

    def where(self, mask: Truth, chosen: Interval, otherwise: Interval) -> Interval:
        """Return the one, the other, or the hull of both where the mask can be either."""
        lo, _ = extremes(_choices(mask, chosen.lo, otherwise.lo))
        _, hi = extremes(_choices(mask, chosen.hi, otherwise.hi))
        return Interval(lo, hi, (mask.true & chosen.nan) | (mask.false & otherwise.nan))

    def minimum(self, left: Interval, right: Interval) -> Interval:
        """Return the smaller of both; undefined if one is."""
        ends = np.minimum(left.lo, right.lo), np.minimum(left.hi, right.hi)
        return Interval(*ends, left.nan | right.nan)

    def maximum(self, left: Interval, right: Interval) -> Interval:
        """Return the larger of both; undefined if one is."""
        ends = np.maximum(left.lo, right.lo), np.maximum(left.hi, right.hi)
        return Interval(*ends, left.nan | right.nan)

    def integer_power(self, base: Interval, exponent: int) -> Interval:
        if exponent < 3 or exponent % 2 == 0:
            return super().integer_power(base, exponent)
        low, high = (
            end * self.integer_power(end, exponent - 1)
            for end in (Interval(base.lo), Interval(base.hi))
        )
        return Interval(low.lo, high.hi, base.nan)

    def power(self, base: Interval, exponent: Interval) -> Interval:
        """Return base**exponent; undefined for a negative base unless the exponent is whole."""
        whole = (exponent.lo == exponent.hi) & (np.floor(exponent.lo) == exponent.lo)
        odd = whole & (np.remainder(exponent.lo, 2) == 1)
        up = positive_power(Interval(np.maximum(base.lo, 0), np.maximum(base.hi, 0)), exponent)
        down = positive_power(Interval(np.maximum(-base.hi, 0), np.maximum(-base.lo, 0)), exponent)
        down = self.where(Truth(~odd, ~whole | odd), down, -down)
        down = Interval(down.lo, down.hi, ~whole)
        found = self.where(Truth(base.hi >= 0, base.lo < 0), up, down)
        # The reciprocal of a zero is of its sign, which ends do not tell, unless it is squared.
        anything = base.contains(0) & (exponent.lo < 0) & ~(whole & ~odd)
        return unknown_where(anything, found, found.nan | base.nan | exponent.nan)

    def floor_divide(self, left: Interval, right: Interval) -> Interval:
        """Return the quotient rounded down; undefined for an infinite numerator."""
        lo, hi = extremes(_whole_quotient(*ends) for ends in corners(left, right))
        found = enclosed((lo, hi), (_quotient_loss(lo), _quotient_loss(hi)))
        by_zero = right.contains(0)
        undefined = left.nan | right.nan | left.infinite | (by_zero & left.contains(0))
        return unknown_where(by_zero, found, undefined)

    def remainder(self, left: Interval, right: Interval) -> Interval:
        """Return the remainder, which lies between zero and the divisor."""
        quotient = self.floor_divide(left, right)
        same = quotient.lo == quotient.hi
        rest = left - Interval(quotient.lo) * right
        lo, hi = np.minimum(right.lo, 0), np.maximum(right.hi, 0)
        lo = np.where(same, np.clip(rest.lo, lo, hi), lo)
        hi = np.where(same, np.clip(rest.hi, lo, hi), hi)
        undefined = left.nan | right.nan | left.infinite | right.contains(0)
        return unknown_where(quotient.size > _LARGEST_QUOTIENT, Interval(lo, hi), undefined)

    def exp(self, x: Interval) -> Interval:
        """Return the exponential."""
        return increasing(np.exp, x, exact_at=0, least=0.0)

    def tanh(self, x: Interval) -> Interval:
        """Return the hyperbolic tangent."""
        return increasing(np.tanh, x, exact_at=0, least=-1.0, most=1.0)

    def log(self, x: Interval) -> Interval:
        """Return the natural logarithm; undefined for negative numbers."""
        return increasing(np.log, from_zero(x), exact_at=1)

    def log10(self, x: Interval) -> Interval:
        """Return the logarithm to base 10; undefined for negative numbers."""
        return increasing(np.log10, from_zero(x), exact_at=1)

    def sqrt(self, x: Interval) -> Interval:
        """Return the square root; undefined for negative numbers."""
        return increasing(np.sqrt, from_zero(x), exact_at=0, least=0.0)

    def sin(self, x: Interval) -> Interval:
        """Return the sine."""
        return wave(np.sin, x, highest_at=0.5 * math.pi)

    def cos(self, x: Interval) -> Interval:
        """Return the cosine."""
        return wave(np.cos, x, highest_at=0.0)

    def tan(self, x: Interval) -> Interval:
        """Return the tangent; all numbers if there may be a pole in the interval."""
        return tangent(x)

    def atan2(self, y: Interval, x: Interval) -> Interval:
        """Return the angle of the point (x, y); from -π to π if the box meets the branch cut."""
        return angle_of(y, x)


def _choices(mask: Truth, chosen: Array, otherwise: Array) -> list[Array]:
    return [np.where(mask.true, chosen, np.nan), np.where(mask.false, otherwise, np.nan)]


def _whole_quotient(left: Array, right: Array) -> Array:
    # NumPy has no quotient of an infinite numerator, of which only the limit matters here.
    quotient = np.where(np.isinf(left), left / right, np.floor_divide(left, right))
    same_sign = np.signbit(left) == np.signbit(right)
    return np.where(np.isinf(left) & np.isinf(right), np.where(same_sign, 0, -1), quotient)


def _quotient_loss(quotient: Array) -> Array:
    return np.where(np.abs(quotient) < _LARGEST_QUOTIENT, 0, relative_loss(quotient))
