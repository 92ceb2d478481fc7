"""Neighbours in a picture after one another: their rays cross the same cells."""

from __future__ import annotations

import numpy as np

# Side of tiles in pixels.
_TILE = 64.0


def nearby(x: np.ndarray, y: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return the order of things at x, y in pixels: tile by tile, in each by depth.

    Rays of one vector are followed together until the last one of them arrives. What is not in the
    picture (NaN) comes last.
    """
    column, row = (np.floor(w / _TILE) for w in (x, y))
    return np.lexsort((depth, column, row))
