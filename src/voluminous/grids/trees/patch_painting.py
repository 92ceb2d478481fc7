"""Entries of a tree painted with the patches that cover them, the finest last.

Where a finer patch touches an entry but does not cover it, a block of smaller entries is painted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...memory import check_memory
from ..boxes import expanded, unravelled

# Patches that touch more entries are painted one by one, the others all at once.
_LARGE = 1 << 7
# What arrays take at the same time for each entry of blocks.
_BYTES_PER_ENTRY = 32


@dataclass(frozen=True)
class Boxes:
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


def painted_root(boxes: Boxes, shape: np.ndarray, unit: np.ndarray) -> tuple[Painted, Pairs]:
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
    boxes: Boxes, above: Painted, pairs: Pairs, unit: np.ndarray, ratio: np.ndarray
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
