"""The blocks of cells of which a picture is drawn in pieces: their order, ranges and contents."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..expressions import Expression
from ..expressions.interval import Interval
from ..fields import coordinate_extremes, held_dtype
from ..grids import CartesianGrid
from ..grids.contract import CellBox
from ..grids.structured import is_structured
from ..grids.trees.ghosts import LeavesWithGhosts
from ..progress import Report, silent
from ..schemes.channels import MOST_TOGETHER
from ..volume import Volume
from .options import check_in_pieces
from .outline import Outline, byte_count, largest_side

if TYPE_CHECKING:
    from ..grids.trees.parts import Parts
    from ..media.contract import Medium
    from ..schemes.base import Scheme
    from .chunks import Chunks

# Memory of each process, if several draw.
_USUAL = "2 GiB"
# Blocks of a picture that several processes draw: a task of Dask takes 2 ms.
_MOST_BLOCKS = 200
# As many of them keep some ten processes busy.
_FEWEST_BLOCKS = 64
# Temporary arrays of classification, kernels and what Dr.Jit keeps of freed memory.
_OTHERS = 96 << 20
# Layers of chunks that interpolating rays need again, of those between some 2 × 50 blocks of 256³.
_LAYERS = 64 << 20
# Bytes of a ray's place in a tree: on the host, and before and after a block.
_WAITING = 240
# Where fields are interpolated on trees: cells with those around per cell, bytes of a cell's
# corners, place and slopes, and of all else while they are computed.
_GHOSTS, _CORNERS, _STENCILS = 1.3, 150, 300 << 20


@dataclass(frozen=True)
class Block:
    """Boxes of cells that one process draws one after another; together they are a box."""

    boxes: tuple[CellBox, ...]
    # Coordinates of its corners, shape (3, 2).
    extent: np.ndarray


class Pieces:
    """The blocks of cells of which a picture is drawn, one after another: of a Cartesian grid.

    Attributes
    ----------
    side : tuple of int
        Cells of a block along the axes: some chunks of the file. Of a tree, cells at most.
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
    sweep : Sweep or None
        Draws blocks in other processes, or keeps them in files.
    report : callable
        Is told the cells done, and all of them.
    """

    def __init__(
        self, volume: Any, medium: Any, memory: Any, sweep: Any = None, **options: Any
    ) -> None:
        memory = _USUAL if memory is None else memory
        self.memory, self.sweep = memory, sweep
        byte_count(memory)
        check_in_pieces(volume, medium, **options)
        self.outline = Outline.of(volume)
        if sweep is not None:
            self.outline = Outline.of(_with(volume, self.outline.stored(medium.names)))
        self.grid: Any = volume.grid
        self.side = self.outline.store.chunks
        # Coordinates between which the cells are met by rays, of each axis.
        self.edges = self.grid.edges if is_structured(self.grid) else ()
        self.walls = self.edges
        self.dual = False
        self.report: Report = silent
        self.lacking: tuple[str, ...] = ()

    def seen_by(self, camera: Any, names: Iterable[str]) -> Outline:
        """Return the outline that a camera sees, with the fields among some names."""
        seen: Any = self.outline.seen_by(camera)
        components = [n for n in names if n not in self.outline._fields and n in self.outline]
        self.outline = seen.computing({name: Expression(name) for name in components})
        return self.outline

    def missing(self, names: Iterable[str], by_field: bool) -> dict[str, int]:
        """Return the number of missing values in each field that lacks some; see `complete`.

        Cells without a value are hidden. Where fields are interpolated (`by_field`) this is
        refused: neighbours in other chunks would fill them.
        """
        used = sorted(name for name in names if name in self.outline)
        counts = {name: count for name in used if (count := self.outline.missing(name))}
        self.lacking = tuple(counts)
        if counts and by_field:
            name = self.lacking[0]
            raise InputError(
                f"field {name!r} has missing values, which memory= cannot interpolate (neighbours "
                "in other chunks fill them): scheme='first-order' hides their cells; or replace "
                "them, or draw without memory="
            )
        return counts

    def hidden(self, box: CellBox, values: dict[str, np.ndarray]) -> np.ndarray | None:
        """Return which cells of a block are hidden, None if none are, and give them some value."""
        hidden = None
        for name in self.lacking:
            gone = np.isnan(values[name]) if self.outline.lacks(box, name) else None
            if gone is not None and gone.any():
                hidden = gone if hidden is None else hidden | gone
                least = self.outline.extremes(name)[..., 0].min()
                values[name] = np.where(gone, values[name].dtype.type(least), values[name])
        return hidden

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process needs."""
        return {**vars(self), "sweep": None, "report": silent}

    def plan(self, medium: Medium, scheme: Scheme, pixels: tuple[int, int]) -> None:
        """Set the blocks: as large as the memory allows.

        Raises
        ------
        MemoryNeededError
            If it does not allow even single chunks.
        """
        used = self.used = [name for name in medium.names if name in self.outline]
        kinds = [self.outline.dtype(name) for name in used]
        extinctions = 1 if medium.grey else medium.channels
        # Many channels are drawn in groups, in each of which rays have a state before and after.
        part = min(1.0, MOST_TOGETHER / medium.channels)
        # Fields of a block, and chunks of the next; with real numbers for integers.
        numbers = medium.channels + extinctions
        per_cell: float = sum(2 * k.itemsize for k in kinds)
        per_cell += sum((4 if k.itemsize <= 2 else 8) for k in kinds if k.kind != "f")
        self.per_table = int(6 * max(part * numbers, len(medium.components())))
        path = numbers + extinctions
        self.dual = scheme.coefficients_at == "field"
        if self.dual:
            # Cells are met between the centres of those before and their own.
            self.walls = tuple(
                np.concatenate([e[:1], 0.5 * (e[1:-1] + e[:-2]), e[-1:]]) for e in self.edges
            )
            per_cell = sum(2 * k.itemsize + 4 for k in kinds)
            self.per_table = 0
            path += 3 + extinctions + 2 * len(medium.scalars())
        # While a field is computed, those that it is made of are there.
        made = [self.outline.stored([n]) for n in used if n not in self.outline.stored([n])]
        per_cell += max(
            (sum(2 * self.outline.dtype(s).itemsize for s in each) for each in made), default=0
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
            self.outline, self.memory, per_cell, others, *need, fewest=fewest
        )
        table = self.per_table * math.prod(n + 2 for n in self.side)
        self.tabulates = table <= self.room
        self.room -= table if self.tabulates else 0
        self.room += _LAYERS if self.dual else 0

    @property
    def geometry(self) -> tuple[np.ndarray, ...]:
        """Numbers that tell where cells are."""
        return tuple(self.grid.edges)

    def boxes(self, parallel: bool, origin: np.ndarray, direction: np.ndarray) -> Iterator[CellBox]:
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
        return self._boxes(self.side, parallel, origin, direction)

    def _boxes(
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
        """Return the chunks of each block, front to back; arguments are those of `boxes`."""
        found: dict[tuple[int, ...], list[CellBox]] = {}
        for box in self._boxes(self.outline.store.chunks, *seen):
            found.setdefault(self.place(box), []).append(box)
        return found

    def blocks(self, boxes: Sequence[CellBox]) -> list[Block]:
        """Return boxes in blocks: few, that several processes draw."""
        groups: dict[Any, list[CellBox]] = {}
        for box, group in zip(boxes, self._groups(boxes), strict=True):
            groups.setdefault(group, []).append(box)
        return [Block(tuple(group), self.around(group)) for group in groups.values()]

    def _groups(self, boxes: Sequence[CellBox]) -> list[Any]:
        """Return the blocks of k × k × k that boxes belong to."""
        counts = [-(-n // side) for n, side in zip(self.grid.shape, self.side, strict=True)]
        k = 1
        while math.prod(-(-n // k) for n in counts) > _MOST_BLOCKS:
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
        if name in self.outline:
            table = self.outline.extremes(name)[self._chunks_of(box)]
            ends = table[..., 0].min(), table[..., 1].max()
        else:
            ends = coordinate_extremes(CartesianGrid(*self._ends(box)), name)
        return Interval(*(np.asarray(end, np.float64) for end in ends))

    def _chunks_of(self, box: CellBox) -> Any:
        return self.outline.chunks_of(box)

    def _ends(self, box: CellBox) -> list[np.ndarray]:
        return [e[[a, b]] for e, a, b in zip(self.grid.edges, box.low, box.high, strict=True)]

    def ranges_of_chunks(self, names: Any) -> dict[str, Interval]:
        """Return the ranges in every chunk, arrays of three axes; see `chunk_ends`."""
        grids = {}
        for name in names:
            if name in self.outline:
                ends = np.moveaxis(self.outline.extremes(name).astype(np.float64), -1, 0)
                grids[name] = self._with_neighbours(*ends)
                continue
            walls = [
                np.stack([e[:-1:c], np.append(e[c:-1:c], e[-1])])
                for e, c in zip(self.grid.edges, self.outline.store.chunks, strict=True)
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


class TreePieces(Pieces):
    """Consecutive cells of an octree, or of patches, in which rays wait to be drawn."""

    parts: Parts
    # Parts that a process draws one after another.
    groups: Parts
    # By the first cell of a part: it with others around, and the chunks that all these are in.
    _leaves: OrderedDict[int, LeavesWithGhosts]
    _touched: dict[int, np.ndarray]

    def plan(self, medium: Medium, scheme: Scheme, pixels: tuple[int, int]) -> None:
        self._leaves, self._touched = OrderedDict(), {}
        super().plan(medium, scheme, pixels)

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "_leaves": OrderedDict()}

    def _divide(self, per_cell: float, others: int, pixels: tuple[int, int]) -> None:
        # Where rays wait: on the host, and before and after a block. Tables of where cells are.
        others += _WAITING * pixels[0] * pixels[1] + 2 * self.grid.tree.entries.nbytes
        if self.dual:
            per_cell, others = _GHOSTS * (per_cell + _CORNERS), others + _STENCILS
        super()._divide(per_cell, others, pixels)
        (most,) = self.side
        self.parts = self.groups = self.grid.parts(most)
        if len(self.parts.low) > _MOST_BLOCKS:
            self.groups = self.grid.parts(max(most, 2 * self.grid.size // _MOST_BLOCKS))

    @property
    def geometry(self) -> tuple[np.ndarray, ...]:
        return (*self.grid.base_edges, self.grid.levels, self.parts.low, self.parts.high)

    def boxes(self, parallel: bool, origin: np.ndarray, direction: np.ndarray) -> Iterator[CellBox]:
        way = origin.mean(axis=1), direction if parallel else None
        rank = np.empty(len(self.groups.low), np.int64)
        rank[self.groups.front_to_back(*way)] = np.arange(len(rank))
        order = self.parts.front_to_back(*way)
        for k in order[np.argsort(rank[self._group(self.parts.ends[order])], kind="stable")]:
            yield CellBox((int(self.parts.ends[k]),), (int(self.parts.ends[k + 1]),))

    def _groups(self, boxes: Sequence[CellBox]) -> list[Any]:
        return [int(self._group(box.low[0])) for box in boxes]

    def _group(self, cell: Any) -> Any:
        return np.searchsorted(self.groups.ends, cell, "right") - 1

    def extent(self, box: CellBox) -> np.ndarray:
        k = np.searchsorted(self.parts.ends, box.low[0])
        return np.stack([self.parts.low[k], self.parts.high[k]], axis=-1)

    def _ends(self, box: CellBox) -> list[np.ndarray]:
        return list(self.extent(box))

    def ranges_of_chunks(self, names: Any) -> dict[str, Interval]:
        grids = {}
        for name in names:
            ends: Any
            if name in self.outline:
                ends = np.moveaxis(self.outline.extremes(name), -1, 0)
            else:
                ends = coordinate_extremes(self.grid, name)
            if self.dual:  # chunks beside one that shows something are needed, too
                ends = np.min(ends[0]), np.max(ends[1])
            grids[name] = Interval(*(np.asarray(end, np.float64) for end in ends))
        return grids

    def cells(self, box: CellBox) -> tuple[tuple[int, ...], tuple[int, ...]]:
        return box.low, box.high

    def _chunks_of(self, box: CellBox) -> Any:
        if not self.dual:
            return super()._chunks_of(box)
        first, side = box.low[0], self.outline.store.chunks[0]
        if first not in self._touched:
            own, ghosts = np.arange(first // side, -(-box.high[0] // side)), self.leaves(box).ghosts
            self._touched[first] = np.unique(np.concatenate([own, ghosts // side]))
        return self._touched[first]

    def leaves(self, box: CellBox) -> LeavesWithGhosts:
        """Return a part with the leaves around it that interpolated fields need."""
        first, last = box.low[0], box.high[0]
        if first not in self._leaves:
            while len(self._leaves) > 1:  # that of the part before, and of the next
                self._leaves.popitem(last=False)
            self._leaves[first] = LeavesWithGhosts(self.grid, first, last)
        return self._leaves[first]

    def around_leaves(self, chunks: Chunks, leaves: LeavesWithGhosts) -> dict[str, np.ndarray]:
        """Return fields in a part and, after it, in the ghosts around it."""
        own = ((leaves.first,), (leaves.first + leaves.own,))
        side, ghosts = self.outline.store.chunks[0], leaves.ghosts
        groups = np.split(ghosts, np.flatnonzero(np.diff(ghosts // side)) + 1)
        groups = [group for group in groups if len(group)]
        ends = [((int(group[0]),), (int(group[-1]) + 1,)) for group in groups]
        fields = {}
        for name in self.used:
            for low, high in (own, *ends):
                chunks.ahead(name, low, high)
            values = np.empty(leaves.size, held_dtype(self.outline.dtype(name)))
            values[: leaves.own] = chunks.box(name, *own)
            end = leaves.own
            for group, (low, high) in zip(groups, ends, strict=True):
                values[end : end + len(group)] = chunks.box(name, low, high)[group - low[0]]
                end += len(group)
            fields[name] = values
        return fields


def pieces_of(volume: Any, medium: Any, memory: Any, sweep: Any = None, **options: Any) -> Pieces:
    """Return the pieces of a volume; see `check_in_pieces` for the options."""
    grid = getattr(volume, "grid", None)
    kind = Pieces if grid is None or is_structured(grid) else TreePieces
    return kind(volume, medium, memory, sweep, **options)


def widen_to_neighbours(low: np.ndarray, high: np.ndarray) -> None:
    """Widen ranges in chunks, arrays of three axes, to those in chunks that share an edge, too."""
    for axis in range(3):
        for ends, furthest in ((low, np.minimum), (high, np.maximum)):
            lines = np.moveaxis(ends, axis, 0)
            own = lines.copy()
            furthest(lines[1:], own[:-1], out=lines[1:])
            furthest(lines[:-1], own[1:], out=lines[:-1])


def _with(volume: Volume, names: Any) -> Volume:
    """Return a volume without other fields in memory: other processes read what is in files."""
    lean = volume.unread()
    for name in lean.fields:
        if name not in names and name not in lean.waiting:
            del lean[name]
    lean.tables = volume.tables
    return lean
