"""Particles that represent the cells of a Voronoi mesh: each place belongs to the nearest one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..grids import OctreeGrid
from ..progress import reported_range
from .deposit import Deposit, with_images
from .octree import Base

# Directions to the middles of the eight octants of a cell.
_OCTANTS = 2.0 * (np.arange(8) >> np.arange(3)[:, None, None] & 1) - 1.0
# Cells of the grid computed at once.
_CHUNK = 1 << 18


class CellsDeposit(Deposit):
    """Each octant of a cell of the grid belongs to the particle that is nearest to its middle.

    What a particle carries is spread evenly over its octants, so that nothing is lost; a particle
    that has none goes to the cell it is in. If there are particles outside of the domain, those
    that reach over its walls are spread over the volume that they really have.

    Parameters
    ----------
    base : Base
    grid : OctreeGrid
        On these base cells.
    points : array, shape (n, 3)
    mass, volume : array, shape (n,)
    reach : array, shape (n,)
        How far from its point a particle may be the nearest.
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
        self.octants = grid.cell_volumes / 8
        self.owners = np.empty((grid.size, 8), np.uint32)
        for part in _parts(grid.size):
            low, high = grid.corners(part.start, part.stop)
            center, step = low + 0.5 * (high - low), 0.25 * (high - low)
            middles = center[..., None] + step[..., None] * _OCTANTS
            nearest = tree.query(middles.reshape(3, -1).T, workers=-1)[1]
            self.owners[part] = owner[nearest].reshape(-1, 8)
        self.volume = self._volumes(len(mass))
        if not base.periodic and not inside.all():
            cut = ~inside
            cut[self.owners[_at_walls(grid)]] = True
            self.volume[cut] = volume[cut]
        stray = np.flatnonzero((self.volume == 0) & inside)
        self.stray, self.cell = stray, grid.locate(points[stray])

    def _volumes(self, count: int) -> np.ndarray:
        volume = np.zeros(count)
        for part in _parts(self.grid.size):
            owners = self.owners[part].ravel()
            volume += np.bincount(owners, np.repeat(self.octants[part], 8), count)
        return volume

    def amounts(self, *carried: np.ndarray) -> list[np.ndarray]:
        found = []
        for values in carried:
            total = np.empty(self.grid.size)
            density = np.divide(values, self.volume, np.zeros(len(values)), where=self.volume > 0)
            for part in _parts(self.grid.size):
                total[part] = density[self.owners[part]].sum(axis=1) * self.octants[part]
            total += np.bincount(self.cell, values[self.stray], self.grid.size)
            found.append(total)
        return found


def _parts(size: int) -> Iterator[slice]:
    for first in reported_range(size, _CHUNK):
        yield slice(first, min(first + _CHUNK, size))


def _at_walls(grid: OctreeGrid) -> np.ndarray:
    low, size = grid.boxes(0, grid.size)
    walls: np.ndarray = ((low == 0) | (low + size == grid.extent[:, None])).any(axis=0)
    return walls
