"""Cartesian grids from what a grid file says: regular, octrees and layers of patches."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError
from . import layers
from .cells import Cells, as_they_are, converted, shaped
from .grid_file import GridFile

Walls = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
# Walls of slabs without end are here, and farther.
_ENDLESS = 1e89


def cartesian_cells(found: GridFile, unit: Any = None) -> Cells:
    """Return the Cartesian grid, regular or refined, that a file describes.

    Parameters
    ----------
    found : GridFile
    unit : str or unit, optional
        Of lengths in the grid; by default that of the file, cm.

    Raises
    ------
    FileFormatError
        If the tree or the layers are none, or the walls cannot be used.
    """
    x, y, z = (converted(w, unit) for w in _finite(found))
    make = _octree if found.flags is not None else _regular if found.layers is None else _patches
    return make(found, (x, y, z), unit or "cm")


def _regular(found: GridFile, walls: Walls, unit: Any) -> Cells:
    from ...grids import CartesianGrid

    return Cells(CartesianGrid(*walls, unit=unit), shaped(found.shape))


def _octree(found: GridFile, walls: Walls, unit: Any) -> Cells:
    from ...grids import OctreeGrid

    if not all(found.active):
        return _flat_tree(found, walls, unit)
    return Cells(OctreeGrid(*walls, refined=found.flags, unit=unit), as_they_are, True)


def _flat_tree(found: GridFile, walls: Walls, unit: Any) -> Cells:
    """Return a tree that is not refined along all axes: each leaf is a patch."""
    from ...grids import PatchGrid
    from ...grids.trees.octree_order import levels_from_flags
    from ...grids.trees.octree_places import Places

    assert found.flags is not None
    axes = tuple(np.flatnonzero(found.active).tolist())
    base_cells = int(np.prod(found.shape))
    levels = levels_from_flags(found.flags, base_cells, 1 << len(axes))
    places = Places(levels, axes)
    base, corner = places.corners()
    nx, ny, _ = found.shape
    corner += np.stack([base % nx, base // nx % ny, base // (nx * ny)]) * (
        found.factors[:, None] ** places.deepest
    )
    size = found.factors[:, None] ** (places.deepest - levels.astype(np.int64))
    grid = PatchGrid.from_boxes(
        *walls,
        level=levels,
        low=(corner // size).T,
        shape=np.ones((len(levels), 3), np.int64),
        ratio=np.tile(found.factors, (places.deepest, 1)),
        unit=unit,
    )
    return Cells(grid, as_they_are, True)


def _patches(found: GridFile, walls: Walls, unit: Any) -> Cells:
    from ...grids import PatchGrid

    layers.uncovered(found)  # refuses what overlaps
    boxes = layers.boxes(found)
    grid = PatchGrid.from_boxes(
        *walls,
        level=boxes.level,
        low=boxes.low,
        shape=boxes.shape,
        ratio=np.tile(found.factors, (int(boxes.level.max()), 1)),
        unit=unit,
    )
    shapes = [tuple(shape) for shape in boxes.shape.tolist()]
    ends = np.cumsum([np.prod(shape) for shape in shapes])

    def arranged(values: NDArray[Any]) -> list[NDArray[Any]]:
        parts = np.split(values, ends[:-1])
        return [shaped(shape)(part) for shape, part in zip(shapes, parts, strict=True)]

    return Cells(grid, arranged)


def _finite(found: GridFile) -> Sequence[NDArray[np.float64]]:
    """Return walls, those of dimensions without end (slabs) as far apart as the others are."""
    endless = [bool(np.abs(w).max() >= _ENDLESS) for w in found.walls]
    if not any(endless):
        return found.walls
    lengths = [np.ptp(w) for w, far in zip(found.walls, endless, strict=True) if not far]
    half = 0.5 * max(lengths, default=0.0)
    if half == 0:
        raise FileFormatError("the grid has no end in any direction")
    axes = " and ".join(axis for axis, far in zip(found.names, endless, strict=True) if far)
    warnings.warn(
        f"the grid has no end along {axes}; it is made {2 * half:g} cm wide there", stacklevel=2
    )
    one_cell = np.array([-half, half])
    return [one_cell if far else w for w, far in zip(found.walls, endless, strict=True)]
