"""Amounts that particles carry, deposited over the cells of a grid, and their periodic images."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from ..grids import OctreeGrid
from ..memory import check_memory
from .octree import Base


class Deposit:
    """Particles on a grid. A subclass knows which part of each goes where.

    Parameters
    ----------
    grid : OctreeGrid
    mass : array of float64, shape (n,)

    Notes
    -----
    Sums over particles are made in an order that the particles fix, never the threads: the same
    particles give the same bits.
    """

    def __init__(self, grid: OctreeGrid, mass: np.ndarray) -> None:
        self.grid, self.mass = grid, mass
        self._masses: np.ndarray | None = None

    def amounts(self, *carried: np.ndarray) -> list[np.ndarray]:
        """Return how much is in each cell of what particles carry: their sums are equal.

        Parameters
        ----------
        *carried : arrays of float64, shape (n,)
        """
        raise NotImplementedError

    def density(self) -> np.ndarray:
        """Return mass per volume of each cell."""
        masses, _ = self._sums()
        return masses / self.grid.cell_volumes

    def means(self, *values: np.ndarray, empty: float = 0.0) -> list[np.ndarray]:
        """Return mass-weighted means of particles' values in each cell.

        Parameters
        ----------
        *values : arrays, shape (n,)
        empty : float
            The value where there is no mass.
        """
        # What carries no mass does not count, even where its value is missing.
        none, there = np.zeros(len(self.mass)), self.mass > 0
        weighted = (np.multiply(self.mass, v, out=none.copy(), where=there) for v in values)
        masses, sums = self._sums(*weighted)
        found = [np.full(self.grid.size, float(empty)) for _ in sums]
        for mean, total in zip(found, sums, strict=True):
            np.divide(total, masses, out=mean, where=masses > 0)
        return found

    def _sums(self, *carried: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return the mass in each cell, kept once it is known, and other amounts."""
        if self._masses is not None:
            return self._masses, self.amounts(*carried) if carried else []
        self._masses, *others = self.amounts(self.mass, *carried)
        return self._masses, others


# Memory that an image takes: its place, whose it is, in which cell it lies.
_IMAGE_BYTES = 100


def with_images(base: Base, points: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points that reach into the domain, and which particle each of them is.

    Parameters
    ----------
    base : Base
        Of a periodic one the points are in it.
    points : array, shape (n, 3)
    reach : array, shape (n,)

    Returns
    -------
    points : array, shape (m, 3)
        Those that reach into the domain; of a periodic one with their images that do.
    owner : array of int64, shape (m,)
    """
    size = np.ptp(base.bounds, axis=1)
    found, owners = [], []
    for shift in _shifts(base, reach):
        # From so many boxes away only particles come that reach over all of those in between.
        owner = np.flatnonzero(reach > ((np.abs(shift) - 1) * size).max())
        moved = points[owner] + shift * size
        near = reaching(base, moved, reach[owner])
        found.append(moved[near])
        owners.append(owner[near])
    return np.concatenate(found), np.concatenate(owners)


def _shifts(base: Base, reach: np.ndarray) -> Iterator[np.ndarray]:
    if not base.periodic:
        return iter([np.zeros(3)])
    size = np.ptp(base.bounds, axis=1)
    images = int(np.prod(1 + 2 * reach[:, None] / size, axis=1).sum())
    advice = "smoothing lengths are many times as long as the periodic box; check their unit"
    check_memory(_IMAGE_BYTES * images, f"{images} images of particles", advice)
    most = np.maximum(np.ceil(reach.max() / size), 1).astype(int)
    every = itertools.product(*(range(-n, n + 1) for n in most))
    return map(np.array, sorted(every, key=lambda shift: sum(map(abs, shift))))


def reaching(base: Base, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return which spheres around points touch the domain."""
    low, high = base.bounds.T
    away = np.maximum(np.maximum(low - points, points - high), 0.0)
    touched: np.ndarray = (away * away).sum(axis=1) < reach * reach
    return touched | base.inside(points)


def crossing(base: Base, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return which spheres around points reach over a wall of the domain."""
    low, high = base.bounds.T
    margin = np.minimum(points - low, high - points).min(axis=1)
    over: np.ndarray = margin < reach
    return over
