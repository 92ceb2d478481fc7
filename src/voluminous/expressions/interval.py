"""Intervals that hold every value of an expression, and what its comparisons can be in them.

Rounding goes outward, after Moore, Kearfott & Cloud, *Introduction to Interval Analysis* (2009),
chapters 2 and 5. Values that do not exist (``0/0``) are kept apart from the numbers, in a flag.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .error_free import Array, outward, product, quotient, total

_TINY = float(np.finfo(np.float64).tiny)


class Interval:
    """All numbers from `lo` to `hi`, element by element, infinities included.

    Parameters
    ----------
    lo, hi : array_like
        The ends, any shapes that broadcast. An end that is NaN stands for: anything, or NaN.
    nan : array_like of bool, optional
        Where, besides, the value may be undefined (NaN).

    Notes
    -----
    The same object twice is the same number twice: ``x * x`` is a square, ``x == x`` is true.

    Ends below the smallest normal number are moved out to zero, because processors may flush the
    numbers inside to zero.
    """

    __slots__ = ("hi", "lo", "nan")
    __hash__ = None  # type: ignore[assignment]
    __array_ufunc__ = None  # so that a NumPy number on the left leaves the operation to us

    def __init__(self, lo: Any, hi: Any = None, nan: Any = False) -> None:
        lo = np.asarray(lo, dtype=np.float64)
        hi = lo if hi is None else np.asarray(hi, dtype=np.float64)
        unknown = np.isnan(lo) | np.isnan(hi)
        self.lo = np.where(unknown, -np.inf, np.where((lo > 0) & (lo < _TINY), 0.0, lo))
        self.hi = np.where(unknown, np.inf, np.where((hi < 0) & (hi > -_TINY), 0.0, hi))
        self.nan = unknown | nan

    @staticmethod
    def of(value: Any) -> Interval:
        """Return `value` itself if it is an interval, else the interval of this one number."""
        return value if isinstance(value, Interval) else Interval(value)

    @property
    def size(self) -> Array:
        """The largest absolute value."""
        return np.maximum(np.abs(self.lo), np.abs(self.hi))

    @property
    def smallest(self) -> Array:
        """The smallest absolute value."""
        return np.maximum(np.maximum(self.lo, -self.hi), 0.0)

    @property
    def infinite(self) -> Array:
        """Where an infinity is among the values."""
        return np.isinf(self.size)

    def contains(self, number: Any) -> Array:
        """Return where a number is among the values."""
        return (self.lo <= number) & (number <= self.hi)

    def __neg__(self) -> Interval:
        return Interval(-self.hi, -self.lo, self.nan)

    def __pos__(self) -> Interval:
        return self

    def __abs__(self) -> Interval:
        return Interval(self.smallest, self.size, self.nan)

    def __add__(self, other: Any) -> Interval:
        other = Interval.of(other)
        opposite = _both(self.hi, other.lo, np.inf) | _both(self.lo, other.hi, -np.inf)
        lo = outward(*total(self.lo, other.lo), -np.inf)
        hi = outward(*total(self.hi, other.hi), np.inf)
        return Interval(lo, hi, self.nan | other.nan | opposite)

    def __sub__(self, other: Any) -> Interval:
        return self + -Interval.of(other)

    def __mul__(self, other: Any) -> Interval:
        if self is other:
            return _square(self)
        other = Interval.of(other)
        undefined = (self.contains(0) & other.infinite) | (other.contains(0) & self.infinite)
        return _hull(product, self, other, self.nan | other.nan | undefined)

    def __truediv__(self, other: Any) -> Interval:
        other = Interval.of(other)
        by_zero = other.contains(0)
        undefined = (by_zero & self.contains(0)) | (self.infinite & other.infinite)
        found = _hull(quotient, self, other, self.nan | other.nan | undefined)
        # Zeros have signs, which ends do not tell: 1/0 can be either infinity.
        lo, hi = np.where(by_zero, -np.inf, found.lo), np.where(by_zero, np.inf, found.hi)
        return Interval(lo, hi, found.nan)

    def __radd__(self, other: Any) -> Interval:
        return Interval.of(other) + self

    def __rsub__(self, other: Any) -> Interval:
        return Interval.of(other) - self

    def __rmul__(self, other: Any) -> Interval:
        return Interval.of(other) * self

    def __rtruediv__(self, other: Any) -> Interval:
        return Interval.of(other) / self

    def __lt__(self, other: Any) -> Truth:
        return self._compare(np.less, Interval.of(other))

    def __le__(self, other: Any) -> Truth:
        return self._compare(np.less_equal, Interval.of(other))

    def __gt__(self, other: Any) -> Truth:
        return Interval.of(other) < self

    def __ge__(self, other: Any) -> Truth:
        return Interval.of(other) <= self

    def __eq__(self, other: Any) -> Truth:  # type: ignore[override]
        if self is other:
            return Truth(np.ones_like(self.nan), self.nan)
        other = Interval.of(other)
        apart = (self.lo > other.hi) | (self.hi < other.lo)
        one_number = (self.lo == other.hi) & (self.hi == other.lo)
        return Truth(~apart, ~one_number | self.nan | other.nan)

    def _compare(self, ordered: Callable[..., Array], other: Interval) -> Truth:
        always = ordered(self.hi, other.lo) & ~(self.nan | other.nan)
        return Truth(ordered(self.lo, other.hi), ~always)


@dataclass(frozen=True, slots=True)
class Truth:
    """What a truth value can be, element by element: true, false, or either.

    Attributes
    ----------
    true, false : array of bool
        Where it can be true, and where it can be false.
    """

    true: Array
    false: Array

    def __and__(self, other: Truth) -> Truth:
        return Truth(self.true & other.true, self.false | other.false)

    def __or__(self, other: Truth) -> Truth:
        return Truth(self.true | other.true, self.false & other.false)

    def __invert__(self) -> Truth:
        return Truth(self.false, self.true)


def extremes(values: Iterable[Array]) -> tuple[Array, Array]:
    """Return the smallest and the largest of some arrays; NaN only where all of them are."""
    listed = list(values)
    return functools.reduce(np.fmin, listed), functools.reduce(np.fmax, listed)


def corners(a: Interval, b: Interval) -> list[tuple[Array, Array]]:
    """Return the pairs of ends: four, or less where one of them is a constant."""
    return list(itertools.product(_ends(a), _ends(b)))


def _ends(x: Interval) -> tuple[Array, ...]:
    return (x.lo,) if x.lo.ndim == 0 and x.lo == x.hi else (x.lo, x.hi)


def _hull(
    function: Callable[..., tuple[Array, Array]], a: Interval, b: Interval, nan: Array
) -> Interval:
    """Return the range of a function that is monotonic in each argument, from its corners.

    Corners such as 0 · inf have no value; the others then tell the range of the numbers.
    """
    found = [function(x, y) for x, y in corners(a, b)]
    lo, _ = extremes(outward(value, error, -np.inf) for value, error in found)
    _, hi = extremes(outward(value, error, np.inf) for value, error in found)
    return Interval(lo, hi, nan)


def _square(x: Interval) -> Interval:
    (low, low_error), (high, high_error) = (product(end, end) for end in (x.smallest, x.size))
    return Interval(outward(low, low_error, -np.inf), outward(high, high_error, np.inf), x.nan)


def _both(x: Array, y: Array, infinity: float) -> Array:
    return (x == infinity) & (y == -infinity)
