"""Between grids of planes: means over cells, one axis after another."""

from __future__ import annotations

from typing import Any

import numpy as np


def axis_means(values: np.ndarray, source: Any, target: Any) -> np.ndarray:
    """Return the integral over each target cell divided by its volume; nothing is outside.

    Parameters
    ----------
    values : float64 array
        Of the source's shape.
    source, target : CartesianGrid
    """
    for axis, (old, new) in enumerate(zip(source.edges, target.edges, strict=True)):
        values = np.moveaxis(_means(np.moveaxis(values, axis, 0), old, new), 0, axis)
    return np.ascontiguousarray(values)


def _means(values: np.ndarray, old: np.ndarray, new: np.ndarray) -> np.ndarray:
    out = np.zeros((len(new) - 1, *values.shape[1:]))
    walls = np.union1d(old, new)
    walls = walls[(walls >= max(old[0], new[0])) & (walls <= min(old[-1], new[-1]))]
    if len(walls) < 2:
        return out
    middle = 0.5 * (walls[1:] + walls[:-1])
    own, into = (np.searchsorted(e, middle, "right") - 1 for e in (old, new))
    part = np.diff(walls) / np.diff(new)[into]
    weighted = values[own] * part.reshape(-1, *[1] * (values.ndim - 1))
    cells, starts = np.unique(into, return_index=True)
    out[cells] = np.add.reduceat(weighted, starts, axis=0)
    return out
