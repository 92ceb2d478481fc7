"""Enclosures of piecewise-linear tables, by NumPy; the rule is that of `interpolation`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .interval import Interval, extremes

# What an interpolated value loses, in ε of the largest value around it: the position loses 1.5, the
# difference of two values 1, their sum 0.5, and as much again for safety.
_LOSS = 8 * float(np.finfo(np.float64).eps)


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
