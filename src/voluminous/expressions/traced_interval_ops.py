"""The operations of expressions on intervals inside kernels: guaranteed bounds along a ray."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..backend import dr
from .drjit_ops import DrjitOps
from .interval import Truth
from .ops import Ops
from .traced_functions import (
    angle_of,
    from_zero,
    increasing,
    positive_power,
    tangent,
    wave,
    whole_power,
)
from .traced_interpolation import interpolate_traced_ranges
from .traced_interval import TracedInterval, traced
from .traced_rounding import float_info, larger, positive, smaller


class TracedIntervalOps(Ops):
    """Evaluation with `TracedInterval`: an enclosure of all values in a box of field values.

    The counterpart of `IntervalOps` inside kernels. The result holds every value of the expression,
    computed with real numbers or by `DrjitOps` in the same type; constants are those of this type.
    It is tight to some ε where each field occurs once and the expression is continuous, but for
    ``//``, ``%``, and ends at which a square root or logarithm just begins to exist.

    Parameters
    ----------
    float_type : type
        The Dr.Jit type of the ends.
    constant : callable, optional
        As in `DrjitOps`.
    """

    def __init__(self, float_type: Any, constant: Callable[[float], Any] | None = None) -> None:
        self._float = float_type
        self._constant = float_type if constant is None else constant
        self._at = DrjitOps(float_type)

    def prepare(self, values: Mapping[str, Any]) -> tuple[Ops, dict[str, Any]]:
        return self, {name: traced(self._float, value) for name, value in values.items()}

    def constant(self, value: float) -> TracedInterval:
        return TracedInterval.constant(self._constant(value))

    def literal(self, value: float) -> TracedInterval:
        return TracedInterval.constant(self._float(value))

    def interpolate(self, x: TracedInterval, places: np.ndarray, entries: np.ndarray) -> Any:
        return interpolate_traced_ranges(x, places, [entries])[0]

    def is_mask(self, value: Any) -> bool:
        return isinstance(value, Truth)

    def number(self, value: Any) -> TracedInterval:
        if not isinstance(value, Truth):
            return traced(self._float, value)
        zero, one = self._float(0), self._float(1)
        return TracedInterval(dr.select(value.false, zero, one), dr.select(value.true, one, zero))

    def ones_like(self, value: TracedInterval) -> TracedInterval:
        """Return one."""
        return TracedInterval.constant(self._float(1))

    def where(self, mask: Truth, chosen: TracedInterval, otherwise: TracedInterval) -> Any:
        """Return the one, the other, or the hull of both where the mask can be either."""
        lo, hi = (
            dr.select(mask.true, dr.select(mask.false, extreme(one, other), one), other)
            for extreme, one, other in (
                (smaller, chosen.lo, otherwise.lo),
                (larger, chosen.hi, otherwise.hi),
            )
        )
        return TracedInterval(lo, hi, (mask.true & chosen.nan) | (mask.false & otherwise.nan))

    def minimum(self, left: TracedInterval, right: TracedInterval) -> TracedInterval:
        """Return the smaller of both; undefined if one is."""
        ends = smaller(left.lo, right.lo), smaller(left.hi, right.hi)
        return TracedInterval(*ends, left.nan | right.nan)

    def maximum(self, left: TracedInterval, right: TracedInterval) -> TracedInterval:
        """Return the larger of both; undefined if one is."""
        ends = larger(left.lo, right.lo), larger(left.hi, right.hi)
        return TracedInterval(*ends, left.nan | right.nan)

    def integer_power(self, base: TracedInterval, exponent: int) -> TracedInterval:
        if exponent < 2:
            return super().integer_power(base, exponent)
        return whole_power(lambda end: self._at.integer_power(end, exponent), base, exponent)

    def power(self, base: TracedInterval, exponent: TracedInterval) -> TracedInterval:
        """Return base**exponent; undefined for a negative base unless the exponent is whole."""
        whole = (exponent.lo == exponent.hi) & (dr.floor(exponent.lo) == exponent.lo)
        odd = whole & ~(dr.floor(exponent.lo / 2) * 2 == exponent.lo)
        up = self._power_of(base.lo, base.hi, exponent)
        down = self._power_of(-base.hi, -base.lo, exponent)
        down = self.where(Truth(~odd, ~whole | odd), down, -down)
        down = TracedInterval(down.lo, down.hi, ~whole)
        found = self.where(Truth(base.hi >= 0, base.lo < 0), up, down)
        # The reciprocal of a zero is of its sign, which ends do not tell, unless it is squared.
        anything = base.contains(0) & (exponent.lo < 0) & ~(whole & ~odd)
        return found.unknown_where(anything, base.nan | exponent.nan)

    def _power_of(self, lo: Any, hi: Any, exponent: TracedInterval) -> TracedInterval:
        base = TracedInterval(positive(lo), positive(hi))
        return TracedInterval(*positive_power(self._at, base, exponent))

    def floor_divide(self, left: TracedInterval, right: TracedInterval) -> TracedInterval:
        """Return the quotient rounded down; undefined for an infinite numerator."""
        quotient = left / right
        lo, hi = dr.floor(quotient.lo), dr.floor(quotient.hi)
        by_zero = right.contains(0)
        undefined = left.nan | right.nan | left.infinite | (by_zero & left.contains(0))
        return TracedInterval(lo, hi, undefined)

    def remainder(self, left: TracedInterval, right: TracedInterval) -> TracedInterval:
        """Return the remainder, which lies between zero and the divisor."""
        quotient = self.floor_divide(left, right)
        rest = left - TracedInterval(quotient.lo) * right
        least, most = -positive(-right.lo), positive(right.hi)
        same = quotient.lo == quotient.hi
        lo = dr.select(same, larger(rest.lo, least), least)
        hi = dr.select(same, smaller(rest.hi, most), most)
        # From here on a quotient and its neighbours are hard to tell apart.
        vague = quotient.size > 0.25 / float(float_info(self._float).eps)
        undefined = left.nan | right.nan | left.infinite | right.contains(0)
        return TracedInterval(lo, hi, undefined).unknown_where(vague, undefined)

    def exp(self, x: TracedInterval) -> TracedInterval:
        """Return the exponential."""
        return increasing(self._at.exp, x, exact_at=0, least=0.0)

    def tanh(self, x: TracedInterval) -> TracedInterval:
        """Return the hyperbolic tangent."""
        return increasing(self._at.tanh, x, exact_at=0, least=-1.0, most=1.0)

    def log(self, x: TracedInterval) -> TracedInterval:
        """Return the natural logarithm; undefined for negative numbers."""
        return increasing(self._at.log, from_zero(x), exact_at=1)

    def log10(self, x: TracedInterval) -> TracedInterval:
        """Return the logarithm to base 10; undefined for negative numbers."""
        return increasing(self._at.log10, from_zero(x), exact_at=1)

    def sqrt(self, x: TracedInterval) -> TracedInterval:
        """Return the square root; undefined for negative numbers."""
        return increasing(self._at.sqrt, from_zero(x), exact_at=0, least=0.0)

    def sin(self, x: TracedInterval) -> TracedInterval:
        """Return the sine."""
        return wave(self._at.sin, x, highest_at=0.5 * math.pi)

    def cos(self, x: TracedInterval) -> TracedInterval:
        """Return the cosine."""
        return wave(self._at.cos, x, highest_at=0.0)

    def tan(self, x: TracedInterval) -> TracedInterval:
        """Return the tangent; all numbers if there may be a pole in the interval."""
        return tangent(self._at.tan, x)

    def atan2(self, y: TracedInterval, x: TracedInterval) -> TracedInterval:
        """Return the angle of the point (x, y); from -π to π if the box meets the branch cut."""
        return angle_of(self._at.atan2, y, x)
