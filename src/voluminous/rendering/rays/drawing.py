"""Rays through pixels, in batches: marched, and gathered into one array per number of a path."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr
from ...backend.functions import flush_subnormal
from ...grids.contract import Ray, cells_across
from ...schemes.path import Path, empty_path, plus, times
from .hidden import Hiding, through_cells
from .march import Cutoff, State, march
from .paths import Paths, mean
from .pixels import BLOCK, Lanes, PixelOrder, some_lanes, subpixel_offsets

if TYPE_CHECKING:
    from ..job import Job

# Cells crossed per kernel launch, at most: a fraction of a second, so that Ctrl-C is heard.
_STEPS_PER_BATCH = 5e7
# Sums below so many times the smallest normal number count as zero: they may have lost subnormal
# terms, and with how many threads, decides.
MARGIN = 2.0**36


class Drawing:
    """A job's rays, ready to be marched through its source."""

    def __init__(self, job: Job, source: Any, brightest_background: float) -> None:
        self.job, self.source, self.backend = job, source, job.backend
        grid = job.volume.grid
        kind = getattr(source, "walk_kind", job.walk_kind)
        self.walk = getattr(source, "walk", None) or grid.walk(job.backend, kind)
        self.scheme = job.scheme
        if job.hidden is not None:
            self.walk = through_cells(self.walk, grid, job.backend)
            self.scheme = Hiding(job.scheme, job.hidden.on(job.backend))
        per_lane = _share_of_steps(source.blocks) * cells_across(grid)
        self.batch = max(1, int(_STEPS_PER_BATCH / per_lane) // BLOCK**2) * BLOCK**2
        self.ending = self._ending(brightest_background)

    def frame(self) -> Paths:
        """Return the paths of all pixels, in the order of the image's rows."""
        job, (nx, ny) = self.job, self.job.frame.pixels
        order, gathered = PixelOrder((nx, ny)), _Gathered(self, nx * ny)
        for first in range(0, order.count, self.batch):
            count = min(self.batch, order.count - first)
            lanes = order.lanes(first, count, self.backend)
            path, early = self._mean(lanes, order.count)
            gathered.add(path, early, lanes)
            if job.samples == 1:
                job.advance(self.batch, order.count)
        return gathered.paths()

    def pixels(self, pixel: np.ndarray) -> Paths:
        """Return the mean paths of some pixels, given by their flat numbers."""
        offsets = subpixel_offsets(self.job.samples)
        found = [
            self.rays(pixel, np.full(len(pixel), du), np.full(len(pixel), dv)) for du, dv in offsets
        ]
        return mean(found)

    def rays(self, pixel: np.ndarray, du: np.ndarray, dv: np.ndarray) -> Paths:
        """Return the paths of single rays.

        Parameters
        ----------
        pixel : array of int, shape (n,)
            Flat numbers of their pixels.
        du, dv : array, shape (n,)
            Where in the pixel they go through, in pixels from its centre.
        """
        gathered = _Gathered(self, len(pixel))
        for first in range(0, len(pixel), self.batch):
            part = slice(first, first + self.batch)
            lanes = self._lanes(pixel[part], du[part], dv[part])
            path, early = self._march(lanes)
            gathered.add(path, early, lanes, first)
        return gathered.paths()

    def ray_through(self, pixel: np.ndarray, du: np.ndarray, dv: np.ndarray) -> Ray:
        """Return single rays themselves, on at least two lanes; see `rays`."""
        return self._ray(self._lanes(pixel, du, dv))

    def _lanes(self, pixel: np.ndarray, du: np.ndarray, dv: np.ndarray) -> Lanes:
        return some_lanes(pixel, du, dv, self.job.frame.pixels, self.backend)

    def _mean(self, lanes: Lanes, total_lanes: int) -> tuple[Path, Any]:
        """Return the mean paths of some pixels over their sub-pixels."""
        job = self.job
        total, early = None, self.backend.Bool(False)
        for offset in subpixel_offsets(job.samples):
            path, stopped = self._march(lanes, offset)
            early |= stopped
            if job.samples == 1:
                return path, early
            total = path if total is None else plus(total, path)
            dr.eval(total, early)  # one kernel per sub-pixel, the same one each time
            job.advance(len(lanes.u), total_lanes)
        assert total is not None
        return times(total, 1.0 / job.samples**2), early

    def _march(self, lanes: Lanes, offset: tuple[float, float] = (0.0, 0.0)) -> tuple[Path, Any]:
        """Return the paths through places in pixels, and the lanes that stopped early."""
        state = self._followed(self._ray(lanes, offset))
        return state.path, state.cursor.inside

    def _followed(self, ray: Ray) -> State:
        """Return what rays have gathered."""
        path, backward = self.nothing(), self.job.backward
        try:
            return march(self.walk, self.source, self.scheme, ray, path, self.ending, backward)
        except RuntimeError as error:
            raise innermost(error) from None

    def nothing(self) -> Path:
        """Return what a ray has gathered at first."""
        return empty_path(self.backend.Float, *self.counts)

    @property
    def counts(self) -> tuple[int, int, int]:
        """How many emissions, extinctions and errors a path has."""
        numbers = self.source.numbers
        return numbers.emissions, numbers.extinctions, 3 if self.job.scheme.controlled else 0

    def _ray(self, lanes: Lanes, offset: tuple[float, float] = (0.0, 0.0)) -> Ray:
        """Return the rays through places in pixels; lanes that are no rays have none."""
        wide, frame = self.backend.wide, self.job.frame
        u, v = (
            dr.fma(place + wide(o), wide(step), wide(shift))
            for place, o, step, shift in zip(
                (lanes.u, lanes.v), offset, frame.pixel, frame.shift, strict=True
            )
        )
        ray = self.job.camera.rays(frame.traced_vectors(self.backend), u, v)
        ray.active = lanes.there
        return reverse(ray) if self.job.backward else ray

    def _ending(self, brightest_background: float) -> Cutoff | None:
        """Return the criterion at which rays stop; None if they never do."""
        job, numbers = self.job, self.source.numbers
        if job.backward or job.cutoff == 0.0:
            return None
        opaque = self.backend.opaque
        if job.cutoff is not None:
            return Cutoff(opaque(1.0), [], opaque(job.cutoff))
        bounds = job.volume.grid.bounds
        diagonal = float(np.linalg.norm(bounds[:, 1] - bounds[:, 0])) / job.volume.grid.scale
        most = numbers.brightest(self.source.largest) * diagonal
        most += brightest_background / numbers.unit
        most = min(most, float(np.finfo(self.backend.dtype).max))  # no bound: rays hardly stop
        weights = [opaque(job.early_error * float(w)) for w in numbers.weights()]
        return Cutoff(opaque(most), weights, opaque(0.0))


def _share_of_steps(blocks: Any) -> float:
    """Return about how many steps rays take, of those through all cells.

    Few in empty space, and where steps are wide: fewer, longer batches then (512³, a thin shell: 20
    batches took 0.27 s, 2 take 0.22 s).
    """
    if blocks is None:
        return 1.0
    return float(max(blocks.filled ** (1 / 3) * blocks.share, 0.03))


class _Gathered:
    """Numbers of paths, scattered into one device array each."""

    def __init__(self, drawing: Drawing, count: int) -> None:
        self.counts, self.ending = drawing.counts, drawing.ending
        emissions, extinctions, errors = self.counts
        total = emissions + 2 * extinctions + errors
        self.rows = [dr.zeros(drawing.backend.Float, count) for _ in range(total)]
        self.stopped = False

    def add(self, path: Path, early: Any, lanes: Lanes, first: int = 0) -> None:
        """Write the paths of a batch to where they belong, counted from the first of its rays."""
        there = lanes.there
        target = lanes.target + dr.opaque(type(lanes.target), first)
        numbers = path.emission + path.transparency + path.depth + path.error
        for row, number in zip(self.rows, numbers, strict=True):
            dr.scatter(row, flush_subnormal(number, MARGIN), target, there)
        dr.eval(self.rows, early)
        self.stopped |= bool(dr.any(early)) if self.ending is not None else False

    def paths(self) -> Paths:
        """Return all of them."""
        return Paths([np.asarray(row) for row in self.rows], self.counts, self.stopped)


def innermost(error: BaseException) -> BaseException:
    """Return what went wrong inside a traced loop: Dr.Jit wraps it once for every loop around."""
    while isinstance(error, RuntimeError) and error.__cause__ is not None:
        error = error.__cause__
    return error


def reverse(ray: Any) -> Any:
    """Return rays that run the other way, towards the camera."""
    last = None if ray.first is None else -ray.first
    first = None if ray.last is None else -ray.last
    away = [-d for d in ray.direction]
    return replace(ray, direction=away, first=first, last=last)
