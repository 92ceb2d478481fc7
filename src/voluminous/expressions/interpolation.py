"""Piecewise-linear interpolation in a table, by Dr.Jit.

Beyond the ends the values of the ends go on; two equal nodes make a jump, at which the value is
already that behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..backend import Float, dr, from_host
from ..backend.functions import first_true


def interpolate(real: Any, x: Float, nodes: np.ndarray, columns: Sequence[np.ndarray]) -> list[Any]:
    """Return the columns interpolated at x (traced by Dr.Jit); NaN where x is.

    Parameters
    ----------
    real : type
        Dr.Jit float type of `x` and of the result.
    x : array
        Places.
    nodes : array, shape (n,)
        Increasing places of the entries, at least two.
    columns : sequence of array, shape (n,)
        The entries.
    """
    place = locate(x, from_host(real, nodes))
    place.fraction = dr.select(dr.isnan(x), x, place.fraction)
    return [place.between(*place.around(from_host(real, column))) for column in columns]


@dataclass
class TablePosition:
    """Where in a table a number lies.

    Attributes
    ----------
    passed : Dr.Jit integer array
        How many nodes do not lie above it.
    upper : Dr.Jit integer array
        The node that ends the piece in which it lies.
    fraction : Dr.Jit float array
        How far it is from the node before that one.
    """

    passed: Any
    upper: Any
    fraction: Any

    def around(self, column: Any) -> tuple[Any, Any]:
        """Return the entries before and after it."""
        real = type(self.fraction)
        return dr.gather(real, column, self.upper - 1), dr.gather(real, column, self.upper)

    def between(self, before: Any, after: Any) -> Any:
        """Return the interpolated entry."""
        return dr.fma(self.fraction, after - before, before)


def locate(x: Float, nodes: Any) -> TablePosition:
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
