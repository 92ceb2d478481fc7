"""Grids whose cells are boxes of a tree: where cells are, how large, and which is where."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend.types import Int
from ...geometry import is_uniform, span
from ...packages import room
from ...units import unit_name
from ..arguments import plain_points
from ..contract import CellBox, Grid
from .tree import Tree
from .vertices import VertexNumbers

if TYPE_CHECKING:
    from ...backend.device import Backend

AXES = "xyz"
# Single precision must tell this many points apart across the smallest cell.
_POINTS_PER_CELL = 256
# Cells whose corners are computed at once: temporary arrays stay small beside the fields.
_CHUNK = 1 << 20


class TreeCells(Grid):
    """What `grids.contract.Grid` asks of a grid of boxes between planes of x, y and z.

    A subclass has the attributes below, and tells where its cells are by `boxes` and `tree`.

    Attributes
    ----------
    base_edges : tuple of three float64 arrays
        The walls of the base cells.
    extent : array of int64, shape (3,)
        Size of the domain in finest units: each base cell is evenly divided into them.
    levels : array of uint8, shape (n,)
        How often each cell's base cell was refined.
    unit : astropy unit or None
        Length unit; None is dimensionless.
    """

    base_edges: tuple[np.ndarray, ...]
    extent: np.ndarray
    levels: np.ndarray
    unit: Any
    walk_kinds: tuple[str, ...] = ("cells", "dual")
    cells_are_boxes = has_vertices = has_neighbourhood = True

    @functools.cached_property
    def tree(self) -> Tree:
        """From places to cells."""
        raise NotImplementedError

    def boxes(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Return lower corners and sizes of consecutive cells in finest units, int64 (3, n)."""
        raise NotImplementedError

    def boxes_of(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `boxes` of cells given by ascending numbers."""
        found = [np.empty((3, len(cells)), np.int64) for _ in range(2)]
        for first in range(0, self.size, _CHUNK):
            here = slice(*np.searchsorted(cells, [first, first + _CHUNK]))
            if here.start == here.stop:
                continue
            parts = self.boxes(first, min(first + _CHUNK, self.size))
            for whole, part in zip(found, parts, strict=True):
                whole[:, here] = part[:, cells[here] - first]
        return found[0], found[1]

    @property
    def size(self) -> int:
        """Number of cells."""
        return len(self.levels)

    @property
    def shape(self) -> tuple[int]:
        """Shape of a field: one value per cell."""
        return (self.size,)

    @property
    def bounds(self) -> np.ndarray:
        """Corners of the domain, shape (3, 2), in the grid's unit."""
        return np.array([[e[0], e[-1]] for e in self.base_edges])

    @property
    def divisions(self) -> np.ndarray:
        """Finest units per base cell along each axis."""
        divided: np.ndarray = self.extent // [len(e) - 1 for e in self.base_edges]
        return divided

    @functools.cached_property
    def cells_per_level(self) -> tuple[int, ...]:
        """Number of cells of each level."""
        return tuple(int(n) for n in np.bincount(self.levels))

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

    def needs_double(self) -> bool:
        """Return True where single precision cannot tell the cells of an axis apart."""
        return bool(self.resolution < np.finfo(np.float32).eps * _POINTS_PER_CELL)

    def unpack(self, flat: np.ndarray) -> Any:
        return np.asarray(flat)

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
        """Return x, y and z of the centres of consecutive cells, shape (3, n)."""
        low, high = self.corners(first, last)
        return 0.5 * (low + high)

    def cell_sizes(self, first: int = 0, last: int | None = None) -> np.ndarray:
        """Return the widths of consecutive cells, shape (3, n)."""
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
        """Volumes of the cells, shape (n,)."""
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
        """Return the number of the cell that each point is in, -1 outside and in holes.

        A point on a wall is in the cell above it; on the last wall of all, below it.

        Parameters
        ----------
        points : array_like or Quantity, shape (n, 3)
            x, y and z; plain numbers are in the grid's unit.
        """
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

    @functools.cached_property
    def vertex_numbers(self) -> VertexNumbers:
        """Numbers of the vertices of all cells."""
        raise NotImplementedError

    @property
    def vertex_count(self) -> int:
        """Number of vertices."""
        return self.vertex_numbers.count

    def vertex_cells(self, vertex: Int, backend: Backend) -> list[tuple[Any, Any]]:
        """Return the eight cells around consecutive vertices; see `grids.contract.Grid`."""
        from .vertices import cells_around

        return cells_around(self, vertex, backend)

    def surroundings(self, backend: Backend) -> Any:
        """Return what finds the cells around vertices in kernels (made once)."""
        from .vertices import Surroundings

        double = backend.with_precision("double")
        return self.on_device(double, "surroundings", lambda: Surroundings(self.tree, double))

    def neighbourhood(self, backend: Backend) -> Any:
        """Return what finds neighbours of cells in kernels, and how far they are: the same."""
        return self.surroundings(backend)

    def lattice(self, arrays: Sequence[np.ndarray], backend: Backend) -> list[Any]:
        lattices: list[Any] = room("rendering.sources.corner_layouts").tree_lattices(
            self, arrays, backend
        )
        return lattices

    def walk(self, backend: Backend, kind: str = "cells", box: CellBox | None = None) -> Any:
        self.check_no_box(box)
        return self.on_device(backend, kind, lambda: self.walk_through(self.tree, backend, kind))

    def walk_through(self, tree: Tree, backend: Backend, kind: str = "cells") -> Any:
        """Return a walk through another tree over the same domain, such as one with more holes."""
        from .walk import TreeFieldWalk, TreeWalk

        kinds = {"cells": TreeWalk, "dual": TreeFieldWalk}
        return kinds[kind](self, tree, backend)

    def describe(self) -> dict[str, Any]:
        """Return type, cells per level, bounds and unit as plain values."""
        return {
            **super().describe(),
            "base": [len(e) - 1 for e in self.base_edges],
            "levels": len(self.cells_per_level),
            "cells_per_level": list(self.cells_per_level),
        }

    def __repr__(self) -> str:
        limits = ", ".join(
            f"{a}: {span(lo, hi)}" for a, (lo, hi) in zip(AXES, self.bounds, strict=True)
        )
        base = "x".join(str(len(e) - 1) for e in self.base_edges)
        levels = "/".join(str(n) for n in self.cells_per_level)
        where = f"{limits} {unit_name(self.unit)}".strip()
        name = type(self).__name__
        return f"<{name} {self.size} cells, base {base}, per level {levels}, {where}>"
