"""Rays through pixels, in batches: marched, and gathered into one array per number of a path."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr
from ...grids.contract import Ray
from ...schemes.path import Path, empty_path
from .found import Batch, Found, Numbers
from .hidden import Hiding, through_cells
from .march import Cutoff, RayState, State, march
from .paths import Paths, mean
from .pixels import (
    BLOCK,
    MOST_KEPT,
    Lanes,
    PixelOrder,
    some_lanes,
    subpixel_offsets,
    whole_picture,
)

if TYPE_CHECKING:
    from ..job import Job
    from .kernels import Kernels

# Cells crossed per kernel launch, at most: a fraction of a second, so that Ctrl-C is heard.
_STEPS_PER_BATCH = 5e7


class Drawing:
    """A job's rays, ready to be marched through its source.

    Attributes
    ----------
    kernels : Kernels or None
        Where what is traced is kept, to be launched again.
    """

    def __init__(self, job: Job, source: Any, brightest_background: float) -> None:
        self.job, self.source, self.backend = job, source, job.backend
        self.kernels: Kernels | None = None
        grid, wide = job.volume.grid, job.backend.wide
        kind = getattr(source, "walk_kind", job.walk_kind)
        self.walk = getattr(source, "walk", None) or grid.walk(job.backend, kind)
        self.scheme = job.scheme
        if job.hidden is not None:
            self.walk = through_cells(self.walk, grid, job.backend)
            self.scheme = Hiding(job.scheme, job.hidden.on(job.backend))
        per_lane = _share_of_steps(source.blocks) * grid.cells_across
        self.batch = max(1, int(_STEPS_PER_BATCH / per_lane) // BLOCK**2) * BLOCK**2
        self.ending = self._ending(brightest_background)
        self.vectors = job.frame.traced_vectors(job.backend)
        self.places = [
            [wide(step), wide(shift)]
            for step, shift in zip(job.frame.pixel, job.frame.shift, strict=True)
        ]

    def frame(self) -> Paths:
        """Return the paths of all pixels, in the order of the image's rows."""
        return mean(self._frame(offset) for offset in subpixel_offsets(self.job.samples))

    def _frame(self, offset: tuple[float, float]) -> Paths:
        (nx, ny), order = self.job.frame.pixels, PixelOrder(self.job.frame.pixels)
        gathered = Gathered(self, nx * ny)
        kept = order.count <= min(self.batch, MOST_KEPT)
        for first in range(0, order.count, self.batch):
            count = min(self.batch, order.count - first)
            if kept:
                batch = Batch(whole_picture((nx, ny), self.backend), offset, whole=(nx, ny))
            else:
                batch = Batch(order.lanes(first, count, self.backend), offset)
            self._draw(gathered, batch)
            self.job.advance(count, order.count)
        return gathered.paths()

    def pixels(self, pixel: np.ndarray) -> Paths:
        """Return the mean paths of some pixels, given by their flat numbers."""
        offsets = subpixel_offsets(self.job.samples)
        return mean(
            self.rays(pixel, np.full(len(pixel), du), np.full(len(pixel), dv)) for du, dv in offsets
        )

    def rays(self, pixel: np.ndarray, du: np.ndarray, dv: np.ndarray) -> Paths:
        """Return the paths of single rays.

        Parameters
        ----------
        pixel : array of int, shape (n,)
            Flat numbers of their pixels.
        du, dv : array, shape (n,)
            Where in the pixel they go through, in pixels from its centre.
        """
        gathered = Gathered(self, len(pixel))
        for first in range(0, len(pixel), self.batch):
            part = slice(first, first + self.batch)
            lanes = self._lanes(pixel[part], du[part], dv[part])
            self._draw(gathered, Batch(lanes, first=first))
        return gathered.paths()

    def ray_through(self, pixel: np.ndarray, du: np.ndarray, dv: np.ndarray) -> Ray:
        """Return single rays themselves, on at least two lanes; see `rays`."""
        return self._ray(self._lanes(pixel, du, dv))

    def _lanes(self, pixel: np.ndarray, du: np.ndarray, dv: np.ndarray) -> Lanes:
        return some_lanes(pixel, du, dv, self.job.frame.pixels, self.backend)

    def _draw(self, gathered: Gathered, batch: Batch) -> None:
        if self.kernels is None or not self.kernels.draw(self, batch, gathered.rows):
            found = self.found(batch.lanes, self.within(batch))
            found.write(gathered.rows, batch.first)

    def within(self, batch: Batch) -> list[Any]:
        """Return where in pixels the rays of a batch go through, as run-time numbers."""
        return [self.backend.wide(o) for o in batch.offset]

    def found(self, lanes: Lanes, within: list[Any]) -> Found:
        """Return what rays find: traced, not computed."""
        state = self._followed(self._ray(lanes, within))
        return Found(state.path, state.cursor.inside, lanes)

    @property
    def numbers(self) -> Numbers:
        """All that a kernel reads besides what belongs to walk, source and scheme."""
        tolerance = getattr(self.source, "tolerance", ())
        return Numbers(self.vectors, self.places, self.ending, tolerance)

    def reading(self, numbers: Numbers) -> Drawing:
        """Return the same rays, but for the arrays that kernels read numbers from."""
        other = copy.copy(self)
        other.vectors, other.places, other.ending = numbers.vectors, numbers.places, numbers.ending
        if numbers.tolerance:
            other.source = copy.copy(self.source)
            other.source.tolerance = numbers.tolerance
        return other

    def _followed(self, ray: Ray) -> State:
        before, backward = RayState(self.nothing()), self.job.backward
        try:
            return march(self.walk, self.source, self.scheme, ray, before, self.ending, backward)
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

    def _ray(self, lanes: Lanes, within: Sequence[Any] | None = None) -> Ray:
        """Return the rays through places in pixels; lanes that are no rays have none."""
        within = within or [self.backend.wide(0.0)] * 2
        u, v = (
            dr.fma(place + o, step, shift)
            for place, o, (step, shift) in zip((lanes.u, lanes.v), within, self.places, strict=True)
        )
        ray = self.job.camera.rays(self.vectors, u, v)
        ray.active = lanes.there
        return reverse(ray) if self.job.backward else ray

    def _ending(self, brightest_background: float) -> Cutoff | None:
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


class Gathered:
    """Numbers of paths, one device array each, and at last where rays stopped early.

    Every place is written once: there is nothing to set to zero before.
    """

    def __init__(self, drawing: Drawing, count: int) -> None:
        self.counts, self.ending = drawing.counts, drawing.ending
        emissions, extinctions, errors = self.counts
        total = emissions + 2 * extinctions + errors + 1
        self.rows = [dr.empty(drawing.backend.Float, count) for _ in range(total)]

    def paths(self) -> Paths:
        """Return all of them."""
        *rows, early = (row.numpy() for row in self.rows)
        return Paths(rows, self.counts, self.ending is not None and bool(np.any(early)))


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
