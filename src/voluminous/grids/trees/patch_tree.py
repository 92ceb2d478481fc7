"""The tree of blocks over nested patches: which patch is the finest one at a place.

Entries of the tree are painted with the patches that cover them. How small they
need be is known beforehand: all corners of the patches up to some level are multiples of some size,
so entries of that size are painted by none of them partly.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from ...memory import check_memory
from ..boxes import expanded, unravelled
from .tree import ABSENT, NONE, NUMBER_BITS, PLAIN

# Patches that touch more entries are painted one by one, the others all at once.
_LARGE = 1 << 7
# What arrays take at the same time for each entry of blocks.
_BYTES_PER_ENTRY = 32


@dataclass(frozen=True)
class PatchBoxes:
    """Patches in the order in which they are painted, in finest units.

    Attributes
    ----------
    low, high : array of int64, shape (n, 3)
        Their corners.
    level : array of int64, shape (n,)
        Ascending.
    name : array of int64, shape (n,)
        Their numbers in the order they were given.
    """

    low: np.ndarray
    high: np.ndarray
    level: np.ndarray
    name: np.ndarray


@dataclass(frozen=True)
class Painted:
    """Entries of one tree level.

    Attributes
    ----------
    full : array of int32, shape (entries,)
        The last patch that covers each entry, by rank; -1 where none does.
    mixed : array of int64, shape (m,)
        Entries that a later patch touches.
    corner : array of int64, shape (m, 3)
        Their lower corners in units of entries.
    """

    full: np.ndarray
    mixed: np.ndarray
    corner: np.ndarray


_NOTHING = np.zeros(0, np.int64)

# A patch by rank, and a mixed entry, by its place among them, that it touches but does not cover.
Pairs = tuple[np.ndarray, np.ndarray]


def painted_root(boxes: PatchBoxes, shape: np.ndarray, unit: np.ndarray) -> tuple[Painted, Pairs]:
    """Return the painted root, and the patches that its mixed entries need."""
    full = np.full(shape[::-1], -1, np.int32)
    low, high = boxes.low // unit, -(-boxes.high // unit)
    inner = -(-boxes.low // unit), boxes.high // unit
    _paint(full, *inner)
    # Others do not touch more than they cover.
    partly = np.flatnonzero(((inner[0] != low) | (inner[1] != high)).any(axis=1))
    touch = full.copy()
    _paint(touch, low[partly], high[partly], partly)
    mixed = np.flatnonzero(touch > full)
    painted = Painted(full.reshape(-1), mixed, unravelled(mixed, shape).T)
    rank, entry = _beyond(full, low[partly], high[partly], partly)
    return painted, (rank, np.searchsorted(mixed, entry))


def painted_blocks(
    boxes: PatchBoxes, above: Painted, pairs: Pairs, unit: np.ndarray, ratio: np.ndarray
) -> tuple[Painted, Pairs]:
    """Return the painted blocks of mixed entries, and what their own mixed entries need."""
    volume = int(ratio.prod())
    check_memory(
        _BYTES_PER_ENTRY * volume * len(above.mixed),
        "telling which patch is where",
        "patches that begin at multiples of some number of cells take less",
    )
    full = np.repeat(above.full[above.mixed], volume)
    order = np.argsort(pairs[0], kind="stable")  # the last one painted is the finest
    rank, block = pairs[0][order], pairs[1][order]
    start = above.corner[block] * ratio
    low = np.clip(boxes.low[rank] // unit, start, start + ratio)
    high = np.clip(-(-boxes.high[rank] // unit), start, start + ratio)
    which, index = expanded(low, high)
    rank, block = rank[which], block[which]
    local = index.T - start[which]
    entry = block * volume + local[:, 0] + ratio[0] * (local[:, 1] + ratio[1] * local[:, 2])
    if not (boxes.low[pairs[0]] % unit).any() and not (boxes.high[pairs[0]] % unit).any():
        full[entry] = rank  # none is covered partly
        return Painted(full, _NOTHING, _NOTHING.reshape(0, 3)), (_NOTHING, _NOTHING)
    inside = ((boxes.low[rank] <= index.T * unit) & ((index.T + 1) * unit <= boxes.high[rank])).all(
        axis=1
    )
    touch = full.copy()
    full[entry[inside]] = rank[inside]
    touch[entry] = rank
    touch = np.maximum(touch, full)
    mixed = np.flatnonzero(touch > full)
    place = np.full(len(full), -1)
    place[mixed] = np.arange(len(mixed))
    block, inner = np.divmod(mixed, volume)
    corner = above.corner[block] * ratio + unravelled(inner, ratio).T
    needed = (place[entry] >= 0) & (rank > full[entry]) & ~inside
    return Painted(full, mixed, corner), (rank[needed], place[entry[needed]])


def _paint(
    target: np.ndarray, low: np.ndarray, high: np.ndarray, ranks: np.ndarray | None = None
) -> None:
    """Write the rank of each box into the entries inside it, (nz, ny, nx), the last one remaining.

    Small boxes all at once, large ones one by one: that takes 1 ns an entry, where expanding them
    takes 30.
    """
    small, large = _by_size(low, high)
    ranks = np.arange(len(low)) if ranks is None else ranks
    which, (x, y, z) = expanded(low[small], high[small])
    target[z, y, x] = ranks[small[which]]
    for box in large.tolist():
        part = target[_inside(low[box], high[box])]
        np.maximum(part, ranks[box], out=part)


def _beyond(
    full: np.ndarray, low: np.ndarray, high: np.ndarray, ranks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return ranks of boxes, and flat entries in them that none of their rank or above covers."""
    small, large = _by_size(low, high)
    which, (x, y, z) = expanded(low[small], high[small])
    rank = ranks[small[which]]
    seen = full[z, y, x] < rank
    entry = np.ravel_multi_index((z[seen], y[seen], x[seen]), full.shape)
    found = [(rank[seen], entry)]
    for box in large.tolist():
        place = np.nonzero(full[_inside(low[box], high[box])] < ranks[box])
        corner = low[box, ::-1]
        entry = np.ravel_multi_index(
            tuple(p + c for p, c in zip(place, corner, strict=True)), full.shape
        )
        found.append((np.full(len(entry), ranks[box]), entry))
    first, second = zip(*found, strict=True)
    return np.concatenate(first), np.concatenate(second)


def _by_size(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    count = np.maximum(high - low, 0).prod(axis=1)
    return np.flatnonzero((count > 0) & (count <= _LARGE)), np.flatnonzero(count > _LARGE)


def _inside(low: np.ndarray, high: np.ndarray) -> tuple[slice, ...]:
    return tuple(slice(a, b) for a, b in zip(low[::-1].tolist(), high[::-1].tolist(), strict=True))


# Entries of a block along an axis, where there is a choice, and at most.
_WIDE, _WIDEST = 4, 16
# Root entries per cell, at most, and how many are no matter.
_ROOT_SHARE, _ROOT_FREE = 0.125, 1 << 15
# Entries looked at together: temporary arrays stay in the cache.
_SOME = 1 << 16


@dataclass(frozen=True)
class PatchEntries:
    """A tree whose entries name the finest patch that covers them.

    Attributes
    ----------
    units : array of int64, shape (K, 3)
        Sizes of the entries of its levels.
    entries : array of uint32
    starts : array of int64, shape (K + 1,)
        Where the entries of each level start, and where the last ones end.
    bricks : tuple of three int
        How the root is laid out (`tree.Tree`).
    shape : array of int64, shape (3,)
        Number of the root's entries along each axis.
    corners : list of K - 1 arrays of int64, shape (m, 3)
        Where the blocks of the levels below the root begin, in units of their entries.
    """

    units: np.ndarray
    entries: np.ndarray
    starts: np.ndarray
    bricks: tuple[int, ...]
    shape: np.ndarray
    corners: list[np.ndarray]

    def levels(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield sizes and entries of all levels, the root first."""
        for unit, first, last in zip(self.units, self.starts[:-1], self.starts[1:], strict=True):
            yield unit, self.entries[first:last]

    def located(self, level: int, entry: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield entries of a level, some at a time, and where they are: indices (3, n)."""
        # Made again: kept, it would take twice the memory of the entries.
        order = _brick_order(self.shape)[1] if level == 0 else None
        for first in range(0, len(entry), _SOME):
            some = entry[first : first + _SOME]
            if order is not None:
                yield some, unravelled(order[some], self.shape)
                continue
            ratio = self.units[level - 1] // self.units[level]
            block, inner = np.divmod(some, int(ratio.prod()))
            yield some, self.corners[level - 1][block].T + unravelled(inner, ratio)


def patch_entries(boxes: PatchBoxes, extent: np.ndarray, cells: int) -> PatchEntries:
    """Return the tree of patches.

    Parameters
    ----------
    boxes : PatchBoxes
    extent : array of int64, shape (3,)
        Size of the domain in finest units.
    cells : int
        Number of cells of all patches.
    """
    units = _units(boxes, extent, cells)
    shape = -(-extent // units[0])
    painted, pairs = painted_root(boxes, shape, units[0])
    blocks, total, used = [], 0, 1
    corners: list[np.ndarray] = []
    while True:
        words = _words(painted.full, boxes)
        total += len(words)
        if not len(painted.mixed):
            blocks.append(words)
            starts = np.cumsum([0, *(len(b) for b in blocks)])
            bricks, order = _brick_order(shape)
            blocks[0] = blocks[0][order]
            entries = np.concatenate(blocks)
            return PatchEntries(units[:used], entries, starts, bricks, shape, corners)
        ratio = units[used - 1] // units[used]
        words[painted.mixed] = total + int(ratio.prod()) * np.arange(len(painted.mixed))
        blocks.append(words)
        corners.append(painted.corner * ratio)
        painted, pairs = painted_blocks(boxes, painted, pairs, units[used], ratio)
        used += 1
        if total > NONE:
            raise InputError("patches need too many blocks: their corners lie too irregularly")


def _brick_order(shape: np.ndarray) -> tuple[tuple[int, ...], np.ndarray]:
    """Return the bricks of a root, and which of its entries, the first axis fastest, goes where."""
    bricks = tuple(next(b for b in (2, 1, 0) if n % (1 << b) == 0) for n in shape.tolist())
    split = [
        part for n, b in zip(shape[::-1], bricks[::-1], strict=True) for part in (n >> b, 1 << b)
    ]
    order = np.arange(int(shape.prod())).reshape(split)
    return bricks, order.transpose(0, 2, 4, 1, 3, 5).reshape(-1)


def _words(full: np.ndarray, boxes: PatchBoxes) -> np.ndarray:
    """Return entries from the patches, by rank, that cover them; -1 where none does."""
    name = boxes.name[full]
    return np.where(full < 0, ABSENT, PLAIN << NUMBER_BITS | name).astype(np.uint32)


def _units(boxes: PatchBoxes, extent: np.ndarray, cells: int) -> np.ndarray:
    """Return sizes of entries, each dividing the one before, of which the last suffices."""
    chain = [extent.astype(np.int64)]
    for level in range(int(boxes.level[-1]) + 1):
        here = boxes.level == level
        corners = [boxes.low[here], boxes.high[here], chain[-1][None]]
        chain += _steps(chain[-1], np.gcd.reduce(np.concatenate(corners), axis=0))
    chain = _without_wide_steps(chain, extent)
    counts = [np.prod(-(-extent // unit), dtype=float) for unit in chain]
    most = max(_ROOT_FREE, _ROOT_SHARE * cells)
    root = max(k for k, count in enumerate(counts) if k == 0 or count <= most)
    kept = [chain[root]]
    for k in range(root + 1, len(chain)):
        if k + 1 == len(chain) or (kept[-1] // chain[k + 1]).max() > _WIDE:
            kept.append(chain[k])
    return np.array(kept)


def _without_wide_steps(chain: list[np.ndarray], extent: np.ndarray) -> list[np.ndarray]:
    """Return sizes that divide those before, none much smaller, from one as large as the domain on.

    A step that is a large prime would make blocks of its third power of entries. Above such a step
    sizes grow by small factors instead, and the root ends beyond the domain.
    """
    units, exact = [chain[-1]], np.ones(3, bool)
    for unit in chain[-2::-1]:
        exact &= unit // units[-1] <= _WIDEST
        units.append(np.where(exact, unit, _grown(units[-1], extent)))
    while (units[-1] < extent).any():
        units.append(_grown(units[-1], extent))
    return units[::-1]


def _grown(unit: np.ndarray, extent: np.ndarray) -> np.ndarray:
    return np.where(unit < extent, unit * _WIDE, unit)


def _steps(unit: np.ndarray, last: np.ndarray) -> list[np.ndarray]:
    """Return sizes from one (excluded) to another that divides it, in steps that are not wide."""
    steps = []
    while (unit != last).any():
        unit = unit // [_divisor(int(r)) for r in unit // last]
        steps.append(unit)
    return steps


def _divisor(ratio: int) -> int:
    """Return a divisor of a number: the largest up to 4, or the least; itself if all are wide."""
    small = [d for d in range(_WIDE, 1, -1) if ratio % d == 0]
    if ratio == 1 or small:
        return small[0] if small else 1
    return next((d for d in range(_WIDE + 1, _WIDEST + 1) if ratio % d == 0), ratio)
