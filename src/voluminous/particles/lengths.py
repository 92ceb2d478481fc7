"""Smoothing lengths of particles that have none, from how many there are around them."""

from __future__ import annotations

import numpy as np

from .base import Base
from .kernels import get_kernel
from .octree import Refinement, octree_around
from .smoothed import SmoothedDeposit

# Smoothing length in units of the mean distance of particles: 58 are in a cubic spline then.
ETA = 1.2
# Particles of which a first guess is made.
_PARTICLES = 16


def smoothing_lengths(base: Base | None, points: np.ndarray) -> np.ndarray:
    """Return smoothing lengths h = η n^(-1/3), where n is the number density of particles.

    n is that in cells of an octree with few particles each, smoothed once with these lengths.

    Parameters
    ----------
    base : Base or None
        A periodic domain that the points are in; None if it is not.
    points : array, shape (n, 3)

    Notes
    -----
    η = 1.2 is the usual choice (Price 2012, J. Comput. Phys. 231, 759, section 2.2).
    """
    if base is None:
        base = Base.around(np.stack([points.min(axis=0), points.max(axis=0)], axis=1))
    one = np.ones(len(points))
    grid = octree_around(base, points, Refinement(_PARTICLES, 0 * one))
    leaf = grid.locate(points)
    number = np.bincount(leaf, minlength=grid.size) / grid.cell_volumes
    first = ETA * number[leaf] ** (-1 / 3)
    kernel = get_kernel("cubic")
    deposit = SmoothedDeposit(base, grid, points, one, kernel.support * first, kernel)
    lengths: np.ndarray = ETA * deposit.density()[leaf] ** (-1 / 3)
    return lengths
