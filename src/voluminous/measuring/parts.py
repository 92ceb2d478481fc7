"""Which part of each cell is measured: where a condition holds, and inside of a region."""

from __future__ import annotations

from numbers import Integral
from typing import Any

import numpy as np

from ..errors import InputError
from ..geometry import CARTESIAN, metric, mirror_images, position
from ..regions import Region
from .conditions import condition, holds

# Cells looked at at once.
CHUNK = 1 << 18
# Of a cell that is inside entirely the parts need not add up to one.
_ROUNDING = 1e-12


class Parts:
    """The part of each cell that is measured.

    Parameters
    ----------
    volume : Volume
        As it is seen.
    where : str, optional
        A condition on the fields: it holds in a cell or not.
    region : Region, optional
        Cells on its surface are divided into ``samples**3`` parts, of which those count that have
        their centre inside.

    Raises
    ------
    InputError
        If `samples` is not positive.
    """

    def __init__(self, volume: Any, where: Any, region: Region | None, samples: Any) -> None:
        if not isinstance(samples, Integral) or samples < 1:
            raise InputError(f"samples must be a positive whole number, got {samples!r}")
        self.volume, self.region, self.samples = volume, region, int(samples)
        self.where = None if where is None else condition(volume, where)

    @property
    def everything(self) -> bool:
        """True if nothing is left out."""
        return self.where is None and self.region is None

    def of(self, first: int, last: int) -> np.ndarray:
        """Return the parts of consecutive cells, from 0 to 1."""
        part = np.ones(last - first)
        if self.where is not None:
            part *= holds(self.volume, self.where, first, last)
        if self.region is not None:
            part *= self._inside(first, last)
        return part

    def whole(self) -> np.ndarray:
        """Return the parts of all cells, of the grid's shape."""
        grid = self.volume.grid
        found = [self.of(a, min(a + CHUNK, grid.size)) for a in range(0, grid.size, CHUNK)]
        return np.concatenate(found).reshape(grid.shape)

    def _inside(self, first: int, last: int) -> np.ndarray:
        """Return the parts of cells that are in the region."""
        assert self.region is not None
        corners = self._tally(first, last, np.arange(last - first), (0.0, 0.5, 1.0))
        part = np.round(corners)  # all points inside, or none
        divided = np.flatnonzero(((corners > 0) & (corners < 1)) | self._cut(first, last))
        if divided.size:
            steps = (np.arange(self.samples) + 0.5) / self.samples
            part[divided] = self._tally(first, last, divided, tuple(steps))
        return part

    def _cut(self, first: int, last: int) -> np.ndarray:
        """Return which boxes the region's surface may pass through, between their corners."""
        assert self.region is not None
        grid = self.volume.grid
        if tuple(grid.coordinates) != CARTESIAN:
            return np.zeros(last - first, dtype=bool)
        reach = 0.5 * np.linalg.norm(np.asarray(grid.cell_sizes(first, last)), axis=0)
        away = self.region.beyond(np.asarray(grid.cell_centers(first, last)), grid.unit)
        return np.asarray(np.abs(away) < reach)

    def _tally(
        self, first: int, last: int, cells: np.ndarray, steps: tuple[float, ...]
    ) -> np.ndarray:
        """Return the part that is inside, of points at fractions of cells along each axis."""
        assert self.region is not None
        grid, system = self.volume.grid, tuple(self.volume.grid.coordinates)
        inside, total, images = np.zeros(len(cells)), np.zeros(len(cells)), mirror_images(grid)
        low, size = (a[:, cells] for a in _native_boxes(grid, first, last))
        for place in np.array(np.meshgrid(steps, steps, steps)).reshape(3, -1).T:
            native = low + place[:, None] * size
            points = position(system, native)
            weight = np.abs(np.prod(metric(system, native), axis=0)) + 1e-300
            total += weight
            for image in images:
                found = self.region.inside(points * image[:, None], grid.unit)
                inside += weight * found / len(images)
        return np.where(inside > (1 - _ROUNDING) * total, 1.0, inside / total)


def _native_boxes(grid: Any, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
    """Return lower corners and sizes of cells in the grid's own coordinates."""
    if tuple(grid.coordinates) == CARTESIAN:
        size = np.asarray(grid.cell_sizes(first, last))
        return np.asarray(grid.cell_centers(first, last)) - 0.5 * size, size
    low, high = grid.spans(first, last)
    return low, high - low
