"""Patches as RADMC-3D's layers, or as an octree."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError, InputError
from .grid_file import LAYERS, GridFile
from .layers import uncovered

Ints = NDArray[np.int64]
Flat = Callable[[NDArray[Any]], NDArray[Any]]
# Parents are looked for among all patches of a level: of more than these an octree is made.
_MOST = 10_000


def layers_of(grid: Any, base: GridFile) -> tuple[GridFile, Flat] | None:
    """Return patches as layers, and what brings a field into their order; None if they are none.

    Layers are halved along all axes, cover a part of one other layer each, and do not overlap.

    Parameters
    ----------
    grid : PatchGrid
    base : GridFile
        What there is to say of the cells of level 0.
    """
    patches = grid.patches
    if not _halved(patches) or not _one_base(patches) or len(patches.level) > _MOST:
        return None
    refined = np.flatnonzero(patches.level > 0).tolist()
    found = {k: parent for k in refined if (parent := _parent(patches, k)) is not None}
    if len(found) < len(refined):
        return None
    order = _parents_first(patches, found)
    file = replace(base, style=LAYERS, layers=_rows(patches, found, order))
    try:
        uncovered(file)
    except FileFormatError:  # they overlap
        return None
    return file, _layer_order(grid, order)


def _parents_first(patches: Any, parent: dict[int, int]) -> Ints:
    """Return an order of patches in which all come after their parents; theirs if it is one."""
    if patches.level[0] == 0 and all(above < k for k, above in parent.items()):
        return np.arange(len(patches.level))
    order: Ints = np.argsort(patches.level, kind="stable")
    return order


def _rows(patches: Any, parent: dict[int, int], order: Ints) -> Ints:
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    low, cells = patches.low, patches.shape // 2
    rows = [
        [number[parent[k]], *(low[k] // 2 - low[parent[k]] + 1), *cells[k]]
        for k in order[1:].tolist()
    ]
    return np.array(rows, np.int64).reshape(-1, 7)


def _halved(patches: Any) -> bool:
    return bool((patches.sizes[:-1] == 2 * patches.sizes[1:]).all())


def _one_base(patches: Any) -> bool:
    """Return True if one patch of an even number of cells is all of the coarsest level."""
    base = np.flatnonzero(patches.level == 0)
    whole = patches.extent // patches.sizes[0]
    return bool(
        len(base) == 1
        and (patches.shape[base[0]] == whole).all()
        and (whole % 2 == 0).all()
        and (patches.low[base[0]] == 0).all()
    )


def _parent(patches: Any, k: int) -> int | None:
    """Return the patch of the level below that holds all of a patch; None if none does."""
    low, high = patches.low[k], patches.low[k] + patches.shape[k]
    if (low % 2).any() or (high % 2).any():
        return None
    fits = (
        (patches.level == patches.level[k] - 1)
        & (patches.low <= low // 2).all(axis=1)
        & (patches.low + patches.shape >= high // 2).all(axis=1)
    )
    return int(np.argmax(fits)) if fits.any() else None


def _layer_order(grid: Any, order: Ints) -> Flat:
    def flat(values: NDArray[Any]) -> NDArray[Any]:
        parts = grid.unpack(values)
        seen = grid.unpack(np.ones(len(values), np.int8))  # cells below finer ones are 0
        return np.concatenate(
            [np.where(seen[k], parts[k], 0).astype(values.dtype).ravel(order="F") for k in order]
        )

    return flat


def octree_of(grid: Any) -> tuple[Any, Ints]:
    """Return patches as an octree, and where its leaves are among their cells.

    Raises
    ------
    InputError
        If cells are not halved along all axes, again and again, or there are holes.
    """
    from ...grids import OctreeGrid

    low, size = grid.boxes(0, grid.size)
    parts = grid.divisions[:, None] // size
    level = np.round(np.log2(parts[0])).astype(np.int64)
    if (parts != 1 << level).any():
        raise InputError(
            "RADMC-3D halves cells along all three axes, these patches do not; resample them with "
            "volume.resample(vm.CartesianGrid…) first"
        )
    try:
        x, y, z = grid.base_edges
        index = (low // size).T
        found: tuple[Any, Ints] = OctreeGrid.from_leaves(x, y, z, level, index, unit=grid.unit)
    except InputError as error:
        raise InputError(
            f"RADMC-3D has no grids with holes ({error}); resample it with volume.resample(…) first"
        ) from error
    return found
