"""Ranges of the elementary functions over intervals in kernels; see `interval_functions`.

The functions are those a kernel computes values with (`DrjitOps`), at the ends of the interval.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from ..backend import dr
from .drjit_ops import DrjitOps
from .traced_interval import TracedInterval, corners, extremes
from .traced_rounding import float_info, lowered, positive, raised, smaller

# What a function may lose, in ε, first at the end of an interval and then at the place inside that
# is looked at; and as much again for safety. Dr.Jit's lose 2, its angles of points 7.
_LOSS = 16.0
_LOSS_OF_ANGLES = 28.0


def increasing(
    function: Callable[[Any], Any],
    x: TracedInterval,
    exact_at: float,
    least: float = -math.inf,
    most: float = math.inf,
) -> TracedInterval:
    """Return the range of an increasing function that has no rounding error at one place."""
    low, high = function(x.lo), function(x.hi)
    low = dr.select(x.lo == exact_at, low, lowered(low, _LOSS))
    high = dr.select(x.hi == exact_at, high, raised(high, _LOSS))
    return TracedInterval(
        dr.select(low < least, least, low), dr.select(high > most, most, high), x.nan
    )


def from_zero(x: TracedInterval) -> TracedInterval:
    """Return the part that is not negative, for functions that have no value elsewhere.

    Its ends are zero or normal numbers: of others functions may lose all digits.
    """
    tiny = float(float_info(type(x.lo)).tiny)
    lo = dr.select(x.lo < tiny, 0, x.lo)
    hi = dr.select((x.hi > 0) & (x.hi < tiny), tiny, x.hi)
    return TracedInterval(lo, hi, x.nan | (x.lo < 0))


def whole_power(function: Callable[[Any], Any], x: TracedInterval, exponent: int) -> TracedInterval:
    """Return the range of a positive whole power by multiplication, which `function` computes."""
    even = exponent % 2 == 0
    ends = (x.smallest, x.size) if even else (x.lo, x.hi)
    low, high = (function(end) for end in ends)
    # Each of less than `exponent` products loses 0.5, and all of its factors' losses.
    low = dr.select(ends[0] == 0, low, lowered(low, 2 * exponent))
    high = dr.select(ends[1] == 0, high, raised(high, 2 * exponent))
    return TracedInterval(positive(low) if even else low, high, x.nan)


def wave(function: Callable[[Any], Any], x: TracedInterval, highest_at: float) -> TracedInterval:
    """Return the range of the sine or cosine, which is highest at some angle."""
    moved = []
    for angle in (x.lo, x.hi):
        value = function(angle)
        loss = _angle_loss(value, angle)
        moved += [value - loss, value + loss]
    lo, hi = extremes(moved)
    lo = dr.select(_meets(x, highest_at + math.pi, math.tau) | (lo < -1), -1, lo)
    hi = dr.select(_meets(x, highest_at, math.tau) | (hi > 1), 1, hi)
    return TracedInterval(lo, hi, _undefined_angle(x))


def tangent(function: Callable[[Any], Any], x: TracedInterval) -> TracedInterval:
    """Return the range of the tangent; all numbers if there may be a pole in the interval."""
    low, high = function(x.lo), function(x.hi)
    # Its slope is 1 + tan².
    low, high = low - _angle_loss(low * low, x.lo), high + _angle_loss(high * high, x.hi)
    pole = _meets(x, 0.5 * math.pi, math.pi)
    lo, hi = dr.select(pole, -dr.inf, low), dr.select(pole, dr.inf, high)
    return TracedInterval(lo, hi, _undefined_angle(x))


def angle_of(
    function: Callable[[Any, Any], Any], y: TracedInterval, x: TracedInterval
) -> TracedInterval:
    """Return the angles of the points (x, y): from -π to π if the box meets the branch cut."""
    lo, hi = extremes([function(first, second) for first, second in corners(y, x)])
    cut = y.contains(0) & (x.lo <= 0)
    lo = lowered(dr.select(cut, -math.pi, lo), _LOSS_OF_ANGLES)
    hi = raised(dr.select(cut, math.pi, hi), _LOSS_OF_ANGLES)
    lo = dr.select((y.lo >= 0) & ~cut & (lo < 0), 0, lo)
    # Dr.Jit has no value for two infinities.
    return TracedInterval(lo, hi, y.nan | x.nan | (y.infinite & x.infinite))


def positive_power(at: DrjitOps, base: TracedInterval, exponent: TracedInterval) -> tuple[Any, Any]:
    """Return the ends of a power of a base that is not negative: monotonic in each of the two."""
    base = from_zero(base)
    lows, highs = [], []
    for b, e in corners(base, exponent):
        value, doublings = at.power(b, e), dr.abs(e * dr.log2(b))
        # The power is 2**(e log2 b), which turns the rounding of the product into a factor.
        loss = _LOSS + 2 * dr.select(dr.isfinite(doublings), doublings, 0)
        exact = (b == 0) | (b == 1) | (e == 0)
        lows.append(dr.select(exact, value, lowered(value, loss)))
        highs.append(dr.select(exact, value, raised(value, loss)))
    return positive(extremes(lows)[0]), extremes(highs)[1]


def _angle_loss(value: Any, angle: Any) -> Any:
    # Taking off whole turns loses ε; of small angles none are taken off.
    eps = float(float_info(type(value)).eps)
    return _LOSS * eps * (dr.abs(value) + smaller(dr.abs(angle), type(value)(1)))


def _undefined_angle(x: TracedInterval) -> Any:
    # Rounding exceeds one turn from here on, and the functions give NaN.
    return x.nan | (x.size > 1 / float(float_info(type(x.lo)).eps))


def _meets(x: TracedInterval, place: float, period: float) -> Any:
    """Return where `place`, or that some periods further, is in the interval, or may be."""
    loss = 4 * float(float_info(type(x.lo)).eps)
    first, last = (x.lo - place) / period, (x.hi - place) / period
    before = dr.ceil(first - loss * (1 + dr.abs(first)))
    after = dr.floor(last + loss * (1 + dr.abs(last)))
    return ~(before > after)
