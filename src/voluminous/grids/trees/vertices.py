"""The corners of a tree's cells, and the cells around them.

Every cell has eight vertices of its own, ``8 · cell + 4 x + 2 y + z`` with x, y and z from 0 to 1;
vertices of several cells at one place are as many numbers. That takes more memory than numbering
places, and saves finding out, on the ray, which place has which number.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from ...backend import dr, from_host
from .lookup import Cell, TreeLookup
from .spacing import Spacing

# Corners of a cell, or octants around a vertex: below (0) or above along x, y and z.
OCTANTS = tuple(itertools.product((0, 1), repeat=3))


class Boxes:
    """Some cells of a tree, for kernels.

    Parameters
    ----------
    low, size : int arrays, shape (3, n)
        Lower corners and sizes in finest units.
    backend : Backend
    """

    def __init__(self, low: np.ndarray, size: np.ndarray, backend: Any) -> None:
        self.backend = backend
        self.low, self.size = ([from_host(backend.Wide, v) for v in part] for part in (low, size))

    def corner(self, lane: Any, corner: Any) -> list[Any]:
        """Return the place of a corner of a cell, given by its number among these."""
        found = []
        for axis, (low, size) in enumerate(zip(self.low, self.size, strict=True)):
            start, wide = (dr.gather(self.backend.Wide, v, lane) for v in (low, size))
            found.append(dr.select((corner >> (2 - axis)) & 1 == 1, start + wide, start))
        return found


def boxes_between(grid: Any, first: int, last: int, backend: Any) -> Boxes:
    """Return consecutive cells of a grid."""
    low, size = grid.boxes(first, last)
    return Boxes(low, size, backend)


class Surroundings:
    """Finds the cells in the eight octants around vertices.

    Parameters
    ----------
    tree : Tree
    backend : Backend
        In double precision, that places of deep trees are whole numbers.
    """

    def __init__(self, tree: Any, backend: Any) -> None:
        self.lookup = TreeLookup(tree, backend)
        self.way = self.lookup.orient()
        self.extent = [dr.opaque(backend.Wide, float(n)) for n in tree.extent]
        self.unit = [float(u) for u in np.broadcast_to(self.lookup.per_finest, 3)]

    def cells(self, vertex: list[Any], active: Any) -> list[tuple[Cell, Any]]:
        """Return the cells around vertices, each with where it exists.

        Parameters
        ----------
        vertex : list of three arrays
            Places in finest units.
        active : array of Bool
        """
        return [
            self.cell_at(
                [v + (0.5 if b else -0.5) for v, b in zip(vertex, up, strict=True)], active
            )
            for up in OCTANTS
        ]

    def cell_at(self, place: list[Any], active: Any) -> tuple[Cell, Any]:
        """Return the cells around places, which may be outside, and where there is one."""
        there = active
        for p, extent in zip(place, self.extent, strict=True):
            there = there & (p > 0.0) & (p < extent)
        scaled = [p * unit for p, unit in zip(place, self.unit, strict=True)]
        cell = self.lookup.find(scaled, self.way, there)
        return cell, there & self.lookup.is_cell(cell)

    def spacing(self, grid: Any, backend: Any) -> Spacing:
        """Return what knows lengths on the grid."""
        return Spacing(grid, backend)

    def steps(self, middle: list[Any], size: list[Any], width: list[Any]) -> list[Any]:
        """Return what widths of boxes are to gradients there: the same, on Cartesian grids."""
        return width

    def box(self, cell: Cell) -> tuple[list[Any], list[Any]]:
        """Return lower corners and sizes of cells in finest units."""
        low = [v / unit for v, unit in zip(cell.low, self.unit, strict=True)]
        sizes = self.lookup.sizes(cell)
        return low, [s / unit for s, unit in zip(sizes, self.unit, strict=True)]


def cells_around(grid: Any, vertex: Any, backend: Any) -> list[tuple[Any, Any]]:
    """Return the cells around consecutive vertices; see `Grid.vertex_cells`.

    A cell that fills several octants counts as often (RADMC-3D's rule).
    """
    numbers = np.asarray(vertex)
    first, last = int(numbers[0]) >> 3, (int(numbers[-1]) >> 3) + 1
    boxes = boxes_between(grid, first, last, backend)
    lane = backend.UInt(vertex)
    place = boxes.corner((lane >> 3) - dr.opaque(backend.UInt, first), lane & 7)
    around = grid.surroundings(backend).cells(place, dr.full(backend.Bool, True, len(numbers)))
    return [(cell.number, there) for cell, there in around]
