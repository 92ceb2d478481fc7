"""Grids from a grid file, with the corrections that RADMC-3D applies, and grid files from grids."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import FileFormatError, InputError
from ..grids.structured import is_structured
from ..io.contract import UnitLike
from ..io.fortran import Reals
from ..io.leaves import grid_of_blocks
from ..units import parse_unit, plain
from .grid_file import DEEPEST, SPHERICAL, GridFile, Ints

if TYPE_CHECKING:
    from ..grids.contract import Grid

# Walls of infinite slabs are at this distance or beyond.
_ENDLESS = 1e89
_HALF, _WHOLE = 0.5 * np.pi, 2 * np.pi
# RADMC-3D's tolerances: theta walls in cells, phi in radian; equal widths.
_NEAR, _NEAR_CIRCLE = 1e-4, 1e-2
# A theta range that ends this near to the midplane (fraction of the range) means to end there.
_NEAR_MIDPLANE = 1e-2


class ArrangedGrid(NamedTuple):
    """A grid, and a function that converts values from file order to a field."""

    grid: Grid
    arranged: Callable[[np.ndarray], Any]  # returns an array that `Volume` accepts
    in_order: bool = False  # the orders are equal


def grid_from(file: GridFile, unit: UnitLike = None) -> ArrangedGrid:
    """Return the grid of a file; lengths are in `unit` (default: cm).

    A spherical grid that ends at the midplane is mirrored.
    """
    from ..grids import CartesianGrid, OctreeGrid, PatchGrid, SphericalGrid

    kind: Callable[..., Any] = CartesianGrid
    grid: Grid
    if file.spherical:
        r, theta, phi = _spherical_walls(file)
        x, y, z = converted(r, unit), theta, phi
        kind = functools.partial(SphericalGrid, mirror=bool(theta[-1] == _HALF))
    else:
        x, y, z = (converted(w, unit) for w in _finite(file))
    unit = unit or "cm"
    if file.flags is not None:
        if file.spherical:
            grid = kind(x, y, z, refined=file.flags, unit=unit)
        elif all(file.active):
            grid = OctreeGrid(x, y, z, file.flags, unit=unit)
        else:  # each leaf of a tree that is not refined along all axes becomes a patch
            level, low = _leaves(file, file.flags)
            ratio = np.tile(file.factors, (int(level.max()), 1))
            grid = PatchGrid.from_boxes(x, y, z, level, low, (1, 1, 1), ratio, unit=unit)
        return ArrangedGrid(grid, lambda values: values, True)
    level, low, shape = file.boxes()
    grid, arrange = grid_of_blocks(kind, (x, y, z), level, low, shape, file.factors, unit=unit)
    if file.layers is not None and grid.size != file.cells - file.layers[:, 4:].prod(axis=1).sum():
        raise FileFormatError("layers overlap")
    ends = np.cumsum(shape.prod(axis=1))

    def arranged(values: np.ndarray) -> Any:
        parts = np.split(values, ends[:-1])
        return arrange(map(_first_index_last, parts, shape.tolist()))

    return ArrangedGrid(grid, arranged)


def _first_index_last(values: np.ndarray, shape: list[int]) -> np.ndarray:
    """Return values (first index fastest) as an array [i1, i2, i3]."""
    flat = values.reshape(shape[::-1])
    array = np.empty(shape, values.dtype.newbyteorder("="))
    for j in range(shape[1]):  # takes a third of the time of transposing the whole array
        array[:, j] = flat[:, j].T
    return array


def _leaves(file: GridFile, flags: np.ndarray) -> tuple[Ints, Ints]:
    from ..grids.trees.octree_order import Places, levels_from_flags

    axes = tuple(np.flatnonzero(file.active).tolist())
    levels = levels_from_flags(flags, int(np.prod(file.shape)), 1 << len(axes))
    places = Places(levels, axes)
    base, corner = places.corners()
    level = levels.astype(np.int64)
    index = np.stack(np.unravel_index(base, file.shape, order="F"))
    index = index * file.factors[:, None] ** level
    return level, (index + corner // file.factors[:, None] ** (places.deepest - level)).T


def _finite(file: GridFile) -> list[Reals]:
    """Return the walls; infinite slabs get the extent of the other dimensions."""
    endless = [bool(np.abs(w).max() >= _ENDLESS) for w in file.walls]
    if not any(endless):
        return list(file.walls)
    lengths = [np.ptp(w) for w, e in zip(file.walls, endless, strict=True) if not e]
    half = 0.5 * max(lengths, default=0.0)
    if half == 0:
        raise FileFormatError("the grid has no end in any direction")
    axes = " and ".join(axis for axis, e in zip(file.names, endless, strict=True) if e)
    warnings.warn(
        f"the grid has no end along {axes}; it is made {2 * half:g} cm wide there", stacklevel=2
    )
    one_cell = np.array([-half, half])
    return [one_cell if e else w for w, e in zip(file.walls, endless, strict=True)]


def _spherical_walls(file: GridFile) -> list[Reals]:
    """Return walls in r, theta and phi; those near a special angle are set exactly."""
    with_r, with_theta, with_phi = file.active
    if not with_r or (with_phi and not with_theta):
        raise FileFormatError(
            "in spherical coordinates r must be active, and theta where phi is; the active "
            f"dimensions are {' '.join(str(int(active)) for active in file.active)}"
        )
    theta, phi = np.array([0.0, np.pi]), np.array([0.0, _WHOLE])
    if with_theta:
        theta = file.walls[1].copy()
        first, last = theta[1] - theta[0], theta[-1] - theta[-2]
        theta[0] = 0.0 if abs(theta[0]) < _NEAR * first else theta[0]
        for special in (_HALF, np.pi):
            theta[-1] = special if abs(theta[-1] - special) < _NEAR * last else theta[-1]
        inner = np.abs(theta[1:-1] - _HALF) < 0.5 * _NEAR * (theta[2:] - theta[:-2])
        theta[1:-1][inner] = _HALF
        if 0 < abs(theta[-1] - _HALF) < _NEAR_MIDPLANE * np.ptp(theta):
            warnings.warn(
                f"theta ends at {theta[-1]:.17g}, near the midplane but not there: what is above "
                "it is not mirrored. RADMC-3D would stop; write theta with more digits",
                stacklevel=2,
            )
    if with_phi:
        phi = file.walls[2].copy()
        phi[0] = 0.0 if abs(phi[0]) < _NEAR_CIRCLE else phi[0]
        phi[-1] = _WHOLE if abs(phi[-1] - _WHOLE) < _NEAR_CIRCLE else phi[-1]
    refined = file.flags is not None or file.layers is not None
    for active, walls, whole in ((with_theta, theta, np.pi), (with_phi, phi, _WHOLE)):
        if refined and active and len(walls) == 2 and np.ptp(walls) >= whole:
            raise FileFormatError("an angle with one cell all around cannot be refined")
    return [file.walls[0], theta, phi]


def converted(lengths: Reals, unit: UnitLike, own: UnitLike = "cm") -> Reals:
    """Convert lengths between units; None stands for the other one, equal ones keep all bits."""
    own, unit = parse_unit(own), parse_unit(unit)
    if own is None or unit is None or own == unit:
        return lengths
    result: Reals = plain(lengths * own, unit, "the unit of length")
    return result


# Grid files from grids

# The parent search is over all patches of a level: above this number, write an octree.
_MOST_LAYERS = 10_000


class GridOut(NamedTuple):
    """A grid in the form of RADMC-3D's files, and a function that puts fields in file order."""

    file: GridFile
    flat: Callable[[np.ndarray], np.ndarray]


def grid_out(grid: Any, coordinates: Any = None) -> GridOut:
    """Return the file form of a grid; `coordinates` is its RADMC-3D coordinate number, if given."""
    if grid.kind not in ("cartesian", "octree", "patches", "spherical"):
        raise InputError(
            f"RADMC-3D has Cartesian and spherical grids, got {type(grid).__name__}; resample it "
            "with volume.resample(vm.CartesianGrid…) first"
        )
    least = SPHERICAL if grid.kind == "spherical" else 0
    fits = isinstance(coordinates, int) and least <= coordinates < least + SPHERICAL
    edges = grid.edges if grid.kind in ("cartesian", "spherical") else grid.base_edges
    lengths = 1 if least else 3
    walls = tuple(converted(e, "cm", grid.unit) if k < lengths else e for k, e in enumerate(edges))
    file = GridFile(coordinates if fits else least or 1, (True,) * 3, walls)
    flat: Callable[[np.ndarray], np.ndarray] = lambda values: values  # noqa: E731
    if grid.kind == "octree":
        file = _octree(file, grid, grid.refined)
    elif grid.kind == "patches":
        file, flat = _patches(file, grid)
    else:
        file = _spherical(file, grid) if least else file
        if file.flags is None:
            flat = functools.partial(np.ravel, order="F")
    for complaint in _complaints(file):
        warnings.warn(f"RADMC-3D will refuse this grid: {complaint}", stacklevel=3)
    return GridOut(file, flat)


def _octree(file: GridFile, grid: Any, flags: np.ndarray) -> GridFile:
    levels = len(grid.cells_per_level) - 1
    if levels > DEEPEST:
        raise InputError(f"the tree is {levels} levels deep; RADMC-3D takes {DEEPEST} at most")
    return replace(file, flags=flags, levels=levels)


def _patches(file: GridFile, grid: Any) -> GridOut:
    from ..grids import OctreeGrid

    if (layered := _layers(grid)) is not None:
        order, rows = layered

        def flat(values: np.ndarray) -> np.ndarray:
            parts = grid.unpack(values)
            visible = grid.unpack(np.ones(len(values), np.int8))  # cells under finer ones are 0
            return np.concatenate(
                [np.where(visible[k], parts[k], 0).astype(values.dtype).ravel("F") for k in order]
            )

        levels = len(grid.cells_per_level) - 1
        return GridOut(replace(file, layers=rows, levels=levels), flat)
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
        octree, leaf = OctreeGrid.from_leaves(x, y, z, level, (low // size).T)
    except InputError as error:
        raise InputError(
            f"RADMC-3D has no grids with holes ({error}); resample it with volume.resample(…) first"
        ) from error
    return GridOut(_octree(file, octree, octree.refined), lambda values: values[leaf])


def _layers(grid: Any) -> tuple[Ints, Ints] | None:
    """Return patches by level and the rows of RADMC-3D's layers; None if they are no layers.

    Layers are refined by 2 along all axes, each covers a part of one other layer, and they do not
    overlap. The coarsest level is one patch with an even number of cells.
    """
    patches = grid.patches
    order: Ints = np.argsort(patches.level, kind="stable")
    level, low, shape = (a[order] for a in (patches.level, patches.low, patches.shape))
    if (
        len(level) > _MOST_LAYERS
        or np.count_nonzero(level == 0) != 1
        or (patches.sizes[:-1] != 2 * patches.sizes[1:]).any()
        or (low[0] != 0).any()
        or (shape[0] * patches.sizes[0] != patches.extent).any()
        or (shape % 2).any()
        or (low % 2).any()
    ):
        return None
    rows = np.zeros((len(level) - 1, 7), np.int64)
    for k in range(1, len(level)):
        first, cells = low[k] // 2, shape[k] // 2
        around = (low <= first) & (low + shape >= first + cells)
        parents = np.flatnonzero((level == level[k] - 1) & around.all(axis=1))
        if not len(parents):
            return None
        rows[k - 1] = [parents[0], *(first - low[parents[0]] + 1), *cells]
    overlap = grid.size != (shape.prod(axis=1).sum() - rows[:, 4:].prod(axis=1).sum())
    return None if overlap else (order, rows)


def _spherical(file: GridFile, grid: Any) -> GridFile:
    from ..grids.trees.octree_order import flags_from_levels

    _, theta, phi = grid.edges
    if theta[-1] == _HALF and not grid.mirror:
        raise InputError(
            "theta ends at the midplane: RADMC-3D takes such a grid as mirrored. Make it with "
            "mirror=True, or add cells below"
        )
    if phi[0] < -_NEAR or phi[-1] > _WHOLE + _NEAR:
        raise InputError(
            f"phi must lie between 0 and 2 pi for RADMC-3D, got {phi[0]:g} … {phi[-1]:g}"
        )
    round_phi = len(phi) == 2 and np.ptp(phi) == _WHOLE
    round_theta = len(theta) == 2 and np.ptp(theta) == np.pi and round_phi
    file = replace(file, active=(True, not round_theta, not round_phi))
    if is_structured(grid):
        return file
    if grid.places.axes != tuple(np.flatnonzero(file.active).tolist()):
        raise InputError("RADMC-3D cannot leave out theta where it has phi; give theta two cells")
    return _octree(file, grid, flags_from_levels(grid.levels, grid.places))


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
