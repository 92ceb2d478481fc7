"""Volumes with known answers."""

from __future__ import annotations

import numpy as np

from .errors import InputError
from .grids import CartesianGrid
from .volume import Volume

PARSEC = 3.08572e18
"""Parsec in cm as RADMC-3D (and the note made with it) has it; astropy's is 1.4e-5 shorter."""


def prestellar_core(resolution: int = 100, width: float = 0.25, *, peak: float = 28.0) -> Volume:
    """Return the prestellar core of Peters, *The physics of volume rendering*, section 5.

    The number density of a singular isothermal sphere, n(r) = `peak` (r / pc)^-2 cm^-3, at the
    centres of cubic cells in a cube around the origin.

    Parameters
    ----------
    resolution : int
        Cells per side; even, since the density of a central cell would be infinite.
    width : float
        Side of the cube in parsec (3.08572e18 cm).
    peak : float
        Density at one parsec, cm^-3.

    Returns
    -------
    Volume
        Lengths in cm; field ``density`` (float32, cm^-3).

    Raises
    ------
    InputError
        If `resolution` is no even positive whole number.
    """
    half = 0.5 * width * PARSEC
    grid = CartesianGrid.uniform(resolution, (-half, half), unit="cm")
    if resolution % 2:
        raise InputError(
            f"resolution must be even, got {resolution}: a cell at the centre has infinite density"
        )
    square = [(c / PARSEC) ** 2 for c in grid.centers]
    r2 = np.asarray(sum(np.meshgrid(*square, indexing="ij", sparse=True)))
    volume = Volume(grid, density=(peak / r2).astype(np.float32))
    volume.set_unit("density", "cm-3")
    return volume


def uniform_slab(emissivity: float, extinction: float, thickness: float = 1.0) -> Volume:
    """Return a homogeneous slab -0.5 < x, y < 0.5, 0 < z < `thickness`, fields ``j`` and ``a``.

    Seen along z its intensity is j/α (1 - exp(-α thickness)).
    """
    grid = CartesianGrid([-0.5, 0.5], [-0.5, 0.5], [0.0, thickness])
    return Volume(grid, j=np.full((1, 1, 1), emissivity), a=np.full((1, 1, 1), extinction))


def sphere(resolution: int = 64, radius: float = 1.0, *, width: float | None = None) -> Volume:
    """Return a sphere: field ``inside`` is one where a cell's centre is within `radius`, else zero.

    Seen at an impact parameter b its path is 2 sqrt(radius² - b²), to the size of a cell.
    """
    half = 0.5 * (width if width is not None else 2.5 * radius)
    grid = CartesianGrid.uniform(resolution, (-half, half))
    r2 = sum(np.meshgrid(*(c**2 for c in grid.centers), indexing="ij", sparse=True))
    return Volume(grid, inside=np.asarray(r2 <= radius**2, np.float32))
