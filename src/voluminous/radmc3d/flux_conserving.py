"""RADMC-3D's antialiasing: pixels are divided until their parts are no wider than the cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import Backend, dr, from_host
from ..backend.functions import loop
from ..backend.types import Float, Mask
from ..errors import InputError
from ..geometry import CYLINDRICAL, SPHERICAL
from ..grids.contract import Cursor, Grid, Ray, Segment
from ..grids.structured import is_structured
from ..grids.trees.cells import TreeCells
from ..rendering.tracer import Batches, Paths, RayTracer, reverse

if TYPE_CHECKING:
    from ..rendering.job import RenderJob

# Maximum number of parts of pixels processed at once, approximately.
_TOGETHER = 1 << 18
# How often a pixel may be halved along each side; a deeper recursion indicates a mistake.
_DEEPEST = 12
_QUARTERS = np.array([(-1, -1), (1, -1), (-1, 1), (1, 1)]).T[:, None, :]


class FluxConserving(RayTracer):
    """Traces a job's rays in parts of pixels no wider than the cells on their way."""

    def __init__(self, job: RenderJob, source: Any, brightest_background: float) -> None:
        super().__init__(job, source, brightest_background)
        self.narrowest = _narrowest(job.volume.grid, job.backend, job.backward)
        self.width = max(job.frame.pixel)

    def batches(
        self, seconds: float | None = None, focus: tuple[float, float] | None = None
    ) -> Batches[Paths]:
        pixel = np.arange(np.prod(self.job.frame.pixels))
        paths = self.pixels(pixel)
        yield self, pixel, paths
        return paths

    def pixels(self, pixel: np.ndarray) -> Paths:
        """Return the mean paths of some pixels, given by their flat indices."""
        count, total = len(pixel), int(np.prod(self.job.frame.pixels))
        rows: Any = 0.0
        area, stopped = 0.0, False
        # Squares: indices into the list of pixels, centres (2, n) in pixels, number of halvings.
        waiting = [(np.arange(count), np.zeros((2, count)), 0)]
        while waiting:
            entry, center, depth = waiting.pop()
            if len(entry) > _TOGETHER:
                waiting.append((entry[_TOGETHER:], center[:, _TOGETHER:], depth))
                entry, center = entry[:_TOGETHER], center[:, :_TOGETHER]
            large = self._too_large(pixel[entry], center, depth)
            if large.any():
                parts = center[:, large, None] + 0.25 * 0.5**depth * _QUARTERS
                waiting.append((np.repeat(entry[large], 4), parts.reshape(2, -1), depth + 1))
                entry, center = entry[~large], center[:, ~large]
            if len(entry):
                paths, share = self.rays(pixel[entry], *center), 0.25**depth
                weighted = share * np.stack(paths.rows).astype(np.float64)
                rows += np.array([np.bincount(entry, row, count) for row in weighted])
                area, stopped = area + share * len(entry), stopped | paths.stopped
            if count == total:
                self.job.advance(max(0, int(area) - self.job.done), total)
        return Paths(list(rows.astype(self.backend.dtype)), self.counts, stopped)

    def _too_large(self, pixel: np.ndarray, center: np.ndarray, depth: int) -> np.ndarray:
        nx, width = self.job.frame.pixels[0], self.width * 0.5**depth
        large = np.empty(len(pixel), bool)
        for first in range(0, len(pixel), self.batch):
            part = slice(first, first + self.batch)
            ray = self.ray_through(pixel[part], *center[:, part])
            large[part] = (width > self.narrowest.along(ray))[: len(large[part])]
        if large.any() and depth == _DEEPEST:
            where = int(pixel[np.argmax(large)])
            raise InputError(
                f"flux conservation needs more than {2**_DEEPEST} x {2**_DEEPEST} rays for a pixel "
                f"(ix = {where % nx}, iy = {where // nx}): take more pixels, a smaller width, or "
                "antialias='adaptive'"
            )
        return large


def _narrowest(grid: Any, backend: Backend, backward: bool) -> MinCellWidth:
    system = tuple(grid.coordinates)
    if system == SPHERICAL:
        return SphericalCellWidth(grid, backend, backward)
    if system == CYLINDRICAL:
        low, high = grid.spans()
        # The limits that RADMC-3D has for spherical grids.
        around = 0.5 * (low[0] + high[0]) * np.clip(high[1] - low[1], _LEAST_ANGLE, _MOST_ANGLE)
        width = np.minimum(np.minimum(_depth(low[0], high[0]), around), high[2] - low[2])
        return MinCellWidth(grid, backend, width / grid.scale, grid.scale)
    if not isinstance(grid, TreeCells):
        raise InputError(
            f"antialias='radmc3d' has no rule for a {type(grid).__name__}; use antialias='adaptive'"
        )
    edges = grid.base_edges[0]
    unit = float((edges[1] - edges[0]) / grid.divisions[0])
    return MinCellWidth(grid, backend, grid.boxes(0, grid.size)[1][0], unit)


@dataclass
class WidthState:
    """Loop state: a ray's position, and the smallest width so far."""

    cursor: Cursor
    least: Float


class MinCellWidth:
    """Computes the width of the narrowest cell along rays.

    Parameters
    ----------
    widths : array, shape (cells,)
        In the unit.
    """

    def __init__(self, grid: Grid, backend: Backend, widths: np.ndarray, unit: float) -> None:
        self.backend, self.unit, self.walk = backend, unit, grid.walk(backend)
        self.widths = from_host(backend.Float, np.ascontiguousarray(widths).reshape(-1))
        self.widest = float(widths.max())

    def along(self, ray: Ray) -> np.ndarray:
        """Return the width of the narrowest cell that each ray meets, in the grid's unit."""
        track, cursor = self.walk.enter(ray)
        sight = self.sight(ray)

        def inside(state: WidthState) -> Mask:
            return state.cursor.inside

        def step(state: WidthState) -> tuple[WidthState]:
            segment, cursor = self.walk.step(track, state.cursor)
            width = self.width(segment, sight)
            narrower = segment.active & (segment.length > 0.0) & (width < state.least)
            return (WidthState(cursor, dr.select(narrower, width, state.least)),)

        state = WidthState(cursor, self.initial(sight, dr.width(ray.direction)))
        (state,) = loop((state,), inside, step, label="min_cell_width")
        return np.asarray(state.least, np.float64) * self.unit

    def sight(self, ray: Ray) -> Any:
        """Return the geometry of rays that `width` needs."""
        return None

    def initial(self, sight: Any, count: int) -> Float:
        """Return the initial widths of rays."""
        return dr.full(self.backend.Float, self.widest, count)

    def width(self, segment: Segment, sight: Any) -> Float:
        """Return the width of the cell of a segment."""
        return dr.gather(self.backend.Float, self.widths, segment.cell, segment.active)


# Minimum relative size, and minimum and maximum angular size, of a cell.
_THINNEST = 0.003
_LEAST_ANGLE, _MOST_ANGLE = 0.05, 0.3
# Width of the central cavity for rays through it, as a fraction of the innermost radius.
_OF_CAVITY = 0.05


# Of rays: the distance of closest approach, the (negative) distance from that point at which they
# enter the outermost sphere, and the absolute z component of the direction.
RaySight = tuple[Float, Float, Float]


class SphericalCellWidth(MinCellWidth):
    """The rule for spherical grids; widths in units of the grid's scale.

    RADMC-3D traces rays towards the camera, and the rule depends on the direction.

    Parameters
    ----------
    backward : bool
        Rays run towards the camera.
    """

    def __init__(self, grid: Any, backend: Backend, backward: bool) -> None:
        if is_structured(grid):  # sizes are the same for all φ
            walls = grid.edges[:2]
            low, high = (
                np.stack([w.ravel() for w in np.meshgrid(*(e[part] for e in walls), indexing="ij")])
                for part in (slice(None, -1), slice(1, None))
            )
        else:
            low, high = (ends[:2] for ends in grid.spans())
        across = np.minimum(np.minimum(low[1] + high[1], 2 * np.pi - low[1] - high[1]) / 2, 1.0)
        polar = high[1] - low[1]
        # Width along r, and angles along θ and φ (sic: RADMC-3D takes θ's for both).
        sizes = [
            0.5 * (low[0] + high[0]) / grid.scale,
            _depth(low[0], high[0]) / grid.scale,
            np.clip(polar, _LEAST_ANGLE, _MOST_ANGLE),
            np.clip(across * polar, _LEAST_ANGLE, _MOST_ANGLE),
        ]
        super().__init__(grid, backend, np.stack(sizes, axis=1), grid.scale)
        self.backward = backward
        self.inner, self.outer = (backend.wide(grid.edges[0][k] / grid.scale) for k in (0, -1))
        self.alike = dr.opaque(backend.UInt, grid.shape[2] if is_structured(grid) else 1)

    def along(self, ray: Ray) -> np.ndarray:
        return super().along(ray if self.backward else reverse(ray))

    def sight(self, ray: Ray) -> RaySight:
        to_scale = self.backend.wide(1.0 / self.unit)
        origin = [o * to_scale for o in ray.origin]
        distance = -sum(o * d for o, d in zip(origin, ray.direction, strict=True))
        nearest = [dr.fma(distance, d, o) for o, d in zip(origin, ray.direction, strict=True)]
        square = sum(n * n for n in nearest)
        arrive = -dr.sqrt(dr.maximum(self.outer * self.outer - square, 0.0))
        real = self.backend.Float
        return real(dr.sqrt(square)), real(arrive), real(dr.abs(ray.direction[2]))

    def initial(self, sight: RaySight, count: int) -> Float:
        inner, (closest, *_) = self.backend.Float(self.inner), sight
        return dr.select(closest <= inner, _OF_CAVITY * inner, np.inf)

    def width(self, segment: Segment, sight: RaySight) -> Float:
        number = self.backend.quotient(segment.cell, self.alike)
        radius, depth, along_theta, along_phi = dr.gather(
            self.backend.packet(4), self.widths, number, segment.active
        )
        across, around = radius * along_theta, radius * along_phi
        closest, arrive, polar = sight
        distance = segment.begin + arrive
        upright = dr.abs(distance) / dr.sqrt(dr.fma(distance, distance, closest * closest))
        tilted = dr.lerp(around, across, polar) * upright
        width = dr.minimum(dr.minimum(across, around), tilted)
        return dr.maximum(depth, width)


def _depth(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.asarray(np.maximum(high - low, _THINNEST * 0.5 * (low + high)))
