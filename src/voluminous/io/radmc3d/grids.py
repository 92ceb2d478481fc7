"""Construction of grids from a grid file, with the corrections that RADMC-3D applies."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError
from ...units import parse_unit
from ..contract import UnitLike
from ..leaves import tree_of_leaves
from .grid_file import GridFile, boxes, leaves, uncovered

if TYPE_CHECKING:
    from ...grids import CartesianGrid, OctreeGrid, PatchGrid, SphericalGrid

Walls = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
# Walls of infinite slabs are at this distance or beyond.
_ENDLESS = 1e89
_HALF, _WHOLE = 0.5 * np.pi, 2 * np.pi
# RADMC-3D's tolerances for the special angles: theta in cells, phi in radian.
_NEAR_WALL, _NEAR_CIRCLE = 1e-4, 1e-2
# A theta range that ends this near to the midplane (fraction of the range) means to end there.
_NEAR_MIDPLANE = 1e-2


@dataclass(frozen=True)
class ArrangedGrid:
    """A grid, and a function that converts values from file order to a field."""

    grid: CartesianGrid | OctreeGrid | PatchGrid | SphericalGrid
    arranged: Callable[[np.ndarray], Any]  # returns an array that `Volume` accepts
    in_order: bool = False  # the orders are equal


def cartesian_grid(file: GridFile, unit: UnitLike = None) -> ArrangedGrid:
    """Return the Cartesian grid, regular or refined; lengths are in `unit` (default: cm)."""
    x, y, z = (converted(w, unit) for w in _finite(file))
    make = _octree if file.flags is not None else _regular if file.layers is None else _patches
    return make(file, (x, y, z), unit or "cm")


def _regular(file: GridFile, walls: Walls, unit: UnitLike) -> ArrangedGrid:
    from ...grids import CartesianGrid

    return ArrangedGrid(CartesianGrid(*walls, unit=unit), shaped(file.shape))


def _octree(file: GridFile, walls: Walls, unit: UnitLike) -> ArrangedGrid:
    from ...grids import OctreeGrid

    if not all(file.active):
        return _flat_tree(file, walls, unit)
    return ArrangedGrid(OctreeGrid(*walls, refined=file.flags, unit=unit), as_they_are, True)


def _flat_tree(file: GridFile, walls: Walls, unit: UnitLike) -> ArrangedGrid:
    """Return the grid of a tree that is not refined along all axes: each leaf becomes a patch."""
    from ...grids import PatchGrid
    from ...grids.trees.octree_order import Places, levels_from_flags

    assert file.flags is not None
    axes = tuple(np.flatnonzero(file.active).tolist())
    base_cells = int(np.prod(file.shape))
    levels = levels_from_flags(file.flags, base_cells, 1 << len(axes))
    places = Places(levels, axes)
    base, corner = places.corners()
    nx, ny, _ = file.shape
    corner += np.stack([base % nx, base // nx % ny, base // (nx * ny)]) * (
        file.factors[:, None] ** places.deepest
    )
    size = file.factors[:, None] ** (places.deepest - levels.astype(np.int64))
    grid = PatchGrid.from_boxes(
        *walls,
        level=levels,
        low=(corner // size).T,
        shape=np.ones((len(levels), 3), np.int64),
        ratio=np.tile(file.factors, (places.deepest, 1)),
        unit=unit,
    )
    return ArrangedGrid(grid, as_they_are, True)


def _patches(file: GridFile, walls: Walls, unit: UnitLike) -> ArrangedGrid:
    from ...grids import PatchGrid

    uncovered(file)  # refuses overlapping patches
    layers = boxes(file)
    grid = PatchGrid.from_boxes(
        *walls,
        level=layers.level,
        low=layers.low,
        shape=layers.shape,
        ratio=np.tile(file.factors, (int(layers.level.max()), 1)),
        unit=unit,
    )
    shapes = [tuple(shape) for shape in layers.shape.tolist()]
    ends = np.cumsum([np.prod(shape) for shape in shapes])

    def arranged(values: np.ndarray) -> list[np.ndarray]:
        parts = np.split(values, ends[:-1])
        return [shaped(shape)(part) for shape, part in zip(shapes, parts, strict=True)]

    return ArrangedGrid(grid, arranged)


def _finite(file: GridFile) -> Sequence[NDArray[np.float64]]:
    """Return the walls; infinite slabs get the extent of the other dimensions."""
    endless = [bool(np.abs(w).max() >= _ENDLESS) for w in file.walls]
    if not any(endless):
        return file.walls
    lengths = [np.ptp(w) for w, far in zip(file.walls, endless, strict=True) if not far]
    half = 0.5 * max(lengths, default=0.0)
    if half == 0:
        raise FileFormatError("the grid has no end in any direction")
    axes = " and ".join(axis for axis, far in zip(file.names, endless, strict=True) if far)
    warnings.warn(
        f"the grid has no end along {axes}; it is made {2 * half:g} cm wide there", stacklevel=2
    )
    one_cell = np.array([-half, half])
    return [one_cell if far else w for w, far in zip(file.walls, endless, strict=True)]


def spherical_grid(file: GridFile, unit: UnitLike = None) -> ArrangedGrid:
    """Return the spherical grid; a grid that ends at the midplane is mirrored."""
    from ...grids import SphericalGrid

    theta, phi = _angles(file)
    walls = (converted(file.walls[0], unit), theta, phi)
    unit = unit or "cm"
    make = functools.partial(SphericalGrid, mirror=bool(theta[-1] == _HALF))
    if file.flags is not None:
        return ArrangedGrid(make(*walls, refined=file.flags, unit=unit), as_they_are, True)
    if file.layers is None:
        return ArrangedGrid(make(*walls, unit=unit), shaped(file.shape))
    level, index, value = leaves(file)
    axes = np.flatnonzero(file.active).tolist()
    grid, source = tree_of_leaves(make, walls, level, index, axes, unit=unit)
    order = value[source]
    return ArrangedGrid(grid, lambda values: values[order])


def _angles(file: GridFile) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    with_r, with_theta, with_phi = file.active
    if not with_r or (with_phi and not with_theta):
        raise FileFormatError(
            "in spherical coordinates r must be active, and theta where phi is; the active "
            f"dimensions are {' '.join(str(int(active)) for active in file.active)}"
        )
    theta = _polar(file.walls[1].copy()) if with_theta else np.array([0.0, np.pi])
    phi = _azimuth(file.walls[2].copy()) if with_phi else np.array([0.0, _WHOLE])
    refined = file.flags is not None or file.layers is not None
    for active, walls, whole in ((with_theta, theta, np.pi), (with_phi, phi, _WHOLE)):
        if refined and active and len(walls) == 2 and np.ptp(walls) >= whole:
            raise FileFormatError("an angle with one cell all around cannot be refined")
    return theta, phi


def _polar(theta: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return walls in theta; those within tolerance of a pole or the midplane are set exactly."""
    first, last = theta[1] - theta[0], theta[-1] - theta[-2]
    if abs(theta[0]) < _NEAR_WALL * first:
        theta[0] = 0.0
    for special in (_HALF, np.pi):
        if abs(theta[-1] - special) < _NEAR_WALL * last:
            theta[-1] = special
    inner = np.abs(theta[1:-1] - _HALF) < 0.5 * _NEAR_WALL * (theta[2:] - theta[:-2])
    theta[1:-1][inner] = _HALF
    off, whole = abs(theta[-1] - _HALF), theta[-1] - theta[0]
    if 0 < off < _NEAR_MIDPLANE * whole:
        warnings.warn(
            f"theta ends at {theta[-1]:.17g}, near the midplane but not there: what is above it is "
            "not mirrored. RADMC-3D would stop; write theta with more digits",
            stacklevel=2,
        )
    return theta


def _azimuth(phi: NDArray[np.float64]) -> NDArray[np.float64]:
    if abs(phi[0]) < _NEAR_CIRCLE:
        phi[0] = 0.0
    if abs(phi[-1] - _WHOLE) < _NEAR_CIRCLE:
        phi[-1] = _WHOLE
    return phi


def converted(lengths: NDArray[np.float64], unit: UnitLike) -> NDArray[np.float64]:
    """Convert lengths from cm to another unit; lengths that stay in cm keep all bits."""
    if unit is None or parse_unit(unit) == parse_unit("cm"):
        return lengths
    from astropy import units as u

    from ...units import plain

    in_unit: NDArray[np.float64] = plain(lengths * u.cm, parse_unit(unit), "the walls")
    return in_unit


def shaped(shape: tuple[int, ...]) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function that reshapes values (first index fastest) to an array [i1, i2, i3]."""

    def arranged(values: np.ndarray) -> np.ndarray:
        flat = values.reshape(shape[::-1])
        array = np.empty(shape, values.dtype.newbyteorder("="))
        for j in range(shape[1]):  # takes a third of the time of transposing the whole array
            array[:, j] = flat[:, j].T
        return array

    return arranged


def as_they_are(values: np.ndarray) -> np.ndarray:
    """Return the values unchanged: their order is that of the grid."""
    return values
