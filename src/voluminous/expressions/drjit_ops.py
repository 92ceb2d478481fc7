"""The operations of expressions for variables traced by Dr.Jit."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..backend import Float, dr, from_host
from ..backend.functions import first_true, power_of_two, split_log
from .interval import TablePosition
from .ops import Ops

_abs: Callable[[Float], Float] = dr.abs
_log2: Callable[[Float], Float] = dr.log2
# log10(2) in two parts: the product of the first, of 16 bits, and an exponent is exact.
_LOG10_2_HIGH = 39457 / 2**17
_LOG10_2_LOW = -3.0243555500547861e-6


class DrjitOps(Ops):
    """Evaluation with Dr.Jit arrays of one type, following NumPy's floating-point rules.

    `constant` makes an array of each constant, in the order in which they are written, but for
    ``a if c else b`` in the order c, a, b. By default constants become part of the machine code; if
    it returns data, they can be changed without compiling again. Exponents that are whole numbers
    of at most 8, and 0.5, are always part of the code.

    Differences from NumPy, ε being the spacing of numbers at 1:

    * Denormal numbers may count as zero, and ``exp`` overflows up to 0.4 before NumPy's does.
    * ``atan2`` ignores the sign of a zero, and is NaN for two infinities.
    * ``sin``, ``cos`` and ``tan`` of more than 1/ε turns are NaN: rounding exceeds a turn there.
    * x**y with an exponent that is not part of the code has a relative error of up to ε |y log2 x|.
    * ``//`` and ``%`` need a quotient below 1/ε. Above, one operand's rounding exceeds the other.
    """

    def __init__(
        self, float_type: type[Float], constant: Callable[[float], Float] | None = None
    ) -> None:
        self._float = float_type
        self._constant = float_type if constant is None else constant
        self.where = dr.select
        for name in ("log", "exp", "sqrt", "tanh", "minimum", "maximum", "ones_like"):
            setattr(self, name, getattr(dr, name))
        dtype = np.dtype(f"f{dr.itemsize_v(float_type)}")
        self._most_exponent = float(np.finfo(dtype).maxexp - 2)
        self._smallest = float(np.finfo(dtype).tiny)
        self._most_turns = 1 / float(np.finfo(dtype).eps)
        # 2π in this type, and what that leaves out (minus the sine of τ is what the double τ does).
        self._turn = float(dtype.type(math.tau))
        self._rest_of_turn = (math.tau - self._turn) - math.sin(math.tau)

    def prepare(self, values: Mapping[str, Float]) -> tuple[Ops, dict[str, Float]]:
        return self, {name: self.number(value) for name, value in values.items()}

    def constant(self, value: float) -> Float:
        return self._constant(value)

    def literal(self, value: float) -> Float:
        return self._float(value)

    def interp(self, x: Float, places: tuple[float, ...], entries: tuple[float, ...]) -> Float:
        return interpolate(self._float, x, np.array(places), [np.array(entries)])[0]

    def is_mask(self, value: Float) -> bool:
        return bool(dr.is_mask_v(value))

    def number(self, value: Float) -> Float:
        if self.is_mask(value):
            return dr.select(value, self._float(1), self._float(0))
        return value if isinstance(value, self._float) else self._float(value)

    def log10(self, x: Float) -> Float:
        # Dr.Jit has none. With x = m 2^n, n log10(2) is added to the small log10(m) in two parts,
        # the first of which is exact, so that the sum is rounded once. log2(x) log10(2) is rounded
        # twice, which changes a narrow Gaussian of log10(x) in its 13th digit.
        if dr.itemsize_v(self._float) == 4:
            return self._log10_single(x)
        n: Float = dr.round(_log2(x))
        n = dr.select(_abs(n) < self._most_exponent, n, 0.0)
        rest = dr.fma(n, _LOG10_2_LOW, dr.log(x * power_of_two(-n)) * math.log10(math.e))
        return dr.fma(n, _LOG10_2_HIGH, rest)

    def _log10_single(self, x: Float) -> Float:
        n, log = split_log(x)
        value = dr.fma(n, _LOG10_2_HIGH, dr.fma(n, _LOG10_2_LOW, log * math.log10(math.e)))
        beyond = dr.select(x < 0, math.nan, dr.select(x > 1, x, -dr.inf))  # NaN is neither
        ordinary = (x >= self._smallest) & (x < dr.inf)
        return dr.select(ordinary, value, dr.select(x == x, beyond, x))

    def sin(self, x: Float) -> Float:
        return dr.sin(self._within_a_turn(x))

    def cos(self, x: Float) -> Float:
        return dr.cos(self._within_a_turn(x))

    def tan(self, x: Float) -> Float:
        # Dr.Jit's own returns x for |x| < 1e-4, which in double precision loses x² / 3.
        sine, cosine = dr.sincos(self._within_a_turn(x))
        return sine / cosine

    def _within_a_turn(self, x: Float) -> Float:
        # Dr.Jit's functions lose digits from 1e4 on in single precision, and from 1e9 on in double
        # precision give numbers far above 1. Taking off whole turns, with 2π in two parts and each
        # product rounded only together with its difference, is exact to about ε (Cody and Waite,
        # Software Manual for the Elementary Functions, 1980).
        turns: Float = dr.select(_abs(x) < 1e4, 0, dr.round(x / math.tau))
        angle = dr.fma(-turns, self._rest_of_turn, dr.fma(-turns, self._turn, x))
        return dr.select(_abs(turns) < self._most_turns, angle, math.nan)

    def atan2(self, y: Float, x: Float) -> Float:
        """Return the angle of the point (x, y) in radians; NaN if one is (Dr.Jit's own is 0)."""
        undefined = dr.isnan(x) | dr.isnan(y)
        return dr.select(undefined, math.nan, dr.atan2(y, x))

    def power(self, base: Float, exponent: Float) -> Float:
        """Return base**exponent; NaN where that is not real."""
        doublings = exponent * _log2(_abs(base))
        # x**0 and 1**y are 1 also for infinite and undefined x and y. Elsewhere the product is not
        # replaced, because a replaced one has no derivative.
        is_one = dr.isnan(doublings) & ((exponent == 0) | (_abs(base) == 1))
        # dr.exp2 is -inf just above its underflow (double precision, [-1024, -1023.5]).
        tiny = dr.select(doublings < -1022, -dr.inf, doublings)
        size = dr.exp2(dr.select(is_one, 0, tiny))
        whole = dr.floor(exponent) == exponent
        odd = whole & ~(dr.floor(exponent / 2) * 2 == exponent)
        real = dr.select(whole | dr.isinf(base), size, math.nan)
        return dr.select(base < 0, dr.select(odd, -size, real), size)

    def floor_divide(self, left: Float, right: Float) -> Float:
        """Return the quotient rounded down; NaN for an infinite numerator, as NumPy does."""
        quotient = dr.select(dr.isinf(left), math.nan, self._divmod(left, right)[0])
        return dr.select(right == 0, left / right, quotient)

    def remainder(self, left: Float, right: Float) -> Float:
        """Return the remainder of the division, with the divisor's sign."""
        return self._divmod(left, right)[1]

    def _divmod(self, left: Float, right: Float) -> tuple[Float, Float]:
        # Rounding may raise left/right to the next whole number q (1/0.1 gives 10, although 0.1 is
        # a little more than a tenth), and never lowers it below one. Then left - q right, rounded
        # once by the fused multiply-add, has the wrong sign.
        quotient = dr.floor(left / right)
        rest = dr.select(quotient == 0, left, dr.fma(-quotient, right, left))
        lifted = dr.select(right < 0, rest > 0, rest < 0)
        return (
            dr.select(lifted, quotient - 1, quotient),
            dr.select(lifted, rest + right, rest),
        )


def interpolate(
    real: type[Float], x: Float, nodes: np.ndarray, columns: Sequence[np.ndarray]
) -> list[Float]:
    """Return columns of a table, given at increasing nodes, interpolated at x; NaN where x is."""
    place = locate(x, from_host(real, nodes))
    fraction = dr.select(dr.isnan(x), x, place.fraction)

    def value(column: Float) -> Float:
        before, after = (dr.gather(real, column, k) for k in (place.upper - 1, place.upper))
        return dr.fma(fraction, after - before, before)

    return [value(from_host(real, column)) for column in columns]


def locate(x: Float, nodes: Float) -> TablePosition:
    """Return where in a table a number lies; where it is NaN, anywhere."""
    real, count = type(x), len(nodes)
    UInt = dr.uint32_array_t(real)
    passed = first_true(count, UInt, lambda k: dr.gather(real, nodes, k) > x)
    upper = dr.clip(passed, 1, dr.opaque(UInt, count - 1))
    low, high = dr.gather(real, nodes, upper - 1), dr.gather(real, nodes, upper)
    width = high - low
    part = (x - low) / dr.select(width > 0, width, 1)
    part = dr.select(part < 0, 0, part)
    inside = dr.select(part < 1, part, real(1))
    fraction = dr.select(width > 0, inside, dr.select(x < high, real(0), real(1)))
    return TablePosition(passed, upper, fraction)
