"""All nodes of an octree, split ones and leaves, for work that may end at any of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..grids import OctreeGrid


@dataclass(frozen=True)
class Nodes:
    """Nodes depth first: a split node is followed by all that is in it.

    Attributes
    ----------
    level : array of uint8, shape (nodes,)
    low : array of float64, shape (nodes, 3)
        Lower corners.
    width : array of float64, shape (3,)
        Of the base cells.
    after : array of uint32, shape (nodes,)
        The node that follows once all in a node is done with; that of a leaf is the next one.
    leaf : array of int64, shape (leaves,)
        Which nodes are leaves, in the grid's order.
    """

    level: np.ndarray
    low: np.ndarray
    width: np.ndarray
    after: np.ndarray
    leaf: np.ndarray

    @property
    def part(self) -> np.ndarray:
        """Widths of the nodes as parts of the base cells'."""
        return np.ldexp(1.0, -self.level.astype(np.int64))

    @property
    def size(self) -> int:
        """Number of nodes."""
        return len(self.level)

    def spread(self, amounts: np.ndarray) -> np.ndarray:
        """Return what leaves hold, once what each split node holds is spread evenly in it.

        Parameters
        ----------
        amounts : array of float64, shape (nodes,)
            Is changed.
        """
        for level in range(1, int(self.level.max()) + 1):
            parents = np.flatnonzero((self.level == level - 1) & ~self._is_leaf())
            if not len(parents):
                break
            own = np.flatnonzero(self.level == level)
            amounts[own] += 0.125 * amounts[parents[np.searchsorted(parents, own) - 1]]
        return amounts[self.leaf]

    def _is_leaf(self) -> np.ndarray:
        return self.after == np.arange(1, self.size + 1)


def nodes_of(grid: OctreeGrid) -> Nodes:
    """Return all nodes of an octree on equally wide base cells."""
    first = grid.places.aligned_levels().astype(np.int64)
    count = grid.levels - first + 1
    leaf = np.cumsum(count) - 1
    # A leaf comes after the split nodes that begin where it does.
    level = np.repeat(first - np.cumsum(count) + count, count) + np.arange(leaf[-1] + 1)
    low, _ = grid.corners()
    width = np.array([(e[-1] - e[0]) / (len(e) - 1) for e in grid.base_edges])
    return Nodes(
        level.astype(np.uint8), np.repeat(low.T, count, axis=0), width, _after(level), leaf
    )


def _after(level: np.ndarray) -> np.ndarray:
    after = np.empty(len(level), np.uint32)
    for own in range(int(level.max()) + 1):
        ends = np.append(np.flatnonzero(level <= own), len(level))
        nodes = np.flatnonzero(level == own)
        after[nodes] = ends[np.searchsorted(ends, nodes) + 1]
    return after
