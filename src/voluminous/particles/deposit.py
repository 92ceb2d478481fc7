"""What is deposited: amounts that particles carry, over the cells of a grid."""

from __future__ import annotations

import numpy as np

from ..grids import OctreeGrid


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
