"""Conversion of grids to RADMC-3D's form: the contents of a grid file, and fields in file order."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError, InputError
from ...units import plain
from ..contract import UnitLike
from .grid_file import DEEPEST, LAYERS, OCTREE, REGULAR, SPHERICAL, GridFile, Ints, uncovered

Flat = Callable[[np.ndarray], np.ndarray]
CARTESIAN = 1
# The parent search is over all patches of a level: above this number, write an octree.
_MOST_LAYERS = 10_000
_ALL = (True, True, True)
_HALF, _WHOLE = 0.5 * np.pi, 2 * np.pi
# RADMC-3D's tolerance for equal widths and for wall positions.
_NEAR = 1e-4


@dataclass(frozen=True)
class GridOut:
    """A grid in the form of RADMC-3D's files."""

    file: GridFile
    flat: Flat  # converts a field to file order
    levels: int = 0  # number of refinement levels


def grid_out(grid: Any, coordinates: Any = None) -> GridOut:
    """Return the file form of a grid; `coordinates` is its RADMC-3D coordinate number, if given."""
    kinds: dict[str, Callable[[Any, int], GridOut]] = {
        "cartesian": _regular,
        "octree": _octree,
        "patches": _patches,
        "spherical": _spherical,
    }
    make = kinds.get(grid.kind)
    if make is None:
        raise InputError(
            f"RADMC-3D has Cartesian and spherical grids, got {type(grid).__name__}; resample it "
            "with volume.resample(vm.CartesianGrid…) first"
        )
    least = SPHERICAL if make is _spherical else 0
    fits = isinstance(coordinates, int) and least <= coordinates < least + SPHERICAL
    out = make(grid, coordinates if fits else least or CARTESIAN)
    for complaint in _complaints(out.file):
        warnings.warn(f"RADMC-3D will refuse this grid: {complaint}", stacklevel=3)
    return out


def in_cm(edges: NDArray[np.float64], unit: UnitLike) -> NDArray[np.float64]:
    """Return lengths in cm; lengths without a unit are assumed to be in cm."""
    from astropy import units as u

    if unit is None or unit == u.cm:
        return edges
    lengths: NDArray[np.float64] = plain(edges * unit, u.cm, "the grid's unit")
    return lengths


def _fortran(values: np.ndarray) -> np.ndarray:
    return values.ravel(order="F")


def _same(values: np.ndarray) -> np.ndarray:
    return values


def _regular(grid: Any, number: int) -> GridOut:
    walls = tuple(in_cm(e, grid.unit) for e in grid.edges)
    return GridOut(GridFile(REGULAR, number, _ALL, walls), _fortran)


def _octree(grid: Any, number: int) -> GridOut:
    walls = tuple(in_cm(e, grid.unit) for e in grid.base_edges)
    return GridOut(GridFile(OCTREE, number, _ALL, walls, grid.refined), _same, _levels(grid))


def _levels(grid: Any) -> int:
    levels: int = len(grid.cells_per_level) - 1
    if levels > DEEPEST:
        raise InputError(f"the tree is {levels} levels deep; RADMC-3D takes {DEEPEST} at most")
    return levels


def _patches(grid: Any, number: int) -> GridOut:
    """Return patches as layers if possible, else as an octree."""
    walls = tuple(in_cm(e, grid.unit) for e in grid.base_edges)
    if layered := layers_of(grid, GridFile(REGULAR, number, _ALL, walls)):
        return GridOut(*layered, _levels(grid))
    octree, order = octree_of(grid)
    file = GridFile(OCTREE, number, _ALL, walls, octree.refined)
    return GridOut(file, lambda values: values[order], _levels(octree))


def _spherical(grid: Any, number: int) -> GridOut:
    from ...grids.trees.octree_order import flags_from_levels

    r, theta, phi = grid.edges
    _check_angles(theta, phi, grid.mirror)
    round_phi = len(phi) == 2 and np.ptp(phi) == _WHOLE
    round_theta = len(theta) == 2 and np.ptp(theta) == np.pi and round_phi
    active = (True, not round_theta, not round_phi)
    walls = (in_cm(r, grid.unit), theta, phi)
    if grid.places is None:
        return GridOut(GridFile(REGULAR, number, active, walls), _fortran)
    if grid.places.axes != tuple(np.flatnonzero(active).tolist()):
        raise InputError("RADMC-3D cannot leave out theta where it has phi; give theta two cells")
    flags = flags_from_levels(grid.levels, grid.places)
    return GridOut(GridFile(OCTREE, number, active, walls, flags), _same, _levels(grid))


def _check_angles(theta: NDArray[np.float64], phi: NDArray[np.float64], mirror: bool) -> None:
    if theta[-1] == _HALF and not mirror:
        raise InputError(
            "theta ends at the midplane: RADMC-3D takes such a grid as mirrored. Make it with "
            "mirror=True, or add cells below"
        )
    if phi[0] < -_NEAR or phi[-1] > _WHOLE + _NEAR:
        raise InputError(
            f"phi must lie between 0 and 2 pi for RADMC-3D, got {phi[0]:g} … {phi[-1]:g}"
        )


def _complaints(file: GridFile) -> list[str]:
    """Return RADMC-3D's objections to a grid that the format can describe but the code rejects."""
    if file.spherical:
        theta = file.walls[1]
        across = file.active[1] and theta[0] < _HALF < theta[-1] and _HALF not in theta
        complaints = ["theta needs a wall at the midplane, pi/2"] if across else []
        return complaints + (["r must not begin at 0"] if file.walls[0][0] <= 0 else [])
    widths = np.concatenate([np.diff(w) for w in file.walls])
    even = np.abs(widths / widths[0] - 1).max() <= _NEAR
    return [] if even else ["Cartesian cells must be cubes, all of one size"]


def layers_of(grid: Any, base: GridFile) -> tuple[GridFile, Flat] | None:
    """Return patches as layers, and the conversion of a field to their order; None if impossible.

    Layers are refined by 2 along all axes, each covers a part of one other layer, and they do not
    overlap.
    """
    patches = grid.patches
    if not _halved(patches) or not _one_base(patches) or len(patches.level) > _MOST_LAYERS:
        return None
    refined = np.flatnonzero(patches.level > 0).tolist()
    parents = {k: parent for k in refined if (parent := _parent(patches, k)) is not None}
    if len(parents) < len(refined):
        return None
    order = _parents_first(patches, parents)
    file = replace(base, style=LAYERS, layers=_rows(patches, parents, order))
    try:
        uncovered(file)
    except FileFormatError:  # they overlap
        return None
    return file, _layer_order(grid, order)


def _parents_first(patches: Any, parent: dict[int, int]) -> Ints:
    """Return an order of patches with parents before children; the present order if it has this."""
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
    """Return True if the coarsest level is one patch with an even number of cells."""
    base = np.flatnonzero(patches.level == 0)
    whole = patches.extent // patches.sizes[0]
    return bool(
        len(base) == 1
        and (patches.shape[base[0]] == whole).all()
        and (whole % 2 == 0).all()
        and (patches.low[base[0]] == 0).all()
    )


def _parent(patches: Any, k: int) -> int | None:
    """Return the patch of the next coarser level that contains a patch; None if there is none."""
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
    def flat(values: np.ndarray) -> np.ndarray:
        parts = grid.unpack(values)
        seen = grid.unpack(np.ones(len(values), np.int8))  # cells covered by finer ones are 0
        return np.concatenate(
            [np.where(seen[k], parts[k], 0).astype(values.dtype).ravel(order="F") for k in order]
        )

    return flat


def octree_of(grid: Any) -> tuple[Any, Ints]:
    """Return patches as an octree, and the index of each leaf among their cells."""
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
        octree: tuple[Any, Ints] = OctreeGrid.from_leaves(x, y, z, level, index, unit=grid.unit)
    except InputError as error:
        raise InputError(
            f"RADMC-3D has no grids with holes ({error}); resample it with volume.resample(…) first"
        ) from error
    return octree
