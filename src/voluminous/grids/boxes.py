"""Boxes of whole cells, and the indices of the cells in them."""

from __future__ import annotations

import numpy as np


def expanded(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return all cells of boxes: which box (m,) and which indices (3, m), the first one fastest.

    Layer by layer, row by row: no cell's index needs a division (a third of the time).
    """
    size = np.maximum(high - low, 0)
    box = np.arange(len(low))
    found: list[np.ndarray] = []
    for axis in (2, 1, 0):
        count = size[box, axis]
        index = np.arange(int(count.sum())) + np.repeat(low[box, axis] - _starts(count), count)
        found = [np.repeat(f, count) for f in found]
        box = np.repeat(box, count)
        found.append(index)
    return box, np.stack(found[::-1])


def _starts(count: np.ndarray) -> np.ndarray:
    starts: np.ndarray = np.cumsum(count) - count
    return starts


def unravelled(flat: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Return indices (3, n) from flat ones, of which the first axis runs fastest."""
    return np.stack(np.unravel_index(flat, tuple(shape[::-1]))[::-1])
