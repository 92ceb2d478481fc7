"""The vertices of an octree's leaves: lattices over parts of it that are refined about evenly.

A node may have one lattice for all of its leaves, as fine as the finest of them; or one of 3³
points for those of its children that are leaves, and others for the rest. What needs fewer points
is chosen, from the smallest nodes on.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .octree_order import Places
from .vertices import VertexNumbers, corner_numbers

# Levels that a lattice spans at most: wider ones are hardly ever worth it (0 to 1 % fewer points).
_DEEPEST = 3
# Leaves numbered at once.
_CHUNK = 1 << 20


def octree_vertices(grid: Any) -> VertexNumbers:
    """Return the numbers of the vertices of an octree, Cartesian or curvilinear."""
    leaf, level, depth, lattice = _chosen(grid.places)
    lattices = OctreeLattices(grid, leaf, level, depth)
    points = lattices.points(slice(None)).prod(axis=0)
    first = np.concatenate([[0], np.cumsum(points)])
    cells = np.empty((grid.size, 2), np.uint32)
    for begin in range(0, grid.size, _CHUNK):
        part = slice(begin, min(begin + _CHUNK, grid.size))
        cells[part] = lattices.corners(part, lattice[part], first)
    return VertexNumbers(cells, first, lattices)


class OctreeLattices:
    """Lattices over nodes of an octree; see `vertices.Lattices`."""

    def __init__(self, grid: Any, leaf: np.ndarray, level: np.ndarray, depth: np.ndarray) -> None:
        self.grid, self.leaf, self.level, self.depth = grid, leaf, level, depth
        self.halved = np.isin(np.arange(3), grid.places.axes)[:, None]

    def points(self, which: slice | np.ndarray) -> np.ndarray:
        """Return how many points some lattices have along each axis, (3, n)."""
        parts = np.where(self.halved, 1 << self.depth[which].astype(np.int64), 1)
        return parts + 1

    def boxes(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        which = slice(first, last)
        leaf, level = self.leaf[which].astype(np.int64), self.level[which].astype(np.int64)
        corner = self.grid.boxes(int(leaf[0]), int(leaf[-1]) + 1)[0][:, leaf - leaf[0]]
        finer = self.grid.places.deepest - level
        low = np.where(self.halved, corner >> finer << finer, corner)
        step = np.where(self.halved, 1 << (finer - self.depth[which]), 1)
        return low, step, self.points(which)

    def corners(self, leaves: slice, lattice: np.ndarray, first: np.ndarray) -> np.ndarray:
        """Return the numbers of the corners of consecutive leaves, from their lattices."""
        depth = self.depth[lattice].astype(np.int64)
        finest = self.level[lattice] + depth
        corner = self.grid.boxes(leaves.start, leaves.stop)[0]
        corner >>= np.where(self.halved, self.grid.places.deepest - finest, 0)
        index = corner & np.where(self.halved, (1 << depth) - 1, 0)
        scale = np.where(self.halved, 1 << (finest - self.grid.levels[leaves]), 1)
        return corner_numbers(first[lattice], index, self.points(lattice), scale)


def _chosen(places: Places) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return nodes with lattices, in the order of their first leaves, and the lattice of each leaf.

    As first leaves, levels, and how many levels their lattices span. From the smallest nodes on, a
    node takes one lattice for all of its leaves, or one for those of its children that are leaves.
    """
    levels, count = places.levels, len(places.levels)
    axes = len(places.axes)
    points = (2.0 ** np.arange(_DEEPEST + 2) + 1) ** axes * 2.0 ** (3 - axes)
    points[-1] = np.inf
    # Of each leaf: the first leaf, level and span of the node that has its lattice.
    owner, level, span = np.arange(count, dtype=np.uint32), levels.copy(), np.zeros(count, np.uint8)
    leaf, deepest, cost = np.arange(count), levels, np.full(count, points[0])
    aligned = places.aligned_levels()
    for here in range(max(places.deepest, 1) - 1, -1, -1):
        child = np.flatnonzero(aligned <= here)
        last = deepest <= here + 1  # children that are leaves
        apart = np.add.reduceat(np.where(last, 0.0, cost), child)
        apart += points[1] * np.logical_or.reduceat(last, child)
        leaf, aligned, deepest = leaf[child], aligned[child], np.maximum.reduceat(deepest, child)
        spans = np.maximum(deepest.astype(np.int64) - here, 0)
        whole = points[np.minimum(spans, _DEEPEST + 1)]
        cost = np.where(spans == 0, points[0], np.minimum(whole, apart))
        alone, sizes = whole <= apart, np.diff(leaf, append=count)
        spans[~alone & (spans > 0)] = 1
        taken = np.repeat(alone & (spans > 0), sizes) | (levels == here + 1)
        owner[taken], level[taken] = np.repeat(leaf.astype(np.uint32), sizes)[taken], here
        span[taken] = np.repeat(spans.astype(np.uint8), sizes)[taken]
    # Leaves of nodes of one level follow each other.
    lattice, first = np.empty(count, np.uint32), [np.zeros(0, np.int64)]
    for here in range(places.deepest + 1):
        own = np.flatnonzero(level == here)
        new = np.diff(owner[own].astype(np.int64), prepend=-1) != 0
        lattice[own] = sum(len(f) for f in first) + np.cumsum(new) - 1
        first.append(own[new])
    some = np.concatenate(first)
    # Nodes of several levels may begin with one leaf; points of neighbours shall be neighbours.
    order = np.lexsort((level[some], owner[some]))
    rank = np.empty(len(some), np.uint32)
    rank[order] = np.arange(len(some), dtype=np.uint32)
    some = some[order]
    return owner[some], level[some], span[some], rank[lattice]
