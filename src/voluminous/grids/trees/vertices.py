"""The corners of a tree's cells, and the cells around them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...backend import dr, from_host
from .lookup import Cell, TreeLookup
from .spacing import Spacing

# Corners of a cell, or octants around a vertex: below (0) or above along x, y and z.
OCTANTS = tuple(itertools.product((0, 1), repeat=3))
# Cells whose corners are found at once, and what corners are kept as: short or long.
_CHUNK = 1 << 18
_DTYPES = (np.float64, np.uint32)


class Boxes:
    """Consecutive cells of a tree, for kernels: lower corners and sizes in finest units.

    Parameters
    ----------
    grid : TreeCells or RefinedCells
    first, last : int
    backend : Backend
        Of double precision: corners and sizes are given in it. They are kept in half the memory
        where the domain is short enough.
    """

    def __init__(self, grid: Any, first: int, last: int, backend: Any) -> None:
        self.backend = backend
        self.kind = backend.UInt if max(grid.tree.extent) < 1 << 32 else backend.Wide
        kept = [np.empty((3, last - first), _DTYPES[self.kind is backend.UInt]) for _ in range(2)]
        for begin in range(first, last, _CHUNK):
            end = min(begin + _CHUNK, last)
            for whole, part in zip(kept, grid.boxes(begin, end), strict=True):
                whole[:, begin - first : end - first] = part
        self._low, self._size = ([from_host(self.kind, v) for v in part] for part in kept)

    def low(self, lane: Any) -> list[Any]:
        """Return the lower corners of cells, given by their numbers among these."""
        return self._of(self._low, lane)

    def size(self, lane: Any) -> list[Any]:
        """Return the sizes of cells."""
        return self._of(self._size, lane)

    def corner(self, lane: Any, corner: Any) -> list[Any]:
        """Return the places of corners of cells."""
        return [
            low + dr.select((corner >> (2 - axis)) & 1 == 1, size, 0.0)
            for axis, (low, size) in enumerate(zip(self.low(lane), self.size(lane), strict=True))
        ]

    def _of(self, parts: list[Any], lane: Any) -> list[Any]:
        return [self.backend.Wide(dr.gather(self.kind, v, lane)) for v in parts]


class Surroundings:
    """Finds the cells in the eight octants around vertices.

    Parameters
    ----------
    tree : Tree
    backend : Backend
        In double precision, that places of deep trees are whole numbers.

    Attributes
    ----------
    alike : sequence of bool
        Along which axes all is symmetric: beyond a cell there is nothing else.
    """

    alike: Sequence[bool] = (False, False, False)

    def __init__(self, tree: Any, backend: Any) -> None:
        self.lookup = TreeLookup(tree, backend)
        self.way = self.lookup.orient()
        self.extent = [dr.opaque(backend.Wide, float(n)) for n in tree.extent]

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
        cell = self.lookup.find(place, self.way, there)
        return cell, there & self.lookup.is_cell(cell)

    def spacing(self, grid: Any, backend: Any) -> Spacing:
        """Return what knows lengths on the grid."""
        return Spacing(grid, backend)

    def steps(self, middle: list[Any], size: list[Any], width: list[Any]) -> list[Any]:
        """Return what widths of boxes are to gradients there: the same, on Cartesian grids."""
        return width

    def box(self, cell: Cell) -> tuple[list[Any], list[Any]]:
        """Return lower corners and sizes of cells in finest units."""
        return cell.low, self.lookup.sizes(cell)


def cells_around(grid: Any, vertex: Any, backend: Any) -> list[tuple[Any, Any]]:
    """Return the cells around consecutive vertices; see `Grid.vertex_cells`.

    A cell that fills several octants counts as often (RADMC-3D's rule).
    """
    numbers = np.asarray(vertex)
    place = grid.vertex_numbers.places(int(numbers[0]), int(numbers[-1]) + 1, backend)
    around = grid.surroundings(backend).cells(place, dr.full(backend.Bool, True, len(numbers)))
    return [(cell.number, there) for cell, there in around]
