"""What users tell of octrees, checked; leaves in any order are sorted depth first."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import InputError
from .inputs import as_array
from .octree_order import DEEPEST
from .octree_places import Places, interleaved


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


def checked_deepest(levels: Any) -> int:
    """Return a deepest level; refuse what cannot be one."""
    if not isinstance(levels, (int, np.integer)) or not 0 <= levels <= DEEPEST:
        raise InputError(f"levels must be a whole number from 0 to {DEEPEST}, got {levels!r}")
    return int(levels)


def checked_choice(where: Any, count: int, what: str) -> np.ndarray:
    """Return which of so many leaves are chosen; numbers that are 0 or 1 are booleans.

    Raises
    ------
    InputError
        If there are other numbers, or more or fewer than leaves.
    """
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
    """Return the levels of leaves in depth-first order, and that order.

    Parameters
    ----------
    counts : three int
        Number of base cells along each axis.
    level : array_like of int, shape (n,)
    index : array_like of int, shape (n, 3)
        Which cell of its level each leaf is.
    """
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
    return index


def _check_cover(
    counts: tuple[int, ...], levels: np.ndarray, order: np.ndarray, words: np.ndarray
) -> None:
    """Refuse leaves that do not begin where the one before them ends, the last one included."""
    places = Places(levels[order])
    for part, expected in places.parts():
        wrong = np.flatnonzero((words[:, part] != expected).any(axis=0))
        if len(wrong):
            k = int(wrong[0])
            raise _uncovered(levels, order, part.start + k, words[:, part][:, k], expected[:, k])
    cells, _ = places.total()
    if cells < np.prod(counts):
        raise InputError(
            f"leaves leave a hole: nothing fills the domain from base cell {cells} (x fastest) on"
            f"{'; levels count from the base cells, which are 0' if levels.min() > 0 else ''}"
        )


def _uncovered(
    levels: np.ndarray, order: np.ndarray, k: int, place: np.ndarray, expected: np.ndarray
) -> InputError:
    leaf, before = order[k], order[k - 1] if k else None
    own = f"leaf {leaf} (level {levels[leaf]})"
    if tuple(place) < tuple(expected):
        return InputError(f"{own} overlaps leaf {before} (level {levels[order[k - 1]]})")
    where = "the beginning of the domain" if before is None else f"leaf {before}"
    hint = "; levels count from the base cells, which are 0" if levels.min() > 0 else ""
    return InputError(f"leaves leave a hole: between {where} and {own}, depth first{hint}")
