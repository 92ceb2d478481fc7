"""RADMC-3D's layers as boxes of cells on the lattices of their levels."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import InputError
from .inputs import as_array


def boxes_of_layers(
    base: tuple[int, ...], layers: Any
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return level (n + 1,), first cell and shape (n + 1, 3) of a base grid and its layers.

    Parameters
    ----------
    base : three int
        Number of cells of the base grid.
    layers : array_like of int, shape (n, 7)
        Rows ``parent, ix, iy, iz, nx, ny, nz`` as RADMC-3D has them.
    """
    rows = as_array(layers, "layers")
    if not rows.size:  # the base grid alone
        rows = np.zeros((0, 7), np.int64)
    if rows.ndim != 2 or rows.shape[1] != 7 or rows.dtype.kind not in "iu":
        raise InputError(
            "layers must be rows of seven integers (parent, ix, iy, iz, nx, ny, nz), got "
            f"{rows.dtype} of shape {rows.shape}"
        )
    count = len(rows) + 1
    level = np.zeros(count, np.int64)
    low, shape = np.zeros((count, 3), np.int64), np.zeros((count, 3), np.int64)
    shape[0] = base
    for k, (parent, *numbers) in enumerate(rows.tolist(), start=1):
        if not 0 <= parent < k:
            raise InputError(f"layer {k} must have a parent from 0 to {k - 1}, got {parent}")
        first, cells = np.array(numbers[:3]) - 1, np.array(numbers[3:])
        if (first < 0).any() or (cells < 1).any() or (first + cells > shape[parent]).any():
            raise InputError(
                f"layer {k} covers cells {(first + 1).tolist()} to {(first + cells).tolist()} of "
                f"its parent {parent}, which has {shape[parent].tolist()}"
            )
        level[k] = level[parent] + 1
        low[k], shape[k] = 2 * (low[parent] + first), 2 * cells
    return level, low, shape
