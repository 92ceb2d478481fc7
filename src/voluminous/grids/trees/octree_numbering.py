"""What the entries of an octree's tree mean: to NumPy, and to a kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...backend import dr
from .lookup import Cell, Orientation
from .octree_places import spread_bits
from .tree import NONE, NUMBER_BITS, NUMBER_MASK, PLAIN, Tree

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

    def traced(self, tree: Tree, backend: Any) -> Any:
        """Return the same for kernels."""
        return TracedHalved(self.axes, tree, backend)


class TracedHalved:
    """From an entry to the cell around a place, by shifts of whole numbers.

    All sizes being powers of two of the finest unit, the bits of a place are the indices of the
    entries and cells around it, and where it is in them. (Products of floating-point numbers take
    as long: what rays wait for is the chain of look-ups.)
    """

    def __init__(self, axes: tuple[int, ...], tree: Tree, backend: Any) -> None:
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

    def slot(self, unit: list[Any], level: Any, way: Orientation) -> Any:
        """Return the number of an entry of a tree level in its block."""
        bits, slot = self.Whole(self.root_bits - level * STEP), self.backend.UInt(0)
        for k, axis in enumerate(self.axes):
            local = self._local(unit[axis] >> bits, way.flip[axis], (1 << STEP) - 1)
            slot = slot | (local << (k * STEP))
        return slot

    def cell(self, entry: Any, unit: list[Any], level: Any, way: Orientation, active: Any) -> Cell:
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

    def _local(self, index: Any, flip: Any, mask: Any) -> Any:
        """Return the lowest bits of mirrored indices, as they are if counted upwards."""
        return (self.backend.UInt(index) ^ flip) & mask

    def _spread(self, v: Any) -> Any:
        n = len(self.axes)
        if n == 1 or self.even < 2:
            return v
        first, second = (0x33, 0x55) if n == 2 else (0xC3, 0x249)
        if self.even > 2:
            v = (v | (v << 2 * (n - 1))) & first
        return (v | (v << (n - 1))) & second
