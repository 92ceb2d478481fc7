"""A volume without its arrays: names, units, ranges of chunks, and a sample of cells."""

from __future__ import annotations

import copy
import functools
import itertools
import math
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ..deferred import Deferred, Pieces
from ..derivatives import LinesOfSight, is_component
from ..errors import InputError, MemoryNeededError
from ..expressions import Expression, required_names
from ..grids import CartesianGrid
from ..grids.contract import CellBox, Grid
from ..grids.structured import is_structured
from ..grids.trees.parts import SomeCells
from ..memory import byte_count
from ..progress import reporter
from ..store import FieldStore
from ..volume import Volume

# Chunks that are read for a sample of cells all over a volume.
_SAMPLED = 16
# Cells computed at once: temporary arrays stay small beside those of a block.
_SLAB = 1 << 18


class FieldView:
    """A field of a store, of which planning a picture looks at some cells, by flat numbers.

    It stands for the array, which may be larger than memory.
    """

    def __init__(self, view: VolumeView, name: str) -> None:
        self._view, self._name = view, name
        self.shape, self.size = view.grid.shape, view.grid.size
        self.dtype = view.dtype(name)

    def reshape(self, shape: int) -> FieldView:
        return self

    def min(self) -> Any:
        return self._view.extremes(self._name)[..., 0].min()

    def max(self) -> Any:
        return self._view.extremes(self._name)[..., 1].max()

    def __getitem__(self, index: Any) -> np.ndarray:
        """Return consecutive cells, or a sample of cells.

        Of a large sample from a file some are in the chunks of others: it would all be read.
        """
        whole = self._view.in_memory(self._name)
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
        chunks = np.array(self._view.store.chunks)[:, None]
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
        return self._view.store.read(self._name, low, high)


class VolumeView(Volume):
    """A volume without arrays: grid, names, units, ranges of chunks and some cells.

    It may have fields that are computed box by box; see `computing`.
    """

    # Sides of a block do not exceed this: larger ones save no time, and cut less empty space off.
    widest = 256
    _whole: Volume
    # Per chunk and field: ranges of the values, and how many are missing (None: none are).
    _tables: dict[str, tuple[np.ndarray, np.ndarray | None]]
    # Of the fields that are computed: text, and the stored fields that they are made of.
    _made: dict[str, tuple[str, list[str]]]

    @classmethod
    def of(cls, volume: Volume) -> VolumeView:
        """Return the view of a volume; nothing is read yet."""
        if isinstance(volume, cls):
            return volume
        view = object.__new__(cls)
        vars(view).update(vars(volume))
        if len(volume.waiting) < len(volume.fields):  # some may be changed in place
            view.tables = OrderedDict()
        view._whole, view._tables, view._made = volume, {}, {}
        return view

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

    def computing(self, expressions: Mapping[str, Expression]) -> VolumeView:
        """Return the view with fields that are computed box by box.

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
            pieces = Pieces(functools.partial(_computed, self, expression, not component))
            what = Deferred(no_array, kind, pieces=pieces)
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

    def volume(self, box: CellBox, fields: Mapping[str, np.ndarray]) -> Volume:
        """Return a block as a volume; lengths in kernels are in the unit of the whole grid's."""
        grid: Grid
        if is_structured(self.grid):
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

    def is_packed(self, name: str) -> bool:
        """Return whether a file stores a field in chunks, of which it reads the whole."""
        pieces = [self._fields.pieces(n) for n in self.stored([name]) if n in self._whole.waiting]
        return any(part is not None and part.chunks is not None for part in pieces)

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
        """Return the array of a field, if it is in memory."""
        return None if name in self.waiting else self._whole.array(name)

    def array(self, name: str) -> Any:
        self.stored([name])
        self._check_field(name)
        return FieldView(self, name)

    def fingerprint(self) -> str:
        return self._whole.fingerprint()

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
                ends, table = np.full((*self.chunk_counts, 2), np.nan), self.store.extremes(name)
                if table is not None and table.shape == ends.shape:  # else it has other chunks
                    ends[...] = table
                found = self._measured(name, ends)
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

    def _measured(self, name: str, found: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Return ranges of chunks, and the numbers of missing values; NaN is measured.

        Raises
        ------
        InputError
            If a value is infinite, or none is there.
        """
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
    raise AssertionError("a field of a view is read in boxes")


def _computed(
    view: VolumeView,
    expression: Expression,
    double: bool,
    low: Sequence[int],
    high: Sequence[int],
    level: int,
) -> np.ndarray:
    part = view.part(CellBox(tuple(low), tuple(high)), expression.names)
    values, size = [], part.grid.size
    with np.errstate(all="ignore"):  # what is undefined is missing
        for first in range(0, size, _SLAB):
            last = min(first + _SLAB, size)
            values.append(part.evaluate_cells(expression, first, last, double=double))
    return np.asarray(np.concatenate(values).reshape(part.grid.shape))


def largest_side(
    view: VolumeView,
    memory: Any,
    per_cell: float,
    others: int,
    need: str = "",
    advice: str = "",
    fewest: int = 1,
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

    Raises
    ------
    MemoryNeededError
        If it does not allow even single chunks.
    """
    chunks, widest, left = view.store.chunks, None, 0
    most = view.widest if len(chunks) == 3 else view.widest**3
    for times in itertools.chain([1], itertools.count(2, 2)):
        side = [min(c * times, n) for c, n in zip(chunks, view.grid.shape, strict=True)]
        needed = int(others + per_cell * math.prod(n + 2 for n in side))
        if times == 1 and needed > byte_count(memory):
            cells = " x ".join(map(str, chunks))
            raise MemoryNeededError(
                f"memory={memory!r} is too little: chunks of {cells} cells{need} need {needed} "
                f"bytes ({needed / 2**20:.0f} MiB). Allow that, {advice}or write the volume in "
                "smaller chunks"
            )
        count = math.prod(-(-n // s) for n, s in zip(view.grid.shape, side, strict=True))
        large = times > 1 and (max(side) > most or count < fewest)
        if needed > byte_count(memory) or large or side == widest:
            break
        widest, left = side, byte_count(memory) - needed
    assert widest is not None
    return tuple(widest), left
