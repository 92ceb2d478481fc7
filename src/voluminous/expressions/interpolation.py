"""Piecewise-linear interpolation in a table, by Dr.Jit.

Beyond the ends the values of the ends go on; two equal nodes make a jump, at which the value is
already that behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..backend import dr, from_host
from ..backend.functions import first_true


def interpolate(real: Any, x: Any, nodes: np.ndarray, columns: Sequence[np.ndarray]) -> list[Any]:
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
    UInt = dr.uint32_array_t(real)
    last = dr.opaque(UInt, len(nodes) - 1)
    places = from_host(real, nodes)
    upper = first_true(len(nodes), UInt, lambda k: dr.gather(real, places, k) > x)
    upper = dr.clip(upper, 1, last)
    low, high = dr.gather(real, places, upper - 1), dr.gather(real, places, upper)
    width = high - low
    inside = dr.clip((x - low) / dr.select(width > 0, width, 1), 0, 1)
    f = dr.select(width > 0, inside, dr.select(x < high, real(0), real(1)))
    f = dr.select(dr.isnan(x), x, f)  # which clip would hide on some devices

    def entries(column: np.ndarray) -> Any:
        data = from_host(real, column)
        before, after = dr.gather(real, data, upper - 1), dr.gather(real, data, upper)
        return dr.fma(f, after - before, before)

    return [entries(column) for column in columns]
