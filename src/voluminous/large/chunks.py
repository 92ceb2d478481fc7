"""Volumes larger than memory as blocks of cells: their order, ranges and contents."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..expressions.interval import Interval
from ..fields import coordinate_extremes
from ..grids import CartesianGrid
from ..grids.contract import CellBox
from ..grids.structured import is_structured
from ..media.sum import with_each
from ..memory import byte_count
from ..ranges import Ranges
from ..rendering.cache import Cache
from ..rendering.missing import Completed
from ..rendering.partition import Partition
from ..rendering.sources.interpolated import interpolated_fields
from ..rendering.sources.table import CELLS_PER_STEP, on_ray_in_blocks
from ..schemes.channels import MOST_TOGETHER
from ..volume import Volume
from .tracer import BlockTracer
from .view import VolumeView, largest_side

if TYPE_CHECKING:
    from ..media.contract import Medium
    from ..rendering.cache import Cache
    from ..rendering.job import RayJob, RenderJob
    from ..rendering.sources.cells import CellEvaluator
    from ..schemes.base import Scheme
    from .sweep import Sweep

# Memory of each process, if several draw.
_USUAL = "2 GiB"
# As many blocks keep some ten processes busy.
_FEWEST_BLOCKS = 64
# Temporary arrays of classification, kernels and what Dr.Jit keeps of freed memory.
_OTHERS = 96 << 20
# Layers of chunks that interpolating rays need again, of those between some 2 × 50 blocks of 256³.
_LAYERS = 64 << 20


@dataclass(frozen=True)
class Task:
    """Blocks that one process draws one after another; together they are a box."""

    blocks: tuple[CellBox, ...]
    # Coordinates of its corners, shape (3, 2).
    extent: np.ndarray


class CartesianChunks(Partition):
    """A Cartesian volume in blocks of some chunks of its file, each drawn by itself.

    Attributes
    ----------
    side : tuple of int
        Cells of a block along the axes. Of a tree, cells at most.
    dual : bool
        Rays interpolate between the centres of cells.
    room : int
        Bytes that may be taken besides.
    tabulates : bool
        There is also room for a table of a block's coefficients.
    used : list of str
        Fields of the medium.
    per_cell, others : float
        Bytes that drawing takes for each cell of a block, and besides; see `plan`.
    """

    volume: VolumeView
    labels = "first-order"
    # Tasks of a picture that several processes draw: one of Dask takes 2 ms.
    most_tasks = 200

    def __init__(self, volume: Volume, memory: Any = None, sweep: Sweep | None = None) -> None:
        self.memory, self.sweep = _USUAL if memory is None else memory, sweep
        byte_count(self.memory)
        self._whole = self.volume = VolumeView.of(volume)
        self.grid: Any = volume.grid
        self.side = self.ranged = self.volume.store.chunks
        # Coordinates between which the cells are met by rays, of each axis.
        self.edges = self.walls = self.grid.edges if is_structured(self.grid) else ()
        self.dual = False
        self.lacking: tuple[str, ...] = ()

    def alone(self) -> CartesianChunks:
        other = copy.copy(self)
        other.sweep = None
        return other

    def finish(self) -> None:
        if self.sweep is not None:
            self.sweep.finish()

    def seen_by(self, camera: Any, medium: Medium, scheme: Scheme) -> VolumeView:
        if scheme.coefficients_at == "vertex":
            raise InputError(
                f"scheme {scheme.name!r} cannot draw chunk by chunk (memory=): use "
                "'post-classified', 'pre-integrated' or 'first-order'"
            )
        drawn = medium
        if scheme.coefficients_at == "field":
            drawn = with_each(medium, lambda part: part.on_rays())
        seen: Any = self._whole.seen_by(camera)
        names = dict.fromkeys((*medium.names, *drawn.names))
        made = [name for name in names if name not in seen._fields and name in seen]
        self.volume = seen.computing({name: Expression(name) for name in made})
        return self.volume

    def complete(self, cache: Cache, names: Iterable[str], by_field: bool) -> Completed:
        used = sorted(name for name in names if name in self.volume)
        counts = {name: count for name in used if (count := self.volume.missing(name))}
        self.lacking = tuple(counts)
        if counts and by_field:
            name = self.lacking[0]
            raise InputError(
                f"field {name!r} has missing values, which memory= cannot interpolate (neighbours "
                "in other chunks fill them): scheme='first-order' hides their cells; or replace "
                "them, or draw without memory="
            )
        return self.volume, cache, None, counts

    def source(self, job: RayJob, evaluator: CellEvaluator, faintest: bool) -> Any:
        if self.dual:
            limits = job.tolerance, faintest, True
            return interpolated_fields(evaluator, job.cache, job.scheme, *limits, in_blocks=True)
        return on_ray_in_blocks(evaluator, job.cache, job.scheme)

    def coefficients(
        self, tracer: BlockTracer, box: CellBox, rays: int
    ) -> tuple[Callable[[slice], Any], np.ndarray | None]:
        """Return the coefficients of some channels in a block, and which of its cells are hidden.

        Fields are read, and put where kernels gather them, once for all channels.
        """
        source, several, hidden = tracer.source, len(tracer.groups) > 1, None
        values = {
            name: tracer.chunks.box(name, *self.cells(box), tracer.shown, int(self.dual))
            for name in self.used
        }
        sides = [b - a for a, b in zip(box.low, box.high, strict=True)]
        cells = math.prod(sides)
        across = sum(sides) if is_structured(self.grid) else 3.0 * cells ** (1 / 3)
        if self.dual:
            within = source.within(values)
        else:
            hidden = self.hidden(box, values)
            volume = self.volume.volume(box, values)
            pays = self.tabulates and cells < CELLS_PER_STEP * rays * across
            if pays and source.real is tracer.backend.Wide:

                def table(group: slice) -> Any:
                    part = source.group(group) if several else source
                    return part.tabulated(volume, box.low)

                return table, hidden
            within = source.within(volume, box.low)
        return (within.group if several else lambda group: within), hidden

    def tracer(self, job: RenderJob, source: Any, background: float, faintest: bool) -> BlockTracer:
        if job.recursive:
            raise InputError(
                "antialias='radmc3d' of refined grids looks at all cells along a ray: use "
                "antialias='adaptive', or draw without memory="
            )
        return BlockTracer(job, self, source, background, faintest)

    def ranges_around(self, cache: Cache, names: Iterable[str]) -> Ranges:
        found = Ranges()
        for name in names:
            low, high = np.moveaxis(self.volume.extremes(name), -1, 0).copy()
            widen_to_neighbours(low, high)
            found[name] = Interval(low.reshape(-1), high.reshape(-1))
        return found

    def blocks_of(self, names: Iterable[str], per_cell: int, others: int) -> Iterator[CellBox]:
        per_cell += 2 * sum(self.volume.dtype(n).itemsize for n in self.volume.stored(names))
        side, _ = largest_side(self.volume, self.memory, per_cell, others)
        shape = self.grid.shape
        firsts = (range(0, n, s) for n, s in zip(shape, side, strict=True))
        for low in itertools.product(*firsts):
            ends = zip(low, side, shape, strict=True)
            yield CellBox(low, tuple(min(a + s, n) for a, s, n in ends))

    def part(self, box: CellBox, names: Iterable[str]) -> Volume:
        return self.volume.part(box, names)

    def with_field(self, name: str, expression: Expression) -> tuple[Volume, bool]:
        other = self.volume.computing({name: expression})
        return other, other.missing(name) > 0

    def extremes_of(self, expression: Expression) -> np.ndarray:
        return self.volume.computing({"value": expression}).extremes("value")

    def hidden(self, box: CellBox, values: dict[str, np.ndarray]) -> np.ndarray | None:
        """Return which cells of a block are hidden, None if none are, and give them some value."""
        hidden = None
        for name in self.lacking:
            gone = np.isnan(values[name]) if self.volume.lacks(box, name) else None
            if gone is not None and gone.any():
                hidden = gone if hidden is None else hidden | gone
                least = self.volume.extremes(name)[..., 0].min()
                values[name] = np.where(gone, values[name].dtype.type(least), values[name])
        return hidden

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process needs."""
        return {**vars(self), "sweep": None}

    def plan(self, medium: Medium, scheme: Scheme, pixels: tuple[int, int]) -> None:
        """Set the blocks: as large as the memory allows.

        Raises
        ------
        MemoryNeededError
            If it does not allow even single chunks.
        """
        used = self.used = [name for name in medium.names if name in self.volume]
        kinds = [self.volume.dtype(name) for name in used]
        extinctions = 1 if medium.grey else medium.channels
        # Many channels are drawn in groups, in each of which rays have a state before and after.
        part = min(1.0, MOST_TOGETHER / medium.channels)
        # Fields of a block, and chunks of the next; with real numbers for integers.
        numbers = medium.channels + extinctions
        per_cell: float = sum(2 * k.itemsize for k in kinds)
        per_cell += sum((4 if k.itemsize <= 2 else 8) for k in kinds if k.kind != "f")
        self.per_table = int(6 * max(part * numbers, len(medium.components())))
        path = numbers + extinctions
        self.dual, self.walls = scheme.coefficients_at == "field", self.edges
        if self.dual:
            # Cells are met between the centres of those before and their own.
            self.walls = tuple(
                np.concatenate([e[:1], 0.5 * (e[1:-1] + e[:-2]), e[-1:]]) for e in self.edges
            )
            per_cell = sum(2 * k.itemsize + 4 for k in kinds)
            self.per_table = 0
            path += 3 + extinctions + 2 * len(medium.scalars())
        # While a field is computed, those that it is made of are there.
        made = [self.volume.stored([n]) for n in used if n not in self.volume.stored([n])]
        per_cell += max(
            (sum(2 * self.volume.dtype(s).itemsize for s in each) for each in made), default=0
        )
        # Lanes; paths of all rays, of those in a block before and after it, and as results.
        others = _OTHERS + int(96 + (12 + 8 * part) * path) * pixels[0] * pixels[1]
        others += _LAYERS if self.dual else 0
        self._divide(per_cell, others, pixels)

    def _divide(self, per_cell: float, others: int, pixels: tuple[int, int]) -> None:
        self.per_cell, self.others = per_cell, others
        need = f" and {pixels[0]} x {pixels[1]} pixels", "take fewer pixels, "
        fewest = 1 if self.sweep is None else _FEWEST_BLOCKS
        self.side, self.room = largest_side(
            self.volume, self.memory, per_cell, others, *need, fewest=fewest
        )
        table = self.per_table * math.prod(n + 2 for n in self.side)
        self.tabulates = table <= self.room
        self.room -= table if self.tabulates else 0
        self.room += _LAYERS if self.dual else 0

    @property
    def geometry(self) -> tuple[np.ndarray, ...]:
        """Numbers that tell where cells are."""
        return tuple(self.grid.edges)

    def blocks(
        self, parallel: bool, origin: np.ndarray, direction: np.ndarray
    ) -> Iterator[CellBox]:
        """Yield the blocks front to back: rays meet their places at growing distances.

        Places count from that of the observer; from the side the rays come from, if it is far away
        (Manhattan distance: along each axis a ray moves away from where it begins).

        Parameters
        ----------
        origin : float array, shape (3, 2)
            Where rays begin: the least and the largest coordinates.
        direction : float array, shape (3,)
            Of parallel rays.
        """
        return self._blocks(self.side, parallel, origin, direction)

    def _blocks(
        self, side: tuple[int, ...], parallel: bool, origin: np.ndarray, direction: np.ndarray
    ) -> Iterator[CellBox]:
        walls, center = [], []
        for axis, (n, step) in enumerate(zip(self.grid.shape, side, strict=True)):
            begin = [0, 0] if direction[axis] >= 0 else [n, n]
            if not parallel:
                begin = (np.searchsorted(self.walls[axis], origin[axis], "right") - 1).tolist()
            # The block that a ray meets later takes the layer between two: of the other the layer
            # of cells that it needs has been read before.
            own = [w + 1 if self.dual and 0 < w < begin[0] else w for w in range(0, n, step)]
            walls.append([*own, n])
            first, last = (np.searchsorted(walls[-1], begin, "right") - 1).tolist()
            if first != last:
                raise InputError(
                    "memory= needs rays that begin at one place, or are parallel: those of this "
                    "camera begin in several chunks; draw without memory="
                )
            center.append(min(first, len(own) - 1) if parallel else first)

        def far(place: tuple[int, ...]) -> int:
            return sum(abs(i - c) for i, c in zip(place, center, strict=True))

        for place in sorted(np.ndindex(*(len(w) - 1 for w in walls)), key=far):
            low, high = zip(
                *((w[i], w[i + 1]) for w, i in zip(walls, place, strict=True)), strict=True
            )
            if all(a < b for a, b in zip(low, high, strict=True)):
                yield CellBox(low, high)

    def place(self, box: CellBox) -> tuple[int, ...]:
        """Return the number of the block that a box is in, along each axis."""
        return tuple(low // side for low, side in zip(box.low, self.side, strict=True))

    def in_chunks(self, *seen: Any) -> dict[tuple[int, ...], list[CellBox]]:
        """Return the chunks of each block, front to back; arguments are those of `blocks`."""
        found: dict[tuple[int, ...], list[CellBox]] = {}
        for box in self._blocks(self.volume.store.chunks, *seen):
            found.setdefault(self.place(box), []).append(box)
        return found

    def tasks(self, blocks: Sequence[CellBox]) -> list[Task]:
        """Return blocks in tasks: few, that several processes draw."""
        groups: dict[Any, list[CellBox]] = {}
        for block, group in zip(blocks, self._groups(blocks), strict=True):
            groups.setdefault(group, []).append(block)
        return [Task(tuple(group), self.around(group)) for group in groups.values()]

    def _groups(self, boxes: Sequence[CellBox]) -> list[Any]:
        """Return the tasks of k × k × k blocks that blocks belong to."""
        counts = [-(-n // side) for n, side in zip(self.grid.shape, self.side, strict=True)]
        k = 1
        while math.prod(-(-n // k) for n in counts) > self.most_tasks:
            k += 1
        return [tuple(place // k for place in self.place(box)) for box in boxes]

    def around(self, boxes: Sequence[CellBox]) -> np.ndarray:
        """Return the coordinates between which rays meet boxes, shape (3, 2)."""
        extents = np.array([self.extent(box) for box in boxes])
        return np.stack([extents[..., 0].min(axis=0), extents[..., 1].max(axis=0)], axis=-1)

    def extent(self, box: CellBox) -> np.ndarray:
        """Return the coordinates between which rays meet a box, shape (3, 2)."""
        return np.array(
            [(w[a], w[b]) for w, a, b in zip(self.walls, box.low, box.high, strict=True)]
        )

    def ranges(self, box: CellBox, names: Any) -> dict[str, Interval]:
        """Return the ranges of fields and coordinates in a block; see `cells`."""
        box = CellBox(*self.cells(box))
        return {name: self._range(box, name) for name in names}

    def _range(self, box: CellBox, name: str) -> Interval:
        if name in self.volume:
            table = self.volume.extremes(name)[self._chunks_of(box)]
            ends = table[..., 0].min(), table[..., 1].max()
        else:
            ends = coordinate_extremes(CartesianGrid(*self._ends(box)), name)
        return Interval(*(np.asarray(end, np.float64) for end in ends))

    def _chunks_of(self, box: CellBox) -> Any:
        return self.volume.chunks_of(box)

    def _ends(self, box: CellBox) -> list[np.ndarray]:
        return [e[[a, b]] for e, a, b in zip(self.grid.edges, box.low, box.high, strict=True)]

    def ranges_of_chunks(self, names: Any) -> dict[str, Interval]:
        """Return the ranges in every chunk, arrays of three axes; see `chunk_ends`."""
        grids = {}
        for name in names:
            if name in self.volume:
                ends = np.moveaxis(self.volume.extremes(name).astype(np.float64), -1, 0)
                grids[name] = self._with_neighbours(*ends)
                continue
            walls = [
                np.stack([e[:-1:c], np.append(e[c:-1:c], e[-1])])
                for e, c in zip(self.grid.edges, self.volume.store.chunks, strict=True)
            ]
            parts = [
                self._with_neighbours(*np.reshape(w, (2, *(-1 if k == a else 1 for k in range(3)))))
                for a, w in enumerate(walls)
            ]
            if name == "r":
                squares = [part * part for part in parts]
                low, high = (sum(s.lo for s in squares), sum(s.hi for s in squares))
                grids[name] = Interval(np.sqrt(low), np.sqrt(high))
            else:
                grids[name] = parts["xyz".index(name)]
        return grids

    def _with_neighbours(self, low: np.ndarray, high: np.ndarray) -> Interval:
        """Return ranges in chunks; if rays interpolate, in those that share an edge, too."""
        if self.dual:
            widen_to_neighbours(low, high)
        return Interval(low, high)

    def cells(self, box: CellBox) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return the first cells and the last, plus one, that drawing a block needs.

        If rays interpolate, one layer more on the low sides.
        """
        if not self.dual:
            return box.low, box.high
        x, y, z = (max(a - 1, 0) for a in box.low)
        return (x, y, z), box.high


def widen_to_neighbours(low: np.ndarray, high: np.ndarray) -> None:
    """Widen ranges in chunks, arrays of three axes, to those in chunks that share an edge, too."""
    for axis in range(3):
        for ends, furthest in ((low, np.minimum), (high, np.maximum)):
            lines = np.moveaxis(ends, axis, 0)
            own = lines.copy()
            furthest(lines[1:], own[:-1], out=lines[1:])
            furthest(lines[:-1], own[1:], out=lines[:-1])
