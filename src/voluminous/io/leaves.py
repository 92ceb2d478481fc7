"""Trees of any geometry from unordered leaves that need not fill the domain."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from ..grids.trees.octree_order import DEEPEST, Places, flags_from_levels, interleaved
from .contract import UnitLike

# Index that marks a cell without a leaf in the data.
ABSENT = -1


def tree_of_leaves(
    kind: Any, edges: Any, level: np.ndarray, index: np.ndarray, axes: Any, *, unit: UnitLike = None
) -> tuple[Any, np.ndarray]:
    """Return a grid of unordered leaves, and the index of the leaf for each of its cells."""
    counts = np.array([len(e) - 1 for e in edges])
    level, index = np.asarray(level, np.int64), np.asarray(index, np.int64)
    if len(level) == 0 or level.max() > DEEPEST or level.min() < 0:
        raise InputError(f"leaves must have levels from 0 to {DEEPEST}")
    source = np.arange(len(level))
    halved = _halved_axes(kind, edges, unit)
    for axis in sorted(set(halved) - set(axes)):
        level, index, source = _repeated(level, index, source, axis)
    if set(axes) - set(halved):
        raise InputError("an axis with a single cell that closes upon itself cannot be halved")
    empty_level, empty_index = _fillers(counts, level, index, halved)
    level = np.concatenate([level, empty_level])
    index = np.concatenate([index, empty_index])
    source = np.concatenate([source, np.full(len(empty_level), ABSENT)])
    grid, order = _tree(kind, edges, level, index, halved, unit)
    return grid, source[order]


def placed_values(values: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Return a field in grid order; cells without a leaf get NaN, or 0 for integer fields."""
    found: np.ndarray = values[source]
    absent = source == ABSENT
    if absent.any():
        found[absent] = np.nan if found.dtype.kind == "f" else 0
    return found


def _halved_axes(kind: Any, edges: Any, unit: UnitLike) -> tuple[int, ...]:
    """Return the axes that the grid refines: all but periodic axes of one cell."""
    if hasattr(kind, "from_leaves"):
        return (0, 1, 2)
    base = int(np.prod([len(e) - 1 for e in edges]))
    axes: tuple[int, ...] = kind(*edges, refined=np.zeros(base, np.uint8), unit=unit).places.axes
    return axes


def _repeated(
    level: np.ndarray, index: np.ndarray, source: np.ndarray, axis: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Split leaves along an axis that the data do not refine, into cells of their level."""
    parts = 1 << level
    which = np.repeat(np.arange(len(level)), parts)
    first = np.cumsum(parts) - parts
    index = index[which]
    index[:, axis] = index[:, axis] * parts[which] + np.arange(len(which)) - first[which]
    return level[which], index, source[which]


def _fillers(
    counts: np.ndarray, level: np.ndarray, index: np.ndarray, axes: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return levels and indices of the largest cells that fill the gaps between leaves."""
    found: list[tuple[int, np.ndarray]] = []
    if not _is_full(counts, level, len(axes)):
        nodes = np.zeros((0, 3), np.int64)
        for depth in range(int(level.max()), 0, -1):
            here, _ = _distinct(np.concatenate([nodes, index[level == depth]]))
            nodes = here.copy()
            nodes[:, axes] >>= 1
            nodes, _ = _distinct(nodes)
            found.append((depth, _lacking(_children(nodes, axes), here)))
        base = np.moveaxis(np.indices(counts.tolist()), 0, -1).reshape(-1, 3)
        here, _ = _distinct(np.concatenate([nodes, index[level == 0]]))
        found.append((0, _lacking(base, here)))
    levels = [np.full(len(cells), depth) for depth, cells in found]
    none = np.zeros((0, 3), np.int64)
    return np.concatenate([none[:, 0], *levels]), np.concatenate([none, *(c for _, c in found)])


def _is_full(counts: np.ndarray, level: np.ndarray, bits: int) -> bool:
    deepest = int(level.max())
    per_level = np.bincount(level).tolist()  # Python's integers do not overflow
    filled = sum(n << bits * (deepest - depth) for depth, n in enumerate(per_level))
    return bool(filled == int(np.prod(counts.astype(object))) << bits * deepest)


def _children(nodes: np.ndarray, axes: tuple[int, ...]) -> np.ndarray:
    corners = np.zeros((1 << len(axes), 3), np.int64)
    for bit, axis in enumerate(axes):
        corners[:, axis] = np.arange(len(corners)) >> bit & 1
    doubled = nodes.copy()
    doubled[:, axes] <<= 1
    children: np.ndarray = (doubled[:, None] + corners).reshape(-1, 3)
    return children


def _lacking(cells: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Return the cells that are not in `present`, a subset of `cells`."""
    distinct, count = _distinct(np.concatenate([cells, present]))
    return distinct[count == 1]


def _distinct(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distinct rows and their counts; `numpy.unique` takes three times as long."""
    rows = rows[np.lexsort(rows.T)]
    new = np.append(True, (np.diff(rows, axis=0) != 0).any(axis=1))[: len(rows)]
    starts = np.flatnonzero(new)
    return rows[starts], np.diff(starts, append=len(rows))


def _tree(
    kind: Any,
    edges: Any,
    level: np.ndarray,
    index: np.ndarray,
    axes: tuple[int, ...],
    unit: UnitLike,
) -> tuple[Any, np.ndarray]:
    if hasattr(kind, "from_leaves"):
        found: tuple[Any, np.ndarray] = kind.from_leaves(*edges, level, index, unit=unit)
        return found
    counts = [len(e) - 1 for e in edges]
    deepest = int(level.max())
    corner, base = np.zeros_like(index.T), index.T.copy()
    for axis in axes:
        place = index[:, axis] << (deepest - level)
        base[axis], corner[axis] = place >> deepest, place & ((1 << deepest) - 1)
    number = base[0] + counts[0] * (base[1] + counts[1] * base[2])
    words = interleaved(corner, deepest)
    order = np.lexsort((*reversed(words), number))
    levels = level[order].astype(np.uint8)
    flags = flags_from_levels(levels, Places(levels, axes))
    grid = kind(*edges, refined=flags, unit=unit)
    if grid.size != len(level):
        raise InputError(f"leaves overlap: {len(level)} leaves make a tree of {grid.size}")
    return grid, order
