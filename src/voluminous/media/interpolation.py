"""Piecewise-linear interpolation in a table: of numbers by Dr.Jit, and of intervals by NumPy.

Both follow one rule. Beyond the ends the values of the ends go on; two equal nodes make a jump, at
which the value is already that behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..backend import dr, from_host
from ..backend.functions import first_true
from ..expressions.interval import Interval, extremes

# What an interpolated value loses, in ε of the largest value around it: the position loses 1.5, the
# difference of two values 1, their sum 0.5, and as much again for safety.
_LOSS = 8 * float(np.finfo(np.float64).eps)


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


def interpolate_ranges(
    x: Interval, nodes: np.ndarray, columns: Sequence[np.ndarray]
) -> list[Interval]:
    """Return enclosures of the columns interpolated anywhere in x: from both ends and all between.

    Parameters
    ----------
    x : Interval
        Places.
    nodes, columns
        As in `interpolate`.
    """
    passed = [np.searchsorted(nodes, end, "right") for end in (x.lo, x.hi)]
    first, last = (np.clip(count, 1, len(nodes) - 1) for count in passed)
    f_first, f_last = _fraction(x.lo, nodes, first), _fraction(x.hi, nodes, last)

    def enclosure(column: np.ndarray) -> Interval:
        ends = _between(column, first, f_first), _between(column, last, f_last)
        lo, hi = extremes([*ends, *_extremes_within(column, *passed)])
        least, most = _extremes_within(column, first - 1, last + 1)
        loss = np.where(least < most, _LOSS * np.maximum(np.abs(least), np.abs(most)), 0.0)
        # Rounding never carries a value across zero.
        floor, ceiling = np.where(least >= 0, 0, -np.inf), np.where(most <= 0, 0, np.inf)
        return Interval(np.maximum(lo - loss, floor), np.minimum(hi + loss, ceiling), x.nan)

    return [enclosure(column) for column in columns]


def _fraction(x: np.ndarray, nodes: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return how far x is from the node before `upper` to that node."""
    low, high = nodes[upper - 1], nodes[upper]
    width = high - low
    inside = np.clip((x - low) / np.where(width > 0, width, 1), 0, 1)
    return np.where(width > 0, inside, np.where(x < high, 0, 1))


def _between(column: np.ndarray, upper: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    return column[upper - 1] + fraction * (column[upper] - column[upper - 1])


def _extremes_within(
    column: np.ndarray, first: np.ndarray, stop: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest and largest of ``column[first:stop]``; NaN where there are none."""
    ranges = np.stack([first, stop], axis=-1).reshape(-1)
    padded = np.append(column, np.nan)  # so that `stop` is an index
    least, most = (
        np.where(first < stop, function.reduceat(padded, ranges)[::2].reshape(first.shape), np.nan)
        for function in (np.fmin, np.fmax)
    )
    return least, most
