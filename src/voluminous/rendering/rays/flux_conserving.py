"""RADMC-3D's recursion over parts of pixels: as many rays as the cells that they meet ask for.

A pixel is replaced by the mean of its four quarters while its longer side exceeds the width of the
narrowest cell that the ray through its centre meets (`narrowest`), and so is each quarter, for
itself. So small cells are not missed where they are, and rays not wasted where there are none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...geometry import CYLINDRICAL, SPHERICAL
from .drawing import Drawing
from .narrowest import Narrowest, NarrowestOfTree
from .narrowest_round import NarrowestOfCylinder, NarrowestOfSphere
from .paths import Paths

if TYPE_CHECKING:
    from ..job import Job

# Parts of pixels looked at together: a stack of them never holds many more.
_TOGETHER = 1 << 18
# How often a pixel may be halved along each side: beyond, it is a mistake.
_DEEPEST = 12
_QUARTERS = np.array([(-1, -1), (1, -1), (-1, 1), (1, 1)])


@dataclass
class Parts:
    """Squares in pixels: which entry of a list of pixels, where the centre is, how often halved.

    Attributes
    ----------
    entry : int array, shape (n,)
    center : array, shape (2, n)
        In pixels, from the pixel's centre.
    depth : int
    """

    entry: np.ndarray
    center: np.ndarray
    depth: int

    @property
    def share(self) -> float:
        """Their area in pixels."""
        return float(0.25**self.depth)

    def of(self, index: Any) -> Parts:
        """Return some of them."""
        return Parts(self.entry[index], self.center[:, index], self.depth)

    def quarters(self) -> Parts:
        """Return four quarters of each."""
        half = 0.25 * 0.5**self.depth
        center = self.center[:, :, None] + half * _QUARTERS.T[:, None, :]
        return Parts(np.repeat(self.entry, 4), center.reshape(2, -1), self.depth + 1)


class FluxConserving(Drawing):
    """A job's rays, in parts of pixels as small as the cells that they meet."""

    def __init__(self, job: Job, source: Any, brightest_background: float) -> None:
        super().__init__(job, source, brightest_background)
        self.narrowest = _narrowest(job)
        self.width = max(job.frame.pixel)

    def frame(self) -> Paths:
        nx, ny = self.job.frame.pixels
        return self.pixels(np.arange(nx * ny))

    def pixels(self, pixel: np.ndarray) -> Paths:
        waiting = [Parts(np.arange(len(pixel)), np.zeros((2, len(pixel))), 0)]
        means = _Means(len(pixel))
        while waiting:
            parts = waiting.pop()
            if len(parts.entry) > _TOGETHER:
                waiting.append(parts.of(slice(_TOGETHER, None)))
                parts = parts.of(slice(_TOGETHER))
            large = self._too_large(pixel, parts)
            if large.any():
                waiting.append(parts.of(large).quarters())
            small = parts.of(~large)
            if len(small.entry):
                means.add(self.rays(pixel[small.entry], *small.center), small)
            self._report(means.area, len(pixel))
        return means.paths()

    def _too_large(self, pixel: np.ndarray, parts: Parts) -> np.ndarray:
        """Return which parts are wider than the narrowest cell on the way through their centres."""
        nx, (u, v) = self.job.frame.pixels[0], parts.center
        ray_pixel, width = pixel[parts.entry], self.width * 0.5**parts.depth
        large = np.empty(len(ray_pixel), bool)
        for first in range(0, len(ray_pixel), self.batch):
            part = slice(first, first + self.batch)
            ray = self.ray_through(ray_pixel[part], u[part], v[part])
            large[part] = (width > self.narrowest.along(ray))[: len(large[part])]
        if large.any() and parts.depth == _DEEPEST:
            where = int(ray_pixel[np.argmax(large)])
            raise InputError(
                f"flux conservation needs more than {2**_DEEPEST} x {2**_DEEPEST} rays for a pixel "
                f"(ix = {where % nx}, iy = {where // nx}): take more pixels, a smaller width, or "
                "samples='adaptive'"
            )
        return large

    def _report(self, area: float, pixels: int) -> None:
        total = int(np.prod(self.job.frame.pixels))
        if pixels == total:
            self.job.advance(max(0, int(area) - self.job.done), total)


class _Means:
    """Paths of parts of pixels, weighted by their areas."""

    def __init__(self, count: int) -> None:
        self.count, self.area, self.stopped = count, 0.0, False
        self.rows: Any = 0.0
        self.dtype: Any = None
        self.counts = (0, 0, 0)

    def add(self, paths: Paths, parts: Parts) -> None:
        self.counts, self.dtype = paths.counts, paths.rows[0].dtype
        weighted = parts.share * np.stack(paths.rows).astype(np.float64)
        self.rows += np.array([np.bincount(parts.entry, row, self.count) for row in weighted])
        self.area += parts.share * len(parts.entry)
        self.stopped |= paths.stopped

    def paths(self) -> Paths:
        return Paths(list(self.rows.astype(self.dtype)), self.counts, self.stopped)


def _narrowest(job: Job) -> Narrowest:
    """Return what finds the narrowest cells that a job's rays meet.

    Raises
    ------
    InputError
        If there is no rule for such a grid.
    """
    grid, kind = job.volume.grid, tuple(job.volume.grid.coordinates)
    if kind == SPHERICAL:
        return NarrowestOfSphere(grid, job.backend, job.backward)
    if kind == CYLINDRICAL:
        return NarrowestOfCylinder(grid, job.backend)
    if grid.base_edges:
        return NarrowestOfTree(grid, job.backend)
    raise InputError(
        f"samples='flux-conserving' is not known on a {type(grid).__name__}; use samples='adaptive'"
    )
