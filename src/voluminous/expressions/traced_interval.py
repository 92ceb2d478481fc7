"""Intervals inside kernels: `Interval` with ends that are Dr.Jit arrays, rounded a little further.

The rules are those of `interval`. Where a value may be undefined, its ends are infinite: whoever
looks at nothing but the ends is safe.
"""

from __future__ import annotations

import functools
import itertools
import math
import operator
from collections.abc import Callable
from numbers import Real
from typing import Any

import numpy as np

from ..backend import dr, from_host
from .interval import Interval, Truth
from .traced_rounding import float_info, larger, lowered, positive, raised, smaller


class TracedInterval(Interval):
    """All numbers from `lo` to `hi`, lane by lane, infinities included.

    Parameters
    ----------
    lo, hi : Dr.Jit float array
        The ends. Where one is NaN, or `lo` is above `hi`, the value is anything, or NaN.
    nan : Dr.Jit mask, optional
        Where, besides, the value may be undefined (NaN).

    Notes
    -----
    The same object twice is the same number twice: ``x * x`` is a square, ``x == x`` is true.

    It is an `Interval`, so that a medium that is evaluated on these can be evaluated on those, and
    that Python leaves operations between both to this class.
    """

    __slots__ = ()
    __hash__ = None

    lo: Any
    hi: Any
    nan: Any

    def __init__(self, lo: Any, hi: Any = None, nan: Any = False) -> None:
        hi = lo if hi is None else hi
        self.nan = ~(lo <= hi) | nan
        self.lo = dr.select(self.nan, -dr.inf, lo)
        self.hi = dr.select(self.nan, dr.inf, hi)

    @classmethod
    def constant(cls, value: Any) -> TracedInterval:
        """Return the interval of one number, not NaN: both ends are the same object.

        So it is known while tracing that products and quotients have fewer corners.
        """
        self = cls.__new__(cls)
        self.lo = self.hi = value
        self.nan = dr.mask_t(value)(False)
        return self

    @property
    def is_constant(self) -> bool:
        """Whether this is known to be one number."""
        return self.lo is self.hi

    @property
    def size(self) -> Any:
        return larger(dr.abs(self.lo), dr.abs(self.hi))

    @property
    def smallest(self) -> Any:
        return positive(larger(self.lo, -self.hi))

    @property
    def infinite(self) -> Any:
        return (self.lo == -dr.inf) | (self.hi == dr.inf)

    def unknown_where(self, condition: Any, nan: Any) -> TracedInterval:
        """Return this interval, but all numbers where a condition holds; undefined where `nan`."""
        lo, hi = dr.select(condition, -dr.inf, self.lo), dr.select(condition, dr.inf, self.hi)
        return TracedInterval(lo, hi, self.nan | nan)

    def __neg__(self) -> TracedInterval:
        if self.is_constant:
            return TracedInterval.constant(-self.lo)
        return TracedInterval(-self.hi, -self.lo, self.nan)

    def __abs__(self) -> TracedInterval:
        return TracedInterval(self.smallest, self.size, self.nan)

    def __add__(self, other: Any) -> TracedInterval:
        other = self._like(other)
        lo, hi = self.lo + other.lo, self.hi + other.hi
        # Only a sum of opposite numbers is zero without having been rounded to it.
        lo = dr.select(self.lo == -other.lo, lo, lowered(lo))
        hi = dr.select(self.hi == -other.hi, hi, raised(hi))
        opposite = _both(self.hi, other.lo, dr.inf) | _both(self.lo, other.hi, -dr.inf)
        return TracedInterval(lo, hi, self.nan | other.nan | opposite)

    def __sub__(self, other: Any) -> TracedInterval:
        return self + -self._like(other)

    def __mul__(self, other: Any) -> TracedInterval:
        if self is other:
            low, high = self.smallest, self.size
            return TracedInterval(positive(lowered(low * low)), raised(high * high), self.nan)
        other = self._like(other)
        undefined = (self.contains(0) & other.infinite) | (other.contains(0) & self.infinite)
        return _hull(operator.mul, self, other, self.nan | other.nan | undefined)

    def __truediv__(self, other: Any) -> TracedInterval:
        other = self._like(other)
        by_zero = other.contains(0)
        undefined = (by_zero & self.contains(0)) | (self.infinite & other.infinite)
        found = _hull(operator.truediv, self, other, self.nan | other.nan | undefined)
        # Zeros have signs, which ends do not tell: 1/0 can be either infinity.
        return found.unknown_where(by_zero, found.nan)

    def __radd__(self, other: Any) -> TracedInterval:
        return self._like(other) + self

    def __rsub__(self, other: Any) -> TracedInterval:
        return self._like(other) - self

    def __rmul__(self, other: Any) -> TracedInterval:
        return self._like(other) * self

    def __rtruediv__(self, other: Any) -> TracedInterval:
        return self._like(other) / self

    def __lt__(self, other: Any) -> Truth:
        return self._compare(operator.lt, self._like(other))

    def __le__(self, other: Any) -> Truth:
        return self._compare(operator.le, self._like(other))

    def __gt__(self, other: Any) -> Truth:
        return self._like(other) < self

    def __ge__(self, other: Any) -> Truth:
        return self._like(other) <= self

    def __eq__(self, other: Any) -> Truth:  # type: ignore[override]
        if self is other:
            return Truth(type(self.nan)(True), self.nan)
        other = self._like(other)
        apart = (self.lo > other.hi) | (self.hi < other.lo)
        one_number = (self.lo == other.hi) & (self.hi == other.lo)
        return Truth(~apart, ~one_number | self.nan | other.nan)

    def _like(self, other: Any) -> TracedInterval:
        return traced(type(self.lo), other)


def traced(real: Any, value: Any) -> TracedInterval:
    """Return a value as an interval for kernels.

    Parameters
    ----------
    real : type
        Dr.Jit float type of the ends.
    value : TracedInterval, Interval, float or Dr.Jit array
        One that is an interval already is returned as it is.
    """
    if isinstance(value, TracedInterval):
        return value
    if isinstance(value, Interval):
        return _from_host(real, value)
    if isinstance(value, Real) and not math.isnan(value):
        return TracedInterval.constant(real(float(value)))
    return TracedInterval(real(value))


def corners(a: TracedInterval, b: TracedInterval) -> list[tuple[Any, Any]]:
    """Return the pairs of ends: four, or less where one of them is a constant."""
    return list(itertools.product(_ends(a), _ends(b)))


def extremes(values: list[Any]) -> tuple[Any, Any]:
    """Return the smallest and the largest of some arrays without NaN."""
    return functools.reduce(smaller, values), functools.reduce(larger, values)


def _ends(x: TracedInterval) -> tuple[Any, ...]:
    return (x.lo,) if x.is_constant else (x.lo, x.hi)


def _hull(
    function: Callable[..., Any], a: TracedInterval, b: TracedInterval, nan: Any
) -> TracedInterval:
    """Return the range of a product or quotient, from its corners; it has the sign of both.

    Corners without value (0 · inf) are undefined, or quotients by zero: known to the caller.
    """
    lo, hi = extremes([function(x, y) for x, y in corners(a, b)])
    same = ((a.lo >= 0) & (b.lo >= 0)) | ((a.hi <= 0) & (b.hi <= 0))
    opposite = ((a.lo >= 0) & (b.hi <= 0)) | ((a.hi <= 0) & (b.lo >= 0))
    lo, hi = lowered(lo), raised(hi)
    lo, hi = dr.select(same & (lo < 0), 0, lo), dr.select(opposite & (hi > 0), 0, hi)
    return TracedInterval(lo, hi, nan)


def _both(x: Any, y: Any, infinity: float) -> Any:
    return (x == infinity) & (y == -infinity)


def _from_host(real: Any, value: Interval) -> TracedInterval:
    """Return an interval from the host: its ends, where they have too many digits, moved out."""
    dtype = float_info(real).dtype
    with np.errstate(over="ignore"):
        lo, hi = np.ravel(value.lo).astype(dtype), np.ravel(value.hi).astype(dtype)
    lo = np.where(lo > np.ravel(value.lo), np.nextafter(lo, dtype.type(-np.inf)), lo)
    hi = np.where(hi < np.ravel(value.hi), np.nextafter(hi, dtype.type(np.inf)), hi)
    parts = ((real, lo), (real, hi), (dr.mask_t(real), np.ravel(value.nan)))
    return TracedInterval(*(from_host(kind, part) for kind, part in parts))
