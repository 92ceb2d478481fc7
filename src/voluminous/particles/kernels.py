"""Kernels of smoothed particle hydrodynamics: how a particle's mass is spread around it.

A kernel is a function f(u) of u = r / H alone, zero from the radius of its support H on. What a
code calls smoothing length h is H divided by a number that `Kernel.support` tells.

Splines: Price (2012, J. Comput. Phys. 231, 759), normalised to u here. Wendland functions and all
norms: Dehnen & Aly (2012, MNRAS 425, 1068), table 1.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

from ..backend.types import Float
from ..errors import check_name


class Kernel(NamedTuple):
    """A kernel in three dimensions.

    `shape` is f(u, positive) for 0 ≤ u ≤ 1, where ``positive(x)`` is max(x, 0), of arrays of any
    kind; `norm` is one divided by the integral of f over the unit ball; `support` is the radius of
    the support in smoothing lengths, as Price (2012) and Phantom count these.
    """

    shape: Callable[[Float, Callable[[Float], Float]], Float]
    norm: float
    support: float = 2.0

    @property
    def peak(self) -> float:
        """The value at the centre."""
        return float(self.shape(0.0, lambda x: max(x, 0.0)))


def _spline(power: int, terms: tuple[tuple[float, float], ...]) -> Callable[..., Float]:
    def shape(u: Float, positive: Callable[[Float], Float]) -> Float:
        parts = [c * _power(positive(t - u), power) for c, t in terms]
        return sum(parts[1:], parts[0])

    return shape


def _wendland(power: int, polynomial: tuple[float, ...]) -> Callable[..., Float]:
    """Return (1 − u)₊ⁿ times a polynomial, coefficients from the constant one on."""

    def shape(u: Float, positive: Callable[[Float], Float]) -> Float:
        value = functools.reduce(lambda value, c: value * u + c, reversed(polynomial), 0.0)
        return _power(positive(1.0 - u), power) * value

    return shape


def _power(x: Float, n: int) -> Float:
    return functools.reduce(operator.mul, [x] * n)


KERNELS = {
    "cubic": Kernel(_spline(3, ((1.0, 1.0), (-4.0, 0.5))), 16 / math.pi),
    "quartic": Kernel(
        _spline(4, ((1.0, 1.0), (-5.0, 0.6), (10.0, 0.2))), 15625 / (512 * math.pi), 2.5
    ),
    "quintic": Kernel(
        _spline(5, ((1.0, 1.0), (-6.0, 2 / 3), (15.0, 1 / 3))), 2187 / (40 * math.pi), 3.0
    ),
    "wendland-c2": Kernel(_wendland(4, (1.0, 4.0)), 21 / (2 * math.pi)),
    "wendland-c4": Kernel(_wendland(6, (1.0, 6.0, 35 / 3)), 495 / (32 * math.pi)),
    "wendland-c6": Kernel(_wendland(8, (1.0, 8.0, 25.0, 32.0)), 1365 / (64 * math.pi)),
}


def get_kernel(name: Any) -> Kernel:
    """Return a kernel by its name."""
    check_name("kernel", name, KERNELS)
    return KERNELS[name]
