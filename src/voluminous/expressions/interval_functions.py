"""Ranges of the elementary functions over intervals, moved out by all that rounding may lose."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from .error_free import Array
from .interval import Interval, corners, extremes

_EPS, _TINY = float(np.finfo(np.float64).eps), float(np.finfo(np.float64).tiny)
# What a library's function may lose, in ε (NumPy's 2, Dr.Jit's 4), first at the end of an interval
# and then at the place inside that is looked at; and as much again for safety.
_LOSS = 16
# Dr.Jit overflows a little before NumPy.
_OVERFLOW = 2.0**1023
# Rounding exceeds one turn from here on, and Dr.Jit gives NaN.
_LARGEST_ANGLE = 1 / _EPS


def enclosed(
    ends: tuple[Array, Array],
    losses: tuple[Array, Array],
    nan: Array = False,
    least: Array = -np.inf,
    most: Array = np.inf,
) -> Interval:
    """Return ends moved out by their losses (an end that loses 0 is exact), within limits."""
    lo = np.where(losses[0] == 0, ends[0], np.minimum(ends[0], _OVERFLOW) - losses[0])
    hi = np.where(losses[1] == 0, ends[1], np.maximum(ends[1], -_OVERFLOW) + losses[1])
    lo, hi = np.where(lo < -_OVERFLOW, -np.inf, lo), np.where(hi > _OVERFLOW, np.inf, hi)
    return Interval(np.clip(lo, least, most), np.clip(hi, least, most), nan)


def unknown_where(condition: Array, found: Interval, nan: Array) -> Interval:
    """Return what was found, but all numbers where the condition holds."""
    lo, hi = np.where(condition, -np.inf, found.lo), np.where(condition, np.inf, found.hi)
    return Interval(lo, hi, nan)


def increasing(
    function: Callable[[Array], Array],
    x: Interval,
    exact_at: float,
    least: float = -np.inf,
    most: float = np.inf,
) -> Interval:
    """Return the range of an increasing function that has no rounding error at one place."""

    def loss(end: Array, value: Array) -> Array:
        return np.where(end == exact_at, 0, relative_loss(value))

    ends = function(x.lo), function(x.hi)
    return enclosed(ends, (loss(x.lo, ends[0]), loss(x.hi, ends[1])), x.nan, least, most)


def from_zero(x: Interval) -> Interval:
    """Return the part that is not negative, for functions that have no value elsewhere."""
    lo = np.where(x.hi < 0, np.nan, np.maximum(x.lo, 0))
    return Interval(lo, x.hi, x.nan | (x.lo < 0))


def wave(function: Callable[[Array], Array], x: Interval, highest_at: float) -> Interval:
    """Return the range of the sine or cosine, which is highest at some angle."""
    moved = []
    for angle in (x.lo, x.hi):
        value = function(angle)
        loss = _angle_loss(value, angle)
        moved += [value - loss, value + loss]
    lo, hi = extremes(moved)
    lo = np.where(_meets(x, highest_at + math.pi, math.tau), -1, np.maximum(lo, -1))
    hi = np.where(_meets(x, highest_at, math.tau), 1, np.minimum(hi, 1))
    return Interval(lo, hi, _undefined_angle(x))


def tangent(x: Interval) -> Interval:
    """Return the range of the tangent; all numbers if there may be a pole in the interval."""
    ends = np.tan(x.lo), np.tan(x.hi)
    # Its slope is 1 + tan².
    losses = _angle_loss(ends[0] ** 2, x.lo), _angle_loss(ends[1] ** 2, x.hi)
    return unknown_where(
        _meets(x, 0.5 * math.pi, math.pi), enclosed(ends, losses), _undefined_angle(x)
    )


def angle_of(y: Interval, x: Interval) -> Interval:
    """Return the angles of the points (x, y): from -π to π if the box meets the branch cut."""
    # Along the edges of a box that neither holds the origin nor is cut, angles are monotonic.
    ends = extremes(np.arctan2(first, second) for first, second in corners(y, x))
    cut = y.contains(0) & (x.lo <= 0)
    ends = np.where(cut, -math.pi, ends[0]), np.where(cut, math.pi, ends[1])
    losses = relative_loss(ends[0]), relative_loss(ends[1])
    # Dr.Jit has no value for two infinities.
    undefined = y.nan | x.nan | (y.infinite & x.infinite)
    return enclosed(ends, losses, undefined, least=np.where((y.lo >= 0) & ~cut, 0, -np.inf))


def positive_power(base: Interval, exponent: Interval) -> Interval:
    """Return the range of a power of a base that is not negative: monotonic in each of the two."""
    found = []
    for b, e in corners(base, exponent):
        value, doublings = np.power(b, e), np.abs(e * np.log2(b))
        # Dr.Jit's power is 2**(e log2 b), which turns the rounding of the product into a factor.
        loss = relative_loss(value, 2 * np.where(np.isfinite(doublings), doublings, 0))
        loss = np.where((b == 0) | (b == 1) | (e == 0), 0, loss)
        found.append(enclosed((value, value), (loss, loss), least=0.0))
    lo, _ = extremes(power.lo for power in found)
    _, hi = extremes(power.hi for power in found)
    return Interval(lo, hi)


def relative_loss(value: Array, more: Array = 0.0) -> Array:
    """Return what a library's function may lose (and `more`, in ε) where it gives a value."""
    return (_LOSS + more) * _EPS * np.minimum(np.abs(value), _OVERFLOW) + _TINY


def _angle_loss(value: Array, angle: Array) -> Array:
    # Taking off whole turns loses ε; of small angles none are taken off.
    return _LOSS * _EPS * (np.abs(value) + np.minimum(np.abs(angle), 1))


def _undefined_angle(x: Interval) -> Array:
    return x.nan | (x.size > _LARGEST_ANGLE)


def _meets(x: Interval, place: float, period: float) -> Array:
    """Return where `place`, or that some periods further, is in the interval, or may be."""
    first, last = (x.lo - place) / period, (x.hi - place) / period
    before = np.ceil(first - 4 * _EPS * (1 + np.abs(first)))
    after = np.floor(last + 4 * _EPS * (1 + np.abs(last)))
    return ~(before > after)
