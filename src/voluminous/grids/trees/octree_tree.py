"""The tree of blocks of an octree: few look-ups a step, and little memory.

An octree's leaves are numbered depth first, so the leaves of a part refined evenly are numbered by
their interleaved bits: such a part, up to 8 cells wide, is a single entry. Blocks, four entries
wide, are needed where levels change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from .octree_order import Places
from .octree_vertices import STEP, Halved
from .tree import NONE, NUMBER_BITS, NUMBER_MASK, PLAIN, Tree

# The kind has three bits: evenly refined entries are 2^3 cells wide at most, cells 2^3 entries.
_EVEN = 3
# Root entries per leaf, at most, and how many are no matter. More would save look-ups, but small
# trees stay in the caches: that matters more (2.2 instead of 1.5 ns a step for 38 million leaves).
_ROOT_SHARE, _ROOT_FREE = 0.25, 1 << 12


def octree_tree(counts: tuple[int, ...], places: Places, numbers: np.ndarray | None = None) -> Tree:
    """Return the tree of an octree.

    Parameters
    ----------
    counts : three int
        Number of base cells along each axis.
    places : Places
        Levels of all leaves, depth first, and the axes that are halved.
    numbers : array of int64, optional
        Cell number of each leaf, NONE where there is none; leaves refined evenly are numbered
        without gaps. By default they are numbered in order.
    """
    if len(places.levels) > NONE:
        raise InputError(f"an octree can have {NONE} leaves at most, got {len(places.levels)}")
    axes, deepest = places.axes, places.deepest
    leaves = _Leaves(places.levels, places.aligned_levels(), numbers)
    levels, blocks = _blocks(leaves, axes, _root_level(counts, places, leaves))
    extent = np.array(counts, np.int64)
    extent[list(axes)] <<= deepest
    units = np.ones((len(levels), 3), np.int64)
    units[:, list(axes)] = 1 << (deepest - np.array(levels))[:, None]
    holes = numbers is not None and bool((numbers == NONE).any())
    bricks = tuple(levels[0] if axis in axes else 0 for axis in range(3))
    return Tree(extent, units, np.concatenate(blocks), Halved(axes), holes, bricks)


def _root_level(counts: tuple[int, ...], places: Places, leaves: _Leaves) -> int:
    """Return how much finer than the base the root is: fewer look-ups, if not too many entries."""
    bits, deepest = len(places.axes), places.deepest
    if not leaves.entries(0, bits)[1].any():
        return 0
    most = max(_ROOT_FREE, _ROOT_SHARE * len(places.levels))
    cells = float(np.prod(counts, dtype=float))
    fitting = [w for w in range(_EVEN + 1) if w == 0 or cells * 2.0 ** (bits * w) <= most]
    if leaves.number is not None:
        # Siblings may differ in being holes: the last blocks must be made of the smallest leaves.
        fitting = [w for w in fitting if (deepest - w) % STEP == 0] or [deepest % STEP]
    # Entries of a level are mixed only if there are cells two levels deeper.
    return min(fitting, key=lambda w: (max(0, -((w + 1 - deepest) // STEP)), w))


def _blocks(
    leaves: _Leaves, axes: tuple[int, ...], root: int
) -> tuple[list[int], list[np.ndarray]]:
    """Return the levels that entries have, and for each level the entries of its blocks."""
    levels, blocks, total = [root], [], 0
    order = _order(axes, root)
    while True:
        words, mixed, leaves = leaves.entries(levels[-1], len(axes))
        total += len(words)
        # In the order of the leaves, blocks are met as the entries are that point to them.
        order_below = _order(axes, STEP)
        pointers = total + len(order_below) * np.arange(np.count_nonzero(mixed))
        _check_entries(total + len(order_below) * len(pointers))
        words[mixed] = pointers
        blocks.append(words.reshape(-1, len(order))[:, order].reshape(-1))
        if not len(pointers):
            return levels, blocks
        levels.append(levels[-1] + STEP)
        order = order_below


def _check_entries(count: int) -> None:
    if count > NUMBER_MASK:
        raise InputError(f"the octree needs more than {NUMBER_MASK} entries in its blocks")


def _order(axes: tuple[int, ...], steps: int) -> np.ndarray:
    """Return which depth-first entry comes where in a block, whose first axis is to run fastest.

    A block is a cell halved some times; the root consists of one for each base cell.
    """
    digits: dict[int, list[int]] = {axis: [] for axis in axes}
    for step in range(steps):
        for k, axis in enumerate(reversed(axes)):
            digits[axis].append(step * len(axes) + k)
    slowest_first = [digit for axis in reversed(axes) for digit in digits[axis]]
    order = np.arange(1 << steps * len(axes)).reshape((2,) * (steps * len(axes)))
    return order.transpose(slowest_first).reshape(-1)


@dataclass(frozen=True)
class _Leaves:
    """Consecutive leaves, depth first: all of them, or those within some nodes.

    Attributes
    ----------
    level, aligned : array of uint8
        Their levels, and those of the largest nodes that begin where they do.
    number : array of int64 or None
        Their numbers; None if these count up from zero.
    """

    level: np.ndarray
    aligned: np.ndarray
    number: np.ndarray | None

    def entries(self, level: int, axes: int) -> tuple[np.ndarray, np.ndarray, _Leaves]:
        """Return entries of a level, depth first, which of them are mixed, and the leaves there."""
        start = np.flatnonzero(self.aligned <= level)
        own = self.level[start].astype(np.int64)
        even = self._even(start, own) & (own - level <= _EVEN)
        number = start if self.number is None else self.number[start]
        words = ((own - level + PLAIN) << NUMBER_BITS | number).astype(np.uint32)
        words[~even] = 0
        counts = 1 << axes * np.maximum(level - own, 0)
        return np.repeat(words, counts), np.repeat(~even, counts), self._within(start, ~even)

    def _even(self, start: np.ndarray, own: np.ndarray) -> np.ndarray:
        """Return for which nodes all leaves have the level of the first, and the next numbers."""
        even: np.ndarray = np.maximum.reduceat(self.level, start) == own
        even &= np.minimum.reduceat(self.level, start) == own
        if self.number is not None:
            gap = self.number - np.arange(len(self.number))
            even &= np.maximum.reduceat(gap, start) == np.minimum.reduceat(gap, start)
        return even

    def _within(self, start: np.ndarray, chosen: np.ndarray) -> _Leaves:
        inside = np.repeat(chosen, np.diff(start, append=len(self.level)))
        inside = np.flatnonzero(inside)
        number = inside if self.number is None else self.number[inside]
        return _Leaves(self.level[inside], self.aligned[inside], number)
