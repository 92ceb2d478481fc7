"""Traces rays through a volume block by block: their state goes from one block to the next."""

from __future__ import annotations

import functools
import math
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import Backend, dr, from_host
from ..backend.functions import flush_subnormal
from ..backend.types import Float
from ..digest import content_key
from ..errors import InputError
from ..executors import Sent
from ..expressions.interval import Interval
from ..grids.contract import CellBox
from ..grids.structured import is_structured
from ..media.ranges import RangeContext
from ..memory import reuse_memory
from ..schemes.base import Position, Scanner
from ..schemes.path import Path
from .chunks import Chunks
from .march import RayState, arrays_in, hand_on, mapped, march
from .missing import HiddenCells
from .pieces import TreePieces
from .pixels import Lanes, between_walls
from .sources.cells import CellEvaluator
from .sources.table import CELLS_PER_STEP
from .tracer import MARGIN, Batches, Paths, RayBatch, RayTracer, write_paths

if TYPE_CHECKING:
    from .job import RenderJob
    from .pieces import Pieces

# Lanes whose places in the picture are bounded together: a tile of pixels.
_TILE = 256
# Parts of a peak below this are zero in single precision, with room for long paths: leaving them
# out changes no bit.
_FAINTEST = 1e-37
# In pixels: rounding of where the corners of a block are seen.
_MARGIN = 1e-3
# Bytes of fields in memory that every block of another process may bring.
_SENT = 16 << 20
# Optical depth of a chunk in which rays come to their end, at its densest place.
_OPAQUE = 10.0


class StreamingTracer(RayTracer):
    """Traces all rays through one block of cells after another, front to back.

    Each call of `frame`, `pixels` or `rays` is a pass through the blocks that its rays meet, and
    whose medium may be visible, with all channels. Rays that have reached the cut-off need no
    further blocks.
    """

    def __init__(
        self, job: RenderJob, source: Any, brightest_background: float, faintest: bool = False
    ) -> None:
        super().__init__(job, source, brightest_background)
        assert job.pieces is not None
        self.pieces: Pieces = job.pieces
        self.faintest = faintest
        nx, ny = job.frame.pixels
        self.batch = max(self.batch, (nx + _TILE) * (ny + _TILE))  # blocks are read once
        self._done, self._counts = 0, False
        several = job.controlled or job.samples > 1
        pieces = self.pieces
        self.chunks = Chunks(pieces.outline, pieces.room, again=several, layers=pieces.dual)

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
        rays, counts = Rays.starting(self, batch), self._counts
        while True:
            if self.pieces.sweep is None:
                self.through(rays, self.pieces.boxes(*rays.origins()))
            else:
                self.pieces.sweep.draw(self, rays)
            if not rays.wait:
                break
            self._counts = False  # rays come to some pieces of patches again
        self._counts = counts
        for number, state in enumerate(rays.states):
            path = rays.found(state)
            numbers = path.emission + path.transparency + path.depth + path.error
            real = self.backend.Float
            values = [flush_subnormal(from_host(real, n), MARGIN) for n in numbers]
            values.append(from_host(real, state.over.astype(self.backend.dtype)))
            write_paths(self._rows_of(number, rows), values, batch.lanes, batch.first)

    def through(self, rays: Rays, boxes: Iterable[CellBox]) -> None:
        """Let rays go through boxes of cells, one after another; the next one is read meanwhile."""
        left, following = self._divided(rays, boxes), deque[tuple[CellBox, np.ndarray, bool]]()
        names = self.pieces.used
        parts, waiting = [part for _, part in self.parts()], rays.states[0].cursor is not None

        def look_ahead() -> None:
            for box in left:
                chosen = rays.coming_to([box])
                # Rays that wait in a tree come to more cells until the box is drawn.
                seen = (waiting or len(chosen) > 0) and self.visible(box)
                following.append((box, chosen, seen))
                for name in names if seen and len(chosen) else ():
                    self.chunks.ahead(name, *self.pieces.cells(box), self.shown)
                if seen:
                    break

        try:
            look_ahead()
            while following:
                box, chosen, seen = following.popleft()
                chosen = rays.coming_to([box], chosen)
                if seen and len(chosen):
                    self._through(parts, rays, chosen, box, look_ahead)
                elif seen:
                    self.chunks.forget()
                elif len(chosen):
                    self._past(parts, rays, chosen, box)
                if not following:
                    look_ahead()
                if self.pieces.sweep is None:
                    self.drawn([box])
        finally:
            self.chunks.forget()

    def _divided(self, rays: Rays, boxes: Iterable[CellBox]) -> Iterator[CellBox]:
        """Yield boxes; for one in which rays may come to their end its chunks, front to back.

        Those behind others are then not read.
        """
        pieces, chunks, finer = self.pieces, self.pieces.outline.store.chunks, None
        evaluator = CellEvaluator(self.job.volume, self.job.medium, self.backend)
        for box in boxes:
            several = is_structured(pieces.grid) and pieces.side != chunks
            if self.ending is not None and several:
                most = evaluator.most_in(pieces.ranges(box, self.job.medium.names))
                if evaluator.channels.densest(most) * min(chunks) > _OPAQUE:
                    finer = finer or pieces.in_chunks(*rays.origins())
                    yield from finer[pieces.place(box)]
                    continue
            yield box

    def starting(self, pixel: np.ndarray, du: np.ndarray, dv: np.ndarray) -> Rays:
        """Return the rays through points of pixels, which have not met anything yet."""
        return Rays.starting(self, RayBatch(self._lanes(pixel, du, dv)))

    def drawn(self, boxes: Iterable[CellBox]) -> None:
        """Report boxes that are done."""
        if self._counts:
            self._done += sum(
                math.prod(high - low for low, high in zip(box.low, box.high, strict=True))
                for box in boxes
            )
        self.pieces.report(self._done, self.pieces.grid.size * self.job.samples**2)

    @functools.cached_property
    def sent(self) -> Sent:
        """What makes this tracer in another process.

        Raises
        ------
        InputError
            If it cannot be sent, or is more than a task should carry.
        """
        size = self.pieces.outline.bytes_in_memory
        if size > _SENT:
            raise InputError(
                f"executor= sends {size / 2**20:.0f} MiB of fields that are in memory with every "
                "block: write the volume first, volume.save('big.zarr', stats=True), and draw "
                "vm.open('big.zarr')"
            )
        made = functools.partial(_tracer, self.job, self.background, self.faintest)
        return Sent.of(made, "the picture")

    @functools.cached_property
    def name(self) -> str:
        """A hash of what is drawn: pictures of the same name are equal."""
        job, pieces = self.job, self.pieces
        others = ("volume", "cache", "progress", "done", "pieces")
        how = {name: part for name, part in vars(job).items() if name not in others}
        also = pieces.side, pieces.geometry, self.background, self.faintest
        return content_key(how, pieces.outline.fingerprint(), *also)

    @property
    def limits(self) -> Any:
        """The tolerance of this pass, in NumPy's memory."""
        return mapped(lambda a: a.numpy(), self.tolerance)

    def task(self, rays: Rays, boxes: Sequence[CellBox]) -> tuple[Any, ...]:
        """Return a function and its arguments, which returns the rays' states elsewhere."""
        return _draw_elsewhere, self.sent, self.limits, rays.plain(), tuple(boxes)

    @property
    def _everywhere(self) -> bool:
        return isinstance(self.scheme, Scanner) and self.scheme.everywhere

    def visible(self, box: CellBox) -> bool:
        """Return whether the medium may be visible in a block."""
        if self._everywhere:
            return True
        return bool(np.any(self._visible_in(self.pieces.ranges(box, self.job.medium.names))))

    @functools.cached_property
    def shown(self) -> np.ndarray:
        """In which chunks the medium may be visible, whatever block they are part of."""
        shown: Any = True
        if not self._everywhere:
            shown = self._visible_in(self.pieces.ranges_of_chunks(self.job.medium.names))
        return np.broadcast_to(shown, self.pieces.outline.chunk_counts)

    def _visible_in(self, ranges: dict[str, Interval]) -> np.ndarray:
        faint = self.source.context.faint if self.pieces.dual else _FAINTEST
        with np.errstate(all="ignore"):
            return np.asarray(self.source.channels.bound.may_show(ranges, RangeContext(faint)))

    def walk_in(self, box: CellBox) -> Any:
        """Return the walk confined to a box of cells."""
        return self.job.volume.grid.walk(self.backend, self.job.walk_kind, box)

    def _through(
        self,
        parts: Sequence[RayTracer],
        rays: Rays,
        chosen: np.ndarray,
        box: CellBox,
        meanwhile: Callable[[], None],
    ) -> None:
        source, hidden = self._source(box, len(chosen))
        walk = self.walk_in(box)
        bits = None if hidden is None else HiddenCells(hidden).on(self.backend)
        meanwhile()
        for part, group, state in zip(parts, self.groups, rays.states, strict=True):
            own = chosen if len(parts) == 1 else rays.unfinished(chosen, state)
            if not len(own):
                continue
            ray, before = rays.some(own, state)
            _, cursor = walk.enter(ray)
            within = part.limited(source(group))
            after = march(walk, within, self.scheme, ray, before, part.ending, False, bits)
            new = hand_on(before, cursor.inside, after)
            dr.eval(new)
            rays.put(own, state, mapped(lambda a: a.numpy(), new))

    def _past(
        self, parts: Sequence[RayTracer], rays: Rays, chosen: np.ndarray, box: CellBox
    ) -> None:
        """Let rays skip a block; it is not read."""
        walk = self.walk_in(box)
        for part, state in zip(parts, rays.states, strict=True):
            own = chosen if len(parts) == 1 else rays.unfinished(chosen, state)
            if not len(own) or (not state.carried and state.cursor is None):
                continue
            ray, new = rays.some(own, state)
            track, cursor = walk.enter(ray)
            if new.cursor is not None:
                new = replace(new, cursor=walk.beyond(track, cursor))
            if new.carried:
                here = Position(walk, track, cursor)
                carried = self.scheme.after_skip(here, part.source, new.carried, cursor.inside)
                new = replace(new, carried=carried)
            dr.eval(new)
            rays.put(own, state, mapped(lambda a: a.numpy(), new))

    def _source(self, box: CellBox, rays: int) -> tuple[Callable[[slice], Any], np.ndarray | None]:
        """Return the coefficients of some channels in a block, and which of its cells are hidden.

        Fields are read, and put where kernels gather them, once for all channels.
        """
        source, pieces = self.source, self.pieces
        several, hidden = len(self.groups) > 1, None
        if isinstance(pieces, TreePieces) and pieces.dual:
            leaves = pieces.leaves(box)
            within = source.within_leaves(leaves, pieces.around_leaves(self.chunks, leaves))
            return (within.group if several else lambda group: within), None
        values = {
            name: self.chunks.box(name, *pieces.cells(box), self.shown, int(pieces.dual))
            for name in pieces.used
        }
        sides = [b - a for a, b in zip(box.low, box.high, strict=True)]
        cells = math.prod(sides)
        across = sum(sides) if is_structured(pieces.grid) else 3.0 * cells ** (1 / 3)
        steps = rays * across
        if pieces.dual:
            within = source.within(values)
        else:
            hidden = pieces.hidden(box, values)
            volume = pieces.outline.volume(box, values)
            pays = pieces.tabulates and cells < CELLS_PER_STEP * steps
            if pays and source.real is self.backend.Wide:

                def table(group: slice) -> Any:
                    part = source.group(group) if several else source
                    return part.tabulated(volume, box.low)

                return table, hidden
            within = source.within(volume, box.low)
        return (within.group if several else lambda group: within), hidden


class Rays:
    """Some rays, and their states: in NumPy's memory, of which blocks take some.

    Attributes
    ----------
    offset : (float, float)
        Additional offset within the pixels.
    u, v : double arrays
        Positions, in pixels from the middle of the picture; near ones follow each other.
    there : bool array
        Lanes that are rays.
    states : list of RayState
        One for each group of channels.
    """

    def __init__(
        self,
        tracer: StreamingTracer,
        offset: tuple[float, float],
        places: tuple[np.ndarray, np.ndarray, np.ndarray],
        states: list[RayState],
    ) -> None:
        self.tracer, self.offset, self.states = tracer, offset, states
        self.u, self.v, self.there = places
        # The least and the largest places of rays that are together.
        starts = np.arange(0, len(self.u), _TILE)
        self.low, self.high = (
            np.array([end.reduceat(values, starts) for values in (self.u, self.v)])
            for end in (np.minimum, np.maximum)
        )

    @classmethod
    def starting(cls, tracer: StreamingTracer, batch: RayBatch) -> Rays:
        """Return the rays of a batch, which have not met anything yet."""
        lanes, count, states = batch.lanes, len(batch.lanes.target), []
        for _, part in tracer.parts():
            path = mapped(lambda a: np.full(count, a.numpy()[0]), part.nothing())
            states.append(RayState(path, None, np.zeros(count, bool), np.zeros(count, bool)))
        places = np.asarray(lanes.u), np.asarray(lanes.v), np.asarray(lanes.there)
        rays = cls(tracer, batch.offset, places, states)
        if not is_structured(grid := tracer.pieces.grid):
            walk = tracer.walk_in(CellBox((0,), (grid.size,)))
            _, cursor = walk.enter(rays.ray(np.arange(count)))
            dr.eval(cursor)
            for state in states:
                state.cursor = mapped(lambda a: np.resize(a.numpy(), count), cursor)
        return rays

    @property
    def over(self) -> np.ndarray:
        """Which rays are at their end, in all channels."""
        return np.asarray(np.logical_and.reduce([state.over for state in self.states]))

    @property
    def wait(self) -> bool:
        """Whether some rays wait in cells of a tree."""
        size = self.tracer.pieces.grid.size
        return self.states[0].cursor is not None and bool(np.any(self._waiting(0, size)))

    def _waiting(self, first: int, last: int) -> np.ndarray:
        here = np.zeros(len(self.u), bool)
        for state in self.states:
            number = state.cursor.cell.number
            here |= (number >= first) & (number < last) & ~state.over & self.there
        return here

    def taken(self, chosen: np.ndarray) -> Rays:
        """Return some of the rays by themselves."""
        places = self.u[chosen], self.v[chosen], self.there[chosen]
        states = mapped(lambda a: a[chosen], self.states)
        return Rays(self.tracer, self.offset, places, states)

    def plain(self) -> tuple[Any, ...]:
        """Return the arguments besides the tracer, which other processes take."""
        return self.offset, (self.u, self.v, self.there), self.states

    def found(self, state: RayState) -> Path:
        """Return the paths of all rays, or the results of those that look for something else.

        Rays that have met no block carry nothing.
        """
        if not (results := self.tracer.results):
            return state.path
        dtype, carried = self.tracer.backend.dtype, state.carried or results
        pairs = zip(results, carried, strict=False)
        return Path([np.where(state.begun, c, f).astype(dtype) for f, c in pairs], [], [])

    def origins(self) -> tuple[bool, np.ndarray, np.ndarray]:
        """Return whether rays are parallel, the extent of their origins, and their direction."""
        ray, origin = self.ray(np.arange(len(self.u))), np.zeros((3, 2))
        if parallel := self.tracer.job.camera.parallel:
            direction = np.array([np.asarray(d).ravel()[0] for d in ray.direction])
        else:
            origin = np.array([(np.min(o), np.max(o)) for o in map(np.asarray, ray.origin)])
            direction = np.zeros(3)
        return parallel, origin, direction

    def coming_to(self, boxes: Sequence[CellBox], met: np.ndarray | None = None) -> np.ndarray:
        """Return the numbers of rays that may meet boxes next, or wait in these cells of a tree.

        Those that may go through the boxes were `met`, if that is known.
        """
        if self.states[0].cursor is None:
            if met is None:
                return self.meeting(self.tracer.pieces.around(boxes))
            return self.unfinished(met)
        here = [self._waiting(box.low[0], box.high[0]) for box in boxes]
        return _many(np.flatnonzero(np.logical_or.reduce(here)))

    def meeting(self, extent: np.ndarray) -> np.ndarray:
        """Return the numbers of rays that may meet a box and are not at their end.

        Parameters
        ----------
        extent : array, shape (3, 2)
            Coordinates of the box.
        """
        job = self.tracer.job
        low, high = np.full(2, -np.inf), np.full(2, np.inf)
        if job.camera.straight:
            corners = np.reshape(np.meshgrid(*extent), (3, -1))
            seen = job.camera.project(corners, job.volume.grid)[:2]
            places = [
                (s - shift) / step
                for s, shift, step in zip(seen, job.frame.shift, job.frame.pixel, strict=True)
            ]
            if np.all(np.isfinite(places)):
                places = np.asarray(places) - np.array(self.offset)[:, None]
                low, high = places.min(axis=1) - _MARGIN, places.max(axis=1) + _MARGIN
        beyond = (low[:, None] > self.high) | (high[:, None] < self.low)
        near = ~np.any(beyond, axis=0)
        chosen = (np.flatnonzero(near)[:, None] * _TILE + np.arange(_TILE)).ravel()
        chosen = chosen[chosen < len(self.u)]
        u, v = self.u[chosen], self.v[chosen]
        inside = (u >= low[0]) & (u <= high[0]) & (v >= low[1]) & (v <= high[1])
        chosen = chosen[inside & self.there[chosen] & ~self.over[chosen]]
        return np.asarray(chosen[self._through_box(chosen, extent)] if len(chosen) else chosen)

    def unfinished(self, chosen: np.ndarray, state: RayState | None = None) -> np.ndarray:
        """Return those of some rays that are not at their end, on at least two lanes.

        In all channels, or in those of a state.
        """
        over = self.over if state is None else state.over
        return _many(chosen[~over[chosen]])

    def _through_box(self, chosen: np.ndarray, extent: np.ndarray) -> np.ndarray:
        ray, bounds = self.ray(chosen), self.tracer.job.volume.grid.bounds
        double = np.dtype(self.tracer.backend.Wide.__name__.lower()) == np.float64
        margin = (1e-9 if double else 1e-4) * np.max(np.abs(bounds))
        enters, leaves = between_walls(ray, extent + np.array([-margin, margin]))
        first = -np.inf if ray.first is None else np.asarray(ray.first) - margin
        last = np.inf if ray.last is None else np.asarray(ray.last) + margin
        inside = np.maximum(enters, first) <= np.minimum(leaves, last)
        return np.broadcast_to(inside, chosen.shape)

    def ray(self, chosen: np.ndarray) -> Any:
        """Return some rays as kernels have them."""
        backend = self.tracer.backend
        u, v = (from_host(backend.Wide, a[chosen]) for a in (self.u, self.v))
        lanes = Lanes(u, v, dr.arange(backend.UInt, len(chosen)))
        return self.tracer.ray(lanes, [backend.wide(o) for o in self.offset])

    def some(self, chosen: np.ndarray, state: RayState) -> tuple[Any, RayState]:
        """Return some rays, and their state on the device."""
        backend = self.tracer.backend
        own = mapped(lambda a: _on_device(backend, a[chosen]), state)
        return replace(self.ray(chosen), waiting=own.cursor), own

    def put(self, chosen: np.ndarray, state: RayState, new: RayState) -> None:
        """Remember the state of some rays; of the others nothing is carried yet."""
        if state.carried is None:
            count = len(self.u)
            state.carried = mapped(lambda a: np.zeros(count, a.dtype), new.carried)
        for own, values in zip(arrays_in(state), arrays_in(new), strict=True):
            own[chosen] = values

    def put_all(self, chosen: np.ndarray, states: Sequence[RayState]) -> None:
        """Remember the states of some rays, of all channels."""
        for state, new in zip(self.states, states, strict=True):
            self.put(chosen, state, new)


# Threads of one process that draw blocks do so one after another: kernels use all cores.
_LOCK = threading.Lock()


def _tracer(job: RenderJob, background: float, faintest: bool) -> StreamingTracer:
    reuse_memory()
    return StreamingTracer(job, job.source(faintest), background, faintest)


def _draw_elsewhere(
    sent: Sent, limits: Any, rays: tuple[Any, ...], boxes: tuple[CellBox, ...]
) -> list[RayState]:
    """Return the states of rays that have gone through boxes; see `StreamingTracer.task`."""
    with _LOCK:
        tracer: StreamingTracer = sent.value()
        tracer.tolerance = mapped(lambda a: _on_device(tracer.backend, a), limits)
        own = Rays(tracer, *rays)
        tracer.through(own, boxes)
        return own.states


def _many(chosen: np.ndarray) -> np.ndarray:
    """Return numbers of rays, at least two: kernels of one lane differ from those of many."""
    return np.resize(chosen, 2) if len(chosen) == 1 else chosen


def _on_device(backend: Backend, values: np.ndarray) -> Any:
    kinds = {"float32": "Float32", "float64": "Float64", "bool": "Bool", "uint32": "UInt32"}
    return from_host(getattr(backend.module, kinds[values.dtype.name]), values)
