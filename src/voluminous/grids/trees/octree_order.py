"""Where the leaves of an octree begin, in depth-first order.

Leaves fill the base cells one after the other, so the places where they begin are a running sum of
their sizes: a number with one digit per level, three bits each, which is kept in words of ten
digits so that trees may be thirty levels deep.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...errors import InputError
from ..arguments import as_array

DEEPEST = 30
# Levels that share a word of a place: three axes times ten bits, and room for sums over a part.
_LEVELS_PER_WORD = 10
_PART = 1 << 16


# Masks of ten bits: groups of 1, 2, 4, 8 and 16 of them, which begin n times a group apart.
_EVERY = {
    n: [
        sum(1 << (bit // group * group * n + bit % group) for bit in range(_LEVELS_PER_WORD))
        for group in (1, 2, 4, 8, 16)
    ]
    for n in (1, 2, 3)
}


@dataclass(frozen=True)
class Places:
    """Where leaves begin, from their levels.

    `levels`: levels of all leaves, in depth-first order; `axes`: the axes that are halved, the one
    whose halves come first (x) first.
    """

    levels: np.ndarray
    axes: tuple[int, ...] = (0, 1, 2)

    @cached_property
    def deepest(self) -> int:
        """Highest level."""
        return int(self.levels.max(initial=0))

    @property
    def words(self) -> int:
        """Number of words of digits below the base cell's number."""
        return -(-self.deepest // _LEVELS_PER_WORD)

    @cached_property
    def _sizes(self) -> np.ndarray:
        bits = len(self.axes)
        sizes = np.zeros((self.words + 1, self.deepest + 1), np.int64)
        for level in range(self.deepest + 1):
            word = -(-level // _LEVELS_PER_WORD)
            sizes[word, level] = 1 << bits * (word * _LEVELS_PER_WORD - level)
        return sizes

    @cached_property
    def _starts(self) -> np.ndarray:
        sums = [
            [self._sizes[:, self.levels[k : k + _PART]].sum(axis=1)]
            for k in range(0, len(self.levels), _PART)
        ]
        starts = np.concatenate([np.zeros((1, self.words + 1), np.int64), *sums])
        total = np.zeros(self.words + 1, np.int64)
        for row in starts:  # carried each time: sums over all parts do not fit
            total = _carried((total + row)[:, None], len(self.axes))[:, 0]
            row[:] = total
        return np.asarray(starts.T)

    def total(self) -> tuple[int, bool]:
        """Return how many base cells the leaves fill, and whether the last one entirely."""
        end = self._starts[:, -1]
        return int(end[0]), not end[1:].any()

    def parts(self, first: int = 0, last: int | None = None) -> Iterator[tuple[slice, np.ndarray]]:
        """Yield slices of leaves, and the words (words + 1, n) of the places where they begin."""
        last = len(self.levels) if last is None else last
        for k in range(first // _PART, -(-last // _PART)):
            begin, end = k * _PART, min((k + 1) * _PART, last)
            steps = self._sizes[:, self.levels[begin : end - 1]]
            words = np.empty((len(steps), end - begin), np.int64)
            words[:, :1] = self._starts[:, k : k + 1]
            np.cumsum(steps, axis=1, out=words[:, 1:])
            words[:, 1:] += words[:, :1]
            skip = max(first - begin, 0)
            yield slice(begin + skip, end), _carried(words, len(self.axes))[:, skip:]

    def aligned_levels(self) -> np.ndarray:
        """Return for each leaf the lowest level of a node that begins where the leaf does."""
        aligned = np.zeros(len(self.levels), np.uint8)
        for part, words in self.parts():
            for number, word in enumerate(words[1:], start=1):
                # The exponent of the lowest bit set tells the digit it is in.
                _, exponent = np.frexp((word & -word).astype(np.float64))
                level = number * _LEVELS_PER_WORD - (exponent - 1) // len(self.axes)
                aligned[part] = np.where(word > 0, level, aligned[part])
        return aligned

    def corners(self, first: int = 0, last: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return base numbers (n,), and lower corners (3, n) in units of the finest level there."""
        last = len(self.levels) if last is None else last
        base = np.empty(last - first, np.int64)
        corner = np.zeros((3, last - first), np.int64)
        for part, words in self.parts(first, last):
            here = slice(part.start - first, part.stop - first)
            base[here] = words[0]
            for k, axis in enumerate(self.axes):
                for word in words[1:]:
                    digits = _every_nth_bit(word >> k, len(self.axes))
                    corner[axis, here] = (corner[axis, here] << _LEVELS_PER_WORD) | digits
        corner[list(self.axes)] >>= self.words * _LEVELS_PER_WORD - self.deepest
        return base, corner

    def boxes(
        self, counts: tuple[int, ...], first: int, last: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return lower corners and sizes of leaves in finest units, int64 (3, n).

        Base cells, of which there are so many along each axis, are numbered with x fastest.
        """
        base, corner = self.corners(first, last)
        size = np.ones_like(corner)
        size[list(self.axes)] <<= self.deepest - self.levels[first:last].astype(np.int64)
        index = base % counts[0], base // counts[0] % counts[1], base // (counts[0] * counts[1])
        for axis, i in enumerate(index):
            corner[axis] += i << self.deepest if axis in self.axes else i
        return corner, size


def _carried(words: np.ndarray, bits: int) -> np.ndarray:
    full = bits * _LEVELS_PER_WORD
    for k in range(len(words) - 1, 0, -1):
        words[k - 1] += words[k] >> full
        words[k] &= (1 << full) - 1
    return words


def _every_nth_bit(v: np.ndarray, n: int) -> np.ndarray:
    """Return ten bits that lie n bits apart, moved together: by twos, fours, eights and all."""
    gathered = v & _EVERY[n][0]
    for together, mask in zip((1, 2, 4, 8), _EVERY[n][1:], strict=True):
        gathered |= gathered >> together * (n - 1)
        gathered &= mask
    return gathered


def spread_bits(v: np.ndarray, n: int) -> np.ndarray:
    """Return the ten bits of numbers moved n bits apart: the inverse of gathering every n-th."""
    spread = v & _EVERY[n][-1]
    for together, mask in zip((8, 4, 2, 1), _EVERY[n][-2::-1], strict=True):
        spread |= spread << together * (n - 1)
        spread &= mask
    return spread


def interleaved(corner: np.ndarray, deepest: int) -> np.ndarray:
    """Return the words of places below the base cell's number, from corners (3, n) in it.

    The inverse of `Places.corners`, for trees whose three axes are halved.
    """
    words = -(-deepest // _LEVELS_PER_WORD)
    corner = corner << (words * _LEVELS_PER_WORD - deepest)
    found = np.zeros((words, corner.shape[1]), np.int64)
    for number, word in enumerate(found):
        digits = corner >> ((words - 1 - number) * _LEVELS_PER_WORD)
        for axis in range(3):
            word |= spread_bits(digits[axis] & 0x3FF, 3) << axis
    return found


def levels_from_flags(flags: np.ndarray, bases: int, children: int) -> np.ndarray:
    """Return the levels of all leaves from depth-first split flags.

    Nodes that have nothing but leaves below them are folded into leaves until all are, and then
    unfolded again: as many passes as there are levels.
    """
    ones = int(np.count_nonzero(flags))
    expected = bases + children * ones
    if len(flags) != expected:
        raise InputError(
            f"refined has too {'few' if len(flags) < expected else 'many'} flags: {bases} base "
            f"cells and {ones} splits into {children} make {expected} nodes, got {len(flags)} flags"
        )
    word, folds = flags.astype(bool), []
    while ones:
        word, folded = _fold(word, children)
        if len(folded) == 0:  # of the right number, in an order that is no tree
            missing = bases + np.cumsum(children * flags.astype(np.int64) - 1)
            end = int(np.flatnonzero(missing <= 0)[0]) + 1
            raise InputError(
                f"refined does not describe {bases} base cells: all of them are complete after "
                f"{end} flags, but {len(flags) - end} more follow"
            )
        folds.append(folded)
        ones -= len(folded)
    if len(folds) > DEEPEST:
        raise InputError(f"the tree is {len(folds)} levels deep; at most {DEEPEST} are possible")
    levels = np.zeros(bases, np.uint8)
    for folded in reversed(folds):
        levels = _unfold(levels, folded, children)
    return levels[flags == 0] if folds else levels


def _fold(word: np.ndarray, children: int) -> tuple[np.ndarray, np.ndarray]:
    """Fold nodes with leaves only; return the shorter word, and where in it they are."""
    split = np.flatnonzero(word)
    gap = np.diff(split, append=len(word))
    found = split[gap > children]  # the leaves that follow a split node at once are its children
    keep = np.ones(len(word), bool)
    for k in range(1, children + 1):
        keep[found + k] = False
    word = word.copy()
    word[found] = False
    return word[keep], found - children * np.arange(len(found))


def _unfold(levels: np.ndarray, folded: np.ndarray, children: int) -> np.ndarray:
    """Return the levels of all nodes once `children` leaves follow each of those folded before."""
    counts = np.ones(len(levels), np.int64)
    counts[folded] += children
    longer = np.repeat(levels, counts)
    place = folded + children * np.arange(len(folded))
    for k in range(1, children + 1):
        longer[place + k] += 1
    return longer


def split_levels(levels: np.ndarray, where: np.ndarray, children: int) -> np.ndarray:
    """Return the levels of all leaves once some of them, told by booleans, are split."""
    split: np.ndarray = levels + where.astype(np.uint8)
    return np.repeat(split, np.where(where, children, 1))


def merged(
    places: Places, number: np.ndarray, children: int, none: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return levels and numbers of leaves once all siblings numbered `none` are merged."""
    level, aligned = places.levels.copy(), places.aligned_levels()
    for deep in range(places.deepest, 0, -1):
        mergeable = (level == deep) & (number == none)
        before = np.concatenate([[0], np.cumsum(mergeable)])
        first = np.flatnonzero(mergeable & (aligned < deep))
        first = first[first + children <= len(level)]
        first = first[before[first + children] - before[first] == children]
        level[first] = deep - 1
        keep = np.ones(len(level), bool)
        for k in range(1, children):
            keep[first + k] = False
        level, number, aligned = level[keep], number[keep], aligned[keep]
    return level, number


def flags_from_levels(levels: np.ndarray, places: Places) -> np.ndarray:
    """Return the depth-first split flags of a tree: the inverse of `levels_from_flags`.

    A leaf that begins where a node of level a begins, and none of a lower level, is met after
    the splits of the nodes of levels a to its own.
    """
    opened = levels - places.aligned_levels()
    flags = np.ones(len(levels) + int(opened.sum(dtype=np.int64)), np.uint8)
    flags[np.cumsum(opened.astype(np.int64) + 1) - 1] = 0
    return flags


def checked_flags(refined: Any) -> np.ndarray:
    """Return split flags as uint8; refuse what is neither 0 nor 1."""
    flags = as_array(refined, "refined")
    if flags.ndim != 1 or flags.dtype.kind not in "biuf":
        raise InputError(
            f"refined must be a 1-D array of 0 and 1, got {flags.dtype} of shape {flags.shape}"
        )
    if flags.dtype.kind != "b":
        bad = np.flatnonzero((flags != 0) & (flags != 1))
        if len(bad):
            raise InputError(f"refined must be 0 or 1; flag {bad[0]} is {flags[bad[0]]}")
    return flags.astype(np.uint8)


def checked_levels(level: Any) -> np.ndarray:
    """Return levels as uint8; refuse what cannot be levels."""
    levels = as_array(level, "levels")
    if levels.ndim != 1 or levels.dtype.kind not in "iu" or len(levels) == 0:
        raise InputError(
            f"levels must be a 1-D array of integers, got {levels.dtype} of shape {levels.shape}"
        )
    bad = np.flatnonzero((levels < 0) | (levels > DEEPEST))
    if len(bad):
        raise InputError(
            f"levels must be between 0 and {DEEPEST}; that of leaf {bad[0]} is {levels[bad[0]]}"
        )
    return levels.astype(np.uint8)


def checked_choice(where: Any, count: int, what: str) -> np.ndarray:
    """Return which of so many leaves are chosen; numbers that are 0 or 1 are booleans."""
    chosen = as_array(where, what)
    if chosen.dtype != bool and np.isin(chosen, (0, 1)).all():  # what `Volume.evaluate` gives
        chosen = chosen.astype(bool)
    if chosen.shape != (count,) or chosen.dtype != bool:
        raise InputError(
            f"{what} must be {count} booleans, one per leaf, got {chosen.dtype} of shape "
            f"{chosen.shape}"
        )
    return chosen


def levels_of_leaves(
    counts: tuple[int, ...], level: Any, index: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return the levels of leaves in depth-first order, and that order."""
    levels = checked_levels(level)
    index = _checked_index(counts, levels, index)
    deepest = int(levels.max())
    corner = index.T << (deepest - levels.astype(np.int64))
    base = corner >> deepest
    number = base[0] + counts[0] * (base[1] + counts[1] * base[2])
    words = interleaved(corner & ((1 << deepest) - 1), deepest)
    order = np.lexsort((*reversed(words), number))
    _check_cover(counts, levels, order, np.stack([number, *words])[:, order])
    return levels[order], order


def _checked_index(counts: tuple[int, ...], levels: np.ndarray, index: Any) -> np.ndarray:
    index = as_array(index, "index")
    if index.shape != (len(levels), 3) or index.dtype.kind not in "iu":
        raise InputError(
            f"index must be integers of shape ({len(levels)}, 3), got {index.dtype} of shape "
            f"{index.shape}"
        )
    index = index.astype(np.int64)
    end = np.array(counts) << levels.astype(np.int64)[:, None]
    bad = np.flatnonzero(((index < 0) | (index >= end)).any(axis=1))
    if len(bad):
        k = bad[0]
        raise InputError(
            f"leaf {k} is outside the domain: its index {index[k].tolist()} at level {levels[k]} "
            f"must be below {end[k].tolist()}"
        )
    return np.asarray(index)


def _check_cover(
    counts: tuple[int, ...], levels: np.ndarray, order: np.ndarray, words: np.ndarray
) -> None:
    places = Places(levels[order])
    hint = "; levels count from the base cells, which are 0" if levels.min() > 0 else ""
    for part, expected in places.parts():
        wrong = np.flatnonzero((words[:, part] != expected).any(axis=0))
        if not len(wrong):
            continue
        k = part.start + int(wrong[0])
        own = f"leaf {order[k]} (level {levels[order[k]]})"
        if tuple(words[:, k]) < tuple(expected[:, wrong[0]]):
            before = order[k - 1]
            raise InputError(f"{own} overlaps leaf {before} (level {levels[before]})")
        where = f"leaf {order[k - 1]}" if k else "the beginning of the domain"
        raise InputError(f"leaves leave a hole: between {where} and {own}, depth first{hint}")
    cells, _ = places.total()
    if cells < np.prod(counts):
        raise InputError(
            "leaves leave a hole: nothing fills the domain from base cell "
            f"{cells} (x fastest) on{hint}"
        )
