"""The grid for the cells of a source, and the order of values on it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...errors import InputError
from ...grids import CartesianGrid, CylindricalGrid, OctreeGrid, PatchGrid, SphericalGrid
from ...memory import check_memory
from ..leaves import ABSENT, placed_values, tree_of_leaves
from .lattice import Lattice, grid_boxes
from .source import Source, plain_values

# Values of a field (a tuple, as yt names it) in a unit of yt, as they can be given to a volume.
Load = Callable[[tuple[str, str], Any], Any]
_REGULAR: dict[str, Any] = {
    "cartesian": CartesianGrid,
    "spherical": SphericalGrid,
    "cylindrical": CylindricalGrid,
}
_TREES: dict[str, Any] = {**_REGULAR, "cartesian": OctreeGrid}
# A box that a region fills to less than this part is not made whole.
_SPARSE = 8
_FEW = 1 << 16
_ADVICE = "choose a smaller region, such as ds.box(left, right)"


def layout(source: Source, lattice: Lattice) -> tuple[Any, Load]:
    """Return the grid of a source's cells, and what reads a field onto it.

    Nothing is resampled. Cells of one level are a regular grid; grids of several levels are
    patches, or a tree in curvilinear coordinates; octrees are octrees.
    """
    if source.whole and source.kind == "grids":
        level, low, shape = grid_boxes(source.ds, lattice)
        if not level.any() and shape.prod(axis=1).sum() == lattice.counts.prod():
            return _joined(source, lattice, low)
        if lattice.kind == "cartesian":
            return _patches(source, lattice, 0, np.zeros(3, np.int64), lattice.counts)
    level, index = _all_cells(source, lattice)
    base, low, high = _box(level, index, lattice)
    if level.min() == level.max() == base:
        number = np.ravel_multi_index(tuple((index - low).T), tuple(high - low))
        grid = _REGULAR[lattice.kind](*lattice.edges(base, low, high), unit=lattice.unit)
        return _scattered(source, grid, number)
    if source.kind == "grids" and lattice.kind == "cartesian":
        return _patches(source, lattice, base, low, high)
    return _tree(source, lattice, level - base, index, (base, low, high))


def _all_cells(source: Source, lattice: Lattice) -> tuple[np.ndarray, np.ndarray]:
    """Return level and index of all cells.

    Raises
    ------
    InputError
        If there are none.
    """
    found = [(level, lattice.cells(level, index)) for level, index in source.cells()]
    if not sum(len(level) for level, _ in found):
        raise InputError("the region has no cells; is it inside the domain?")
    levels, indices = zip(*found, strict=True)
    return np.concatenate(levels), np.concatenate(indices)


def _box(
    level: np.ndarray, index: np.ndarray, lattice: Lattice
) -> tuple[int, np.ndarray, np.ndarray]:
    """Return a level, and first and last cells of it, of the box around cells.

    It is the level of the largest cell, or a coarser one if cells are few and far between.
    """
    base = int(level.min())
    sizes = lattice.sizes // lattice.sizes[base]
    ends = [(index[level == k] // sizes[k], k) for k in np.unique(level)]
    low = np.min([cells.min(axis=0) for cells, _ in ends], axis=0)
    high = np.max([cells.max(axis=0) for cells, _ in ends], axis=0) + 1
    most = max(_SPARSE * len(level), _FEW)
    while base > 0 and np.prod((high - low).astype(float)) > most:
        ratio = lattice.sizes[base] // lattice.sizes[base - 1]
        base, low, high = base - 1, low // ratio, -(-high // ratio)
    return base, low, high


def _joined(source: Source, lattice: Lattice, low: np.ndarray) -> tuple[Any, Load]:
    grid = _REGULAR[lattice.kind](*lattice.walls, unit=lattice.unit)

    def load(field: tuple[str, str], unit: Any) -> np.ndarray:
        whole = np.empty(grid.shape)
        for part, first in zip(source.ds.index.grids, low, strict=True):
            kept = set(part.field_data)
            values = lattice.array(plain_values(part[field], unit))
            for key in set(part.field_data) - kept:
                del part.field_data[key]  # all of them would be kept as long as the data set
            x, y, z = (slice(a, a + n) for a, n in zip(first, values.shape, strict=True))
            whole[x, y, z] = values
        return whole

    return grid, load


def _patches(
    source: Source, lattice: Lattice, base: int, low: np.ndarray, high: np.ndarray
) -> tuple[Any, Load]:
    """Return the grids of the levels from `base` on, as far as they are inside a box of cells."""
    level, first, shape = grid_boxes(source.ds, lattice)
    ratio = lattice.sizes // lattice.sizes[base]
    last = np.minimum(first + shape, high * ratio[level])
    first = np.maximum(first, low * ratio[level])
    inside = (level >= base) & (first < last).all(axis=1)
    level, first, last = level[inside], first[inside], last[inside]
    check_memory(16 * int((last - first).prod(axis=1).sum()), "reading the grids", _ADVICE)
    sizes = ratio[base : int(level.max()) + 1]
    x, y, z = lattice.edges(base, low, high)
    grid = PatchGrid.from_boxes(
        x,
        y,
        z,
        level - base,
        first - low * ratio[level],
        last - first,
        sizes[1:] // sizes[:-1],
        unit=lattice.unit,
    )

    def numbers(levels: np.ndarray, indices: np.ndarray) -> np.ndarray:
        place = (lattice.cells(levels, indices) - low * ratio[levels]).T
        found: np.ndarray = grid.tree.find(place * grid.patches.sizes[levels - base].T).number
        return found

    return _scattered(source, grid, np.concatenate([numbers(*c) for c in source.cells()]))


def _tree(
    source: Source,
    lattice: Lattice,
    level: np.ndarray,
    index: np.ndarray,
    box: tuple[int, np.ndarray, np.ndarray],
) -> tuple[Any, Load]:
    base, low, high = box
    ratio = lattice.sizes // lattice.sizes[base]
    ratios = lattice.sizes[1:] // lattice.sizes[:-1]
    axes = np.flatnonzero((ratios == 2).all(axis=0)) if len(ratios) else np.arange(3)
    halved = np.where(np.isin(np.arange(3), axes), 1 << np.arange(len(ratio))[:, None], 1)
    if (lattice.sizes != halved).any():
        raise InputError(
            "refined cells in these coordinates must be halves of the coarser ones, along the same "
            f"axes; levels make {lattice.sizes.tolist()} cells of one"
        )
    grid, order = tree_of_leaves(
        _TREES[lattice.kind],
        lattice.edges(base, low, high),
        level,
        index - low * ratio[level + base],
        axes.tolist(),
        unit=lattice.unit,
    )
    return grid, lambda field, unit: placed_values(source.values(field, unit), order)


def _scattered(source: Source, grid: Any, number: np.ndarray) -> tuple[Any, Load]:
    """Return what reads values of cells of the grid by number; others are missing."""
    if (number < 0).any():
        raise InputError("yt tells of a cell that is in no grid; is the region of this data set?")
    small = np.int32 if grid.size < np.iinfo(np.int32).max else np.int64
    order = np.full(grid.size, ABSENT, small)
    order[number] = np.arange(len(number))

    def load(field: tuple[str, str], unit: Any) -> np.ndarray:
        return placed_values(source.values(field, unit), order).reshape(grid.shape)

    return grid, load
