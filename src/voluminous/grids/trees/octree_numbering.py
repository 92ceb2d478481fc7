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
    """From an entry to the cell around a place, by arithmetic alone.

    Places are in units of the root's entries. All sizes being powers of two, only exponents are
    computed, and no place need be rounded to a whole number of anything.
    """

    def __init__(self, axes: tuple[int, ...], tree: Tree, backend: Any) -> None:
        self.axes, self.backend = axes, backend
        self.per_finest = 1.0 / tree.units[0]
        single = backend.precision == "single"
        self.bias, self.shift = (127, 23) if single else (1023, 52)
        # Indices of cells among all of their level, of which the lowest bits are wanted.
        self.Whole: Any = backend.UInt if single else dr.uint64_array_t(backend.UInt)
        self.Bits: Any = (
            dr.int32_array_t(backend.Float) if single else dr.int64_array_t(backend.Float)
        )
        kinds = tree.entries >> NUMBER_BITS
        self.even = int(kinds.max()) - PLAIN
        self.larger = bool(((kinds > 0) & (kinds < PLAIN)).any())

    def centred(self, place: list[Any]) -> list[Any]:
        """Return places as they are: products with powers of two are exact."""
        return place

    def root(self, place: list[Any]) -> list[Any]:
        """Return the indices of the root's entries around places."""
        return [self.backend.UInt(p) for p in place]

    def slot(self, place: list[Any], level: Any, way: Orientation) -> Any:
        """Return the number of an entry of a tree level in its block."""
        per_root = self._power(self.Bits(level) * STEP)
        slot = self.backend.UInt(0)
        for k, axis in enumerate(self.axes):
            local = self._local(place[axis] * per_root, way.flip[axis], (1 << STEP) - 1)
            slot = slot | (local << (k * STEP))
        return slot

    def cell(self, entry: Any, place: list[Any], level: Any, way: Orientation, active: Any) -> Cell:
        """Return the cells around places, from entries of a tree level that are no blocks.

        Nothing is looked up: `active` is for numberings that do.
        """
        kind = self.Bits(entry >> NUMBER_BITS)
        halvings = kind + (self.Bits(level) * STEP - PLAIN)
        size, per_root = self._power(-halvings), self._power(halvings)
        deeper = self.backend.Int(entry >> NUMBER_BITS) - PLAIN
        if self.larger:
            deeper = dr.maximum(deeper, 0)
        mask = (self.backend.UInt(1) << self.backend.UInt(deeper)) - 1
        low, number = list(place), entry & NUMBER_MASK
        for axis in range(3):
            index = dr.floor(place[axis] * per_root) if axis in self.axes else dr.floor(place[axis])
            low[axis] = index * size if axis in self.axes else index
            if axis in self.axes:
                local = self._local(index, way.flip[axis], mask)
                number = number + (self._spread(local) << self.axes.index(axis))
        return Cell(number, low, [size])

    def sizes_of(self, cell: Cell) -> list[Any]:
        """Return the sizes of cells along each axis."""
        return [cell.size[0] if axis in self.axes else 1.0 for axis in range(3)]

    def _power(self, exponent: Any) -> Any:
        """Return two to a power."""
        return dr.reinterpret_array(self.backend.Float, (exponent + self.bias) << self.shift)

    def _local(self, index: Any, flip: Any, mask: Any) -> Any:
        """Return the lowest bits of mirrored indices, as they are if counted upwards."""
        return (self.backend.UInt(self.Whole(index)) ^ flip) & mask

    def _spread(self, v: Any) -> Any:
        """Return four bits moved apart, as many places as there are axes."""
        n = len(self.axes)
        if n == 1 or self.even < 2:
            return v
        first, second = (0x33, 0x55) if n == 2 else (0xC3, 0x249)
        if self.even > 2:
            v = (v | (v << 2 * (n - 1))) & first
        return (v | (v << (n - 1))) & second
