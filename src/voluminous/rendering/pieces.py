"""A volume that is drawn in pieces: its outline, the blocks of cells, their order and ranges."""

from __future__ import annotations

import itertools
import math
import mmap
import re
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, MemoryNeededError
from ..expressions.interval import Interval
from ..fields import coordinate_extremes
from ..grids import CartesianGrid
from ..grids.contract import CellBox
from ..progress import Report, reporter, silent
from ..volume import Volume
from .options import check_in_pieces

if TYPE_CHECKING:
    from ..media.contract import Medium
    from ..schemes.base import Scheme
    from ..store import Store

_SIZES = {"": 0, "K": 1, "M": 2, "G": 3, "T": 4}
_TEXT = re.compile(r"\s*([0-9.]+(?:e[0-9]+)?)\s*([KMGT]?)(i?)B?\s*", re.IGNORECASE)
# Sides of a block do not exceed this: larger ones save no time, and cut less empty space off.
_WIDEST = 256
# Memory of each process, if several draw.
_USUAL = "2 GiB"
# Chunks that are read for a sample of cells all over a volume.
_SAMPLED = 16
# Blocks of a picture that several processes draw: a task of Dask takes 2 ms.
_MOST_BLOCKS = 200
# Temporary arrays of classification, kernels and what Dr.Jit keeps of freed memory.
_OTHERS = 160 << 20


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
            plane = self.shape[1] * self.shape[2]
            low = first // plane
            layers = self._read((low, 0, 0), (-(-last // plane), *self.shape[1:])).reshape(-1)
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
    """A volume as planning a picture sees it: grid, names, units, ranges and some cells."""

    _whole: Volume
    _tables: dict[str, np.ndarray]

    @classmethod
    def of(cls, volume: Volume) -> Outline:
        """Return the outline of a volume; nothing is read yet."""
        outline = object.__new__(cls)
        vars(outline).update(vars(volume))
        outline.tables = OrderedDict()
        outline._whole, outline._tables = volume, {}
        return outline

    @property
    def store(self) -> Store:
        """Where boxes of fields are read from."""
        return self._whole.store

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
        if name in self._whole.waiting:
            return None
        array = root = self._whole.array(name)
        while isinstance(root.base, np.ndarray):
            root = root.base
        return None if isinstance(root.base, mmap.mmap) else array

    def array(self, name: str) -> Any:
        if self._derived(name) is not None:
            raise InputError(
                f"{name!r} is computed from a whole field, which memory= does not read; make it a "
                "field of the file, or draw without memory="
            )
        self._check_field(name)
        return FlatField(self, name)

    def digest(self, name: str) -> bytes:
        return name.encode()  # caches of an outline are its own

    def extremes(self, name: str) -> np.ndarray:
        """Return the least and the largest value in each chunk, shape (kx, ky, kz, 2).

        They are measured once, unless the file tells; of fields in memory for every picture.
        """
        if name not in self._tables:
            found = self.store.extremes(name)
            if found is not None and found.shape[:3] != self._counts():
                found = None  # of other chunks than those of the other fields
            key, kept = ("extremes of chunks", name), name in self._whole.waiting
            if found is None and kept and key in self._whole.tables:
                found = self._whole.tables[key][0]
            if found is None:
                found = self._measured(name)
                if kept:
                    self._whole.tables[key] = found, found.nbytes
            self._tables[name] = found
        return self._tables[name]

    def _counts(self) -> tuple[int, ...]:
        """Return the number of chunks along each axis."""
        return tuple(-(-n // c) for n, c in zip(self.grid.shape, self.store.chunks, strict=True))

    def _measured(self, name: str) -> np.ndarray:
        counts, chunks = self.grid.shape, self.store.chunks
        found = np.empty((*self._counts(), 2))
        for place in np.ndindex(*found.shape[:3]):
            reporter()(0, self.grid.size)
            low = [i * c for i, c in zip(place, chunks, strict=True)]
            high = [min(a + c, n) for a, c, n in zip(low, chunks, counts, strict=True)]
            values = self.store.read(name, low, high)
            found[place] = values.min(), values.max()
        return found


class Pieces:
    """The blocks of cells of which a picture is drawn, one after another.

    Attributes
    ----------
    side : tuple of three int
        Cells of a block along the axes: some chunks of the file.
    sweep : Sweep or None
        Draws blocks in other processes, or keeps them in files.
    report : callable
        Is told the cells done, and all of them.
    """

    def __init__(
        self, volume: Any, medium: Any, memory: Any, sweep: Any = None, **options: Any
    ) -> None:
        memory = _USUAL if memory is None else memory
        self.memory, self.asked, self.sweep = byte_count(memory), memory, sweep
        check_in_pieces(volume, medium, **options)
        self.outline = Outline.of(volume if sweep is None else _with(volume, medium.names))
        self.grid: CartesianGrid = volume.grid
        self.side = self.outline.store.chunks
        # Coordinates between which the cells are met by rays, of each axis.
        self.walls = self.grid.edges
        self.report: Report = silent
        for name in medium.names:
            if name in self.outline and not np.all(np.isfinite(self.outline.extremes(name))):
                raise InputError(
                    f"field {name!r} has missing or infinite values, which memory= cannot draw "
                    "(neighbours in other chunks fill them); replace them, or draw without memory="
                )

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
        sizes = [self.outline.dtype(n).itemsize for n in medium.names if n in self.outline]
        extinctions = 1 if medium.grey else medium.channels
        # Fields as read, padded and as gathered; or with a table of coefficients.
        numbers = medium.channels + extinctions
        per_cell = 2 * sum(sizes) + 6 * max(numbers, len(medium.components()))
        path = numbers + extinctions
        if scheme.coefficients_at == "field":
            # Cells are met between the centres of those before and their own.
            self.walls = tuple(
                np.concatenate([e[:1], 0.5 * (e[1:-1] + e[:-2]), e[-1:]]) for e in self.grid.edges
            )
            per_cell = sum(2 * size + 20 for size in sizes)
            path += 3 + extinctions + 2 * len(medium.scalars())
        # Lanes; paths of all rays, of those in a block before and after it, and as results.
        others = _OTHERS + (96 + 20 * path) * pixels[0] * pixels[1]
        chunks, widest = self.outline.store.chunks, None
        for times in itertools.chain([1], itertools.count(2, 2)):
            side = [min(c * times, n) for c, n in zip(chunks, self.grid.shape, strict=True)]
            needed = others + per_cell * math.prod(n + 2 for n in side)
            if times == 1 and needed > self.memory:
                raise MemoryNeededError(
                    f"memory={self.asked!r} is too little: chunks of {chunks} cells and "
                    f"{pixels[0]} x {pixels[1]} pixels need {needed} bytes "
                    f"({needed / 2**20:.0f} MiB). Allow that, take fewer pixels, or write the "
                    "volume in smaller chunks"
                )
            if needed > self.memory or (times > 1 and max(side) > _WIDEST) or side == widest:
                break
            widest = side
        assert widest is not None
        self.side = (widest[0], widest[1], widest[2])

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
        walls = [
            [*range(0, n, side), n] for n, side in zip(self.grid.shape, self.side, strict=True)
        ]
        counts = [len(w) - 1 for w in walls]
        if parallel:
            center = [0 if d >= 0 else n - 1 for d, n in zip(direction, counts, strict=True)]
        else:
            center = [self._place(a, walls[a], origin[a]) for a in range(3)]

        def far(place: tuple[int, ...]) -> int:
            return sum(abs(i - c) for i, c in zip(place, center, strict=True))

        for place in sorted(np.ndindex(*counts), key=far):
            low, high = zip(
                *((w[i], w[i + 1]) for w, i in zip(walls, place, strict=True)), strict=True
            )
            yield CellBox(low, high)

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
        return [Block(tuple(group), self._around(group)) for group in groups.values()]

    def _around(self, boxes: Sequence[CellBox]) -> np.ndarray:
        extents = np.array([self.extent(box) for box in boxes])
        return np.stack([extents[..., 0].min(axis=0), extents[..., 1].max(axis=0)], axis=-1)

    def extent(self, box: CellBox) -> np.ndarray:
        """Return the coordinates between which rays meet a box, shape (3, 2)."""
        return np.array(
            [(w[a], w[b]) for w, a, b in zip(self.walls, box.low, box.high, strict=True)]
        )

    def _place(self, axis: int, walls: list[int], origin: np.ndarray) -> int:
        """Return the number of the block that rays begin in along an axis; they may be outside."""
        edges = self.walls[axis][walls]
        first, last = (np.searchsorted(edges, origin, "right") - 1).tolist()
        if first != last:
            raise InputError(
                "memory= needs rays that begin at one place, or are parallel: those of this camera "
                "begin in several chunks; draw without memory="
            )
        return int(first)

    def ranges(self, box: CellBox, names: Any, ghosts: bool) -> dict[str, Interval]:
        """Return the ranges of fields and coordinates in a block; see `values`."""
        if ghosts:
            box = CellBox(_below(box), box.high)
        return {name: self._range(box, name) for name in names}

    def _range(self, box: CellBox, name: str) -> Interval:
        if name in self.outline:
            part = tuple(
                slice(a // c, -(-b // c))
                for a, b, c in zip(box.low, box.high, self.outline.store.chunks, strict=True)
            )
            table = self.outline.extremes(name)[part]
            ends = table[..., 0].min(), table[..., 1].max()
        else:
            edges = [
                e[a : b + 1] for e, a, b in zip(self.grid.edges, box.low, box.high, strict=True)
            ]
            ends = coordinate_extremes(CartesianGrid(*edges), name)
        return Interval(*(np.asarray(end, np.float64) for end in ends))

    def values(self, box: CellBox, names: Any, ghosts: bool) -> dict[str, np.ndarray]:
        """Return fields of a block; with `ghosts`, and of one layer more on the low sides."""
        low = _below(box) if ghosts else box.low
        store = self.outline.store
        return {n: store.read(n, low, box.high) for n in names if n in self.outline}

    def volume(self, box: CellBox, fields: dict[str, np.ndarray]) -> Volume:
        """Return a block as a volume; lengths in kernels are in the unit of the whole grid's."""
        edges = [e[a : b + 1] for e, a, b in zip(self.grid.edges, box.low, box.high, strict=True)]
        grid = CartesianGrid(*edges, unit=self.grid.unit)
        grid.__dict__["scale"] = self.grid.scale
        part = Volume(grid)
        part._fields.update(fields)
        part._units.update(self.outline._units)
        return part


def _with(volume: Volume, names: Any) -> Volume:
    """Return a volume without other fields in memory: other processes read what is in files."""
    lean = volume.with_arrays({})
    lean._fields.unread()
    for name in lean.fields:
        if name not in names and name not in lean.waiting:
            del lean[name]
    lean.tables = volume.tables
    return lean


def _below(box: CellBox) -> tuple[int, int, int]:
    """Return the first cell of a box with one layer more on the low sides."""
    x, y, z = (max(a - 1, 0) for a in box.low)
    return x, y, z
