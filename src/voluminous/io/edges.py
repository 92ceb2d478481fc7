"""Edges of cells from their centres."""

from __future__ import annotations

import numpy as np

# Centres that are so equally spaced as single precision can tell belong to equal cells.
_EVEN = 1e-4


def edges_of_centers(centers: np.ndarray) -> np.ndarray:
    """Return the midpoints between ascending centres, and one beyond each end.

    Parameters
    ----------
    centers : array, shape (n,)
        Strictly increasing. The outermost cells are as wide on both sides of their centres; a
        single cell is one unit wide.

    Returns
    -------
    array, shape (n + 1,), float64
        Equally spaced if the centres are so to the precision of their type or to six digits: a
        grid of equal cells is faster, and files round coordinates.
    """
    values = np.asarray(centers, np.float64)
    if len(values) == 1:
        return values[0] + np.array([-0.5, 0.5])
    if is_even(values):
        half = 0.5 * (values[-1] - values[0]) / (len(values) - 1)
        return np.linspace(values[0] - half, values[-1] + half, len(values) + 1)
    middles = 0.5 * (values[1:] + values[:-1])
    ends = 2 * values[0] - middles[0], 2 * values[-1] - middles[-1]
    return np.concatenate([[ends[0]], middles, [ends[1]]])


def is_even(centers: np.ndarray) -> bool:
    """Return True for coordinates that are equally spaced but for rounding."""
    even = np.linspace(centers[0], centers[-1], len(centers))
    step = abs(centers[-1] - centers[0]) / max(len(centers) - 1, 1)
    return bool(np.max(np.abs(centers - even)) <= _EVEN * step)
