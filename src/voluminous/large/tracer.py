"""Traces rays through a volume block by block: their states go from one block to the next."""

from __future__ import annotations

import functools
import math
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr, from_host
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
from ..rendering.march import RayState, hand_on, mapped, march
from ..rendering.missing import HiddenCells
from ..rendering.sources.cells import CellEvaluator
from ..rendering.tracer import MARGIN, Batches, Followed, Paths, RayBatch, RayTracer, write_paths
from ..schemes.base import Position, Scanner
from .prefetch import Prefetch
from .rays import TILE, Rays, on_device

if TYPE_CHECKING:
    from ..rendering.job import RenderJob
    from .chunks import CartesianChunks

# Parts of a peak below this are zero in single precision, with room for long paths: leaving them
# out changes no bit.
_FAINTEST = 1e-37
# Optical depth of a chunk in which rays come to their end, at its densest place.
_OPAQUE = 10.0


class BlockTracer(RayTracer):
    """Traces all rays through one block of cells after another, front to back.

    Each call of `frame`, `pixels` or `rays` is a pass through the blocks that its rays meet, and
    whose medium may be visible, with all channels. Rays that have reached the cut-off need no
    further blocks.
    """

    # Bytes of fields in memory that are sent with every block.
    most_sent = 16 << 20

    def __init__(
        self,
        job: RenderJob,
        partition: CartesianChunks,
        source: Any,
        brightest_background: float,
        faintest: bool,
    ) -> None:
        super().__init__(job, source, brightest_background)
        self.partition, self.faintest = partition, faintest
        nx, ny = job.frame.pixels
        self.batch = max(self.batch, (nx + TILE) * (ny + TILE))  # blocks are read once
        self._done, self._counts = 0, False
        several = job.controlled or job.adaptive or job.samples > 1
        options = {"again": several, "layers": partition.dual}
        self.chunks = Prefetch(partition.volume, partition.room, **options)

    def afresh(self, background: float) -> BlockTracer:
        return BlockTracer(self.job, self.partition, self.source, background, self.faintest)

    def advance(self, rays: int, lanes: int) -> None:
        """Report nothing: cells are counted, not rays."""

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
            if self.partition.sweep is None:
                self.through(rays, self.partition.blocks(*rays.origins()))
            else:
                self.partition.sweep.draw(self, rays)
            if not rays.wait and not rays.further():
                break
            self._counts = False  # rays come to some parts of patches, or all blocks, again
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
        names = self.partition.used
        parts, waiting = [part for _, part in self.parts()], rays.states[0].cursor is not None

        def look_ahead() -> None:
            for box in left:
                chosen = rays.coming_to([box])
                # Rays that wait in a tree come to more cells until the box is drawn.
                seen = (waiting or len(chosen) > 0) and self.visible(box)
                following.append((box, chosen, seen))
                for name in names if seen and len(chosen) else ():
                    self.chunks.ahead(name, *self.partition.cells(box), self.shown)
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
                if self.partition.sweep is None:
                    self.drawn([box])
        finally:
            self.chunks.forget()

    def _divided(self, rays: Rays, boxes: Iterable[CellBox]) -> Iterator[CellBox]:
        """Yield boxes; for one in which rays may come to their end its chunks, front to back.

        Those behind others are then not read.
        """
        partition, chunks, finer = self.partition, self.partition.volume.store.chunks, None
        evaluator = CellEvaluator(self.job.volume, self.job.medium, self.backend)
        for box in boxes:
            several = is_structured(partition.grid) and partition.side != chunks
            if self.ending is not None and several:
                most = evaluator.most_in(partition.ranges(box, self.job.medium.names))
                if evaluator.channels.densest(most) * min(chunks) > _OPAQUE:
                    finer = finer or partition.in_chunks(*rays.origins())
                    yield from finer[partition.place(box)]
                    continue
            yield box

    def follow(self, pixel: np.ndarray, du: np.ndarray, dv: np.ndarray, *written: Any) -> Followed:
        rays = Rays.starting(self, RayBatch(self._lanes(pixel, du, dv)))
        (state,), blocks = rays.states, list[tuple[CellBox, int]]()
        while not blocks or rays.wait or rays.further():  # rays come to some parts again
            for block in self.partition.blocks(*rays.origins()):
                self.through(rays, [block])
                blocks.append((block, int(state.carried[0][0]) if state.carried else 0))
        return Followed(state.path, state.over, blocks)

    def drawn(self, boxes: Iterable[CellBox]) -> None:
        """Report boxes that are done."""
        if self._counts:
            self._done += sum(
                math.prod(high - low for low, high in zip(box.low, box.high, strict=True))
                for box in boxes
            )
        self.job.progress(self._done, self.partition.grid.size * self.job.samples**2)

    @functools.cached_property
    def sent(self) -> Sent:
        """What makes this tracer in another process.

        Raises
        ------
        InputError
            If it cannot be sent, or is more than a task should carry.
        """
        size = self.partition.volume.bytes_in_memory
        if size > self.most_sent:
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
        job, partition = self.job, self.partition
        others = ("volume", "cache", "progress", "done", "partition")
        how = {name: part for name, part in vars(job).items() if name not in others}
        also = partition.side, partition.geometry, self.background, self.faintest
        return content_key(how, partition.volume.fingerprint(), *also)

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
        return bool(np.any(self._visible_in(self.partition.ranges(box, self.job.medium.names))))

    @functools.cached_property
    def shown(self) -> np.ndarray:
        """In which chunks the medium may be visible, whatever block they are part of."""
        shown: Any = True
        if not self._everywhere:
            shown = self._visible_in(self.partition.ranges_of_chunks(self.job.medium.names))
        return np.broadcast_to(shown, self.partition.volume.chunk_counts)

    def _visible_in(self, ranges: dict[str, Interval]) -> np.ndarray:
        faint = self.source.context.faint if self.partition.dual else _FAINTEST
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
        source, hidden = self.partition.coefficients(self, box, len(chosen))
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


# Threads of one process that draw blocks do so one after another: kernels use all cores.
_LOCK = threading.Lock()


def _tracer(job: RenderJob, background: float, faintest: bool) -> RayTracer:
    reuse_memory()
    return job.partition.tracer(job, job.source(faintest), background, faintest)


def _draw_elsewhere(
    sent: Sent, limits: Any, rays: tuple[Any, ...], boxes: tuple[CellBox, ...]
) -> list[RayState]:
    """Return the states of rays that have gone through boxes; see `BlockTracer.task`."""
    with _LOCK:
        tracer: BlockTracer = sent.value()
        tracer.tolerance = mapped(lambda a: on_device(tracer.backend, a), limits)
        own = Rays(tracer, *rays)
        tracer.through(own, boxes)
        return own.states
