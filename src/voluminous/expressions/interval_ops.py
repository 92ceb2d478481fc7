"""The operations of expressions on intervals: what values an expression can have in a box."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from .interval import Array, Interval, Truth, corners, extremes, outward
from .ops import Ops

_EPS = float(np.finfo(np.float64).eps)
# What the functions of a library may lose, in ε: NumPy's 2, Dr.Jit's 4 (log10 and tanh), and twice
# that, because values between the ends are rounded too.
_LOSS = 16
# Quotients from here on are not told from their neighbours by // and %.
_LARGEST_QUOTIENT = 0.25 / _EPS
# Dr.Jit overflows a little before NumPy.
_OVERFLOW = 2.0**1023
# More turns than this are NaN in Dr.Jit.
_LARGEST_ANGLE = 1 / _EPS


class IntervalOps(Ops):
    """Evaluation with `Interval`: an enclosure of all values in a box of field values.

    The fields are independent of each other: each takes every value of its interval. The result
    holds every value of the expression, computed with real numbers, or in double precision by
    `NumpyOps` or `DrjitOps` (in single precision, it may lie outside by that rounding). It is tight
    to a few ε where each field occurs once and the expression is continuous; elsewhere, it may be
    too large, but never too small.
    """

    def prepare(self, values: Mapping[str, Any]) -> tuple[Ops, dict[str, Any]]:
        """Return this evaluator, and the fields as intervals."""
        return self, {name: Interval.of(value) for name, value in values.items()}

    def constant(self, value: float) -> Interval:
        """Return the interval of one number."""
        return Interval(value)

    def is_mask(self, value: Any) -> bool:
        """Return True for truth values."""
        return isinstance(value, Truth)

    def number(self, value: Any) -> Interval:
        """Return `value` as an interval; true is 1 and false is 0."""
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

    def exp(self, x: Interval) -> Interval:
        """Return the exponential."""
        return _increasing(np.exp, x, exact_at=0, least=0.0)

    def tanh(self, x: Interval) -> Interval:
        """Return the hyperbolic tangent."""
        return _increasing(np.tanh, x, exact_at=0, least=-1.0, most=1.0)

    def log(self, x: Interval) -> Interval:
        """Return the natural logarithm; undefined for negative numbers."""
        return _increasing(np.log, _from_zero(x), exact_at=1)

    def log10(self, x: Interval) -> Interval:
        """Return the logarithm to base 10; undefined for negative numbers."""
        return _increasing(np.log10, _from_zero(x), exact_at=1)

    def sqrt(self, x: Interval) -> Interval:
        """Return the square root; undefined for negative numbers."""
        return _increasing(np.sqrt, _from_zero(x), exact_at=0, least=0.0)

    def sin(self, x: Interval) -> Interval:
        """Return the sine."""
        return _wave(np.sin, x, highest_at=0.5 * math.pi)

    def cos(self, x: Interval) -> Interval:
        """Return the cosine."""
        return _wave(np.cos, x, highest_at=0.0)

    def tan(self, x: Interval) -> Interval:
        """Return the tangent; any number if there is a pole in the interval."""
        lo, hi = np.tan(x.lo), np.tan(x.hi)
        lo, hi = lo - _angle_loss(x.lo) * (1 + lo * lo), hi + _angle_loss(x.hi) * (1 + hi * hi)
        anything = _meets(x, 0.5 * math.pi, math.pi) | ~(lo <= hi)
        ends = np.where(anything, -np.inf, lo), np.where(anything, np.inf, hi)
        return Interval(*ends, x.nan | (x.size > _LARGEST_ANGLE))

    def atan2(self, y: Interval, x: Interval) -> Interval:
        """Return the angle of the point (x, y); from -π to π if the box meets the branch cut."""
        # Angles grow or shrink along each edge of a box that neither holds the origin nor is cut.
        lo, hi = extremes(np.arctan2(first, second) for first, second in corners(y, x))
        cut = y.contains(0) & (x.lo <= 0)
        half_turn = np.nextafter(math.pi, np.inf)
        ends = np.where(cut, -half_turn, lo), np.where(cut, half_turn, hi)
        both_infinite = y.infinite & x.infinite
        return _widened(*ends, y.nan | x.nan | both_infinite, least=-half_turn, most=half_turn)

    def power(self, base: Interval, exponent: Interval) -> Interval:
        """Return base**exponent; undefined for a negative base unless the exponent is whole."""
        found = _power_of_positive(abs(base), exponent)
        whole = (exponent.lo == exponent.hi) & (np.floor(exponent.lo) == exponent.lo)
        odd = whole & (np.abs(np.remainder(exponent.lo, 2)) == 1)
        raised = _power_of_positive(Interval(np.maximum(base.lo, 0), np.maximum(base.hi, 0)), exponent)
        sunk = _power_of_positive(Interval(np.maximum(-base.hi, 0), np.maximum(-base.lo, 0)), exponent)
        negative = base.lo < 0
        lo = np.where(negative & ~whole, -found.hi, found.lo)
        raise NotImplementedError


def _choices(mask: Truth, chosen: Array, otherwise: Array) -> list[Array]:
    return [np.where(mask.true, chosen, np.nan), np.where(mask.false, otherwise, np.nan)]
