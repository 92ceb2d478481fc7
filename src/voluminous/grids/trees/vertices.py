"""How the vertices of a tree's cells are numbered: by lattices.

Cells come in lattices, boxes of evenly spaced points of which the eight corners of each cell are
some. So the numbers of a cell's corners are ``first + a·sx + b·sy + c·sz``, with a, b and c from 0
to 1, and two words per cell tell them all. Points where lattices meet have a number in each.

Eight numbers of its own for every cell would need no words, but 2 to 5 times as many vertices: of
0.7 million leaves, with four coefficients each, 28 MB in place of 86, so that caches hold more of
them (400² rays in second order take 0.92 of the time, on tiles of 8³ cells 0.75).
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ...backend import dr, from_host
from ...backend.types import Float, Int, Mask
from ..contract import BoxGrid, DualGrid, VertexGrid, on_device
from .axes import Spacing
from .tree import Cell, Tree, TreeLookup

if TYPE_CHECKING:
    from ...backend.device import Backend

# Corners of a cell, or octants around a vertex: below (0) or above along x, y and z.
OCTANTS = tuple(itertools.product((0, 1), repeat=3))
# Cells whose corners are found at once, and what corners are kept as: short or long.
_CHUNK = 1 << 18
_DTYPES = (np.float64, np.uint32)


class VertexBoxes:
    """Consecutive cells of a tree, for kernels: lower corners and sizes in finest units."""

    def __init__(self, grid: LeafGrid, first: int, last: int, backend: Backend) -> None:
        self.backend = backend
        self.kind = backend.UInt if max(grid.tree.extent) < 1 << 32 else backend.Wide
        kept = [np.empty((3, last - first), _DTYPES[self.kind is backend.UInt]) for _ in range(2)]
        for begin in range(first, last, _CHUNK):
            end = min(begin + _CHUNK, last)
            for whole, part in zip(kept, grid.boxes(begin, end), strict=True):
                whole[:, begin - first : end - first] = part
        self._low, self._size = ([from_host(self.kind, v) for v in part] for part in kept)

    def low(self, lane: Int) -> list[Float]:
        """Return the lower corners of cells, given by their numbers among these."""
        return self._of(self._low, lane)

    def size(self, lane: Int) -> list[Float]:
        """Return the sizes of cells."""
        return self._of(self._size, lane)

    def corner(self, lane: Int, corner: Int) -> list[Float]:
        """Return the places of corners of cells."""
        return [
            low + dr.select((corner >> (2 - axis)) & 1 == 1, size, 0.0)
            for axis, (low, size) in enumerate(zip(self.low(lane), self.size(lane), strict=True))
        ]

    def _of(self, parts: list[Float], lane: Int) -> list[Float]:
        return [self.backend.Wide(dr.gather(self.kind, v, lane)) for v in parts]


class Surroundings:
    """Finds the cells in the eight octants around vertices.

    `alike`: along which axes all is symmetric: beyond a cell there is nothing else.
    """

    alike: Sequence[bool] = (False, False, False)

    def __init__(self, grid: LeafGrid, backend: Backend) -> None:
        self.grid, tree = grid, grid.tree
        self.lookup = TreeLookup(tree, backend)
        self.sense = self.lookup.orient()
        self.extent = [dr.opaque(backend.Wide, float(n)) for n in tree.extent]

    def cells(self, vertex: list[Float], active: Mask) -> list[tuple[Cell, Mask]]:
        """Return the cells around vertices, each with where it exists."""
        return [
            self.cell_at(
                [v + (0.5 if b else -0.5) for v, b in zip(vertex, up, strict=True)], active
            )
            for up in OCTANTS
        ]

    def cell_at(self, place: list[Float], active: Mask) -> tuple[Cell, Mask]:
        """Return the cells around places, which may be outside, and where there is one."""
        there = active
        for p, extent in zip(place, self.extent, strict=True):
            there = there & (p > 0.0) & (p < extent)
        cell = self.lookup.find(place, self.sense, there)
        return cell, there & self.lookup.is_cell(cell)

    def spacing(self, backend: Backend) -> Spacing:
        """Return what knows lengths on the grid."""
        return Spacing(self.grid, backend)

    def steps(self, middle: list[Float], size: list[Float], width: list[Float]) -> list[Float]:
        """Return what widths of boxes are to gradients there: the same, on Cartesian grids."""
        return width

    def box(self, cell: Cell) -> tuple[list[Float], list[Float]]:
        """Return lower corners and sizes of cells in finest units."""
        return cell.low, self.lookup.sizes(cell)


def cells_around(grid: LeafGrid, vertex: Int, backend: Backend) -> list[tuple[Int, Mask]]:
    """Return the cells around consecutive vertices; see `Grid.vertex_cells`.

    A cell that fills several octants counts as often (RADMC-3D's rule).
    """
    numbers = np.asarray(vertex)
    place = grid.vertex_numbers.places(int(numbers[0]), int(numbers[-1]) + 1, backend)
    around = grid.surroundings(backend).cells(place, dr.full(backend.Bool, True, len(numbers)))
    return [(cell.number, there) for cell, there in around]


# Strides along y and z take so many bits, that along x all others.
_STRIDE_BITS = 10
_MASK = (1 << _STRIDE_BITS) - 1


class Lattices(Protocol):
    """Where lattices are, in the order of their points' numbers."""

    def boxes(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return first points and spacings in finest units, and points per axis: int64 (3, n)."""


@dataclass(frozen=True)
class VertexNumbers:
    """The numbers of the vertices of all cells.

    `cells` (n, 2): per cell the number of its lower corner, and the strides to the others, packed;
    `first` (m + 1,): number of the first point of each lattice, and how many points there are;
    `lattices`.
    """

    cells: np.ndarray
    first: np.ndarray
    lattices: Lattices
    _traced: dict[type, Int] = field(default_factory=dict)

    @property
    def count(self) -> int:
        return int(self.first[-1])

    def places(self, first: int, last: int, backend: Backend) -> list[Float]:
        """Return where consecutive vertices are, in finest units: x, y and z (traced)."""
        UInt, Wide = backend.UInt, backend.Wide
        begin = int(np.searchsorted(self.first, first, "right")) - 1
        end = int(np.searchsorted(self.first, last))
        low, step, points = self.lattices.boxes(begin, end)
        starts, ends = self.first[begin:end], self.first[begin + 1 : end + 1]
        counts = np.minimum(ends, last) - np.maximum(starts, first)
        own = from_host(UInt, np.repeat(np.arange(end - begin, dtype=np.uint32), counts))
        skipped = dr.gather(backend.Int, from_host(backend.Int, first - starts), own)
        ny, nz = (dr.gather(UInt, from_host(UInt, points[axis]), own) for axis in (1, 2))
        local = UInt(dr.arange(backend.Int, last - first) + skipped)
        row = backend.quotient(local, nz)
        plane = backend.quotient(row, ny)
        index = (plane, row - plane * ny, local - row * nz)
        return [
            dr.fma(
                Wide(i),
                dr.gather(Wide, from_host(Wide, step[axis]), own),
                dr.gather(Wide, from_host(Wide, low[axis]), own),
            )
            for axis, i in enumerate(index)
        ]

    def of(self, cell: Int, active: Mask, backend: Backend) -> tuple[Int, list[Int]]:
        """Return the numbers of the lower corners of cells, and the strides along x, y and z.

        Cells of lanes that are not active may be any numbers.
        """
        key, bits = backend.UInt, _STRIDE_BITS  # the same in both precisions
        if key not in self._traced:
            self._traced[key] = from_host(backend.UInt, self.cells.reshape(-1))
        corner, strides = dr.gather(backend.module.Array2u, self._traced[key], cell, active)
        return corner, [strides >> (2 * bits), (strides >> bits) & _MASK, strides & _MASK]


def corner_numbers(
    first: np.ndarray, index: np.ndarray, points: np.ndarray, scale: np.ndarray | int
) -> np.ndarray:
    """Return `VertexNumbers.cells` of cells.

    From the number of the first point of each cell's lattice (n,), the point at its lower corner
    (3, n), the points per axis (3, n), and how many spacings it is wide (3, n).
    """
    rows = points[2]
    planes = points[1] * rows
    numbers = np.empty((len(rows), 2), np.uint32)
    numbers[:, 0] = first + index[0] * planes + index[1] * rows + index[2]
    x, y, z = np.stack([planes, rows, np.ones_like(rows)]) * scale
    numbers[:, 1] = x << (2 * _STRIDE_BITS) | y << _STRIDE_BITS | z
    return numbers


class LeafGrid(BoxGrid, VertexGrid, DualGrid):
    """What grids share whose cells are boxes of a tree, in any coordinates.

    A subclass has the attributes below, and tells where its cells are by `boxes` and `tree`.

    `levels` (n,): how often each cell's base cell was refined; `base_edges`, `base_shape`: walls
    and number of base cells along each axis; `divisions` (3,): finest units per base cell.
    """

    levels: np.ndarray
    base_edges: tuple[np.ndarray, ...]
    divisions: np.ndarray
    fine_edges: tuple[np.ndarray, ...] = ()
    dual_layout = "corners"

    @functools.cached_property
    def tree(self) -> Tree:
        """From places, whole numbers of finest units, to cells."""
        raise NotImplementedError

    @functools.cached_property
    def vertex_numbers(self) -> VertexNumbers:
        raise NotImplementedError

    def boxes(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Return lower corners and sizes of consecutive cells in finest units, int64 (3, n)."""
        raise NotImplementedError

    def surroundings(self, backend: Backend) -> Surroundings:
        """Return what finds the cells around vertices in kernels, in double precision."""
        double = backend.with_precision("double")
        return on_device(self, double, "surroundings", lambda: Surroundings(self, double))

    def neighbourhood(self, backend: Backend) -> Surroundings:
        """Return what finds neighbours of cells in kernels, and how far they are."""
        return self.surroundings(backend)

    @property
    def base_shape(self) -> tuple[int, int, int]:
        a, b, c = (len(e) - 1 for e in self.base_edges)
        return a, b, c

    @property
    def size(self) -> int:
        return len(self.levels)

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.size,)

    @functools.cached_property
    def cells_per_level(self) -> tuple[int, ...]:
        return tuple(int(n) for n in np.bincount(self.levels))

    @property
    def vertex_count(self) -> int:
        return self.vertex_numbers.count

    def vertex_cells(self, vertex: Int, backend: Backend) -> list[tuple[Int, Mask]]:
        return cells_around(self, vertex, backend)

    def describe(self) -> dict[str, Any]:
        return {
            **super().describe(),
            "base": list(self.base_shape),
            "levels": len(self.cells_per_level),
            "cells_per_level": list(self.cells_per_level),
        }

    def _counts(self) -> str:
        base, levels = "x".join(map(str, self.base_shape)), "/".join(map(str, self.cells_per_level))
        return f"{self.size} cells, base {base}, per level {levels}"
