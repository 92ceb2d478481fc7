"""Depth-first order of an octree: from split flags to the levels of its leaves, and back.

The levels of the leaves, in depth-first order, are all there is to know of a tree. No loop here
goes over its cells, only over its levels.
"""

from __future__ import annotations

import numpy as np

from ...errors import InputError
from .octree_places import Places

DEEPEST = 30


def levels_from_flags(flags: np.ndarray, bases: int, children: int) -> np.ndarray:
    """Return the levels of all leaves from depth-first split flags.

    Nodes that have nothing but leaves below them are folded into leaves until all are, and then
    unfolded again: as many passes as there are levels.

    Parameters
    ----------
    flags : array of uint8, shape (n,)
        1 where a node is split, 0 where it is a leaf.
    bases : int
        Number of base cells.
    children : int
        Number of nodes a node is split into.

    Raises
    ------
    InputError
        If the flags are too few, too many, or the tree is deeper than 30 levels.
    """
    ones = int(np.count_nonzero(flags))
    _check_count(len(flags), bases, ones, children)
    word, folds = flags.astype(bool), []
    while ones:
        word, folded = _fold(word, children)
        if len(folded) == 0:
            raise _misplaced(flags, bases, children)
        folds.append(folded)
        ones -= len(folded)
    if len(folds) > DEEPEST:
        raise InputError(f"the tree is {len(folds)} levels deep; at most {DEEPEST} are possible")
    levels = np.zeros(bases, np.uint8)
    for folded in reversed(folds):
        levels = _unfold(levels, folded, children)
    return levels[flags == 0] if folds else levels


def _check_count(count: int, bases: int, ones: int, children: int) -> None:
    expected = bases + children * ones
    if count != expected:
        raise InputError(
            f"refined has too {'few' if count < expected else 'many'} flags: {bases} base cells "
            f"and {ones} splits into {children} make {expected} nodes, got {count} flags"
        )


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


def _misplaced(flags: np.ndarray, bases: int, children: int) -> InputError:
    """Return the error for flags of the right number in an order that is no tree."""
    missing = bases + np.cumsum(children * flags.astype(np.int64) - 1)
    end = int(np.flatnonzero(missing <= 0)[0]) + 1
    return InputError(
        f"refined does not describe {bases} base cells: all of them are complete after {end} "
        f"flags, but {len(flags) - end} more follow"
    )


def split_levels(levels: np.ndarray, where: np.ndarray, children: int) -> np.ndarray:
    """Return the levels of all leaves once some of them, told by booleans, are split."""
    split: np.ndarray = levels + where.astype(np.uint8)
    return np.repeat(split, np.where(where, children, 1))


def merged(
    places: Places, number: np.ndarray, children: int, none: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return levels and numbers of leaves once siblings numbered `none` are merged, all that can.

    Parameters
    ----------
    places : Places
        Of all leaves.
    number : array of int64, shape (leaves,)
    children : int
        How many siblings there are.
    none : int
        The number of leaves that may be merged, if all their siblings may.
    """
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
