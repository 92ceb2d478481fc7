"""Traces rays through pixels in batches, and stores each component of the paths in one array."""

from __future__ import annotations

import copy
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ..backend import clone_inputs, copy_into, dr
from ..backend.functions import flush_subnormal
from ..grids.contract import Ray
from ..schemes.path import Path, empty_path
from .march import Cutoff, MarchState, RayState, march
from .missing import Hiding, through_cells
from .pixels import BLOCK, MOST_KEPT, Lanes, PixelOrder, some_lanes, subpixel_offsets, whole_picture

if TYPE_CHECKING:
    from .job import RenderJob


# Sums below this multiple of the smallest normal number count as zero: they may have lost subnormal
# terms, depending on the number of threads.
MARGIN = 2.0**36


@dataclass
class RayBatch:
    """Rays that are traced together.

    Attributes
    ----------
    lanes : Lanes
        The rays.
    offset : (float, float)
        Additional offset within the pixels.
    first : int
        Index of the first ray's results.
    whole : (int, int), optional
        The pixels of the picture, if the lanes are cached and cover all of it.
    """

    lanes: Lanes
    offset: tuple[float, float] = (0.0, 0.0)
    first: int = 0
    whole: tuple[int, int] | None = None


@dataclass
class RayInputs:
    """Kernel inputs that change from picture to picture: arrays of one number each.

    Attributes
    ----------
    vectors : list of lists of arrays
        The camera's vectors.
    places : list of [array, array]
        Along both axes: the width of a pixel, and the position of the picture's centre.
    ending : Cutoff or None
        When rays stop.
    tolerance : tuple of arrays
        Error allowed in a segment, for schemes with error control.
    """

    vectors: list[list[Any]]
    places: list[list[Any]]
    ending: Cutoff | None
    tolerance: tuple[Any, ...]


class BatchResult:
    """Unevaluated results of a ray batch; evaluated by each call of `write`."""

    def __init__(self, path: Path, early: Any, lanes: Lanes) -> None:
        numbers = path.emission + path.transparency + path.depth + path.error
        kind = type(path.transparency[0] if path.transparency else numbers[0])
        self.numbers = [flush_subnormal(number, MARGIN) for number in numbers]
        self.numbers.append(dr.select(early, kind(1), 0))
        self.lanes, self.path = lanes, path

    def write(self, rows: list[Any], first: int) -> None:
        """Write all components to the output arrays, the first ray's at index `first`."""
        # Dr.Jit orders variables by scope: without a new scope, kernels traced now and earlier
        # would differ. Everything traced by another thread must be in one scope.
        dr.detail.new_scope(dr.backend_v(rows[0]))
        target = self.lanes.target + dr.opaque(type(self.lanes.target), first)
        for row, number in zip(rows, self.numbers, strict=True):
            dr.scatter(row, number, target, self.lanes.there)
        dr.eval(rows)


@dataclass
class Paths:
    """Paths of rays.

    Attributes
    ----------
    rows : list of array, shape (n,)
        One per component of a path. On the CPU they are the memory that kernels wrote to; copying
        them to one array took 2 ms of the 13 of a picture of 400 × 400.
    counts : (int, int, int)
        Number of emissions, extinctions and errors.
    stopped : bool
        Some rays stopped early.
    """

    rows: list[np.ndarray]
    counts: tuple[int, int, int]
    stopped: bool

    @property
    def emission(self) -> list[np.ndarray]:
        """Intensities, one row per emission."""
        return self.rows[: self.counts[0]]

    @property
    def transparency(self) -> list[np.ndarray]:
        """Transparencies, one row per extinction."""
        first, count, _ = self.counts
        return self.rows[first : first + count]

    @property
    def depth(self) -> list[np.ndarray]:
        """Optical depths, one row per extinction."""
        first, count, _ = self.counts
        return self.rows[first + count : first + 2 * count]

    @property
    def error(self) -> list[np.ndarray]:
        """Errors; see `schemes.path.Path`."""
        first, count, _ = self.counts
        return self.rows[first + 2 * count :]

    def some(self, index: np.ndarray) -> Paths:
        return _mapped(lambda row: row[index], [self])

    def put(self, index: np.ndarray, new: Paths) -> None:
        for row, values in zip(self.rows, new.rows, strict=True):
            row[index] = values
        self.stopped |= new.stopped

    def plus(self, other: Paths) -> Paths:
        """Return the sums with other paths, ray by ray."""
        return _mapped(np.add, [self, other])

    def times(self, factor: float) -> Paths:
        """Return the paths with all components multiplied by a factor."""
        return _mapped(lambda row: row * factor, [self])


def mean(found: Iterable[Paths]) -> Paths:
    """Return the mean of several sets of paths."""
    total, count = None, 0
    for one in found:
        total, count = one if total is None else total.plus(one), count + 1
    assert total is not None
    return total if count == 1 else total.times(1.0 / count)


def _mapped(function: Callable[..., np.ndarray], paths: Sequence[Paths]) -> Paths:
    rows = [function(*each) for each in zip(*(one.rows for one in paths), strict=True)]
    return Paths(rows, paths[0].counts, any(one.stopped for one in paths))


@dataclass
class Traced:
    """Result of a batch: flat indices of its pixels, and the paths of the whole picture so far.

    Paths of pixels that have not been traced yet hold zeros.
    """

    pixel: np.ndarray
    paths: Paths


Result = TypeVar("Result")


def exhausted(batches: Generator[Traced, None, Result]) -> Result:
    """Return the return value of a generator of batches."""
    while True:
        try:
            next(batches)
        except StopIteration as end:
            result: Result = end.value
            return result


# Maximum number of cells crossed per kernel launch: a fraction of a second, so that Ctrl-C works.
_STEPS_PER_BATCH = 5e7
# Rays in the first batch, if batches are limited in time.
_FIRST_LANES = 1 << 13


class RayTracer:
    """Traces a job's rays through its source.

    Attributes
    ----------
    kernels : KernelCache or None
        Cache of traced batches, which can be launched again.
    """

    def __init__(self, job: RenderJob, source: Any, brightest_background: float) -> None:
        self.job, self.source, self.backend = job, source, job.backend
        self.kernels: KernelCache | None = None
        grid, wide = job.volume.grid, job.backend.wide
        kind = source.walk_kind or job.walk_kind
        self.walk = source.walk or grid.walk(job.backend, kind)
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
        return exhausted(self.batches())

    def batches(
        self, seconds: float | None = None, focus: tuple[float, float] | None = None
    ) -> Generator[Traced, None, Paths]:
        """Trace all pixels: yield the result of each batch, and return all paths at the end."""
        total: Paths | None = None
        offsets = subpixel_offsets(self.job.samples)
        for offset in offsets:
            paths = yield from self._frame(offset, seconds, focus)
            total = paths if total is None else total.plus(paths)
        assert total is not None
        return total if len(offsets) == 1 else total.times(1.0 / len(offsets))

    def _frame(
        self,
        offset: tuple[float, float],
        seconds: float | None,
        focus: tuple[float, float] | None,
    ) -> Generator[Traced, None, Paths]:
        pixels, order = self.job.frame.pixels, PixelOrder(self.job.frame.pixels, focus)
        buffers = OutputBuffers(self, pixels[0] * pixels[1], partial=seconds is not None)
        size = self.batch if seconds is None else min(self.batch, _FIRST_LANES)
        whole = seconds is None and order.count <= min(size, MOST_KEPT)
        first = 0
        while first < order.count:
            count, start = min(size, order.count - first), time.monotonic()
            if whole:
                batch = RayBatch(whole_picture(pixels, self.backend), offset, whole=pixels)
            else:
                batch = RayBatch(order.lanes(first, count, self.backend), offset)
            self._draw(buffers, batch)
            self.job.advance(count, order.count)
            first += count
            if seconds is not None:
                took = time.monotonic() - start
                size = min(self.batch, size * 2 if took < 0.5 * seconds else size)
                size = max(BLOCK**2, size // 2 if took > seconds else size)
                yield Traced(batch.lanes.pixels, buffers.paths())
        return buffers.paths()

    def pixels(self, pixel: np.ndarray) -> Paths:
        """Return the mean paths of some pixels, given by their flat indices."""
        offsets = subpixel_offsets(self.job.samples)
        return mean(
            self.rays(pixel, np.full(len(pixel), du), np.full(len(pixel), dv)) for du, dv in offsets
        )

    def rays(self, pixel: np.ndarray, du: np.ndarray, dv: np.ndarray) -> Paths:
        gathered = OutputBuffers(self, len(pixel))
        for first in range(0, len(pixel), self.batch):
            part = slice(first, first + self.batch)
            lanes = self._lanes(pixel[part], du[part], dv[part])
            self._draw(gathered, RayBatch(lanes, first=first))
        return gathered.paths()

    def ray_through(self, pixel: np.ndarray, du: np.ndarray, dv: np.ndarray) -> Ray:
        """Return the rays themselves, on at least two lanes; see `rays`."""
        return self._ray(self._lanes(pixel, du, dv))

    def _lanes(self, pixel: np.ndarray, du: np.ndarray, dv: np.ndarray) -> Lanes:
        return some_lanes(pixel, du, dv, self.job.frame.pixels, self.backend)

    def _draw(self, gathered: OutputBuffers, batch: RayBatch) -> None:
        if self.kernels is None or not self.kernels.draw(self, batch, gathered.rows):
            found = self.found(batch.lanes, self.within(batch))
            found.write(gathered.rows, batch.first)

    def within(self, batch: RayBatch) -> list[Any]:
        """Return the offset of a batch's rays within pixels, as run-time numbers."""
        return [self.backend.wide(o) for o in batch.offset]

    def found(self, lanes: Lanes, within: list[Any]) -> BatchResult:
        """Return the traced, unevaluated results of rays."""
        state = self._followed(self._ray(lanes, within))
        return BatchResult(state.path, state.cursor.inside, lanes)

    @property
    def numbers(self) -> RayInputs:
        """Return all kernel inputs except those of walk, source and scheme."""
        return RayInputs(self.vectors, self.places, self.ending, self.source.tolerance)

    def reading(self, numbers: RayInputs) -> RayTracer:
        """Return a copy of this tracer whose kernels read other input arrays."""
        other = copy.copy(self)
        other.vectors, other.places, other.ending = numbers.vectors, numbers.places, numbers.ending
        if numbers.tolerance:
            other.source = copy.copy(self.source)
            other.source.tolerance = numbers.tolerance
        return other

    def _followed(self, ray: Ray) -> MarchState:
        before, backward = RayState(self.nothing()), self.job.backward
        try:
            return march(self.walk, self.source, self.scheme, ray, before, self.ending, backward)
        except RuntimeError as error:
            raise innermost(error) from None

    def nothing(self) -> Path:
        """Return the initial path of a ray."""
        return empty_path(self.backend.Float, *self.counts)

    @property
    def counts(self) -> tuple[int, int, int]:
        """Number of emissions, extinctions and errors of a path."""
        numbers = self.source.numbers
        return numbers.emissions, numbers.extinctions, 3 if self.job.scheme.controlled else 0

    def _ray(self, lanes: Lanes, within: Sequence[Any] | None = None) -> Ray:
        """Return the rays through positions in pixels; lanes without a ray are inactive."""
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
    """Return an estimate of the number of steps, relative to rays through all cells.

    Rays take fewer steps in empty space and where steps are wide. Batches are then fewer and longer
    (512³, a thin shell: 20 batches took 0.27 s, 2 take 0.22 s).
    """
    if blocks is None:
        return 1.0
    return float(max(blocks.filled ** (1 / 3) * blocks.share, 0.03))


class OutputBuffers:
    """Device arrays for the components of paths, and a last one that marks rays that stopped early.

    Every element is written once. Zeros are needed only if elements are read before (`partial`).
    """

    def __init__(self, tracer: RayTracer, count: int, *, partial: bool = False) -> None:
        self.counts, self.ending = tracer.counts, tracer.ending
        emissions, extinctions, errors = self.counts
        total = emissions + 2 * extinctions + errors + 1
        make = dr.zeros if partial else dr.empty
        self.rows = [make(tracer.backend.Float, count) for _ in range(total)]

    def paths(self) -> Paths:
        *rows, early = (row.numpy() for row in self.rows)
        return Paths(rows, self.counts, self.ending is not None and bool(np.any(early)))


def innermost(error: BaseException) -> BaseException:
    """Return the original error of a traced loop: Dr.Jit wraps it once per enclosing loop."""
    while isinstance(error, RuntimeError) and error.__cause__ is not None:
        error = error.__cause__
    return error


def reverse(ray: Ray) -> Any:
    """Return the reversed rays, towards the camera."""
    last = None if ray.first is None else -ray.first
    first = None if ray.last is None else -ray.last
    away = [-d for d in ray.direction]
    return replace(ray, direction=away, first=first, last=last)


# With more rays, unless they are a whole picture's, tracing is a small part of the time, and cached
# lanes take memory.
_MOST_RAYS = 1 << 16
# Maximum number of batches in the cache.
_KEPT = 8


class KernelCache:
    """Traced batches, for pictures that differ in their `RayInputs` alone.

    With the cache the core (100³, 400², without error control) takes 12.3 ms; tracing took 2.4 ms
    more. With error control, where some pixels are traced first, tracing took 8 ms in addition to
    70.
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[Any, CompiledBatch | None] = OrderedDict()
        self._lock = threading.Lock()

    def draw(self, tracer: RayTracer, batch: RayBatch, rows: list[Any]) -> bool:
        """Trace a batch with its cached kernel and write the results.

        Returns False, and does nothing, if the batch is new (most are traced only once) or large,
        or if another thread is tracing.
        """
        many = len(batch.lanes.target) > _MOST_RAYS and batch.whole is None
        if many or not self._lock.acquire(blocking=False):
            return False
        try:
            traced = self._traced(tracer, batch)
            if traced is not None:
                traced.draw(tracer, batch, rows)
            return traced is not None
        finally:
            self._lock.release()

    def _traced(self, tracer: RayTracer, batch: RayBatch) -> CompiledBatch | None:
        key = (len(batch.lanes.target), batch.whole)
        if key not in self._kept:
            self._kept[key] = None
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
            return None
        self._kept.move_to_end(key)
        traced = self._kept[key]
        if traced is None:
            traced = self._kept[key] = CompiledBatch(tracer, batch)
        return traced


class CompiledBatch:
    """A traced batch, with separate memory for its kernel's inputs."""

    def __init__(self, tracer: RayTracer, batch: RayBatch) -> None:
        self.read = clone_inputs(_read(tracer, batch))
        numbers, within, lanes = self.read
        self.found: BatchResult = tracer.reading(numbers).found(lanes or batch.lanes, within)

    def draw(self, tracer: RayTracer, batch: RayBatch, rows: list[Any]) -> None:
        dr.sync_thread()
        copy_into(self.read, _read(tracer, batch))
        self.found.write(rows, batch.first)


def _read(tracer: RayTracer, batch: RayBatch) -> tuple[Any, ...]:
    lanes = batch.lanes if batch.whole is None else None
    return tracer.numbers, tracer.within(batch), lanes
