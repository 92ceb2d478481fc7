"""The corners of a refined curvilinear grid's leaves, and the cells around them.

Every leaf has eight vertices of its own, ``8 leaf + 4 a + 2 b + c``, a, b and c being 1 at the
upper ends of its coordinates. RADMC-3D's rule: a vertex is the mean over its eight octants; a leaf
that fills several counts as often.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np


def cells_around(grid: Any, lane: Any, backend: Any) -> list[tuple[Any, Any]]:
    """Return the cells around consecutive vertices, and whether they exist; see `Grid`."""
    vertex = np.asarray(lane).astype(np.int64)
    first, last = int(vertex[0]) >> 3, (int(vertex[-1]) >> 3) + 1
    corner, size = grid.boxes(first, last)
    leaf, bits = (vertex >> 3) - first, np.stack([(vertex >> s) & 1 for s in (2, 1, 0)])
    place = corner[:, leaf] + bits * size[:, leaf]
    found = []
    for octant in itertools.product((-1, 0), repeat=3):
        inside, there = _folded(grid, place + np.array(octant)[:, None])
        number = grid.tree.find(inside).number
        found.append((backend.Int(number.astype(np.int32)), backend.Bool(there)))
    return found


def _folded(grid: Any, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return cells of the evenly refined grid inside it, and whether they were."""
    there = np.ones(place.shape[1], bool)
    for axis, (name, count) in enumerate(
        zip(grid.coordinates, grid.divisions * grid.base_shape, strict=True)
    ):
        if name == "phi" and grid.is_periodic:
            place[axis] %= count
        elif name == "theta" and grid.mirror:
            place[axis] = np.minimum(place[axis], count - 1)
        there &= (place[axis] >= 0) & (place[axis] < count)
        place[axis] = np.clip(place[axis], 0, count - 1)
    return place, there
