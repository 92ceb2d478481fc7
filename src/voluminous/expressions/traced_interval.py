"""Intervals inside kernels: guaranteed bounds along a ray, with ends that are Dr.Jit arrays.

The rules are those of `interval`, but rounding is a few ε of the value: simpler and faster than
error-free transformations, and wide enough on devices whose division and square root are not
rounded correctly. Where a value may be undefined, its ends are infinite: bounds that use nothing
but the ends are safe.

Between the ends of an interval lie any number of entries of a table. Their extremes are those of
two blocks of 2^k entries that may overlap, and extremes of all such blocks are tabulated: Bender &
Farach-Colton, *The LCA problem revisited* (2000), section 3.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from numbers import Real
from typing import Any, ClassVar

import numpy as np

from ..backend import Float, dr, from_host
from .drjit_ops import DrjitOps
from .interpolation import TablePosition, locate
from .interval import ROUNDING, Array, Ends, Interval, Operation
from .interval_ops import LOSS_OF_TABLES, IntervalOps
from .ops import Ops


class _TracedEnds(Ends):
    select = staticmethod(dr.select)
    abs = staticmethod(dr.abs)
    floor = staticmethod(dr.floor)
    ceil = staticmethod(dr.ceil)
    log2 = staticmethod(dr.log2)
    isfinite = staticmethod(dr.isfinite)

    def info(self, value: Array) -> Any:
        return float_info(type(value))

    # For arrays without NaN: `dr.minimum` looks for them.
    def smaller(self, left: Array, right: Array) -> Array:
        return dr.select(left < right, left, right)

    def larger(self, left: Array, right: Array) -> Array:
        return dr.select(left > right, left, right)

    def lowered(self, value: Array, loss: Any = ROUNDING) -> Array:
        info = float_info(type(value))
        # Dr.Jit's functions overflow a little below the largest number.
        most = 2.0 ** (info.maxexp - 1)
        capped = dr.select(value > most, most, value)
        # They underflow just above the smallest normal number.
        moved = dr.fma(dr.abs(capped), -float(info.eps) * loss, capped) - 2 * float(info.tiny)
        return dr.select((value > 0) & (moved < 0), 0, moved)

    def sums(self, low: tuple[Array, Array], high: tuple[Array, Array]) -> tuple[Array, Array]:
        lo, hi = sum(low), sum(high)
        # Only a sum of opposite numbers is zero without having been rounded to it.
        lo = dr.select(low[0] == -low[1], lo, self.lowered(lo))
        return lo, dr.select(high[0] == -high[1], hi, self.raised(hi))

    def limits(self, operation: Operation, pairs: list[tuple[Array, Array]]) -> tuple[Array, Array]:
        lo, hi = self.extremes([operation(x, y) for x, y in pairs])
        return self.lowered(lo), self.raised(hi)


def float_info(real: Any) -> Any:
    """Return NumPy's description of the numbers of a Dr.Jit type."""
    return np.finfo(f"f{dr.itemsize_v(real)}")


_ENDS = _TracedEnds()
lowered, raised, positive = _ENDS.lowered, _ENDS.raised, _ENDS.positive
smaller, larger, extremes = _ENDS.smaller, _ENDS.larger, _ENDS.extremes


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
    It is an `Interval`, so that a medium that is evaluated on these can be evaluated on those, and
    that Python leaves operations between both to this class.
    """

    __slots__ = ()
    __hash__ = None

    ends: ClassVar[Ends] = _ENDS

    def __init__(self, lo: Array, hi: Array = None, nan: Any = False) -> None:
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


def traced(real: Any, value: Float) -> TracedInterval:
    """Return a value as an interval for kernels.

    Parameters
    ----------
    real : type
        Dr.Jit float type of the ends.
    value : TracedInterval, Interval, float or Dr.Jit array
        A `TracedInterval` is returned as is.
    """
    if isinstance(value, TracedInterval):
        return value
    if isinstance(value, Interval):
        return _from_host(real, value)
    if isinstance(value, Real) and not math.isnan(value):
        return TracedInterval.constant(real(float(value)))
    return TracedInterval(real(value))


def _from_host(real: Any, value: Interval) -> TracedInterval:
    """Return an interval from the host: its ends, where they have too many digits, moved out."""
    dtype = float_info(real).dtype
    with np.errstate(over="ignore"):
        lo, hi = np.ravel(value.lo).astype(dtype), np.ravel(value.hi).astype(dtype)
    lo = np.where(lo > np.ravel(value.lo), np.nextafter(lo, dtype.type(-np.inf)), lo)
    hi = np.where(hi < np.ravel(value.hi), np.nextafter(hi, dtype.type(np.inf)), hi)
    parts = ((real, lo), (real, hi), (dr.mask_t(real), np.ravel(value.nan)))
    return TracedInterval(*(from_host(kind, part) for kind, part in parts))


class TracedIntervalOps(IntervalOps):
    """Evaluation with `TracedInterval`: an enclosure of all values in a box of field values.

    The counterpart of `IntervalOps` inside kernels. The result holds every value of the expression,
    computed with real numbers or by `DrjitOps` in the same type; constants are those of this type.

    Parameters
    ----------
    float_type : type
        The Dr.Jit type of the ends.
    constant : callable, optional
        As in `DrjitOps`.
    """

    # Dr.Jit's angles of points lose 7 ε.
    loss_of_angles = 28.0

    def __init__(self, float_type: Any, constant: Callable[[float], Any] | None = None) -> None:
        self._real = float_type
        self._constant = float_type if constant is None else constant
        self._at = DrjitOps(float_type)

    def of(self, value: Float) -> TracedInterval:
        return traced(self._real, value)

    def constant(self, value: float) -> TracedInterval:
        return TracedInterval.constant(self._constant(value))

    def literal(self, value: float) -> TracedInterval:
        return TracedInterval.constant(self._real(value))

    def ones_like(self, value: TracedInterval) -> TracedInterval:
        return self.literal(1.0)

    def integer_power(self, base: TracedInterval, exponent: int) -> TracedInterval:
        if exponent < 2:
            return Ops.integer_power(self, base, exponent)
        even = exponent % 2 == 0
        limits = (base.smallest, base.size) if even else (base.lo, base.hi)
        low, high = (self._at.integer_power(end, exponent) for end in limits)
        # Each of less than `exponent` products loses 0.5, and all losses of its factors.
        low = dr.select(limits[0] == 0, low, lowered(low, 2 * exponent))
        high = dr.select(limits[1] == 0, high, raised(high, 2 * exponent))
        return TracedInterval(positive(low) if even else low, high, base.nan)

    def interpolate(self, x: TracedInterval, places: np.ndarray, entries: np.ndarray) -> Any:
        return interpolate_traced_ranges(x, places, [entries])[0]


def interpolate_traced_ranges(
    x: TracedInterval, nodes: np.ndarray, columns: Sequence[np.ndarray]
) -> list[TracedInterval]:
    """Return enclosures of the columns interpolated anywhere in x: from both ends and all between.

    Parameters
    ----------
    x : TracedInterval
        Places.
    nodes : array, shape (n,)
        Increasing places of the entries, at least two.
    columns : sequence of array, shape (n,)
        The entries.
    """
    data = from_host(type(x.lo), nodes)
    first, last = (locate(end, data) for end in (x.lo, x.hi))
    return [_enclosure(column, first, last, x) for column in columns]


def slopes_in_ranges(x: TracedInterval, nodes: np.ndarray, values: np.ndarray) -> Any:
    """Return an enclosure of the slopes of a table in x, and where x is within one of its pieces.

    Parameters
    ----------
    x : TracedInterval
        Places.
    nodes, values : array, shape (n,)
        Increasing places of the entries, at least two, and the entries.

    Returns
    -------
    slope : TracedInterval
        Beyond the ends of the table it is zero.
    straight : Dr.Jit mask
        Whether there is no node between the ends of x.
    """
    real = type(x.lo)
    kept = nodes.astype(float_info(real).dtype).astype(np.float64)  # as the kernel has them
    rise, run = np.diff(values), np.diff(kept)
    steep = np.divide(rise, run, out=np.sign(rise) * np.inf, where=run > 0)
    slopes = np.concatenate([[0.0], steep, [0.0]])
    first, last = (locate(end, from_host(real, nodes)).passed for end in (x.lo, x.hi))
    lo, hi = (
        _extreme_between(slopes, extreme, first, last + 1, real(0))
        for extreme in (np.minimum, np.maximum)
    )
    return TracedInterval(lowered(lo), raised(hi), x.nan), first == last


def _enclosure(
    column: np.ndarray, first: TablePosition, last: TablePosition, x: TracedInterval
) -> Any:
    real = type(x.lo)
    data = from_host(real, column)
    pieces = [place.around(data) for place in (first, last)]
    values = [place.between(*own) for place, own in zip((first, last), pieces, strict=True)]
    # The entries between are among those around: with none between, any of the values will do.
    between = [
        _extreme_between(column, extreme, first.passed, last.passed, values[0])
        for extreme in (np.minimum, np.maximum)
    ]
    around = extremes([*pieces[0], *pieces[1], *between])
    return _moved_out(*extremes([*values, *between]), *around, x.nan)


def _moved_out(lo: Float, hi: Float, least: Float, most: Float, nan: Any) -> TracedInterval:
    """Return ends moved out by what rounding may lose; where all entries are equal, it is none."""
    info = float_info(type(lo))
    largest = larger(dr.abs(least), dr.abs(most))
    loss = dr.fma(largest, LOSS_OF_TABLES * float(info.eps), float(info.tiny))
    loss = dr.select(least < most, loss, 0)
    lo, hi = lo - loss, hi + loss
    # Rounding never carries a value across zero.
    lo = dr.select(least >= 0, positive(lo), lo)
    hi = dr.select(most <= 0, -positive(-hi), hi)
    return TracedInterval(lo, hi, nan)


def _extreme_between(
    column: np.ndarray, extreme: Callable[..., Any], start: Float, stop: Any, otherwise: Any
) -> Any:
    """Return the extreme of ``column[start:stop]``; `otherwise` where that is empty."""
    real, UInt = type(otherwise), type(start)
    data = from_host(real, _extremes_of_blocks(column, extreme))
    some = start < stop
    level = 31 - dr.lzcnt(dr.select(some, stop - start, 1))
    row = level * dr.opaque(UInt, len(column))
    first = dr.gather(real, data, row + start, some)
    last = dr.gather(real, data, row + stop - (UInt(1) << level), some)
    found = smaller(first, last) if extreme is np.minimum else larger(first, last)
    return dr.select(some, found, otherwise)


def _extremes_of_blocks(column: np.ndarray, extreme: Callable[..., Any]) -> np.ndarray:
    """Return the extremes of 1, 2, 4 … entries from each entry on, one row after the other."""
    rows, half = [np.ascontiguousarray(column)], 1
    while 2 * half <= len(column):
        row = rows[-1].copy()
        row[:-half] = extreme(row[:-half], row[half:])
        rows.append(row)
        half *= 2
    return np.concatenate(rows)
