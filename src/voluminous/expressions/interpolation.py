"""Piecewise-linear interpolation in a table, by Dr.Jit.

Beyond the table the value at its end continues; two equal nodes make a jump, at which the value is
that behind it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..backend import Float, dr, from_host
from ..backend.functions import first_true
from .interval import TablePosition


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
