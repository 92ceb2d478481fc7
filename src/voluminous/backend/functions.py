"""Accurate functions of optical depth, for arrays of any device and precision."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import numpy as np

from .jit import dr
from .types import Float, Int, Mask

Result = TypeVar("Result")
Call = TypeVar("Call", bound=Callable[..., Any])
# Cody & Waite split of ln 2: n·LN2_HIGH is exact for the n that occur, in either precision.
_LN2_HIGH = {"single": 0.693359375, "double": 0.693147180369123816490}
_LN2_LOW = {"single": -2.12194440e-4, "double": 1.90821492927058770002e-10}
# Terms of (1 - exp(-r))/r = Σ (-r)^k/(k+1)! needed for |r| <= ln(2)/2 and full precision.
_TERMS = {"single": 7, "double": 14}
# Up to this depth one polynomial suffices for attenuation.
THIN = 0.3466


def _raising(call: Call) -> Call:
    """Return a function of Dr.Jit that raises what traced code raised, Ctrl-C for example.

    Dr.Jit wraps that in a RuntimeError, once per enclosing loop or branch.
    """

    def called(*args: Any, **options: Any) -> Any:
        try:
            return call(*args, **options)
        except RuntimeError as error:
            first: BaseException = error
            while str(first).startswith(("dr.", "drjit.")) and first.__cause__ is not None:
                first = first.__cause__
            raise first from first.__cause__

    return cast("Call", called)


loop, if_else = _raising(dr.while_loop), _raising(dr.if_stmt)


def branch(
    args: tuple[Any, ...],
    cond: Mask,
    true_fn: Callable[..., Result],
    false_fn: Callable[..., Result],
) -> Result:
    """Return the result of one function of some arrays where a condition holds, of the other else.

    A vector whose lanes agree skips the other function. Arrays that record derivatives take both:
    Dr.Jit 1.5 loses the derivatives of what a branch in a loop uses besides its arguments.
    """
    if records(cond):
        both: Result = dr.select(cond, true_fn(*args), false_fn(*args))
        return both
    result: Result = if_else(args, cond, true_fn, false_fn)
    return result


def records(array: Any) -> bool:
    """Return whether operations on such arrays are recorded here, to be differentiated."""
    if not dr.is_diff_v(array):
        return False
    kind: Any = dr.float64_array_t(type(array))
    number = kind(0.0)
    dr.enable_grad(number)
    return bool(dr.grad_enabled(number))  # not where gradients are suspended


def attenuation(tau: Float) -> tuple[Float, Float]:
    """Return ``exp(-tau)`` and ``(1 - exp(-tau))/tau`` without cancellation.

    The second is the mean transparency of a homogeneous segment: one at ``tau = 0``. Where all
    lanes are thin a branch skips all but one polynomial (first order: 29 instead of 34 ms).
    """
    size: Float = dr.abs(tau)
    return branch((tau,), size <= THIN, thin_attenuation, any_attenuation)


def thin_attenuation(tau: Float) -> tuple[Float, Float]:
    """Return both for depths up to `THIN`."""
    mean = _mean_transparency_near_zero(tau, _TERMS[precision_of(type(tau))])
    return dr.fma(-tau, mean, 1.0), mean


def any_attenuation(tau: Float) -> tuple[Float, Float]:
    """Return both for any depth, without a branch.

    ``tau = n ln 2 + r`` with ``|r| <= ln(2)/2`` (Cody & Waite 1980, section 6.2), so
    ``1 - exp(-tau) = (1 - 2^-n) + 2^-n (1 - exp(-r))`` adds positive numbers where ``n > 0``.
    """
    precision = precision_of(type(tau))
    deepest = 80.0 if precision == "single" else 700.0
    capped = dr.select(tau < deepest, tau, deepest)
    n = dr.round(capped * 1.4426950408889634)
    r = dr.fma(-n, _LN2_HIGH[precision], capped)
    r = dr.fma(-n, _LN2_LOW[precision], r)
    mean = _mean_transparency_near_zero(r, _TERMS[precision])
    scale = power_of_two(-n)
    lost = dr.fma(scale, dr.fma(r, mean, -1.0), 1.0)
    theta = scale * dr.fma(-r, mean, 1.0)
    return theta, dr.select(n == 0, mean, lost / tau)


def _mean_transparency_near_zero(r: Float, terms: int) -> Float:
    coefficients = [1.0]
    for k in range(2, terms + 1):
        coefficients.append(-coefficients[-1] / k)
    return polynomial(r, coefficients)


def horner(x: Float, coefficients: Sequence[Any]) -> Float:
    """Return a polynomial in x, lowest power first; its coefficients may be arrays."""
    total = type(x)(coefficients[-1])
    for c in coefficients[-2::-1]:
        total = dr.fma(total, x, c)
    return total


def polynomial(x: Float, coefficients: Sequence[Any]) -> Float:
    """Return a polynomial in x of many terms, lowest power first, with a short dependency chain.

    Estrin's scheme (1960) is used for all but the first coefficient, and Horner's rule for that:
    eight terms take four dependent operations, not seven, and the last rounding is Horner's.
    """
    first, *terms = coefficients
    power = x
    while len(terms) > 1:
        pairs = [
            dr.fma(high, power, low) for low, high in zip(terms[::2], terms[1::2], strict=False)
        ]
        terms = pairs + (terms[-1:] if len(terms) % 2 else [])
        power = power * power
    return dr.fma(terms[0], x, first)


def unit_interval(f: Float) -> Float:
    """Return the nearest number between 0 and 1."""
    f = dr.select(f > 0.0, f, 0.0)
    return dr.select(f < 1.0, f, 1.0)


def first_true(count: int, UInt: Any, holds: Callable[[Int], Mask]) -> Int:
    """Return the first of `count` indices at which a monotonic condition holds; `count` if none.

    In a loop with a run-time count, so that grids of all sizes share a kernel; unrolled it took 2.5
    times as long to compile on a spherical grid (1.2 s).
    """
    lanes = dr.width(holds(UInt(0)))

    def halve(low: Int, high: Int) -> tuple[Int, Int]:
        middle = (low + high) >> 1
        beyond = holds(middle)
        return dr.select(beyond, low, middle + 1), dr.select(beyond, middle, high)

    def undecided(low: Int, high: Int) -> Mask:
        return low < high

    ends = dr.zeros(UInt, lanes), dr.zeros(UInt, lanes) + dr.opaque(UInt, count)
    return loop(ends, undecided, halve, label="search")[0]


# 2^r for |r| <= ½, fitted to 8e-8.
_EXP2 = (1.0000001, 0.69314694, 0.2402212, 0.055507131, 0.009675541, 0.001327647)


def decay(x: Float) -> Float:
    """Return exp(-x) for x >= 0, but about 1e-37 where it is smaller.

    The single-precision error is 1e-7 (1 + x), with half of the instructions of Dr.Jit's.
    """
    real = type(x)
    if precision_of(real) == "double":
        return dr.exp(-x)
    t = x * -1.4426950408889634
    t = dr.select(t < -124.0, -124.0, t)
    n = dr.round(t)
    return polynomial(t - n, _EXP2) * power_of_two(n)


def _bits(real: Any) -> tuple[Any, int, int]:
    if precision_of(real) == "single":
        return dr.int32_array_t(real), 127, 23
    return dr.int64_array_t(real), 1023, 52


def power_of_two(n: Float) -> Float:
    """Return 2 to an integer power within the exponent range, by setting its bits."""
    integer, bias, shift = _bits(type(n))
    return dr.reinterpret_array(type(n), (integer(n) + bias) << shift)


def inverse_power_of_two(x: Float) -> Float:
    """Return 1/x for a power of two, from its bits: a division takes as long as 20 operations."""
    integer, bias, shift = _bits(type(x))
    bits: Any = dr.reinterpret_array(integer, x)
    return dr.reinterpret_array(type(x), (2 * bias << shift) - bits)


# (log(1 + f) - f + f²/2)/f³ for √½ <= 1 + f < √2, fitted to 6e-9 of log(1 + f).
_LOG_TAIL = (
    0.3333333171,
    -0.2500082106,
    0.2000122667,
    -0.1662335651,
    0.1420176232,
    -0.1316019463,
    0.1276155126,
    -0.07634432149,
)


def split_log(x: Float) -> tuple[Float, Float]:
    """Return n and log(m) of positive normal numbers x = m 2^n with √½ <= m < √2, single precision.

    The error is one rounding besides the half of an ulp.
    """
    real = type(x)
    integer: Any = dr.int32_array_t(real)
    bits: Any = dr.reinterpret_array(integer, x)
    n = (bits - 0x3F3504F3) >> 23
    mantissa: Any = dr.reinterpret_array(real, bits - (n << 23))
    if dr.is_diff_v(real):  # the same number; bits have no derivative
        exact = x * power_of_two(-real(n))
        mantissa = dr.replace_grad(mantissa, exact)  # type: ignore[func-returns-value]
    f = mantissa - 1.0
    square = f * f
    tail = f * square * polynomial(f, _LOG_TAIL)
    return real(n), f + dr.fma(-0.5, square, tail)


# atan(q)/q for |q| <= tan(π/8), in powers of q², fitted to 1e-9 and 4e-17.
_ATAN = {
    "single": (
        0.999999999369465,
        -0.333333068321333,
        0.199981797556648,
        -0.142394717862651,
        0.105693748527518,
        -0.0602513405778633,
    ),
    "double": (
        0.999999999999999965,
        -0.333333333333284159,
        0.1999999999885039,
        -0.142857141805968936,
        0.111111061650365127,
        -0.0909077271667437228,
        0.0768994845277858792,
        -0.0664019012732186543,
        0.0568812005923421516,
        -0.0434739031566048804,
        0.0211272689568591347,
    ),
}


def sharp_angle(y: Float, x: Float, length: Float) -> Float:
    """Return the angle of a vector of given length from the x axis, for angles up to π/4.

    It is twice the angle whose tangent is ``y/(x + length)``. Results for wider angles are wrong,
    but also wider than π/4. With `atan2` second order took 1.1 times as long on spherical grids.
    """
    both = x + length
    q = y / dr.select(both > 0.0, both, 1.0)
    q = dr.clip(q, -1.0, 1.0)  # rounding may place a point far outside its cell
    return 2.0 * q * horner(q * q, _ATAN[precision_of(type(q))])


def precision_of(real: Any) -> str:
    """Return ``"single"`` or ``"double"`` for a Dr.Jit float type."""
    return "double" if dr.type_v(real) == dr.VarType.Float64 else "single"


def flush_subnormal(value: Float, margin: float = 2.0**30) -> Float:
    """Clamp numbers to zero that are subnormal, or so small that products with them would be.

    Dr.Jit's worker threads flush subnormal numbers, the calling thread does not, where arithmetic
    on them is slow: without this a picture would depend on the number of threads.
    """
    kind = np.float32 if precision_of(type(value)) == "single" else np.float64
    size: Float = dr.abs(value)
    return dr.select(size < margin * float(np.finfo(kind).tiny), 0.0, value)
