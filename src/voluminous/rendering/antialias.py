"""Antialiasing: more rays where the picture is not smooth, or RADMC-3D's recursion."""

from __future__ import annotations

import functools
from collections.abc import Generator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import Backend, dr, from_host
from ..backend.types import Int
from ..errors import InputError
from ..geometry import CYLINDRICAL, SPHERICAL
from ..grids.contract import Ray
from .tolerance import in_kernel_unit
from .tracer import Paths, RayTracer, Traced, reverse

if TYPE_CHECKING:
    from ..grids.contract import Segment
    from ..schemes.base import Source
    from .job import RenderJob
    from .tracer import RayTracer


# Rays per pixel after each round.
_ROUNDS = (8, 16, 32, 64, 128, 256)
# A mean has converged when each of two consecutive rounds changed it by less than the tolerance.
_LEAST = 32
# Roberts' sequence in two dimensions: the inverse plastic number, x³ = x + 1, and its square.
_PLASTIC = 1.32471795724474602596
# Second differences of neighbours below this many tolerances are smooth. The difference between a
# pixel's mean and its centre value is a twelfth of them where the picture is smooth, and up to a
# half, a fourth on average over all positions, where it has small edges; this is included in the
# error.
_SMOOTH = 4.0


@dataclass
class Means:
    """Sums over the rays of some pixels, with the resulting picture values and their errors.

    Rows are picture values, see `_seen`, in the unit in which differences are compared.

    Attributes
    ----------
    seen : array, shape (row, n)
        The mean over the rays so far.
    low, high : array, shape (row, n)
        Minimum and maximum over single rays: the pixel's, and those through the centres of the
        neighbouring pixels.
    off : array, shape (row, n)
        Change of the mean by the last rays.
    """

    pixel: np.ndarray
    total: Paths
    count: int
    seen: np.ndarray
    low: np.ndarray
    high: np.ndarray
    off: np.ndarray

    def take(self, tracer: RayTracer, scale: np.ndarray, count: int) -> None:
        """Trace more rays, up to a number per pixel.

        Each is reported: there may be many times as many as the picture has pixels.
        """
        numbers = range(self.count, count)
        for done, number in enumerate(numbers):
            tracer.job.progress(done * len(self.pixel), len(numbers) * len(self.pixel))
            found = tracer.rays(self.pixel, *_offsets(self.pixel, number))
            self._add(found, _seen(tracer, found) / scale)
        self.count = count
        now = _seen(tracer, self.mean()) / scale
        self.seen, self.off = now, np.abs(now - self.seen)

    def _add(self, found: Paths, seen: np.ndarray) -> None:
        self.total = self.total.plus(found)
        self.low, self.high = np.minimum(self.low, seen), np.maximum(self.high, seen)

    def mean(self) -> Paths:
        return self.total.times(1.0 / self.count)

    def wrong(self) -> np.ndarray:
        """Return the errors of rows."""
        return np.maximum(self.off, left_of_edges(self.high - self.low, self.count))

    def some(self, index: np.ndarray) -> Means:
        rows = (row[:, index] for row in (self.seen, self.low, self.high, self.off))
        return Means(self.pixel[index], self.total.some(index), self.count, *rows)


def refine(tracer: RayTracer, paths: Paths, tolerance: float) -> None:
    """Replace the paths of pixels where the picture is not smooth by means over more rays."""
    seen, pixels = _seen(tracer, paths), tracer.job.frame.pixels
    scale = _scale(seen, len(paths.transparency))
    seen = seen / scale
    low, high = _around(seen, pixels)
    bends = _bends(seen, pixels)
    rough = _rough(bends, pixels, _SMOOTH * tolerance)
    smooth = np.setdiff1d(np.arange(seen.shape[1]), rough, assume_unique=True)
    unit = tracer.source.numbers.unit
    _count(paths, smooth, bends[:, smooth] / _SMOOTH, scale, unit)
    unsettled = np.full_like(seen, np.inf)
    everywhere = Means(np.arange(seen.shape[1]), paths, 1, seen, low, high, unsettled)
    means = everywhere.some(rough)
    for count in _ROUNDS:
        if not len(means.pixel):
            break
        before = means.off
        means.take(tracer, scale, count)
        paths.put(means.pixel, means.mean())
        _count(paths, means.pixel, means.wrong(), scale, unit)
        changed = np.maximum(means.off, before).max(axis=0)
        means = means.some(np.flatnonzero((changed > tolerance) | (count < _LEAST)))


def left_of_edges(spread: np.ndarray, count: int) -> np.ndarray:
    """Return the error of means over a number of rays, due to an edge of some height.

    For sequences like these it was 0.3 of the returned value, which includes three deviations.
    """
    return np.asarray(spread * count**-0.75)


def _offsets(pixel: np.ndarray, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a point of the sequence for each pixel, relative to its centre (-½ to ½)."""
    shifts = (_hashed(pixel, salt) for salt in (0x9E3779B9, 0x85EBCA6B))
    steps = (1.0 / _PLASTIC, 1.0 / _PLASTIC**2)
    du, dv = (np.mod(s + number * step, 1.0) - 0.5 for s, step in zip(shifts, steps, strict=True))
    return du, dv


def _hashed(pixel: np.ndarray, salt: int) -> np.ndarray:
    """Return pseudo-random numbers in [0, 1) for pixels (Steele et al. 2014)."""
    h = pixel.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(salt)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return ((h ^ (h >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53


def _seen(tracer: RayTracer, paths: Paths) -> np.ndarray:
    """Return the picture values of paths, in rows: intensities, then transparencies."""
    mixed = tracer.source.numbers.mix(paths.emission)
    return np.vstack([np.moveaxis(mixed, -1, 0), *(row[None] for row in paths.transparency)])


def _scale(seen: np.ndarray, extinctions: int) -> np.ndarray:
    brightest = float(np.max(np.abs(seen[:-extinctions]), initial=0.0))
    column = np.full((len(seen), 1), brightest if brightest > 0 else 1.0, seen.dtype)
    column[-extinctions:] = 1.0
    return column


def _bends(seen: np.ndarray, pixels: tuple[int, int]) -> np.ndarray:
    """Return the second differences of rows at each pixel: the larger of both axes.

    Pixels at the frame's edge take the value of the next ones. Two pixels in a row give their
    difference, a single one infinity.
    """
    nx, ny = pixels
    planes = seen.reshape(-1, ny, nx)
    found = [_bends_along(planes, axis) for axis in (1, 2)]
    return np.maximum(*found).reshape(seen.shape)


def _bends_along(planes: np.ndarray, axis: int) -> np.ndarray:
    """Return the second differences of planes along one axis, at each of their pixels."""
    size = planes.shape[axis]
    if size == 1:
        return np.full_like(planes, np.inf)
    bends = np.abs(np.diff(planes, min(size - 1, 2), axis=axis))
    around = [(0, 0)] * planes.ndim
    around[axis] = (1, size - 1 - bends.shape[axis])
    return np.pad(bends, around, mode="edge")


def _rough(bends: np.ndarray, pixels: tuple[int, int], limit: float) -> np.ndarray:
    """Return the flat indices of pixels at or beside which second differences exceed a limit."""
    nx, ny = pixels
    bent = bends.max(axis=0) > limit
    return np.flatnonzero(_dilated(bent.reshape(ny, nx)))


def _around(seen: np.ndarray, pixels: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the minimum and maximum over a pixel and its neighbours, in the same rows."""
    nx, ny = pixels
    planes = np.pad(seen.reshape(-1, ny, nx), ((0, 0), (1, 1), (1, 1)), mode="edge")
    shifts = [planes[:, a : a + ny, b : b + nx] for a in range(3) for b in range(3)]
    low, high = (functools.reduce(extreme, shifts) for extreme in (np.minimum, np.maximum))
    return low.reshape(seen.shape), high.reshape(seen.shape)


def _dilated(mask: np.ndarray) -> np.ndarray:
    wide = np.pad(mask, 1)
    return np.logical_or.reduce(
        [wide[a : a + mask.shape[0], b : b + mask.shape[1]] for a in range(3) for b in range(3)]
    )


def _count(
    paths: Paths, pixel: np.ndarray, wrong: np.ndarray, scale: np.ndarray, unit: float
) -> None:
    """Add the errors of the rows of some pixels to their paths.

    Errors of intensities are in the kernel's unit; those of transparencies are weighted by the
    background.
    """
    if paths.error:
        extinctions = len(paths.transparency)
        brightest = in_kernel_unit(float(scale[0, 0]), unit)
        paths.error[0][pixel] += wrong[:-extinctions].max(axis=0) * brightest
        paths.error[1][pixel] += wrong[-extinctions:].max(axis=0)


@dataclass
class WidthState:
    """Loop state: a ray's position, and the smallest width so far."""

    cursor: Any
    least: Any


class MinCellWidth:
    """Computes the width of the narrowest cell along rays."""

    def __init__(self, grid: Any, backend: Backend) -> None:
        self.grid, self.backend = grid, backend
        self.walk = grid.walk(backend)

    def along(self, ray: Ray) -> np.ndarray:
        """Return the width of the narrowest cell that each ray meets, in the grid's unit."""
        track, cursor = self.walk.enter(ray)
        sight = self.sight(ray)

        def inside(state: WidthState) -> Any:
            return state.cursor.inside

        def step(state: WidthState) -> tuple[WidthState]:
            here = state.cursor
            if self.walk.has_gaps:
                here = self.walk.cross(track, here).cursor
            segment, cursor = self.walk.next(track, here)
            width = self.width(here, segment, sight)
            narrower = segment.active & (segment.length > 0.0) & (width < state.least)
            return (WidthState(cursor, dr.select(narrower, width, state.least)),)

        state = WidthState(cursor, self.before(sight, dr.width(ray.direction)))
        (state,) = dr.while_loop((state,), inside, step, label="min_cell_width")
        return np.asarray(state.least, np.float64) * self.unit

    unit: float

    def sight(self, ray: Ray) -> Any:
        """Return the geometry of rays that `width` needs."""
        return None

    def before(self, sight: Any, count: int) -> Any:
        """Return the initial widths of rays."""
        raise NotImplementedError

    def width(self, cursor: Any, segment: Segment, sight: Any) -> Any:
        """Return the width of the cell of a segment."""
        raise NotImplementedError


class TreeCellWidth(MinCellWidth):
    """Widths in units of the first base cell's finest parts."""

    def __init__(self, grid: Any, backend: Backend) -> None:
        super().__init__(grid, backend)
        largest = int(np.argmin(grid.levels))
        self.largest = float(grid.boxes(largest, largest + 1)[1][0, 0])
        edges = grid.base_edges[0]
        self.unit = float((edges[1] - edges[0]) / grid.divisions[0])

    def before(self, sight: Any, count: int) -> Any:
        return dr.full(self.backend.Float, self.largest, count)

    def width(self, cursor: Any, segment: Segment, sight: Any) -> Any:
        lookup = self.walk.lookup
        width = lookup.sizes(cursor.cell)[0]
        return dr.select(lookup.is_cell(cursor.cell), width, self.largest)


# Minimum relative size, and minimum and maximum angular size, of a cell.
_THINNEST = 0.003
_LEAST_ANGLE, _MOST_ANGLE = 0.05, 0.3
# Width of the central cavity for rays through it, as a fraction of the innermost radius.
_OF_CAVITY = 0.05


@dataclass
class RaySight:
    """Geometry of rays relative to the centre.

    Attributes
    ----------
    closest : array
        Distance of closest approach.
    arrive : array
        Distance from the closest point at which they enter the outermost sphere: negative.
    polar : array
        Absolute z component of the direction.
    """

    closest: Any
    arrive: Any
    polar: Any


class SphericalCellWidth(MinCellWidth):
    """The rule for spherical grids; widths in units of the grid's scale.

    RADMC-3D traces rays towards the camera, and the rule depends on the direction.

    Parameters
    ----------
    backward : bool
        Rays run towards the camera.
    """

    def __init__(self, grid: Any, backend: Backend, backward: bool) -> None:
        super().__init__(grid, backend)
        self.backward = backward
        self.unit = grid.scale
        r = grid.edges[0] / grid.scale
        self.inner, self.outer = backend.wide(r[0]), backend.wide(r[-1])
        # On grids without refinement, cells that differ in φ only have the same sizes.
        self.alike = dr.opaque(backend.UInt, grid.shape[2] if grid.is_structured else 1)
        low, high = _profile(grid)
        across = np.minimum(np.minimum(low[1] + high[1], 2 * np.pi - low[1] - high[1]) / 2, 1.0)
        polar = high[1] - low[1]
        # Width along r, and angles along θ and φ (sic: RADMC-3D takes θ's for both).
        self.sizes = _packets(
            backend,
            0.5 * (low[0] + high[0]) / grid.scale,
            _depth(low[0], high[0]) / grid.scale,
            np.clip(polar, _LEAST_ANGLE, _MOST_ANGLE),
            np.clip(across * polar, _LEAST_ANGLE, _MOST_ANGLE),
        )

    def along(self, ray: Ray) -> np.ndarray:
        return super().along(ray if self.backward else reverse(ray))

    def sight(self, ray: Ray) -> RaySight:
        to_scale = self.backend.wide(1.0 / self.grid.scale)
        origin = [o * to_scale for o in ray.origin]
        way = -sum(o * d for o, d in zip(origin, ray.direction, strict=True))
        nearest = [dr.fma(way, d, o) for o, d in zip(origin, ray.direction, strict=True)]
        square = sum(n * n for n in nearest)
        arrive = -dr.sqrt(dr.maximum(self.outer * self.outer - square, 0.0))
        own = self.backend.Float
        return RaySight(own(dr.sqrt(square)), own(arrive), own(dr.abs(ray.direction[2])))

    def before(self, sight: RaySight, count: int) -> Any:
        inner = self.backend.Float(self.inner)
        return dr.select(sight.closest <= inner, _OF_CAVITY * inner, np.inf)

    def width(self, cursor: Any, segment: Segment, sight: RaySight) -> Any:
        kind = self.backend.quotient(segment.cell, self.alike)
        radius, depth, along_theta, along_phi = dr.gather(
            self.backend.packet(4), self.sizes, kind, segment.active
        )
        across, around = radius * along_theta, radius * along_phi
        way = segment.begin + sight.arrive
        distance = dr.sqrt(dr.fma(way, way, sight.closest * sight.closest))
        upright = dr.abs(way) / distance
        tilted = dr.lerp(around, across, sight.polar) * upright
        width = dr.minimum(dr.minimum(across, around), tilted)
        return dr.maximum(depth, width)


class CylindricalCellWidth(MinCellWidth):
    """Widths along R, φ and z, with the limits that RADMC-3D has for spherical grids."""

    def __init__(self, grid: Any, backend: Backend) -> None:
        super().__init__(grid, backend)
        self.unit = grid.scale
        low, high = grid.spans()
        middle = 0.5 * (low[0] + high[0])
        around = middle * np.clip(high[1] - low[1], _LEAST_ANGLE, _MOST_ANGLE)
        width = np.minimum(np.minimum(_depth(low[0], high[0]), around), high[2] - low[2])
        self.widths = from_host(backend.Float, width / grid.scale)
        self.widest = float(width.max() / grid.scale)

    def before(self, sight: Any, count: int) -> Any:
        return dr.full(self.backend.Float, self.widest, count)

    def width(self, cursor: Any, segment: Segment, sight: Any) -> Any:
        return dr.gather(self.backend.Float, self.widths, segment.cell, segment.active)


def _profile(grid: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the limits of cells along r and θ, (2, n); on unrefined grids once for all φ."""
    if not grid.is_structured:
        low, high = grid.spans()
        return low[:2], high[:2]
    walls = grid.edges[:2]
    low, high = (
        np.stack([w.ravel() for w in np.meshgrid(*(e[part] for e in walls), indexing="ij")])
        for part in (slice(None, -1), slice(1, None))
    )
    return low, high


def _depth(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    depth: np.ndarray = np.maximum(high - low, _THINNEST * 0.5 * (low + high))
    return depth


def _packets(backend: Backend, *columns: np.ndarray) -> Any:
    return from_host(backend.Float, np.stack(columns, axis=1).reshape(-1))


# Maximum size of the stack of pixel parts processed at once, approximately.
_TOGETHER = 1 << 18
# How often a pixel may be halved along each side; a deeper recursion indicates a mistake.
_DEEPEST = 12
_QUARTERS = np.array([(-1, -1), (1, -1), (-1, 1), (1, 1)])


@dataclass
class PixelParts:
    """Squares in pixels: index into a list of pixels, centre, and number of halvings.

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

    def of(self, index: Int) -> PixelParts:
        return PixelParts(self.entry[index], self.center[:, index], self.depth)

    def quarters(self) -> PixelParts:
        half = 0.25 * 0.5**self.depth
        center = self.center[:, :, None] + half * _QUARTERS.T[:, None, :]
        return PixelParts(np.repeat(self.entry, 4), center.reshape(2, -1), self.depth + 1)


class FluxConserving(RayTracer):
    """Traces a job's rays in parts of pixels no wider than the cells on their way."""

    def __init__(self, job: RenderJob, source: Source, brightest_background: float) -> None:
        super().__init__(job, source, brightest_background)
        self.narrowest = _narrowest(job)
        self.width = max(job.frame.pixel)

    def batches(
        self, seconds: float | None = None, focus: tuple[float, float] | None = None
    ) -> Generator[Traced, None, Paths]:
        nx, ny = self.job.frame.pixels
        paths = self.pixels(np.arange(nx * ny))
        yield Traced(np.arange(nx * ny), paths)
        return paths

    def pixels(self, pixel: np.ndarray) -> Paths:
        waiting = [PixelParts(np.arange(len(pixel)), np.zeros((2, len(pixel))), 0)]
        means = _PathMeans(len(pixel))
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

    def _too_large(self, pixel: np.ndarray, parts: PixelParts) -> np.ndarray:
        """Return which parts are wider than the narrowest cell on the ray through the centre."""
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
                "antialias='adaptive'"
            )
        return large

    def _report(self, area: float, pixels: int) -> None:
        total = int(np.prod(self.job.frame.pixels))
        if pixels == total:
            self.job.advance(max(0, int(area) - self.job.done), total)


class _PathMeans:
    """Paths of parts of pixels, weighted by their areas."""

    def __init__(self, count: int) -> None:
        self.count, self.area, self.stopped = count, 0.0, False
        self.rows: Any = 0.0
        self.dtype: Any = None
        self.counts = (0, 0, 0)

    def add(self, paths: Paths, parts: PixelParts) -> None:
        self.counts, self.dtype = paths.counts, paths.rows[0].dtype
        weighted = parts.share * np.stack(paths.rows).astype(np.float64)
        self.rows += np.array([np.bincount(parts.entry, row, self.count) for row in weighted])
        self.area += parts.share * len(parts.entry)
        self.stopped |= paths.stopped

    def paths(self) -> Paths:
        return Paths(list(self.rows.astype(self.dtype)), self.counts, self.stopped)


def _narrowest(job: RenderJob) -> MinCellWidth:
    grid, kind = job.volume.grid, tuple(job.volume.grid.coordinates)
    if kind == SPHERICAL:
        return SphericalCellWidth(grid, job.backend, job.backward)
    if kind == CYLINDRICAL:
        return CylindricalCellWidth(grid, job.backend)
    if grid.base_edges:
        return TreeCellWidth(grid, job.backend)
    raise InputError(
        f"antialias='radmc3d' has no rule for a {type(grid).__name__}; use antialias='adaptive'"
    )
