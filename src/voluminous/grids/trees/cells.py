"""Grids whose cells are boxes of a tree: where cells are, how large, and which is where."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

import numpy as np

from ...geometry import is_uniform
from ..arguments import plain_points
from ..contract import CellBox, check_walk, on_device
from .tree import Tree
from .vertices import LeafGrid

if TYPE_CHECKING:
    from ...backend.device import Backend
    from .parts import Parts
    from .walk import TreeWalk

# Cells whose corners are computed at once: temporary arrays stay small beside the fields.
_CHUNK = 1 << 20


class TreeCells(LeafGrid):
    """What `grids.contract.Grid` asks of a grid of boxes between planes of x, y and z.

    `base_edges`: the walls of the base cells; `extent` (3,): size of the domain in finest units:
    each base cell is evenly divided into them; `unit`: length unit; None is dimensionless.
    """

    extent: np.ndarray

    @property
    def bounds(self) -> np.ndarray:
        """Corners of the domain, shape (3, 2), in the grid's unit."""
        return np.array([[e[0], e[-1]] for e in self.base_edges])

    @property
    def divisions(self) -> np.ndarray:  # type: ignore[override]
        divided: np.ndarray = self.extent // self.base_shape
        return divided

    @functools.cached_property
    def scale(self) -> float:
        """Width of the cells of the most frequent level, in which kernels measure lengths."""
        count = int(np.argmax(self.cells_per_level))
        first = int(np.argmax(self.levels == count))
        _, size = self.boxes(first, first + 1)
        share = size[:, 0] / self.extent
        return float(np.exp(np.mean(np.log(np.ptp(self.bounds, axis=1) * share))))

    @property
    def resolution(self) -> float:
        """Width of the thinnest cell as a fraction of the domain's."""
        thinnest = [np.diff(e).min() for e in self.base_edges] / self.divisions
        return float(np.min(thinnest / np.ptp(self.bounds, axis=1)))

    def corners(self, first: int = 0, last: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return lower and upper corners of consecutive cells, float64 (3, n)."""
        low, size = self.boxes(first, self.size if last is None else last)
        return self.position(low), self.position(low + size)

    def position(self, place: np.ndarray) -> np.ndarray:
        """Return the coordinates of places, an integer array (3, n) of finest units."""
        found = np.empty(place.shape)
        for axis, (edges, parts) in enumerate(zip(self.base_edges, self.divisions, strict=True)):
            base, part = np.divmod(place[axis], parts)
            widths = np.append(np.diff(edges), 0.0)
            found[axis] = edges[base] + widths[base] * (part / parts)
        return found

    def cell_centers(self, first: int = 0, last: int | None = None) -> np.ndarray:
        low, high = self.corners(first, last)
        return np.asarray(0.5 * (low + high))

    def cell_sizes(self, first: int = 0, last: int | None = None) -> np.ndarray:
        low, size = self.boxes(first, self.size if last is None else last)
        return self.widths(low, size)

    def widths(self, low: np.ndarray, size: np.ndarray) -> np.ndarray:
        """Return the widths of boxes in the grid's unit, from corners and sizes in finest units."""
        widths = np.empty(size.shape)
        for axis, (edges, parts) in enumerate(zip(self.base_edges, self.divisions, strict=True)):
            widths[axis] = np.diff(edges)[low[axis] // parts] * (size[axis] / parts)
        return widths

    @property
    def level_sizes(self) -> np.ndarray:
        """Sizes of the cells of each level in finest units, int64 (levels, 3)."""
        raise NotImplementedError

    @property
    def cell_volumes(self) -> np.ndarray:
        if all(is_uniform(e) for e in self.base_edges):  # a tenth of the time
            finest = np.ptp(self.bounds, axis=1) / self.extent
            volumes: np.ndarray = np.prod(finest * self.level_sizes, axis=1)[self.levels]
            return volumes
        volumes = np.empty(self.size)
        for first in range(0, self.size, _CHUNK):
            part = slice(first, min(first + _CHUNK, self.size))
            volumes[part] = self.cell_sizes(part.start, part.stop).prod(axis=0)
        return volumes

    def locate(self, points: Any) -> np.ndarray:
        points = plain_points(points, self.unit)
        low, high = self.bounds.T
        inside = ((points >= low) & (points <= high)).all(axis=1)
        found = np.full(len(points), -1, np.int64)
        found[inside] = self.tree.find(self._places(points[inside].T)).number
        return found

    def _places(self, points: np.ndarray) -> np.ndarray:
        places = np.empty(points.shape, np.int64)
        for axis, (edges, parts) in enumerate(zip(self.base_edges, self.divisions, strict=True)):
            base = np.clip(np.searchsorted(edges, points[axis], "right") - 1, 0, len(edges) - 2)
            part = (points[axis] - edges[base]) / np.diff(edges)[base] * parts
            places[axis] = base * parts + np.clip(part.astype(np.int64), 0, parts - 1)
        return places

    def walk(self, backend: Backend, kind: str = "cells", box: CellBox | None = None) -> Any:
        check_walk(self, kind, ("cells", "dual"), box if box and len(box.low) != 1 else None)
        whole = on_device(self, backend, kind, lambda: self.walk_through(self.tree, backend, kind))
        if box is None:
            return whole
        from .confined import ConfinedWalk

        return ConfinedWalk(whole, box)

    def surface(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Return lower corners and sizes of those cells of a part that may touch others, (3, n)."""
        raise NotImplementedError

    def parts(self, most: int) -> Parts:
        """Return the grid in parts of consecutive cells, of so many at most.

        Those of an octree are boxes, so that rays cross each of them once.
        """
        raise NotImplementedError

    def walk_through(self, tree: Tree, backend: Backend, kind: str = "cells") -> TreeWalk:
        from .walk import TreeFieldWalk, TreeWalk

        kinds = {"cells": TreeWalk, "dual": TreeFieldWalk}
        return kinds[kind](self, tree, backend)
