"""A volume that is drawn in pieces: its outline, the blocks of cells, their order and ranges."""

from __future__ import annotations

import copy
import functools
import itertools
import math
import mmap
import re
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import deferred
from ..derivatives import LinesOfSight, is_component
from ..errors import InputError, MemoryNeededError
from ..expressions import Expression, required_names
from ..expressions.interval import Interval
from ..fields import coordinate_extremes, held_dtype
from ..grids import CartesianGrid
from ..grids.contract import CellBox, Grid
from ..grids.some_cells import SomeCells
from ..grids.trees.ghosts import LeavesWithGhosts
from ..progress import Report, reporter, silent
from ..store import FieldStore
from ..volume import Volume
from .options import check_in_pieces

if TYPE_CHECKING:
    from ..grids.trees.parts import Parts
    from ..media.contract import Medium
    from ..schemes.base import Scheme
    from ..store import FieldStore
    from .chunks import Chunks

_SIZES = {"": 0, "K": 1, "M": 2, "G": 3, "T": 4}
_TEXT = re.compile(r"\s*([0-9.]+(?:e[0-9]+)?)\s*([KMGT]?)(i?)B?\s*", re.IGNORECASE)
# Sides of a block do not exceed this: larger ones save no time, and cut less empty space off.
_WIDEST = 256
# Memory of each process, if several draw.
_USUAL = "2 GiB"
# Channels that are drawn together at most; see `sources.channel_layout.blocks_of`.
_TOGETHER = 16
# Chunks that are read for a sample of cells all over a volume.
_SAMPLED = 16
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


def byte_count(memory: Any) -> int:
    """Return a number of bytes from text such as ``"2 GiB"`` or ``"500 MB"``, or a number."""
    if isinstance(memory, (int, float)) and memory is not True and 0 < memory < math.inf:
        return int(memory)
    found = _TEXT.fullmatch(memory) if isinstance(memory, str) else None
    try:
        count = float(found[1]) if found else 0.0
    except ValueError:
        count = 0.0
    if not found or not 0.0 < count < math.inf:
        raise InputError(
            "memory is the number of bytes that drawing may take, as in memory='2 GiB', '500 MB' "
            f"or 2_000_000_000, got {memory!r}"
        )
    return int(count * (1024 if found[3] else 1000) ** _SIZES[found[2].upper()])


@dataclass(frozen=True)
class Block:
    """Boxes of cells that one process draws one after another; together they are a box."""

    boxes: tuple[CellBox, ...]
    # Coordinates of its corners, shape (3, 2).
    extent: np.ndarray


class FlatField:
    """A field of a store, of which planning a picture looks at some cells, by flat numbers.

    It stands for the array, which may be larger than memory.
    """

    def __init__(self, outline: Outline, name: str) -> None:
        self._outline, self._name = outline, name
        self.shape, self.size = outline.grid.shape, outline.grid.size
        self.dtype = outline.dtype(name)

    def reshape(self, shape: int) -> FlatField:
        """Return itself, for -1: it is flat already."""
        return self

    def min(self) -> Any:
        """Return the least value; NaN if there is one."""
        return self._outline.extremes(self._name)[..., 0].min()

    def max(self) -> Any:
        """Return the largest value; NaN if there is one."""
        return self._outline.extremes(self._name)[..., 1].max()

    def __getitem__(self, index: Any) -> np.ndarray:
        """Return consecutive cells, or a sample of cells.

        Of a large sample from a file some are in the chunks of others: it would all be read.
        """
        whole = self._outline.in_memory(self._name)
        if whole is not None:
            return np.asarray(whole.reshape(-1)[index])
        if isinstance(index, slice):
            first, last, _ = index.indices(self.size)
            plane = math.prod(self.shape[1:])
            low, others = first // plane, self.shape[1:]
            begin, end = (low, *(0 for _ in others)), (-(-last // plane), *others)
            layers = self._read(begin, end).reshape(-1)
            return layers[first - low * plane : last - low * plane]
        cell = np.stack(np.unravel_index(index, self.shape))
        chunks = np.array(self._outline.store.chunks)[:, None]
        # One chunk after another, evenly among those that there are cells of.
        kinds, which = np.unique(cell // chunks, axis=1, return_inverse=True)
        taken = np.unique(np.linspace(0, kinds.shape[1] - 1, _SAMPLED).astype(int))
        values = []
        for k in taken.tolist():
            low = kinds[:, k] * chunks[:, 0]
            high = np.minimum(low + chunks[:, 0], self.shape)
            own = cell[:, which.reshape(-1) == k] - low[:, None]
            values.append(self._read(low.tolist(), high.tolist())[tuple(own)])
        return np.resize(np.concatenate(values), len(index))

    def _read(self, low: Any, high: Any) -> np.ndarray:
        return self._outline.store.read(self._name, low, high)


class Outline(Volume):
    """A volume as planning a picture sees it: grid, names, units, ranges and some cells.

    It may have fields that are computed box by box; see `computing`.
    """

    _whole: Volume
    # Per chunk and field: ranges of the values, and how many are missing (None: none are).
    _tables: dict[str, tuple[np.ndarray, np.ndarray | None]]
    # Of the fields that are computed: text, and the stored fields that they are made of.
    _made: dict[str, tuple[str, list[str]]]

    @classmethod
    def of(cls, volume: Volume) -> Outline:
        """Return the outline of a volume; nothing is read yet."""
        if isinstance(volume, cls):
            return volume
        outline = object.__new__(cls)
        vars(outline).update(vars(volume))
        if len(volume.waiting) < len(volume.fields):  # some may be changed in place
            outline.tables = OrderedDict()
        outline._whole, outline._tables, outline._made = volume, {}, {}
        return outline

    @property
    def store(self) -> FieldStore:
        """Where boxes of fields are read from."""
        return FieldStore(self.grid.shape, self._fields)

    def stored(self, names: Iterable[str]) -> list[str]:
        """Return the stored fields that some names are made of, cell by cell.

        Raises
        ------
        InputError
            For derivatives, which need neighbours in other chunks.
        """
        found: dict[str, None] = {}
        for name in names:
            if name in self._made:
                found |= dict.fromkeys(self._made[name][1])
            elif (derived := self._derived(name)) is None:
                if name not in self.coordinates or name in self._fields:
                    self._check_field(name)
                    found[name] = None
            elif is_component(derived):
                for argument in derived.arguments:
                    found |= dict.fromkeys(self.stored(required_names(argument)))
            else:
                raise InputError(
                    f"{name!r} is computed from a whole field, which memory= does not read; make "
                    "it a field of the file, or leave out memory="
                )
        return list(found)

    def computing(self, expressions: Mapping[str, Expression]) -> Outline:
        """Return the outline with fields that are computed box by box.

        A component such as ``los(velocity)`` has the type of the vector; others are computed in
        double precision, as sums need it.
        """
        other = copy.copy(self)
        other._fields, other._units = copy.copy(self._fields), dict(self._units)
        other._tables, other._made = dict(self._tables), dict(self._made)
        for name, expression in expressions.items():
            stored = self.stored(expression.names)
            kind: np.dtype[Any] = np.dtype(np.float64)
            if component := expression.names == (name,):
                single = all(self.dtype(own) == np.float32 for own in stored)
                kind = np.dtype(np.float32 if single else np.float64)
            pieces = deferred.Pieces(functools.partial(_computed, self, expression, not component))
            what = deferred.Deferred(no_array, kind, pieces=pieces)
            other._fields.defer(name, no_array, what, self.grid.shape)
            other._made[name] = expression.text, stored
            other._units[name] = self.field_unit(name) if component else None
        return other

    def part(self, box: CellBox, names: Iterable[str]) -> Volume:
        """Return a block as a volume with some fields, or those that they are made of."""
        there = [name for name in names if name in self._fields]
        others = [name for name in names if name not in there]
        fields = {
            name: self.store.read(name, box.low, box.high)
            for name in dict.fromkeys([*there, *self.stored(others)])
        }
        return self.volume(box, fields)

    def with_cells(
        self, cells: np.ndarray, names: Iterable[str], side: Sequence[int]
    ) -> Iterator[tuple[Volume, np.ndarray, np.ndarray]]:
        """Yield blocks that hold some cells, their numbers in the grid, and those in the block."""
        shape, sides = self.grid.shape, np.asarray(side)
        index = np.stack(np.unravel_index(cells, shape))
        places, which = np.unique(index // sides[:, None], axis=1, return_inverse=True)
        for k, place in enumerate(places.T):
            low = place * sides
            box = _box(low.tolist(), np.minimum(low + sides, shape).tolist())
            own, part = np.flatnonzero(which.reshape(-1) == k), self.part(box, names)
            local = np.ravel_multi_index(tuple(index[:, own] - low[:, None]), part.grid.shape)
            yield part, cells[own], local

    def volume(self, box: CellBox, fields: Mapping[str, np.ndarray]) -> Volume:
        """Return a block as a volume; lengths in kernels are in the unit of the whole grid's."""
        grid: Grid
        if self.grid.is_structured:
            ends = zip(self.grid.edges, box.low, box.high, strict=True)
            grid = CartesianGrid(*(e[a : b + 1] for e, a, b in ends), unit=self.grid.unit)
            grid.__dict__["scale"] = self.grid.scale
        else:
            grid = SomeCells(self.grid, box.low[0], box.high[0])
        part = Volume(grid)
        part._fields.update(fields)
        part._units.update(self._units)
        part.sight = LinesOfSight(grid, self.sight.camera)
        return part

    def boxes(
        self, names: Sequence[str], memory: Any, per_cell: int, others: int
    ) -> Iterator[CellBox]:
        """Yield blocks one after another, as large as the memory allows to read some fields.

        Parameters
        ----------
        per_cell : int
            Bytes that are needed besides those of fields.
        others : int
            Bytes whatever the size of a block.
        """
        per_cell += 2 * sum(self.dtype(name).itemsize for name in self.stored(names))
        side, _ = largest_side(self, memory, per_cell, others)
        ways = (range(0, n, s) for n, s in zip(self.grid.shape, side, strict=True))
        for low in itertools.product(*ways):
            ends = zip(low, side, self.grid.shape, strict=True)
            yield _box(low, [min(a + s, n) for a, s, n in ends])

    def is_packed(self, name: str) -> bool:
        """Return whether a file stores a field in chunks, of which it reads the whole."""
        pieces = [self._fields.pieces(n) for n in self.stored([name]) if n in self._whole.waiting]
        return any(part is not None and part.chunks is not None for part in pieces)

    def is_mapped(self, name: str) -> bool:
        """Return whether a field stays in a file whose pages are brought into memory."""
        names = self.stored([name])
        return not self.is_packed(name) and any(self.in_memory(n) is None for n in names)

    @property
    def bytes_in_memory(self) -> int:
        """Bytes of the fields that are not read from files."""
        arrays = [self.in_memory(name) for name in self.fields]
        return sum(array.nbytes for array in arrays if array is not None)

    def dtype(self, name: str) -> np.dtype[Any]:
        """Return the type of a field without reading it."""
        kind: np.dtype[Any] = self._fields.dtype(name)
        return kind

    def in_memory(self, name: str) -> np.ndarray | None:
        """Return the array of a field, if it is in memory; pages of mapped files are not yet."""
        if name in self.waiting:
            return None
        array = root = self._whole.array(name)
        while isinstance(root.base, np.ndarray):
            root = root.base
        return None if isinstance(root.base, mmap.mmap) else array

    def array(self, name: str) -> Any:
        self.stored([name])
        self._check_field(name)
        return FlatField(self, name)

    def digest(self, name: str) -> bytes:
        return repr(self._key(name) or name).encode()

    def extremes(self, name: str) -> np.ndarray:
        """Return the least and the largest value in each chunk, shape (kx, ky, kz, 2) or (k, 2).

        They are measured once, unless the file tells; of fields in memory for every picture.
        Missing values do not count; a chunk without any other has the least value of the field.
        """
        return self._ranges(name)[0]

    def missing(self, name: str) -> int:
        """Return how many values of a field are missing (NaN)."""
        counts = self._ranges(name)[1]
        return 0 if counts is None else int(counts.sum())

    def lacks(self, box: CellBox, name: str) -> bool:
        """Return whether values of a field may be missing in a block."""
        counts = self._ranges(name)[1]
        return counts is not None and bool(counts[self.chunks_of(box)].any())

    def chunks_of(self, box: CellBox) -> tuple[slice, ...]:
        """Return the numbers of the chunks that a block is in, along each axis."""
        ends = zip(box.low, box.high, self.store.chunks, strict=True)
        return tuple(slice(a // c, -(-b // c)) for a, b, c in ends)

    def _ranges(self, name: str) -> tuple[np.ndarray, np.ndarray | None]:
        if name not in self._tables:
            key = self._key(name)
            if key is not None and key in self._whole.tables:
                found = self._whole.tables[key][0]
            else:
                table = self.store.extremes(name)
                if table is not None and table.shape[:-1] != self.chunk_counts:
                    table = None  # of other chunks than those of the other fields
                found = self._measured(name, table)
                if key is not None:
                    self._whole.tables[key] = found, found[0].nbytes
            self._tables[name] = found
        return self._tables[name]

    def _key(self, name: str) -> Any:
        """Return the key under which ranges are kept; None of fields that may change in place."""
        if not set(self.stored([name])) <= set(self._whole.waiting):
            return None
        made = self._made.get(name)
        return ("extremes of chunks", name, *(() if made is None else (made[0], self.sight.key())))

    @property
    def chunk_counts(self) -> tuple[int, ...]:
        """Return the number of chunks along each axis."""
        return tuple(-(-n // c) for n, c in zip(self.grid.shape, self.store.chunks, strict=True))

    def _measured(self, name: str, told: np.ndarray | None) -> tuple[np.ndarray, np.ndarray | None]:
        """Return ranges of chunks, and the numbers of missing values; of those that are not told.

        Raises
        ------
        InputError
            If a value is infinite, or none is there.
        """
        found = (
            np.full((*self.chunk_counts, 2), np.nan) if told is None else told.astype(np.float64)
        )
        missing = np.zeros(found.shape[:-1], np.int64)
        for place in np.argwhere(~np.all(np.isfinite(found), axis=-1)):
            reporter()(0, self.grid.size)
            pairs = zip(place.tolist(), self.store.chunks, self.grid.shape, strict=True)
            low, high = zip(*((i * c, min(i * c + c, n)) for i, c, n in pairs), strict=True)
            values = self.store.read(name, low, high)
            ends = values.min(), values.max()
            if not np.all(np.isfinite(ends)):
                gone = np.isnan(values)
                missing[tuple(place)] = np.count_nonzero(gone)
                if infinite := np.argwhere(np.isinf(values)).tolist():
                    cell = tuple(a + i for a, i in zip(low, infinite[0], strict=True))
                    text = self._made[name][0] if name in self._made else name
                    raise InputError(
                        f"{text!r} has infinite values; the first that was met is "
                        f"{values[tuple(infinite[0])]} in cell {cell}. Missing values are NaN "
                        "(transparent): replace them, or clip the field"
                    )
                some = values[~gone]
                ends = some.min(initial=np.inf), some.max(initial=-np.inf)
            found[tuple(place)] = ends
        empty = found[..., 0] > found[..., 1]
        if empty.all():
            raise InputError(f"field {name!r} has no value at all: every cell is NaN")
        found[empty] = found[~empty][:, 0].min()
        return found, missing if missing.any() else None


def no_array() -> np.ndarray:
    """Refuse to make the array of a field that is computed box by box."""
    raise AssertionError("a field of an outline is read in boxes")


# Cells computed at once: temporary arrays stay small beside those of a block.
_SLAB = 1 << 18


def _computed(
    outline: Outline,
    expression: Expression,
    double: bool,
    low: Sequence[int],
    high: Sequence[int],
    level: int,
) -> np.ndarray:
    """Return an expression in a box of cells."""
    part = outline.part(_box(low, high), expression.names)
    values, size = [], part.grid.size
    with np.errstate(all="ignore"):  # what is undefined is missing
        for first in range(0, size, _SLAB):
            last = min(first + _SLAB, size)
            values.append(part.evaluate_cells(expression, first, last, double=double))
    return np.asarray(np.concatenate(values).reshape(part.grid.shape))


def _box(low: Sequence[int], high: Sequence[int]) -> CellBox:
    """Return the box of the cells ``low <= i < high``."""
    return CellBox(tuple(low), tuple(high))


def largest_side(
    outline: Outline,
    memory: Any,
    per_cell: float,
    others: int,
    need: str = "",
    advice: str = "",
    fewest: int = 1,
    pages: float = 0,
) -> tuple[tuple[int, ...], int]:
    """Return the sides of the blocks of chunks that a memory allows, and the bytes left of it.

    Parameters
    ----------
    memory : str or int
        As the user gave it.
    per_cell, others : int
        Bytes for each cell of a block, with a layer around it, and whatever its size.
    need, advice : str
        What the others are for, and how to need less of them.
    fewest : int
        Number of blocks that there are to be, if there are as many chunks.
    pages : float
        Bytes of mapped files for each cell of a block of several chunks. The system can take them
        back, so that single chunks do without.

    Raises
    ------
    MemoryNeededError
        If it does not allow even single chunks.
    """
    chunks, widest, left = outline.store.chunks, None, 0
    most = _WIDEST if len(chunks) == 3 else _WIDEST**3
    for times in itertools.chain([1], itertools.count(2, 2)):
        side = [min(c * times, n) for c, n in zip(chunks, outline.grid.shape, strict=True)]
        each = per_cell if times == 1 else per_cell + pages
        needed = int(others + each * math.prod(n + 2 for n in side))
        if times == 1 and needed > byte_count(memory):
            cells = " x ".join(map(str, chunks))
            raise MemoryNeededError(
                f"memory={memory!r} is too little: chunks of {cells} cells{need} need {needed} "
                f"bytes ({needed / 2**20:.0f} MiB). Allow that, {advice}or write the volume in "
                "smaller chunks"
            )
        count = math.prod(-(-n // s) for n, s in zip(outline.grid.shape, side, strict=True))
        large = times > 1 and (max(side) > most or count < fewest)
        if needed > byte_count(memory) or large or side == widest:
            break
        widest, left = side, byte_count(memory) - needed
    assert widest is not None
    return tuple(widest), left


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
        self.walls = self.grid.edges
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
        used = [name for name in medium.names if name in self.outline]
        kinds = [self.outline.dtype(name) for name in used]
        extinctions = 1 if medium.grey else medium.channels
        # Many channels are drawn in blocks, in each of which rays have a state before and after.
        part = min(1.0, _TOGETHER / medium.channels)
        # Fields of a block, and chunks of the next; with real numbers for integers.
        numbers = medium.channels + extinctions
        per_cell: float = sum(2 * k.itemsize for k in kinds)
        # They are wider than a box, and are let go of some time after it.
        self.pages = sum(
            4 * k.itemsize for n, k in zip(used, kinds, strict=True) if self.outline.is_mapped(n)
        )
        per_cell += sum((4 if k.itemsize <= 2 else 8) for k in kinds if k.kind != "f")
        self.per_table = int(6 * max(part * numbers, len(medium.components())))
        path = numbers + extinctions
        self.dual = scheme.coefficients_at == "field"
        if self.dual:
            # Cells are met between the centres of those before and their own.
            self.walls = tuple(
                np.concatenate([e[:1], 0.5 * (e[1:-1] + e[:-2]), e[-1:]]) for e in self.grid.edges
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
        """Set the blocks, given the bytes that a cell takes, and those besides."""
        self.per_cell, self.others = per_cell, others
        need = f" and {pixels[0]} x {pixels[1]} pixels", "take fewer pixels, "
        fewest = 1 if self.sweep is None else _FEWEST_BLOCKS
        self.side, self.room = largest_side(
            self.outline, self.memory, per_cell, others, *need, fewest=fewest, pages=self.pages
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
        """Return boxes in blocks of k × k × k: few, that several processes draw."""
        counts = [-(-n // side) for n, side in zip(self.grid.shape, self.side, strict=True)]
        k = 1
        while math.prod(-(-n // k) for n in counts) > _MOST_BLOCKS:
            k += 1
        groups: dict[tuple[int, ...], list[CellBox]] = {}
        for box in boxes:
            place = tuple(low // (k * side) for low, side in zip(box.low, self.side, strict=True))
            groups.setdefault(place, []).append(box)
        return [Block(tuple(group), self.around(group)) for group in groups.values()]

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
        """Return the first and the last wall of a block along each axis."""
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
        for axis in range(3 if self.dual else 0):
            for ends, furthest in ((low, np.minimum), (high, np.maximum)):
                lines = np.moveaxis(ends, axis, 0)
                own = lines.copy()
                furthest(lines[1:], own[:-1], out=lines[1:])
                furthest(lines[:-1], own[1:], out=lines[:-1])
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
    used: list[str]
    # By the first cell of a part: it with others around, and the chunks that all these are in.
    _leaves: OrderedDict[int, LeavesWithGhosts]
    _touched: dict[int, np.ndarray]

    def plan(self, medium: Medium, scheme: Scheme, pixels: tuple[int, int]) -> None:
        self.used = [name for name in medium.names if name in self.outline]
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

    def blocks(self, boxes: Sequence[CellBox]) -> list[Block]:
        groups: dict[int, list[CellBox]] = {}
        for box in boxes:
            groups.setdefault(int(self._group(box.low[0])), []).append(box)
        return [Block(tuple(group), self.around(group)) for group in groups.values()]

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
    kind = Pieces if grid is None or grid.is_structured else TreePieces
    return kind(volume, medium, memory, sweep, **options)


def _with(volume: Volume, names: Any) -> Volume:
    """Return a volume without other fields in memory: other processes read what is in files."""
    lean = volume.with_arrays({})
    lean._fields.unread()
    for name in lean.fields:
        if name not in names and name not in lean.waiting:
            del lean[name]
    lean.tables = volume.tables
    return lean
