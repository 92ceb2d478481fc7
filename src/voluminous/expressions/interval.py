"""Intervals that contain every value of an expression, and the possible results of comparisons.

Rounding goes outward, after Moore, Kearfott & Cloud, *Introduction to Interval Analysis* (2009),
chapters 2 and 5. Undefined values (``0/0``) are kept apart from the numbers, in a flag.

One set of rules serves NumPy arrays (`Interval`) and arrays inside kernels (`TracedInterval`); what
differs is in `ends`. Kernels round by some ε, which is fast, and wide enough on devices whose
division is not rounded correctly. On the host the errors of sums, products and quotients are
computed, so that exact results stay exact: Knuth, *The Art of Computer Programming* II (1997),
section 4.2.2, and Dekker, *Numerische Mathematik* 18 (1971), 224-242.
"""

from __future__ import annotations

import functools
import itertools
import operator
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, TypeAlias, TypeVar

import numpy as np

Array: TypeAlias = Any
"""Ends of intervals: NumPy arrays of float64, or Dr.Jit arrays."""
Operation: TypeAlias = Callable[[Array, Array], Array]
_Function: TypeAlias = Callable[..., Array]
Own = TypeVar("Own", bound="Interval")

# In ε: each of the four operations loses 0.5, and division on a GPU 2.
ROUNDING = 4.0
_TINY = float(np.finfo(np.float64).tiny)


class TablePosition(NamedTuple):
    """Where in a table a number lies.

    `passed` nodes do not lie above it, the node `upper` ends the piece in which it lies, and
    `fraction` is its distance from the node before, relative to the piece.
    """

    passed: Array
    upper: Array
    fraction: Array


class Ends:
    """Arithmetic with ends of intervals, here NumPy arrays; `TracedInterval` has that of Dr.Jit."""

    select: _Function = staticmethod(np.where)
    abs: _Function = staticmethod(np.abs)
    floor: _Function = staticmethod(np.floor)
    ceil: _Function = staticmethod(np.ceil)
    log2: _Function = staticmethod(np.log2)
    isfinite: _Function = staticmethod(np.isfinite)
    fma: _Function = staticmethod(lambda a, b, c: a * b + c)
    # Ends are never NaN, but corners such as 0 · inf are; the others then give the range.
    smaller: _Function = staticmethod(np.fmin)
    larger: _Function = staticmethod(np.fmax)

    def info(self, value: Array) -> np.finfo[Any]:
        """Return NumPy's description of the floating-point numbers of an array."""
        info: np.finfo[Any] = np.finfo(np.float64)
        return info

    def locate(self, x: Array, nodes: np.ndarray) -> TablePosition:
        """Return where in a table a number lies."""
        passed = np.searchsorted(nodes, x, "right")
        upper = np.clip(passed, 1, len(nodes) - 1)
        low, high = nodes[upper - 1], nodes[upper]
        width = high - low
        inside = np.clip((x - low) / np.where(width > 0, width, 1), 0, 1)
        return TablePosition(passed, upper, np.where(width > 0, inside, np.where(x < high, 0, 1)))

    def data(self, column: np.ndarray, like: Array) -> Array:
        """Return a column of a table as numbers of the same type as some array."""
        return column

    def gather(self, data: Array, index: Array, active: Array = True) -> Array:
        """Return entries of a column."""
        return np.take(data, index, mode="clip")

    def two_blocks(self, start: Array, stop: Array, count: int) -> tuple[Array, Array, Array]:
        """Return two blocks of a table's entries that together are those from `start` to `stop`.

        Blocks of 2^k entries are numbered row by row, a row of `count` for each k. The last array
        is false where there are no entries.
        """
        level = np.log2(np.maximum(stop - start, 1)).astype(int)
        return level * count + start, level * count + stop - (1 << level), start < stop

    def lowered(self, value: Array, loss: Any = ROUNDING) -> Array:
        """Return a lower limit of a number that was computed with an error of `loss` ε.

        That of a positive number is never negative. Zero may be an underflow, infinity an overflow.
        """
        # Kernels overflow a little below the largest number, and underflow just above the smallest
        # normal number.
        most, eps = 2.0**1023, float(np.finfo(np.float64).eps)
        capped = np.minimum(value, most)
        moved = capped - np.abs(capped) * (eps * loss) - 2 * _TINY
        moved = np.where(moved < -most, -np.inf, moved)
        return np.where((value > 0) & (moved < 0), 0, moved)

    def raised(self, value: Array, loss: Any = ROUNDING) -> Array:
        """Return an upper limit; see `lowered`."""
        return -self.lowered(-value, loss)

    def sums(self, low: tuple[Array, Array], high: tuple[Array, Array]) -> tuple[Array, Array]:
        """Return a lower limit of one sum and an upper limit of another."""
        return _outward(*_sum(*low), -np.inf), _outward(*_sum(*high), np.inf)

    def limits(self, operation: Operation, pairs: list[tuple[Array, Array]]) -> tuple[Array, Array]:
        """Return limits of all products or quotients of some pairs."""
        function = _product if operation is operator.mul else _quotient
        results = [function(x, y) for x, y in pairs]
        lo, _ = self.extremes(_outward(v, error, -np.inf) for v, error in results)
        _, hi = self.extremes(_outward(v, error, np.inf) for v, error in results)
        return lo, hi

    def extremes(self, values: Iterable[Array]) -> tuple[Array, Array]:
        """Return the smallest and the largest of some arrays."""
        listed = list(values)
        return functools.reduce(self.smaller, listed), functools.reduce(self.larger, listed)

    def positive(self, value: Array) -> Array:
        """Return the value, and zero in place of negative ones."""
        return self.select(value < 0, 0, value)


class Interval:
    """All numbers from `lo` to `hi`, element by element, infinities included.

    Where an end is NaN, or `lo` is above `hi`, the value is anything, or NaN; where `nan` it may be
    undefined besides. The same object twice is the same number twice: ``x * x`` is a square,
    ``x == x`` is true. Ends below the smallest normal number are moved out to zero, because
    processors may flush the numbers inside to zero.
    """

    __slots__ = ("hi", "lo", "nan")
    __hash__ = None  # type: ignore[assignment]
    __array_ufunc__ = None  # so that a NumPy number on the left leaves the operation to us

    ends: ClassVar[Ends] = Ends()
    lo: Array
    hi: Array
    nan: Array

    def __init__(self, lo: Any, hi: Any = None, nan: Any = False) -> None:
        lo = np.asarray(lo, dtype=np.float64)
        hi = lo if hi is None else np.asarray(hi, dtype=np.float64)
        unknown = ~(lo <= hi)
        self.lo = np.where(unknown, -np.inf, np.where((lo > 0) & (lo < _TINY), 0.0, lo))
        self.hi = np.where(unknown, np.inf, np.where((hi < 0) & (hi > -_TINY), 0.0, hi))
        self.nan = unknown | nan

    @staticmethod
    def of(value: Any) -> Interval:
        """Return `value` itself if it is an interval, else the interval of this one number."""
        return value if isinstance(value, Interval) else Interval(value)

    @property
    def is_constant(self) -> bool:
        """Whether this is one number, the same everywhere."""
        return bool(self.lo.ndim == 0 and self.lo == self.hi)

    @property
    def size(self) -> Array:
        """The largest absolute value."""
        return self.ends.larger(self.ends.abs(self.lo), self.ends.abs(self.hi))

    @property
    def smallest(self) -> Array:
        return self.ends.positive(self.ends.larger(self.lo, -self.hi))

    @property
    def infinite(self) -> Array:
        return (self.lo == -np.inf) | (self.hi == np.inf)

    def contains(self, number: Any) -> Array:
        return (self.lo <= number) & (number <= self.hi)

    def unknown_where(self: Own, condition: Array, nan: Array) -> Own:
        """Return this interval, but all numbers where a condition holds; undefined where `nan`."""
        select = self.ends.select
        lo, hi = select(condition, -np.inf, self.lo), select(condition, np.inf, self.hi)
        return type(self)(lo, hi, self.nan | nan)

    def corners(self, other: Interval) -> list[tuple[Array, Array]]:
        """Return the pairs of ends of two intervals: four, or fewer if one is a constant."""
        ends = ((x.lo,) if x.is_constant else (x.lo, x.hi) for x in (self, other))
        return list(itertools.product(*ends))

    def _like(self: Own, other: Any) -> Own:
        return other if isinstance(other, Interval) else type(self)(other)  # type: ignore[return-value]

    def __neg__(self: Own) -> Own:
        return type(self)(-self.hi, -self.lo, self.nan)

    def __pos__(self: Own) -> Own:
        return self

    def __abs__(self: Own) -> Own:
        return type(self)(self.smallest, self.size, self.nan)

    def __add__(self: Own, other: Any) -> Own:
        other = self._like(other)
        opposite = (self.hi == np.inf) & (other.lo == -np.inf)
        opposite |= (self.lo == -np.inf) & (other.hi == np.inf)
        lo, hi = self.ends.sums((self.lo, other.lo), (self.hi, other.hi))
        return type(self)(lo, hi, self.nan | other.nan | opposite)

    def __sub__(self: Own, other: Any) -> Own:
        return self + -self._like(other)

    def __mul__(self: Own, other: Any) -> Own:
        if self is other:
            low, high = self.smallest, self.size
            lo, _ = self.ends.limits(operator.mul, [(low, low)])
            _, hi = self.ends.limits(operator.mul, [(high, high)])
            square: Own = type(self)(self.ends.positive(lo), hi, self.nan)
            return square
        other = self._like(other)
        undefined = (self.contains(0) & other.infinite) | (other.contains(0) & self.infinite)
        product: Own = self._hull(operator.mul, other, undefined)
        return product

    def __truediv__(self: Own, other: Any) -> Own:
        other = self._like(other)
        by_zero = other.contains(0)
        undefined = (by_zero & self.contains(0)) | (self.infinite & other.infinite)
        quotient = self._hull(operator.truediv, other, undefined)
        # Zeros have signs, which ends do not have: 1/0 can be either infinity.
        return quotient.unknown_where(by_zero, quotient.nan)

    def _hull(self: Own, operation: Operation, other: Own, undefined: Array) -> Own:
        """Return the range of a product or quotient, from its corners; it has the sign of both.

        The caller marks corners that are undefined (0 · inf), and handles quotients by zero.
        """
        lo, hi = self.ends.limits(operation, self.corners(other))
        same = ((self.lo >= 0) & (other.lo >= 0)) | ((self.hi <= 0) & (other.hi <= 0))
        opposite = ((self.lo >= 0) & (other.hi <= 0)) | ((self.hi <= 0) & (other.lo >= 0))
        select = self.ends.select
        lo, hi = select(same & (lo < 0), 0, lo), select(opposite & (hi > 0), 0, hi)
        return type(self)(lo, hi, self.nan | other.nan | undefined)

    __radd__, __rmul__ = __add__, __mul__

    def __rsub__(self: Own, other: Any) -> Own:
        return self._like(other) - self

    def __rtruediv__(self: Own, other: Any) -> Own:
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
            return Truth(self.nan | True, self.nan)
        other = self._like(other)
        apart = (self.lo > other.hi) | (self.hi < other.lo)
        one_number = (self.lo == other.hi) & (self.hi == other.lo)
        return Truth(~apart, ~one_number | self.nan | other.nan)

    def _compare(self, ordered: Operation, other: Interval) -> Truth:
        always = ordered(self.hi, other.lo) & ~(self.nan | other.nan)
        return Truth(ordered(self.lo, other.hi), ~always)


@dataclass(frozen=True, slots=True)
class Truth:
    """The possible results of a comparison, element by element: true, false, or either."""

    true: Array
    false: Array

    @property
    def either(self) -> Array:
        """Where both are possible."""
        return self.true & self.false

    def __and__(self, other: Truth) -> Truth:
        return Truth(self.true & other.true, self.false | other.false)

    def __or__(self, other: Truth) -> Truth:
        return Truth(self.true | other.true, self.false & other.false)

    def __invert__(self) -> Truth:
        return Truth(self.false, self.true)


# Splits 53 bits into halves.
_SPLITTER = 2.0**27 + 1
# Errors of smaller products may be too small to be a number.
_SMALLEST = 2.0**-960


def _sum(x: Array, y: Array) -> tuple[Array, Array]:
    rounded = x + y
    shift = rounded - x
    return rounded, (x - (rounded - shift)) + (y - shift)


def _product(x: Array, y: Array) -> tuple[Array, Array]:
    rounded = x * y
    (a, b), (c, d) = _halves(x), _halves(y)
    error = ((a * c - rounded) + a * d + b * c) + b * d
    known = (np.abs(rounded) > _SMALLEST) | (x == 0) | (y == 0)
    return rounded, np.where(known, error, np.nan)


def _halves(x: Array) -> tuple[Array, Array]:
    large = _SPLITTER * x
    high = large - (large - x)
    return high, x - high


def _quotient(x: Array, y: Array) -> tuple[Array, Array]:
    rounded = x / y
    back, error = _product(rounded, y)
    known = (np.abs(rounded) > _SMALLEST) | (x == 0)
    return rounded, np.where(known, ((x - back) - error) / y, np.nan)


def _outward(value: Array, error: Array, toward: float) -> Array:
    """Return a rounded value, moved towards an infinity if it was rounded away from there.

    A zero due to underflow keeps its sign.
    """
    underflow = (value == 0) & (np.signbit(value) == (toward > 0))
    exact = (error * np.sign(toward) <= 0) | underflow
    return np.where(exact, value, np.nextafter(value, toward))
