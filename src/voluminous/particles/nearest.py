"""Which point is nearest to places in boxes, in kernels.

Each box has eight places, the middles of its octants. A few points that are near by chance tell how
far away the nearest can be at most; the nodes of an octree of all points within that sphere hold
all that need be looked at.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..backend import dr, from_host, get_backend
from .base import Base
from .nodes import nodes_of
from .octree import Refinement, octree_around
from .overlaps import Overlaps, packed

# Points in a leaf of the tree in which they are searched.
_POINTS = 2
# Points that are looked at first, neighbours in the tree's order.
_FIRST = 8


class Nearest:
    """Finds the nearest of some points.

    Parameters
    ----------
    points : array of float64, shape (n, 3)
    """

    def __init__(self, points: np.ndarray) -> None:
        self.backend = get_backend("cpu", "double")
        base = Base.around(np.stack([points.min(axis=0), points.max(axis=0)], axis=1))
        self.grid = octree_around(base, points, Refinement(_POINTS, np.zeros(len(points))))
        leaf = self.grid.locate(points)
        self.order = np.argsort(leaf, kind="stable")
        self.points = packed(self.backend, points[self.order], np.zeros(len(points)))
        self.first = np.append(0, np.cumsum(np.bincount(leaf, minlength=self.grid.size)))
        self.nodes = nodes_of(self.grid)
        # Node k has the points start[k] to start[after[k]].
        begun = np.zeros(self.nodes.size + 1, np.int64)
        begun[self.nodes.leaf + 1] = 1
        self.start = self.first[np.cumsum(begun)].astype(np.uint32)

    def of(self, low: np.ndarray, size: np.ndarray) -> np.ndarray:
        """Return which points are nearest to the middles of the octants of boxes.

        Parameters
        ----------
        low, size : arrays of float64, shape (3, n)
            Lower corners and widths.

        Returns
        -------
        array of int64, shape (n, 8)
            In the order of octants with x fastest.
        """
        center, step = low + 0.5 * size, 0.25 * size
        overlaps = Overlaps(self.nodes, center.T, self._reach(center, step), self.backend)
        counts = overlaps.counts(0, center.shape[1])
        node = overlaps.pairs(0, counts).node
        places = self._places(center, step)
        return self.order[self._search(places, counts, node).reshape(-1, 8)]

    def _reach(self, center: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Return how far from the centre of a box the nearest points can be at most."""
        backend, count = self.backend, min(_FIRST, len(self.order))
        leaf = self.grid.locate(np.clip(center.T, *self.grid.bounds.T))
        guess = np.clip(self.first[leaf] - count // 2, 0, len(self.order) - count)
        first, end = from_host(backend.UInt, guess), dr.opaque(backend.UInt, count)
        middle, steps = ([from_host(backend.Float, v) for v in part] for part in (center, step))

        def more(k: Any, best: Any) -> Any:
            return k < end

        def look(k: Any, best: Any) -> tuple[Any, Any]:
            point = dr.gather(backend.packet(4), self.points, first + k)
            away = [dr.abs(point[a] - middle[a]) + steps[a] for a in range(3)]
            far = away[0] * away[0] + away[1] * away[1] + away[2] * away[2]
            return k + 1, dr.select(far < best, far, best)

        start = dr.zeros(backend.UInt, dr.width(first))
        best = dr.full(backend.Float, np.inf, dr.width(first))
        far = dr.while_loop((start, best), more, look, label="first points")[1]
        # A little more: what is nearest must not be lost by rounding.
        return np.array(dr.sqrt(far)) * (1 + 1e-9) + np.linalg.norm(step, axis=0)

    def _places(self, center: np.ndarray, step: np.ndarray) -> list[Any]:
        Float = self.backend.Float
        lane = dr.arange(self.backend.UInt, 8 * center.shape[1])
        places = []
        for axis in range(3):
            side = Float((lane >> axis) & 1) * 2.0 - 1.0
            middle, away = (dr.gather(Float, Float(v[axis]), lane >> 3) for v in (center, step))
            places.append(dr.fma(side, away, middle))
        return places

    def _search(self, places: list[Any], counts: np.ndarray, node: np.ndarray) -> np.ndarray:
        """Return the nearest points to places, in the nodes listed for each box of eight."""
        UInt, box = self.backend.UInt, dr.arange(self.backend.UInt, 8 * len(counts)) >> 3
        ends = np.cumsum(counts, dtype=np.int64)
        last = dr.gather(UInt, from_host(UInt, ends), box)
        first = last - dr.gather(UInt, from_host(UInt, counts), box)
        begin, end = (from_host(UInt, self.start[n]) for n in (node, self.nodes.after[node]))

        def more(j: Any, best: Any, found: Any) -> Any:
            return j < last

        def visit(j: Any, best: Any, found: Any) -> tuple[Any, Any, Any]:
            points = (dr.gather(UInt, begin, j), dr.gather(UInt, end, j))
            return j + 1, *self._nearest(places, points, best, found)

        best = dr.full(self.backend.Float, np.inf, dr.width(box))
        state = (first, best, dr.zeros(UInt, dr.width(box)))
        return np.array(dr.while_loop(state, more, visit, label="nearest")[2])

    def _nearest(
        self, places: list[Any], points: tuple[Any, Any], best: Any, found: Any
    ) -> tuple[Any, Any]:
        packet, (first, end) = self.backend.packet(4), points

        def more(k: Any, best: Any, found: Any) -> Any:
            return k < end

        def look(k: Any, best: Any, found: Any) -> tuple[Any, Any, Any]:
            point = dr.gather(packet, self.points, k)
            x, y, z = (point[axis] - places[axis] for axis in range(3))
            square = x * x + y * y + z * z
            closer = square < best
            return k + 1, dr.select(closer, square, best), dr.select(closer, k, found)

        _, best, found = dr.while_loop((first, best, found), more, look, label="points")
        return best, found
