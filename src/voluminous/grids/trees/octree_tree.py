"""The tree of nodes of an octree: few look-ups a step, and little memory.

An octree's leaves are numbered depth first, so the leaves of a part refined evenly are numbered by
their interleaved bits: such a part, up to 8 cells wide, is a single entry. Nodes, four entries
wide, are needed where levels change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr
from ...backend.types import Float, Int, Mask
from ...errors import InputError
from .octree_order import Places, spread_bits
from .tree import NONE, NUMBER_BITS, NUMBER_MASK, PLAIN, Cell, Orientation, Tree

if TYPE_CHECKING:
    from ...backend.device import Backend

# Levels from one node to those below it.
STEP = 2
# The kind has three bits: evenly refined entries are 2^3 cells wide at most, cells 2^3 entries.
_EVEN = 3
# Root entries per leaf, at most, and how many are no matter. More would save look-ups, but small
# trees stay in the caches: that matters more (2.2 instead of 1.5 ns a step for 38 million leaves).
_ROOT_SHARE, _ROOT_FREE = 0.25, 1 << 12


def octree_tree(counts: tuple[int, ...], places: Places, numbers: np.ndarray | None = None) -> Tree:
    """Return the tree of an octree."""
    if len(places.levels) > NONE:
        raise InputError(f"an octree can have {NONE} leaves at most, got {len(places.levels)}")
    axes, deepest = places.axes, places.deepest
    leaves = _Leaves(places.levels, places.aligned_levels(), numbers)
    levels, nodes = _nodes(leaves, axes, _root_level(counts, places, leaves))
    extent = np.array(counts, np.int64)
    extent[list(axes)] <<= deepest
    units = np.ones((len(levels), 3), np.int64)
    units[:, list(axes)] = 1 << (deepest - np.array(levels))[:, None]
    holes = numbers is not None and bool((numbers == NONE).any())
    clusters = tuple(levels[0] if axis in axes else 0 for axis in range(3))
    return Tree(extent, units, np.concatenate(nodes), Halved(axes), holes, clusters)


def _root_level(counts: tuple[int, ...], places: Places, leaves: _Leaves) -> int:
    """Return how much finer than the base the root is: fewer look-ups, if not too many entries."""
    bits, deepest = len(places.axes), places.deepest
    if not leaves.entries(0, bits)[1].any():
        return 0
    most = max(_ROOT_FREE, _ROOT_SHARE * len(places.levels))
    cells = float(np.prod(counts, dtype=float))
    fitting = [w for w in range(_EVEN + 1) if w == 0 or cells * 2.0 ** (bits * w) <= most]
    if leaves.number is not None:
        # Siblings may differ in being holes: the last nodes must be made of the smallest leaves.
        fitting = [w for w in fitting if (deepest - w) % STEP == 0] or [deepest % STEP]
    # Entries of a level are mixed only if there are cells two levels deeper.
    return min(fitting, key=lambda w: (max(0, -((w + 1 - deepest) // STEP)), w))


def _nodes(leaves: _Leaves, axes: tuple[int, ...], root: int) -> tuple[list[int], list[np.ndarray]]:
    levels, nodes, total = [root], [], 0
    order = _order(axes, root)
    while True:
        words, mixed, leaves = leaves.entries(levels[-1], len(axes))
        total += len(words)
        # In the order of the leaves, nodes are met as the entries are that point to them.
        order_below = _order(axes, STEP)
        pointers = total + len(order_below) * np.arange(np.count_nonzero(mixed))
        if total + len(order_below) * len(pointers) > NUMBER_MASK:
            raise InputError(f"the octree needs more than {NUMBER_MASK} entries in its nodes")
        words[mixed] = pointers
        nodes.append(words.reshape(-1, len(order))[:, order].reshape(-1))
        if not len(pointers):
            return levels, nodes
        levels.append(levels[-1] + STEP)
        order = order_below


def _order(axes: tuple[int, ...], steps: int) -> np.ndarray:
    """Return which depth-first entry comes where in a node, whose first axis is to run fastest.

    A node is a cell halved some times; the root consists of one for each base cell.
    """
    digits: dict[int, list[int]] = {axis: [] for axis in axes}
    for step in range(steps):
        for k, axis in enumerate(reversed(axes)):
            digits[axis].append(step * len(axes) + k)
    slowest_first = [digit for axis in reversed(axes) for digit in digits[axis]]
    order = np.arange(1 << steps * len(axes)).reshape((2,) * (steps * len(axes)))
    return np.asarray(order.transpose(slowest_first).reshape(-1))


@dataclass(frozen=True)
class _Leaves:
    """Consecutive leaves, depth first: all of them, or those within some nodes.

    `level`, `aligned`: their levels, and those of the largest nodes that begin where they do;
    `number`: their numbers; None if these count up from zero.
    """

    level: np.ndarray
    aligned: np.ndarray
    number: np.ndarray | None

    def entries(self, level: int, axes: int) -> tuple[np.ndarray, np.ndarray, _Leaves]:
        """Return entries of a level, depth first, which of them are mixed, and the leaves there."""
        start = np.flatnonzero(self.aligned <= level)
        own = self.level[start].astype(np.int64)
        # All leaves of a node have the level of the first, and the next numbers.
        even = (own - level <= _EVEN) & (np.minimum.reduceat(self.level, start) == own)
        even &= np.maximum.reduceat(self.level, start) == own
        number = start
        if self.number is not None:
            number, gap = self.number[start], self.number - np.arange(len(self.number))
            even &= np.maximum.reduceat(gap, start) == np.minimum.reduceat(gap, start)
        words = ((own - level + PLAIN) << NUMBER_BITS | number).astype(np.uint32)
        words[~even] = 0
        counts = 1 << axes * np.maximum(level - own, 0)
        inside = np.flatnonzero(np.repeat(~even, np.diff(start, append=len(self.level))))
        below = inside if self.number is None else self.number[inside]
        leaves = _Leaves(self.level[inside], self.aligned[inside], below)
        return np.repeat(words, counts), np.repeat(~even, counts), leaves


@dataclass(frozen=True)
class Halved:
    """Entries whose cells are entries, halved or doubled some times along some axes.

    An entry of kind k has cells of 2^(4 - k) times its own size. Their numbers follow each other
    depth first: ``number`` is that of the first one, or of the one cell the entry is a part of.

    `axes`: the axes that are halved; the others are not refined.
    """

    axes: tuple[int, ...] = (0, 1, 2)

    def cells(
        self, entry: np.ndarray, place: np.ndarray, unit: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        number = (entry & NUMBER_MASK).astype(np.int64)
        kind = (entry >> NUMBER_BITS).astype(np.int64)
        deeper, size = np.maximum(kind - PLAIN, 0), unit.copy()
        for k, axis in enumerate(self.axes):
            size[axis] = (unit[axis] << np.maximum(PLAIN - kind, 0)) >> deeper
            local = place[axis] // size[axis] & ((1 << deeper) - 1)
            number += spread_bits(local, len(self.axes)) << k
        return np.where(entry & NUMBER_MASK == NONE, -1, number), size

    def traced(self, tree: Tree, backend: Backend) -> TracedHalved:
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

    def located(self, place: list[Float]) -> list[Int]:
        return [self.Whole(p) for p in place]

    def root(self, unit: list[Int]) -> list[Int]:
        bits = self.Whole(self.root_bits)
        return [
            self.backend.UInt(u >> bits if axis in self.axes else u) for axis, u in enumerate(unit)
        ]

    def slot(self, unit: list[Int], level: Int, sense: Orientation) -> Int:
        bits, slot = self.Whole(self.root_bits - level * STEP), self.backend.UInt(0)
        for k, axis in enumerate(self.axes):
            local = self._local(unit[axis] >> bits, sense.flip[axis], (1 << STEP) - 1)
            slot = slot | (local << (k * STEP))
        return slot

    def cell(
        self, entry: Int, unit: list[Int], level: Int, sense: Orientation, active: Mask
    ) -> Cell:
        """Return the cells around finest units, from leaf entries of a tree level.

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
                local = self._local(index, sense.flip[axis], mask)
                number = number + (self._spread(local) << self.axes.index(axis))
                u = index << bits
            low.append(Float(u))
        return Cell(number, low, [Float(self.Whole(1) << bits)])

    def sizes_of(self, cell: Cell) -> list[Float]:
        return [cell.size[0] if axis in self.axes else 1.0 for axis in range(3)]

    def _local(self, index: Int, flip: Int, mask: Int) -> Int:
        return (self.backend.UInt(index) ^ flip) & mask

    def _spread(self, v: Int) -> Int:
        n = len(self.axes)
        if n == 1 or self.even < 2:
            return v
        first, second = (0x33, 0x55) if n == 2 else (0xC3, 0x249)
        if self.even > 2:
            v = (v | (v << 2 * (n - 1))) & first
        return (v | (v << (n - 1))) & second
