"""Spherical grids from what a grid file says, with the corrections that RADMC-3D makes."""

from __future__ import annotations

import functools
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError
from ..leaves import tree_of_leaves
from . import layers
from .cells import Cells, as_they_are, converted, shaped
from .grid_file import GridFile

_HALF, _WHOLE = 0.5 * np.pi, 2 * np.pi
# How near angles are to what they are meant to be: theta in cells, phi in radian. RADMC-3D's.
_NEAR_WALL, _NEAR_CIRCLE = 1e-4, 1e-2
# Where theta ends so near to the midplane, as a part of its range, something is meant by it.
_NEAR_MIDPLANE = 1e-2


def spherical_cells(found: GridFile, unit: Any = None) -> Cells:
    """Return the spherical grid that a file describes; one that ends at the midplane is mirrored.

    Raises
    ------
    FileFormatError
        If dimensions are active that cannot be, or the tree or the layers are none.
    """
    from ...grids import SphericalGrid

    theta, phi = _angles(found)
    walls = (converted(found.walls[0], unit), theta, phi)
    unit = unit or "cm"
    make = functools.partial(SphericalGrid, mirror=bool(theta[-1] == _HALF))
    if found.flags is not None:
        return Cells(make(*walls, refined=found.flags, unit=unit), as_they_are, True)
    if found.layers is None:
        return Cells(make(*walls, unit=unit), shaped(found.shape))
    level, index, value = layers.leaves(found)
    axes = np.flatnonzero(found.active).tolist()
    grid, source = tree_of_leaves(make, walls, level, index, axes, unit=unit)
    order = value[source]
    return Cells(grid, lambda values: values[order])


def _angles(found: GridFile) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    with_r, with_theta, with_phi = found.active
    if not with_r or (with_phi and not with_theta):
        raise FileFormatError(
            "in spherical coordinates r must be active, and theta where phi is; the active "
            f"dimensions are {' '.join(str(int(active)) for active in found.active)}"
        )
    theta = _polar(found.walls[1].copy()) if with_theta else np.array([0.0, np.pi])
    phi = _azimuth(found.walls[2].copy()) if with_phi else np.array([0.0, _WHOLE])
    refined = found.flags is not None or found.layers is not None
    for active, walls, whole in ((with_theta, theta, np.pi), (with_phi, phi, _WHOLE)):
        if refined and active and len(walls) == 2 and np.ptp(walls) >= whole:
            raise FileFormatError("an angle with one cell all around cannot be refined")
    return theta, phi


def _polar(theta: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return walls in theta, those that are meant to be a pole or the midplane exactly there."""
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
