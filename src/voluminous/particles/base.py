"""The domain of an octree: equal base cells, and which cell of a level is where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Base cells along the longest axis at most: kernels look at all base cells.
_BASE_CELLS = 8
# The volume of the domain may be larger by this factor, if base cells are fewer then.
_WASTE = 1.1
_MARGIN = 1e-12
# Below this, of which cubes are no numbers, all is in one place.
_LEAST = 1e-90


@dataclass(frozen=True)
class Base:
    """Equal base cells.

    Attributes
    ----------
    bounds : array, shape (3, 2)
    counts : array of int, shape (3,)
    periodic : bool
        What is beyond a wall is what is at the opposite one.
    """

    bounds: np.ndarray
    counts: np.ndarray
    periodic: bool = False

    @classmethod
    def around(cls, bounds: np.ndarray) -> Base:
        """Return base cells that are cubes, few of them, around what is within bounds."""
        # A little more: what is at the walls must not be lost by rounding.
        extent = np.ptp(bounds, axis=1) + _MARGIN * np.abs(bounds).max()
        longest = float(extent.max())
        longest = longest if longest > _LEAST else 1.0
        choices = [longest / n for n in range(1, _BASE_CELLS + 1)]
        filled = [np.prod(_cubes(extent, width) * width) for width in choices]
        width = next(w for w, f in zip(choices, filled, strict=True) if f <= _WASTE * min(filled))
        counts = _cubes(extent, width)
        middle = bounds.mean(axis=1)[:, None]
        return cls(middle + 0.5 * width * counts[:, None] * np.array([-1.0, 1.0]), counts)

    @classmethod
    def within(cls, bounds: np.ndarray, periodic: bool = False) -> Base:
        """Return base cells, as nearly cubes as can be, that fill bounds."""
        extent = np.ptp(bounds, axis=1)
        width = max(extent.min(), extent.max() / _BASE_CELLS)
        counts = np.maximum(np.rint(extent / width), 1).astype(int)
        return cls(bounds, counts, periodic)

    @property
    def edges(self) -> list[np.ndarray]:
        """Walls of the base cells along each axis."""
        pairs = zip(self.bounds, self.counts, strict=True)
        return [np.linspace(low, high, n + 1) for (low, high), n in pairs]

    @property
    def width(self) -> np.ndarray:
        """Widths of the base cells."""
        width: np.ndarray = np.ptp(self.bounds, axis=1) / self.counts
        return width

    def places(self, points: np.ndarray, level: int) -> np.ndarray:
        """Return which cells of a level points (n, 3) inside are in: int64."""
        cells = self.counts << level
        place = np.floor((points - self.bounds[:, 0]) * (cells / np.ptp(self.bounds, axis=1)))
        clipped: np.ndarray = np.clip(place, 0, cells - 1).astype(np.int64)
        return clipped

    def numbers(self, cells: np.ndarray, level: int | np.ndarray) -> np.ndarray:
        """Return one number, uint64, for each of some cells (n, 3) of a level."""
        x, y, z = cells.astype(np.uint64).T
        nx, ny, _ = (np.uint64(n) << np.asarray(level, np.uint64) for n in self.counts)
        numbers: np.ndarray = x + nx * (y + ny * z)
        return numbers

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Return which points are within bounds."""
        low, high = self.bounds.T
        return ((points >= low) & (points <= high)).all(axis=1)

    def wrapped(self, points: np.ndarray) -> np.ndarray:
        """Return points, those of a periodic domain in it."""
        if not self.periodic:
            return points
        low, size = self.bounds[:, 0], np.ptp(self.bounds, axis=1)
        return low + (points - low) % size


def _cubes(extent: np.ndarray, width: float) -> np.ndarray:
    return np.maximum(np.ceil(extent / width - 1e-9), 1).astype(int)
