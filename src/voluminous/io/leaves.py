"""Grids of any geometry from blocks of cells, or from unordered leaves."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from ..errors import InputError
from ..grids import CartesianGrid, CylindricalGrid, PatchGrid, SphericalGrid
from ..grids.trees.octree_order import DEEPEST, Places, flags_from_levels, interleaved
from .contract import UnitLike

if TYPE_CHECKING:
    from ..grids.contract import Grid

GRIDS: dict[str, Callable[..., Grid]] = {
    "cartesian": CartesianGrid,
    "spherical": SphericalGrid,
    "cylindrical": CylindricalGrid,
}
# Index that marks a cell without a leaf in the data.
ABSENT = -1
Edges: TypeAlias = Sequence[np.ndarray]
# Makes a field of one array [i1, i2, i3] per block, in the order of the blocks.
Arrange: TypeAlias = Callable[[Iterable[np.ndarray]], Any]


def grid_of_blocks(
    kind: Callable[..., Grid],
    edges: Edges,
    level: np.ndarray,
    low: np.ndarray,
    shape: np.ndarray,
    ratio: Any = 2,
    *,
    unit: UnitLike = None,
) -> tuple[Grid, Arrange]:
    """Return the grid of blocks of cells, and a function that makes fields of one array per block.

    Blocks of one level make a regular grid. Blocks of several levels make patches, or a tree in
    curvilinear coordinates; finer blocks cover coarser ones. Parameters are those of
    `PatchGrid.from_boxes`; `edges` are the walls of the cells of level 0, and `ratio` may be three
    numbers for all levels.
    """
    counts = [len(e) - 1 for e in edges]
    if not level.any():
        return kind(*edges, unit=unit), lambda blocks: _joined(blocks, low, tuple(counts))
    ratio = np.broadcast_to(ratio, (level.max(), 3)) if np.ndim(ratio) < 2 else ratio
    if kind is CartesianGrid:
        x, y, z = edges
        return PatchGrid.from_boxes(x, y, z, level, low, shape, ratio, unit=unit), list
    x, y, z = (np.arange(n + 1.0) for n in counts)
    cells = PatchGrid.from_boxes(x, y, z, level, low, shape, ratio)  # tells which ones are covered
    first, size = cells.boxes(0, cells.size)
    tree, source = tree_of_leaves(kind, edges, cells.levels, (first // size).T, ratio, unit=unit)
    return tree, lambda blocks: placed_values(cells.pack(list(blocks)), source)


def _joined(blocks: Iterable[np.ndarray], low: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    whole: np.ndarray | None = None
    for first, block in zip(low.tolist(), blocks, strict=True):
        if block.shape == shape:
            return block
        if whole is None:
            whole = np.full(shape, np.nan if block.dtype.kind == "f" else 0, block.dtype)
        x, y, z = (slice(a, a + n) for a, n in zip(first, block.shape, strict=True))
        whole[x, y, z] = block
    assert whole is not None
    return whole


def tree_of_leaves(
    kind: Callable[..., Any],
    edges: Edges,
    level: Any,
    index: Any,
    ratio: Any = 2,
    *,
    unit: UnitLike = None,
) -> tuple[Grid, np.ndarray]:
    """Return a tree of unordered leaves, and the index of the leaf for each of its cells.

    Gaps between leaves are filled with cells, the largest that fit, without a leaf (`ABSENT`).
    `ratio` has the number of cells of each level that make one of the level before: 1 or 2.
    """
    counts = np.array([len(e) - 1 for e in edges])
    level, index = np.asarray(level, np.int64), np.asarray(index, np.int64)
    if len(level) == 0 or level.max() > DEEPEST or level.min() < 0:
        raise InputError(f"leaves must have levels from 0 to {DEEPEST}")
    ratios = np.broadcast_to(ratio, np.broadcast_shapes(np.shape(ratio), (1, 3)))
    split = (ratios == 2).all(axis=0)
    if (ratios != np.where(split, 2, 1)).any():
        raise InputError(
            "refined cells in these coordinates must be halves of the coarser ones, along the same "
            f"axes; the ratios of levels are {ratios.tolist()}"
        )
    # A grid does not refine periodic axes of one cell: a small one tells which these are.
    small = [e[-3:] for e in edges]
    flags = np.zeros(np.prod([len(e) - 1 for e in small]), np.uint8)
    axes: tuple[int, ...] = kind(*small, refined=flags, unit=unit).places.axes
    source = np.arange(len(level))
    for axis in axes:
        if not split[axis]:  # the data do not refine it, the grid does: cut into cells of the level
            parts = 1 << level
            starts = np.repeat(np.cumsum(parts) - parts, parts)
            level, index, source = (np.repeat(a, parts, axis=0) for a in (level, index, source))
            index[:, axis] = (index[:, axis] << level) + np.arange(len(level)) - starts
    if split[[a for a in range(3) if a not in axes]].any() and level.any():
        raise InputError("an axis with a single cell that closes upon itself cannot be halved")
    empty_level, empty_index = _fillers(counts, level, index, axes)
    level, index = np.concatenate([level, empty_level]), np.concatenate([index, empty_index])
    source = np.concatenate([source, np.full(len(empty_level), ABSENT)])
    deepest = int(level.max())
    corner, base = np.zeros_like(index.T), index.T.copy()
    for axis in axes:
        place = index[:, axis] << (deepest - level)
        base[axis], corner[axis] = place >> deepest, place & ((1 << deepest) - 1)
    number = base[0] + counts[0] * (base[1] + counts[1] * base[2])
    order = np.lexsort((*reversed(interleaved(corner, deepest)), number))
    levels = level[order].astype(np.uint8)
    grid = kind(*edges, refined=flags_from_levels(levels, Places(levels, axes)), unit=unit)
    if grid.size != len(level):
        raise InputError(f"leaves overlap: {len(level)} leaves make a tree of {grid.size}")
    return grid, source[order]


def placed_values(values: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Return a field in grid order; cells without a leaf get NaN, or 0 for integer fields."""
    placed: np.ndarray = values[source]
    placed[source == ABSENT] = np.nan if placed.dtype.kind == "f" else 0
    return placed


def _fillers(
    counts: np.ndarray, level: np.ndarray, index: np.ndarray, axes: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    bits, deepest = len(axes), int(level.max())
    per_level = np.bincount(level).tolist()  # Python's integers do not overflow
    filled = sum(n << bits * (deepest - depth) for depth, n in enumerate(per_level))
    nodes = np.zeros((0, 3), np.int64)
    if filled == int(counts.prod()) << bits * deepest:
        return nodes[:, 0], nodes
    corners = np.zeros((1 << bits, 3), np.int64)
    corners[:, axes] = np.arange(1 << bits)[:, None] >> np.arange(bits) & 1
    levels, indices = [], []
    for depth in range(deepest, -1, -1):
        present, _ = _distinct(np.concatenate([nodes, index[level == depth]]))
        if depth:
            nodes = present.copy()
            nodes[:, axes] >>= 1
            nodes, _ = _distinct(nodes)
            first = nodes.copy()
            first[:, axes] <<= 1
            cells = (first[:, None] + corners).reshape(-1, 3)
        else:
            cells = np.moveaxis(np.indices(counts.tolist()), 0, -1).reshape(-1, 3)
        distinct, count = _distinct(np.concatenate([cells, present]))
        indices.append(distinct[count == 1])
        levels.append(np.full(len(indices[-1]), depth))
    return np.concatenate(levels), np.concatenate(indices)


def _distinct(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distinct rows and their counts; `numpy.unique` takes three times as long."""
    rows = rows[np.lexsort(rows.T)]
    new = np.append(True, (np.diff(rows, axis=0) != 0).any(axis=1))[: len(rows)]
    starts = np.flatnonzero(new)
    return rows[starts], np.diff(starts, append=len(rows))
