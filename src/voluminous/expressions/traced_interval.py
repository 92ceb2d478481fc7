"""Intervals inside kernels: guaranteed bounds along a ray, with ends that are Dr.Jit arrays.

The rules are those of `interval`. Where a value may be undefined, its ends are infinite: bounds
that use only the ends are safe.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from numbers import Real
from typing import Any, ClassVar

import numpy as np

from ..backend import Float, Int, Mask, dr, from_host
from .drjit_ops import DrjitOps, locate
from .interval import ROUNDING, Array, Ends, Interval, Operation, TablePosition
from .interval_ops import IntervalOps, extreme_between
from .ops import Ops, Value


class _TracedEnds(Ends):
    select = staticmethod(dr.select)
    abs = staticmethod(dr.abs)
    floor = staticmethod(dr.floor)
    ceil = staticmethod(dr.ceil)
    log2 = staticmethod(dr.log2)
    isfinite = staticmethod(dr.isfinite)
    fma = staticmethod(dr.fma)
    # Without NaN; `dr.minimum` would look for them.
    smaller = staticmethod(lambda left, right: dr.select(left < right, left, right))
    larger = staticmethod(lambda left, right: dr.select(left > right, left, right))

    def info(self, value: Float) -> np.finfo[Any]:
        return float_info(type(value))

    def lowered(self, value: Float, loss: Float = ROUNDING) -> Float:
        info = self.info(value)
        most = 2.0 ** (info.maxexp - 1)
        capped = dr.select(value > most, most, value)
        moved = dr.fma(dr.abs(capped), -float(info.eps) * loss, capped) - 2 * float(info.tiny)
        return dr.select((value > 0) & (moved < 0), 0, moved)

    def sums(self, low: tuple[Float, Float], high: tuple[Float, Float]) -> tuple[Float, Float]:
        lo, hi = sum(low), sum(high)
        # Only a sum of opposite numbers is zero without having been rounded to it.
        lo = dr.select(low[0] == -low[1], lo, self.lowered(lo))
        return lo, dr.select(high[0] == -high[1], hi, self.raised(hi))

    def limits(self, operation: Operation, pairs: list[tuple[Float, Float]]) -> tuple[Float, Float]:
        lo, hi = self.extremes([operation(x, y) for x, y in pairs])
        return self.lowered(lo), self.raised(hi)

    def locate(self, x: Float, nodes: np.ndarray) -> TablePosition:
        return locate(x, self.data(nodes, x))

    def data(self, column: np.ndarray, like: Float) -> Float:
        return from_host(type(like), column)

    def gather(self, data: Float, index: Int, active: Mask = True) -> Float:
        return dr.gather(type(data), data, index, active)

    def two_blocks(self, start: Int, stop: Int, count: int) -> tuple[Int, Int, Mask]:
        some, UInt = start < stop, type(start)
        level = 31 - dr.lzcnt(dr.select(some, stop - start, 1))
        row = level * dr.opaque(UInt, count)
        return row + start, row + stop - (UInt(1) << level), some


def float_info(real: type[Float]) -> np.finfo[Any]:
    """Return NumPy's description of the numbers of a Dr.Jit type."""
    return np.finfo(f"f{dr.itemsize_v(real)}")


_ENDS = _TracedEnds()
lowered, raised, positive = _ENDS.lowered, _ENDS.raised, _ENDS.positive
smaller, larger, extremes = _ENDS.smaller, _ENDS.larger, _ENDS.extremes


class TracedInterval(Interval):
    """All numbers from `lo` to `hi`, lane by lane, infinities included; see `Interval`.

    A subclass of `Interval`, so that a medium works with both, and that Python leaves operations
    between both to this class.
    """

    __slots__ = ()
    __hash__ = None

    ends: ClassVar[Ends] = _ENDS

    def __init__(self, lo: Array, hi: Array = None, nan: Mask = False) -> None:
        hi = lo if hi is None else hi
        self.nan = ~(lo <= hi) | nan
        self.lo = dr.select(self.nan, -dr.inf, lo)
        self.hi = dr.select(self.nan, dr.inf, hi)

    @classmethod
    def constant(cls, value: Array) -> TracedInterval:
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

    def __neg__(self) -> TracedInterval:
        return TracedInterval.constant(-self.lo) if self.is_constant else super().__neg__()

    def _like(self, other: Any) -> TracedInterval:
        return traced(type(self.lo), other)


def traced(real: type[Float], value: Float) -> TracedInterval:
    """Return a value (interval, number or Dr.Jit array) as an interval of a Dr.Jit type."""
    if isinstance(value, TracedInterval):
        return value
    if isinstance(value, Interval):
        return _from_host(real, value)
    if isinstance(value, Real) and not math.isnan(value):
        return TracedInterval.constant(real(float(value)))
    return TracedInterval(real(value))


def _from_host(real: type[Float], value: Interval) -> TracedInterval:
    dtype = float_info(real).dtype
    with np.errstate(over="ignore"):
        lo, hi = np.ravel(value.lo).astype(dtype), np.ravel(value.hi).astype(dtype)
    lo = np.where(lo > np.ravel(value.lo), np.nextafter(lo, dtype.type(-np.inf)), lo)
    hi = np.where(hi < np.ravel(value.hi), np.nextafter(hi, dtype.type(np.inf)), hi)
    parts = ((real, lo), (real, hi), (dr.mask_t(real), np.ravel(value.nan)))
    return TracedInterval(*(from_host(kind, part) for kind, part in parts))


class TracedIntervalOps(IntervalOps):
    """Evaluation with `TracedInterval`: an enclosure of all values in a box of field values.

    The counterpart of `IntervalOps` inside kernels. The result contains every value of the
    expression, computed with real numbers or by `DrjitOps` in the same type, which constants have.
    """

    # Dr.Jit's atan2 loses 7 ε.
    loss_of_angles = 28.0

    def __init__(
        self, float_type: type[Float], constant: Callable[[float], Float] | None = None
    ) -> None:
        self._real = float_type
        self._constant = float_type if constant is None else constant
        self._at = DrjitOps(float_type)

    def of(self, value: Float) -> TracedInterval:
        return traced(self._real, value)

    def constant(self, value: float) -> TracedInterval:
        return TracedInterval.constant(self._constant(value))

    def literal(self, value: float) -> TracedInterval:
        return TracedInterval.constant(self._real(value))

    def ones_like(self, value: Value) -> TracedInterval:
        return self.literal(1.0)

    def integer_power(self, base: Value, exponent: int) -> Value:
        if exponent < 2:
            return Ops.integer_power(self, base, exponent)
        even = exponent % 2 == 0
        limits = (base.smallest, base.size) if even else (base.lo, base.hi)
        low, high = (self._at.integer_power(end, exponent) for end in limits)
        # Each of less than `exponent` products loses 0.5, and all losses of its factors.
        low = dr.select(limits[0] == 0, low, lowered(low, 2 * exponent))
        high = dr.select(limits[1] == 0, high, raised(high, 2 * exponent))
        return TracedInterval(positive(low) if even else low, high, base.nan)


def slopes_in_ranges(
    x: TracedInterval, nodes: np.ndarray, values: np.ndarray
) -> tuple[TracedInterval, Mask]:
    """Return an enclosure of the slopes of a table in x, and where x is within one of its pieces.

    Beyond the ends of the table the slope is zero.
    """
    real = type(x.lo)
    rounded = nodes.astype(float_info(real).dtype).astype(np.float64)  # as the kernel has them
    rise, run = np.diff(values), np.diff(rounded)
    steep = np.divide(rise, run, out=np.sign(rise) * np.inf, where=run > 0)
    slopes = np.concatenate([[0.0], steep, [0.0]])
    first, last = (x.ends.locate(end, nodes).passed for end in (x.lo, x.hi))
    lo, hi = (
        extreme_between(x, slopes, extreme, first, last + 1, real(0))
        for extreme in (np.minimum, np.maximum)
    )
    return TracedInterval(lowered(lo), raised(hi), x.nan), first == last
