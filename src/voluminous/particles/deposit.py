"""Amounts that particles carry, deposited over the cells of a grid."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from ..grids import OctreeGrid
from ..memory import check_memory
from ..progress import reported_range
from .octree import Base

# Directions to the middles of the eight octants of a cell.
_OCTANTS = 2.0 * (np.arange(8) >> np.arange(3)[:, None, None] & 1) - 1.0
# Cells of the grid computed at once.
_CHUNK = 1 << 18
# Memory that an image takes: its place, whose it is, in which cell it lies.
_IMAGE_BYTES = 100


class Deposit:
    """Particles on a grid. A subclass knows which part of each goes where.

    Sums over particles are made in an order that the particles fix, never the threads: the same
    particles give the same bits.
    """

    def __init__(self, grid: OctreeGrid, mass: np.ndarray) -> None:
        self.grid, self.mass = grid, mass
        self._masses: np.ndarray | None = None

    def amounts(self, *carried: np.ndarray) -> list[np.ndarray]:
        """Return the amount in each cell of what particles carry (n,): their sums are equal."""
        raise NotImplementedError

    def density(self) -> np.ndarray:
        """Return mass per volume of each cell."""
        density: np.ndarray = self._sums()[0] / self.grid.cell_volumes
        return density

    def means(self, *values: np.ndarray, empty: float = 0.0) -> list[np.ndarray]:
        """Return mass-weighted means of particles' values in each cell; `empty` without mass."""
        # What carries no mass does not count, even where its value is missing.
        none, there = np.zeros(len(self.mass)), self.mass > 0
        weighted = (np.multiply(self.mass, v, out=none.copy(), where=there) for v in values)
        masses, sums = self._sums(*weighted)
        means = [np.full(self.grid.size, float(empty)) for _ in sums]
        for mean, total in zip(means, sums, strict=True):
            np.divide(total, masses, out=mean, where=masses > 0)
        return means

    def _sums(self, *carried: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        if self._masses is not None:
            return self._masses, self.amounts(*carried) if carried else []
        self._masses, *others = self.amounts(self.mass, *carried)
        return self._masses, others


class CellsDeposit(Deposit):
    """Each octant of a cell of the grid belongs to the particle that is nearest to its middle.

    What a particle carries is spread evenly over its octants, so that nothing is lost; a particle
    that has none goes to the cell it is in. If there are particles outside of the domain, those
    that reach over its walls are spread over the volume that they really have. `reach` (n,) is
    how far from its point a particle may be the nearest.
    """

    def __init__(
        self,
        base: Base,
        grid: OctreeGrid,
        points: np.ndarray,
        mass: np.ndarray,
        volume: np.ndarray,
        reach: np.ndarray,
    ) -> None:
        from scipy.spatial import cKDTree

        super().__init__(grid, mass)
        near, owner = with_images(base, points, reach)
        tree, inside = cKDTree(near), base.inside(points)
        self.octants, self.volume = grid.cell_volumes / 8, np.zeros(len(mass))
        self.owners = np.empty((grid.size, 8), np.uint32)
        for part in self._parts():
            low, high = grid.corners(part.start, part.stop)
            center, step = low + 0.5 * (high - low), 0.25 * (high - low)
            middles = center[..., None] + step[..., None] * _OCTANTS
            nearest = tree.query(middles.reshape(3, -1).T, workers=-1)[1]
            nearest_owner = owner[nearest]
            self.owners[part] = nearest_owner.reshape(-1, 8)
            self.volume += np.bincount(nearest_owner, np.repeat(self.octants[part], 8), len(mass))
        if not base.periodic and not inside.all():
            low_, size = grid.boxes(0, grid.size)
            at_walls = ((low_ == 0) | (low_ + size == grid.extent[:, None])).any(axis=0)
            cut = ~inside
            cut[self.owners[at_walls]] = True
            self.volume[cut] = volume[cut]
        self.stray = np.flatnonzero((self.volume == 0) & inside)
        self.cell = grid.locate(points[self.stray])

    def _parts(self) -> Iterator[slice]:
        for first in reported_range(self.grid.size, _CHUNK):
            yield slice(first, min(first + _CHUNK, self.grid.size))

    def amounts(self, *carried: np.ndarray) -> list[np.ndarray]:
        amounts = []
        for values in carried:
            total = np.empty(self.grid.size)
            density = np.divide(values, self.volume, np.zeros(len(values)), where=self.volume > 0)
            for part in self._parts():
                total[part] = density[self.owners[part]].sum(axis=1) * self.octants[part]
            total += np.bincount(self.cell, values[self.stray], self.grid.size)
            amounts.append(total)
        return amounts


def with_images(base: Base, points: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points that reach into the domain, (m, 3), and which particle each of them is, (m,).

    Of a periodic domain the points are in it, and their images that reach into it are returned too.
    """
    size = np.ptp(base.bounds, axis=1)
    shifts = [np.zeros(3)]
    if base.periodic:
        images = int(np.prod(1 + 2 * reach[:, None] / size, axis=1).sum())
        advice = "smoothing lengths are many times as long as the periodic box; check their unit"
        check_memory(_IMAGE_BYTES * images, f"{images} images of particles", advice)
        most = np.maximum(np.ceil(reach.max() / size), 1).astype(int)
        steps = itertools.product(*(range(-n, n + 1) for n in most))
        shifts = [np.array(s) for s in sorted(steps, key=lambda shift: sum(map(abs, shift)))]
    places, owners = [], []
    for shift in shifts:
        # From so many boxes away only particles come that reach over all of those in between.
        owner = np.flatnonzero(reach > ((np.abs(shift) - 1) * size).max())
        moved = points[owner] + shift * size
        low, high = base.bounds.T
        away = np.maximum(np.maximum(low - moved, moved - high), 0.0)
        near = ((away * away).sum(axis=1) < reach[owner] * reach[owner]) | base.inside(moved)
        places.append(moved[near])
        owners.append(owner[near])
    return np.concatenate(places), np.concatenate(owners)


def crossing(base: Base, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return which spheres around points reach over a wall of the domain."""
    low, high = base.bounds.T
    margin: np.ndarray = np.minimum(points - low, high - points).min(axis=1)
    return margin < reach
