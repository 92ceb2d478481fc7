"""The vertices of an octree's leaves: lattices over parts of it that are refined about evenly.

A node may have one lattice for all of its leaves, as fine as the finest of them; or one of 3³
points for those of its children that are leaves, and others for the rest. What needs fewer points
is chosen, from the smallest nodes on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import Float, dr
from ...backend.types import Int, Mask
from .lookup import Cell, Orientation
from .octree_order import Places, spread_bits
from .tree import NONE, NUMBER_BITS, NUMBER_MASK, PLAIN, Tree
from .vertices import VertexNumbers, corner_numbers

if TYPE_CHECKING:
    from ...backend.device import Backend

# Levels that a lattice spans at most: wider ones are hardly ever worth it (0 to 1 % fewer points).
_DEEPEST = 3
# Leaves numbered at once.
_CHUNK = 1 << 20
_NONE = np.uint32(0xFFFFFFFF)


def octree_vertices(grid: Any) -> VertexNumbers:
    """Return the numbers of the vertices of an octree, Cartesian or curvilinear.

    Parameters
    ----------
    grid : OctreeGrid or RefinedCells
    """
    chosen = _chosen(grid.places)
    lattices = OctreeLattices(grid, chosen.leaf, chosen.level, chosen.depth)
    points = lattices.points(slice(None)).prod(axis=0)
    first = np.concatenate([[0], np.cumsum(points)])
    cells = np.empty((grid.size, 2), np.uint32)
    for begin in range(0, grid.size, _CHUNK):
        part = slice(begin, min(begin + _CHUNK, grid.size))
        cells[part] = lattices.corners(part, chosen.of[part], first)
    return VertexNumbers(cells, first, lattices)


class OctreeLattices:
    """Lattices over nodes of an octree; see `vertex_numbers.Lattices`.

    Parameters
    ----------
    grid : OctreeGrid or RefinedCells
    leaf, level, depth : array, shape (n,)
        The first leaf of each node, its level, and how many levels its lattice spans.
    """

    def __init__(self, grid: Any, leaf: np.ndarray, level: np.ndarray, depth: np.ndarray) -> None:
        self.grid, self.leaf, self.level, self.depth = grid, leaf, level, depth
        self.halved = np.isin(np.arange(3), grid.places.axes)[:, None]

    def points(self, which: Any) -> np.ndarray:
        """Return how many points some lattices have along each axis, (3, n)."""
        parts = np.where(self.halved, 1 << self.depth[which].astype(np.int64), 1)
        return parts + 1

    def boxes(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return first points, spacings, and points per axis of consecutive lattices."""
        which = slice(first, last)
        leaf, level = self.leaf[which].astype(np.int64), self.level[which].astype(np.int64)
        corner = self.grid.boxes(int(leaf[0]), int(leaf[-1]) + 1)[0][:, leaf - leaf[0]]
        finer = self.grid.places.deepest - level
        low = np.where(self.halved, corner >> finer << finer, corner)
        step = np.where(self.halved, 1 << (finer - self.depth[which]), 1)
        return low, step, self.points(which)

    def corners(self, leaves: slice, lattice: np.ndarray, first: np.ndarray) -> np.ndarray:
        """Return the numbers of the corners of consecutive leaves, from the lattices they are in.

        Parameters
        ----------
        leaves : slice
        lattice : array of int, shape (n,)
        first : array of int
            Number of the first point of each lattice.
        """
        depth = self.depth[lattice].astype(np.int64)
        finest = self.level[lattice] + depth
        corner = self.grid.boxes(leaves.start, leaves.stop)[0]
        corner >>= np.where(self.halved, self.grid.places.deepest - finest, 0)
        index = corner & np.where(self.halved, (1 << depth) - 1, 0)
        scale = np.where(self.halved, 1 << (finest - self.grid.levels[leaves]), 1)
        return corner_numbers(first[lattice], index, self.points(lattice), scale)


@dataclass(frozen=True)
class _Chosen:
    """Nodes with lattices, in the order of their first leaves, and the lattice of each leaf."""

    leaf: np.ndarray
    level: np.ndarray
    depth: np.ndarray
    of: np.ndarray


def _chosen(places: Places) -> _Chosen:
    levels = places.levels
    of = np.full(len(levels), _NONE)
    leaf, level, depth, count = [], [], [], 0
    for nodes, spans in _from_the_root(_from_the_leaves(places)):
        here = np.flatnonzero(spans >= 0)
        own = np.full(len(spans), _NONE)
        own[here] = count + np.arange(len(here), dtype=np.uint32)
        finest = np.maximum(spans, 0).astype(np.uint8) + np.uint8(nodes.level)
        sizes = np.diff(nodes.leaf, append=len(levels))
        lattice = np.repeat(own, sizes)
        inside = (lattice != _NONE) & (levels <= np.repeat(finest, sizes))
        of[inside] = lattice[inside]
        leaf.append(nodes.leaf[here])
        level.append(np.full(len(here), nodes.level, np.uint8))
        depth.append(spans[here].astype(np.uint8))
        count += len(here)
    found = [np.concatenate(part) for part in (leaf, level, depth)]
    # Nodes of several levels may begin with one leaf; points of neighbours shall be neighbours.
    order = np.argsort(found[0], kind="stable")
    rank = np.empty(count, np.uint32)
    rank[order] = np.arange(count, dtype=np.uint32)
    found = [part[order] for part in found]
    return _Chosen(found[0], found[1], found[2], rank[of])


@dataclass(frozen=True)
class _Nodes:
    """The nodes of a level, and leaves of lower ones, depth first.

    Attributes
    ----------
    level : int
    leaf : array of int
        The first leaf of each.
    deepest : array of uint8
        The highest level of their leaves.
    whole : array of bool
        One lattice for all of the node is best.
    leaves : array of bool
        Some of their children are leaves.
    children : array of int
        How many nodes of the next level each one is.
    """

    level: int
    leaf: np.ndarray
    deepest: np.ndarray
    whole: np.ndarray
    leaves: np.ndarray
    children: np.ndarray


def _from_the_leaves(places: Places) -> list[_Nodes]:
    """Return the nodes of all levels but the highest, which has leaves only; the base last."""
    size = _sizes(len(places.axes))
    leaf, deepest = np.arange(len(places.levels)), places.levels
    aligned, cost = places.aligned_levels(), np.full(len(leaf), size[0])
    found = []
    for level in range(max(places.deepest, 1) - 1, -1, -1):
        child = np.flatnonzero(aligned <= level)
        children = np.diff(child, append=len(aligned))
        last = deepest <= level + 1  # children that are leaves
        leaves = np.logical_or.reduceat(last, child)
        apart = np.add.reduceat(np.where(last, 0.0, cost), child) + size[1] * leaves
        leaf, aligned = leaf[child], aligned[child]
        deepest = np.maximum.reduceat(deepest, child)
        spans = np.maximum(deepest.astype(np.int64) - level, 0)
        whole = size[np.minimum(spans, _DEEPEST + 1)]
        cost = np.where(spans == 0, size[0], np.minimum(whole, apart))
        found.append(_Nodes(level, leaf, deepest, whole <= apart, leaves, children))
    return found


def _sizes(axes: int) -> np.ndarray:
    """Return how many points lattices have that span 0, 1, ... levels; too many are infinite."""
    points = (2.0 ** np.arange(_DEEPEST + 2) + 1) ** axes * 2.0 ** (3 - axes)
    points[-1] = np.inf
    return points


def _from_the_root(levels: list[_Nodes]) -> Iterator[tuple[_Nodes, np.ndarray]]:
    """Yield nodes, and how many levels their lattices span: -1 where they have none."""
    opened = np.ones(len(levels[-1].leaf), bool)
    for nodes in reversed(levels):
        spans = nodes.deepest.astype(np.int64) - nodes.level
        split = opened & (spans > 0)
        whole, apart = split & nodes.whole, split & ~nodes.whole
        if nodes.level == 0:  # other leaves share a lattice with their siblings
            whole |= spans == 0
        yield nodes, np.where(whole, spans, np.where(apart & nodes.leaves, 1, -1))
        opened = np.repeat(apart, nodes.children)


# Levels from one block to those below it.
STEP = 2


@dataclass(frozen=True)
class Halved:
    """Entries whose cells are entries, halved or doubled some times along some axes.

    An entry of kind k has cells of 2^(4 - k) times its own size. Their numbers follow each other
    depth first: ``number`` is that of the first one, or of the one cell the entry is a part of.

    Attributes
    ----------
    axes : tuple of int
        The axes that are halved; the others are not refined.
    """

    axes: tuple[int, ...] = (0, 1, 2)

    def cells(
        self, entry: np.ndarray, place: np.ndarray, unit: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return numbers and sizes of the cells around places; see `tree.Numbering`."""
        number = (entry & NUMBER_MASK).astype(np.int64)
        kind = (entry >> NUMBER_BITS).astype(np.int64)
        deeper, size = np.maximum(kind - PLAIN, 0), unit.copy()
        for k, axis in enumerate(self.axes):
            size[axis] = (unit[axis] << np.maximum(PLAIN - kind, 0)) >> deeper
            local = place[axis] // size[axis] & ((1 << deeper) - 1)
            number += spread_bits(local, len(self.axes)) << k
        return np.where(entry & NUMBER_MASK == NONE, -1, number), size

    def traced(self, tree: Tree, backend: Backend) -> Any:
        """Return the same for kernels."""
        return TracedHalved(self.axes, tree, backend)


class TracedHalved:
    """From an entry to the cell around a place, by shifts of whole numbers.

    All sizes being powers of two of the finest unit, the bits of a place are the indices of the
    entries and cells around it, and where it is in them. (Products of floating-point numbers take
    as long: what rays wait for is the chain of look-ups.)
    """

    def __init__(self, axes: tuple[int, ...], tree: Tree, backend: Backend) -> None:
        self.axes, self.backend = axes, backend
        single = backend.precision == "single"
        self.Whole: Any = backend.Int if single else dr.int64_array_t(backend.Float)
        self.root_bits = dr.opaque(backend.Int, int(tree.units[0].max()).bit_length() - 1)
        kinds = tree.entries >> NUMBER_BITS
        self.even = int(kinds.max()) - PLAIN
        self.larger = bool(((kinds > 0) & (kinds < PLAIN)).any())

    def located(self, place: list[Any]) -> list[Any]:
        """Return the finest units that places are in."""
        return [self.Whole(p) for p in place]

    def root(self, unit: list[Any]) -> list[Any]:
        """Return the indices of the root's entries around finest units."""
        bits = self.Whole(self.root_bits)
        return [
            self.backend.UInt(u >> bits if axis in self.axes else u) for axis, u in enumerate(unit)
        ]

    def slot(self, unit: list[Any], level: Int, way: Orientation) -> Any:
        """Return the number of an entry of a tree level in its block."""
        bits, slot = self.Whole(self.root_bits - level * STEP), self.backend.UInt(0)
        for k, axis in enumerate(self.axes):
            local = self._local(unit[axis] >> bits, way.flip[axis], (1 << STEP) - 1)
            slot = slot | (local << (k * STEP))
        return slot

    def cell(self, entry: Int, unit: list[Any], level: Int, way: Orientation, active: Mask) -> Cell:
        """Return the cells around finest units, from entries of a tree level that are no blocks.

        Nothing is looked up: `active` is for numberings that do.
        """
        UInt, Float = self.backend.UInt, self.backend.Float
        deeper = self.backend.Int(entry >> NUMBER_BITS) - PLAIN
        bits = self.Whole(self.root_bits - level * STEP - deeper)
        if self.larger:
            deeper = dr.maximum(deeper, 0)
        mask = (UInt(1) << UInt(deeper)) - 1
        low, number = [], entry & NUMBER_MASK
        for axis, u in enumerate(unit):
            if axis in self.axes:
                index = u >> bits
                local = self._local(index, way.flip[axis], mask)
                number = number + (self._spread(local) << self.axes.index(axis))
                u = index << bits
            low.append(Float(u))
        return Cell(number, low, [Float(self.Whole(1) << bits)])

    def sizes_of(self, cell: Cell) -> list[Any]:
        """Return the sizes of cells along each axis."""
        return [cell.size[0] if axis in self.axes else 1.0 for axis in range(3)]

    def _local(self, index: Int, flip: Any, mask: Mask) -> Any:
        """Return the lowest bits of mirrored indices, as they are if counted upwards."""
        return (self.backend.UInt(index) ^ flip) & mask

    def _spread(self, v: Float) -> Any:
        n = len(self.axes)
        if n == 1 or self.even < 2:
            return v
        first, second = (0x33, 0x55) if n == 2 else (0xC3, 0x249)
        if self.even > 2:
            v = (v | (v << 2 * (n - 1))) & first
        return (v | (v << (n - 1))) & second
