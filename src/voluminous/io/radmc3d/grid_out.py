"""Grids as RADMC-3D has them: what a grid file would say, and fields in a file's order."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...units import plain
from .grid_file import DEEPEST, OCTREE, REGULAR, SPHERICAL, GridFile
from .layers_out import layers_of, octree_of

CARTESIAN = 1
_ALL = (True, True, True)
_HALF, _WHOLE = 0.5 * np.pi, 2 * np.pi
# RADMC-3D takes widths for equal, and walls for there, to this.
_NEAR = 1e-4


@dataclass(frozen=True)
class GridOut:
    """What is written of a grid.

    Attributes
    ----------
    file : GridFile
    flat : callable
        Brings a field into the order of files.
    levels : int
        How often cells are refined.
    """

    file: GridFile
    flat: Callable[[NDArray[Any]], NDArray[Any]]
    levels: int = 0


def grid_out(grid: Any, coordinates: Any = None) -> GridOut:
    """Return what a file would say of a grid.

    Parameters
    ----------
    grid : grid
    coordinates : int, optional
        RADMC-3D's number of the coordinate system, if it is known and fits.

    Raises
    ------
    InputError
        If RADMC-3D has no such grid; says what to do.
    """
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
    known = isinstance(coordinates, int) and least <= coordinates < least + SPHERICAL
    found = make(grid, coordinates if known else least or CARTESIAN)
    for told in _complaints(found.file):
        warnings.warn(f"RADMC-3D will refuse this grid: {told}", stacklevel=3)
    return found


def in_cm(edges: NDArray[np.float64], unit: Any) -> NDArray[np.float64]:
    """Return lengths in cm; without a unit they are in cm."""
    from astropy import units as u

    if unit is None or unit == u.cm:
        return edges
    lengths: NDArray[np.float64] = plain(edges * unit, u.cm, "the grid's unit")
    return lengths


def _fortran(values: NDArray[Any]) -> NDArray[Any]:
    return values.ravel(order="F")


def _same(values: NDArray[Any]) -> NDArray[Any]:
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
    """Return patches as layers if that is what they are, or else as an octree."""
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


def _complaints(found: GridFile) -> list[str]:
    """Return what RADMC-3D says of grids that it could describe, but does not take."""
    if found.spherical:
        theta = found.walls[1]
        across = found.active[1] and theta[0] < _HALF < theta[-1] and _HALF not in theta
        told = ["theta needs a wall at the midplane, pi/2"] if across else []
        return told + (["r must not begin at 0"] if found.walls[0][0] <= 0 else [])
    widths = np.concatenate([np.diff(w) for w in found.walls])
    even = np.abs(widths / widths[0] - 1).max() <= _NEAR
    return [] if even else ["Cartesian cells must be cubes, all of one size"]
