"""The tree of nodes over nested patches: which patch is the finest one at a place.

Entries of the tree are painted with the patches that cover them, the coarsest first. How small they
must be is known beforehand: all corners of the patches up to some level are multiples of some size,
so none of these patches covers a part of an entry of that size.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from ...memory import check_memory
from .tree import ABSENT, NONE, NUMBER_BITS, PLAIN

# What arrays take at the same time for each entry of nodes.
_BYTES_PER_ENTRY = 32
# Entries of a node along an axis, where there is a choice, and at most.
_WIDE, _WIDEST = 4, 16
# Root entries per cell, at most, and how many are no matter.
_ROOT_SHARE, _ROOT_FREE = 0.125, 1 << 15
# Entries handled together: temporary arrays stay small.
_SOME = 1 << 16


@dataclass(frozen=True)
class PatchBoxes:
    """Patches in the order in which they are painted.

    `low`, `high` (n, 3): their corners in finest units; `level` (n,): ascending; `name` (n,): their
    numbers in the order they were given.
    """

    low: np.ndarray
    high: np.ndarray
    level: np.ndarray
    name: np.ndarray


@dataclass(frozen=True)
class Painted:
    """Entries of one tree level.

    `full` (entries,): the last patch that covers each entry, by rank; -1 where none does; `mixed`
    (m,): entries that a later patch covers partly; `corner` (m, 3): their lower corners in units of
    entries; `rank`, `node` (k,): patches, and the mixed entries (by their place among these) that
    they cover partly.
    """

    full: np.ndarray
    mixed: np.ndarray
    corner: np.ndarray
    rank: np.ndarray
    node: np.ndarray


def _painted_below(
    boxes: PatchBoxes, above: Painted, unit: np.ndarray, ratio: np.ndarray
) -> Painted:
    """Return the nodes of mixed entries: `ratio` entries of size `unit` each."""
    volume = int(ratio.prod())
    check_memory(
        _BYTES_PER_ENTRY * volume * len(above.mixed),
        "telling which patch is where",
        "patches that begin at multiples of some number of cells take less",
    )
    order = np.argsort(above.rank, kind="stable")  # the last one painted is the finest
    ranks, nodes = above.rank[order], above.node[order]
    starts = above.corner[nodes] * ratio
    low = np.clip(boxes.low[ranks] // unit, starts, starts + ratio)
    high = np.clip(-(-boxes.high[ranks] // unit), starts, starts + ratio)
    before = np.cumsum((high - low).prod(axis=1)) // _SOME
    parts = np.split(np.arange(len(ranks)), np.flatnonzero(np.diff(before)) + 1)

    def pieces() -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        for part in parts:
            which, index = expanded(low[part], high[part])
            which, index = part[which], index.T
            rank, (x, y, z) = ranks[which], (index - starts[which]).T
            begins, ends = boxes.low[rank] <= index * unit, (index + 1) * unit <= boxes.high[rank]
            entry = nodes[which] * volume + x + ratio[0] * (y + ratio[1] * z)
            yield rank, entry, (begins & ends).all(axis=1)

    full = np.repeat(above.full[above.mixed], volume)
    touched = np.full_like(full, -1)
    for rank, entry, inside in pieces():
        full[entry[inside]] = rank[inside]
        touched[entry] = rank
    mixed = np.flatnonzero(touched > full)
    place = np.full(len(full) if len(mixed) else 0, -1)
    place[mixed] = np.arange(len(mixed))
    partly: list[tuple[np.ndarray, np.ndarray]] = [(np.zeros(0, np.int64),) * 2]
    for rank, entry, inside in pieces() if len(mixed) else ():
        needed = (rank > full[entry]) & ~inside
        partly.append((rank[needed], place[entry[needed]]))
    node, inner = np.divmod(mixed, volume)
    corner = above.corner[node] * ratio + unravelled(inner, ratio).T
    rank, node = (np.concatenate(part) for part in zip(*partly, strict=True))
    return Painted(full, mixed, corner, rank, node)


@dataclass(frozen=True)
class PatchEntries:
    """A tree whose entries name the finest patch that covers them.

    `units` (K, 3): sizes of the entries of its levels; `entries`; `starts` (K + 1,): where the
    entries of each level start, and where the last ones end; `clusters`: how the root is laid out
    (`tree.Tree`); `shape` (3,): number of the root's entries along each axis; `corners` (m, 3):
    where the nodes of the levels below the root begin, in units of their entries.
    """

    units: np.ndarray
    entries: np.ndarray
    starts: np.ndarray
    clusters: tuple[int, ...]
    shape: np.ndarray
    corners: list[np.ndarray]

    def levels(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield sizes and entries of all levels, the root first."""
        for unit, first, last in zip(self.units, self.starts[:-1], self.starts[1:], strict=True):
            yield unit, self.entries[first:last]

    def located(self, level: int, entry: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield entries of a level, some at a time, and where they are: indices (3, n)."""
        # Made again: stored, it would take twice the memory of the entries.
        order = _cluster_order(self.shape)[1] if level == 0 else None
        for first in range(0, len(entry), _SOME):
            some = entry[first : first + _SOME]
            if order is not None:
                yield some, unravelled(order[some], self.shape)
                continue
            ratio = self.units[level - 1] // self.units[level]
            node, inner = np.divmod(some, int(ratio.prod()))
            yield some, self.corners[level - 1][node].T + unravelled(inner, ratio)


def patch_entries(boxes: PatchBoxes, extent: np.ndarray, cells: int) -> PatchEntries:
    """Return the tree of patches in a domain of some extent, with so many cells in all."""
    units = _units(boxes, extent, cells)
    shape, count = -(-extent // units[0]), len(boxes.name)
    nothing, corner = np.full(1, -1, np.int32), np.zeros((1, 3), np.int64)
    above = Painted(nothing, np.zeros(1, np.int64), corner, np.arange(count), np.zeros(count, int))
    words: list[np.ndarray] = []
    starts, corners = [0], []
    while len(above.mixed):
        ratio = units[len(words) - 1] // units[len(words)] if words else shape
        if words:  # entries that are nodes tell where these start
            words[-1][above.mixed] = starts[-1] + int(ratio.prod()) * np.arange(len(above.mixed))
            corners.append(above.corner * ratio)
        above = _painted_below(boxes, above, units[len(words)], ratio)
        name = PLAIN << NUMBER_BITS | boxes.name[above.full]
        words.append(np.where(above.full < 0, ABSENT, name).astype(np.uint32))
        starts.append(starts[-1] + len(words[-1]))
        if starts[-1] > NONE:
            raise InputError("patches need too many nodes: their corners lie too irregularly")
    clusters, order = _cluster_order(shape)
    words[0] = words[0][order]
    entries = np.concatenate(words)
    return PatchEntries(units[: len(words)], entries, np.array(starts), clusters, shape, corners)


def _cluster_order(shape: np.ndarray) -> tuple[tuple[int, ...], np.ndarray]:
    clusters = tuple(next(b for b in (2, 1, 0) if n % (1 << b) == 0) for n in shape.tolist())
    split = [
        part for n, b in zip(shape[::-1], clusters[::-1], strict=True) for part in (n >> b, 1 << b)
    ]
    order = np.arange(int(shape.prod())).reshape(split)
    return clusters, order.transpose(0, 2, 4, 1, 3, 5).reshape(-1)


def _units(boxes: PatchBoxes, extent: np.ndarray, cells: int) -> np.ndarray:
    chain = [extent.astype(np.int64)]
    for level in range(int(boxes.level[-1]) + 1):
        here = boxes.level == level
        corners = [boxes.low[here], boxes.high[here], chain[-1][None]]
        last = np.gcd.reduce(np.concatenate(corners), axis=0)
        while (chain[-1] != last).any():
            parts = np.array([_divisor(int(r)) for r in chain[-1] // last])
            chain.append(chain[-1] // parts)
    chain = _without_wide_steps(chain, extent)
    most = max(_ROOT_FREE, _ROOT_SHARE * cells)
    fits = [np.prod(-(-extent // unit), dtype=float) <= most for unit in chain]
    root = max(k for k, fit in enumerate(fits) if k == 0 or fit)
    units = [chain[root]]
    for k in range(root + 1, len(chain)):
        if k + 1 == len(chain) or (units[-1] // chain[k + 1]).max() > _WIDE:
            units.append(chain[k])
    return np.array(units)


def _without_wide_steps(chain: list[np.ndarray], extent: np.ndarray) -> list[np.ndarray]:
    """Return sizes that divide those before, none much smaller, from one as large as the domain on.

    A step that is a large prime would make nodes of its third power of entries. Above such a step
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


def _divisor(ratio: int) -> int:
    """Return a divisor of a number: the largest up to 4, or the least; itself if all are wide."""
    order = (*range(_WIDE, 1, -1), *range(_WIDE + 1, _WIDEST + 1))
    return next((d for d in order if ratio % d == 0), ratio)


def expanded(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return all cells of boxes: which box (m,) and which indices (3, m), the first one fastest.

    Layer by layer, row by row: no cell's index needs a division (a third of the time).
    """
    size = np.maximum(high - low, 0)
    box = np.arange(len(low))
    found: list[np.ndarray] = []
    for axis in (2, 1, 0):
        count = size[box, axis]
        index = np.arange(int(count.sum())) + np.repeat(low[box, axis] - _starts(count), count)
        found = [np.repeat(f, count) for f in found]
        box = np.repeat(box, count)
        found.append(index)
    return box, np.stack(found[::-1])


def _starts(count: np.ndarray) -> np.ndarray:
    starts: np.ndarray = np.cumsum(count) - count
    return starts


def unravelled(flat: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Return indices (3, n) from flat ones, of which the first axis runs fastest."""
    return np.stack(np.unravel_index(flat, tuple(shape[::-1]))[::-1])
