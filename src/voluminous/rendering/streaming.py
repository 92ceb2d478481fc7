"""Traces rays through a volume block by block: their state goes from one block to the next."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr, from_host
from ..backend.functions import flush_subnormal
from ..backend.types import Float
from ..grids.contract import CellBox
from ..media.ranges import RangeContext
from ..schemes.base import Position
from .march import RayState, hand_on, march
from .pixels import Lanes
from .sources.interpolated import Interpolated
from .tracer import MARGIN, Batches, Paths, RayBatch, RayTracer, write_paths

if TYPE_CHECKING:
    from .job import RenderJob
    from .pieces import Pieces

# Lanes whose places in the picture are bounded together: a block of pixels.
_GROUP = 256
# Parts of a peak below this are zero in single precision, with room for long paths: leaving them
# out changes no bit.
_FAINTEST = 1e-37
# In pixels: rounding of where the corners of a block are seen.
_MARGIN = 1e-3
# With fewer cells than this for each that a ray crosses a table is made first.
_CELLS_PER_STEP = 0.5


class StreamingTracer(RayTracer):
    """Traces all rays through one block of cells after another, front to back.

    Each call of `frame`, `pixels` or `rays` is a pass through the blocks that its rays meet, and
    whose medium may be visible. Rays that have reached the cut-off need no further blocks.
    """

    def __init__(self, job: RenderJob, source: Any, brightest_background: float) -> None:
        super().__init__(job, source, brightest_background)
        assert job.pieces is not None
        self.pieces: Pieces = job.pieces
        nx, ny = job.frame.pixels
        self.batch = max(self.batch, (nx + _GROUP) * (ny + _GROUP))  # blocks are read once
        self._done, self._counts = 0, False

    def _frame(
        self,
        offset: tuple[float, float],
        seconds: float | None,
        focus: tuple[float, float] | None,
    ) -> Batches[Paths]:
        self._counts = True  # cells of other passes are not counted again
        paths = yield from super()._frame(offset, None, focus)
        self._counts = False
        return paths

    def _draw(self, batch: RayBatch, rows: list[Float], lanes: int = 0) -> None:
        for number, part in self.parts():  # blocks of channels are passes of their own
            path, over = self._through_all(part, batch)
            numbers = path.emission + path.transparency + path.depth + path.error
            real = self.backend.Float
            values = [flush_subnormal(from_host(real, n), MARGIN) for n in numbers]
            values.append(from_host(real, over.astype(self.backend.dtype)))
            write_paths(self._rows_of(number, rows), values, batch.lanes, batch.first)

    def _through_all(self, part: RayTracer, batch: RayBatch) -> tuple[Any, np.ndarray]:
        """Return the paths of a batch, and which rays reached the cut-off, as NumPy arrays."""
        rays = _Rays(self, part, batch)
        total = self.pieces.grid.size * self.job.samples**2 * len(self.blocks)
        for box in self.pieces.boxes(*rays.origins()):
            chosen = rays.meeting(box)
            if len(chosen):
                if self._visible(part, box):
                    self._through(part, rays, chosen, box)
                else:
                    self._past(part, rays, chosen, box)
            if self._counts:
                cells = (high - low for low, high in zip(box.low, box.high, strict=True))
                self._done += int(np.prod(list(cells)))
            self.pieces.report(self._done, total)
        return rays.state.path, rays.state.over

    def _visible(self, part: RayTracer, box: CellBox) -> bool:
        """Return whether the medium may be visible in a block."""
        medium, volume = self.job.medium, self.job.volume
        dual = isinstance(part.source, Interpolated)
        faint = part.source.context.faint if dual else _FAINTEST
        context = RangeContext(volume.unit, volume.expression_unit, faint)
        with np.errstate(all="ignore"):
            ranges = self.pieces.ranges(box, medium.names, dual)
            return bool(np.any(medium.visible_in(ranges, context)))

    def _walk(self, box: CellBox) -> Any:
        return self.job.volume.grid.walk(self.backend, self.job.walk_kind, box)

    def _through(self, part: RayTracer, rays: _Rays, chosen: np.ndarray, box: CellBox) -> None:
        """Let rays go through a block, and remember their state."""
        source, walk = self._source(part.source, box, len(chosen)), self._walk(box)
        ray, before = rays.some(chosen)
        _, cursor = walk.enter(ray)
        after = march(walk, source, self.scheme, ray, before, part.ending, False)
        state = hand_on(before, cursor.inside, after)
        dr.eval(state)
        rays.put(chosen, state)

    def _past(self, part: RayTracer, rays: _Rays, chosen: np.ndarray, box: CellBox) -> None:
        """Let rays skip a block; it is not read."""
        if not rays.state.carried:
            return
        walk = self._walk(box)
        ray, before = rays.some(chosen)
        assert before.carried is not None
        track, cursor = walk.enter(ray)
        here = Position(walk, track, cursor)
        carried = self.scheme.after_skip(here, part.source, before.carried, cursor.inside)
        state = replace(before, carried=carried)
        dr.eval(state)
        rays.put(chosen, state)

    def _source(self, source: Any, box: CellBox, rays: int) -> Any:
        """Return the coefficients in a block."""
        names, pieces = self.job.medium.names, self.pieces
        if isinstance(source, Interpolated):
            return source.within(pieces.values(box, names, ghosts=True))
        volume = pieces.volume(box, pieces.values(box, names, ghosts=False))
        steps = rays * volume.grid.cells_across / 2
        if volume.grid.size < _CELLS_PER_STEP * steps and source.real is self.backend.Wide:
            return source.tabulated(volume, box.low)
        return source.within(volume, box.low)


class _Rays:
    """The rays of a batch, and their state: in NumPy's memory, of which blocks take some."""

    def __init__(self, tracer: StreamingTracer, part: RayTracer, batch: RayBatch) -> None:
        self.tracer, self.batch = tracer, batch
        count, lanes = len(batch.lanes.target), batch.lanes
        self.u, self.v, self.target = (np.asarray(a) for a in (lanes.u, lanes.v, lanes.target))
        self.there = np.asarray(lanes.there)
        path = _mapped(lambda a: np.full(count, a.numpy()[0]), part.nothing())
        none = np.zeros(count, bool)
        self.state = RayState(path, None, none, none.copy())
        # The least and the largest places of rays that are together.
        ends = np.append(np.arange(0, count, _GROUP), count)
        self.low, self.high = (
            np.array([end.reduceat(values, ends[:-1]) for values in (self.u, self.v)])
            for end in (np.minimum, np.maximum)
        )

    def origins(self) -> tuple[bool, np.ndarray, np.ndarray]:
        """Return whether rays are parallel, the extent of their origins, and their direction."""
        ray, origin = self.tracer.ray(self.batch.lanes), np.zeros((3, 2))
        if parallel := self.tracer.job.camera.parallel:
            direction = np.array([np.asarray(d).ravel()[0] for d in ray.direction])
        else:
            origin = np.array([(np.min(o), np.max(o)) for o in map(np.asarray, ray.origin)])
            direction = np.zeros(3)
        return parallel, origin, direction

    def meeting(self, box: CellBox) -> np.ndarray:
        """Return the numbers of rays that may meet a block and are not at their end."""
        job = self.tracer.job
        low, high = np.full(2, -np.inf), np.full(2, np.inf)
        if job.camera.straight:
            corners = np.meshgrid(
                *(
                    (e[max(a - 1, 0)], e[b])
                    for e, a, b in zip(job.volume.grid.edges, box.low, box.high, strict=True)
                )
            )
            seen = job.camera.project(np.reshape(corners, (3, -1)), job.volume.grid)[:2]
            places = [
                (s - shift) / step
                for s, shift, step in zip(seen, job.frame.shift, job.frame.pixel, strict=True)
            ]
            if np.all(np.isfinite(places)):
                places = np.asarray(places) - np.array(self.batch.offset)[:, None]
                low, high = places.min(axis=1) - _MARGIN, places.max(axis=1) + _MARGIN
        beyond = (low[:, None] > self.high) | (high[:, None] < self.low)
        near = ~np.any(beyond, axis=0)
        chosen = (np.flatnonzero(near)[:, None] * _GROUP + np.arange(_GROUP)).ravel()
        chosen = chosen[chosen < len(self.u)]
        u, v = self.u[chosen], self.v[chosen]
        inside = (u >= low[0]) & (u <= high[0]) & (v >= low[1]) & (v <= high[1])
        chosen = chosen[inside & self.there[chosen] & ~self.state.over[chosen]]
        # Kernels of one lane differ from those of many.
        return np.resize(chosen, 2) if len(chosen) == 1 else chosen

    def some(self, chosen: np.ndarray) -> tuple[Any, RayState]:
        """Return some rays, and their state on the device."""
        backend = self.tracer.backend
        u, v = (from_host(backend.Wide, a[chosen]) for a in (self.u, self.v))
        lanes = Lanes(u, v, from_host(backend.UInt, self.target[chosen]))
        ray = self.tracer.ray(lanes, [backend.wide(o) for o in self.batch.offset])
        kinds = {"float32": "Float32", "float64": "Float64", "bool": "Bool"}

        def take(values: np.ndarray) -> Any:
            return from_host(getattr(backend.module, kinds[values.dtype.name]), values[chosen])

        return ray, _mapped(take, self.state)

    def put(self, chosen: np.ndarray, state: RayState) -> None:
        """Remember the state of some rays; of the others nothing is carried yet."""
        if self.state.carried is None:
            count = len(self.u)
            self.state.carried = _mapped(lambda a: np.zeros(count, a.numpy().dtype), state.carried)
        for own, new in zip(_leaves(self.state), _leaves(state), strict=True):
            own[chosen] = new.numpy()


def _leaves(tree: Any) -> Iterator[Any]:
    """Yield the arrays in lists and dataclasses."""
    if isinstance(tree, list):
        for part in tree:
            yield from _leaves(part)
    elif is_dataclass(tree):
        for field in fields(tree):
            yield from _leaves(getattr(tree, field.name))
    elif tree is not None:
        yield tree


def _mapped(function: Callable[[Any], Any], tree: Any) -> Any:
    """Return a tree of what a function makes of its arrays."""
    if isinstance(tree, list):
        return [_mapped(function, part) for part in tree]
    if is_dataclass(tree) and not isinstance(tree, type):
        parts = {f.name: _mapped(function, getattr(tree, f.name)) for f in fields(tree)}
        return replace(tree, **parts)
    return None if tree is None else function(tree)
