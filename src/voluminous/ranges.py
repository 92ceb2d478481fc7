"""Ranges of fields on bricks of cells: what a picture is planned by, instead of all cells.

A brick is a cube of 4³ cells, the same that rays leap over. Its range holds every value that the
field takes in the brick, also where it is interpolated between cell centres. Ranges are made once
per field (512³ numbers: 0.3 s of a processor) and kept with the volume: `ranges_of_field` returns
them. Framing, empty space, wide steps and guaranteed bounds share them::

    bricks = ranges_of_field(Cache(volume), "density", DUAL)
    bricks.low.shape                # (129, 129, 129) of 512³ cells, of the field's type
    bricks.coarser(4).high          # in bricks of 16³ cells
    most_in({"density": bricks}, lambda fields: [fields["density"].size])

`Numbers` and `CellsInPlace` are the fields themselves on a device, large ones without a copy.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .backend import Backend, aligned, dr
from .backend.types import Float, Int, Mask
from .expressions.interval import Interval
from .grids.cartesian.leap import brick_shape
from .grids.cartesian.walk import BRICK

# Bricks evaluated at once: limits the memory of temporary arrays.
_CHUNK = 1 << 18
# Quantiles and equal parts between which a field's range is divided into pieces, and the values
# of which the quantiles are.
_QUANTILES, _EQUAL, _VALUES = 4096, 1024, 1 << 17
# With so few bricks each is evaluated by itself.
_FEW = 1 << 16

# Small integers are packed in words if there are so many; fewer are faster as floating point.
_LARGE = 1 << 25


class Window(NamedTuple):
    """The cells that affect a brick of 4 steps of a walk, along each axis."""

    # Number of cells before the first and after the last of the brick itself.
    before: int
    after: int
    # Maximum number of steps of a walk minus the number of cells.
    extra: int
    # Fraction of filled bricks above which skipping does not pay: it costs as much as crossing some
    # cells (first and second order: no gain at a third, 3 times as fast at 1/20).
    worthwhile: float

    def shape(self, cells: Any) -> tuple[int, ...]:
        """Return the number of bricks along axes with given numbers of cells."""
        return tuple(brick_shape([n + self.extra for n in cells]))


# Dual cell i lies between the centres of cells i - 1 and i, and there is one more than cells.
DUAL = Window(before=1, after=0, extra=1, worthwhile=0.7)
# Coefficients at the vertices of a cell are means over its neighbours.
CELLS = Window(before=1, after=1, extra=0, worthwhile=0.25)


@dataclass
class BrickRanges:
    """Least and largest value of a field in each brick, of the field's type; NaN if it has NaN."""

    low: np.ndarray
    high: np.ndarray

    def interval(self, part: Any = ...) -> Interval:
        """Return the ranges of some bricks."""
        return Interval(self.low[part], self.high[part])

    def coarser(self, factor: int, beyond: int = 0) -> BrickRanges:
        """Return ranges of bricks that are wider by a factor; with those of so many more behind."""
        ends = []
        for values, ufunc in ((self.low, np.minimum), (self.high, np.maximum)):
            for axis, n in enumerate(values.shape):
                starts = np.arange(0, n, factor)
                coarse = ufunc.reduceat(values, starts, axis)
                for more in range(beyond):
                    next_one = np.minimum(starts + factor + more, n - 1)
                    coarse = ufunc(coarse, values.take(next_one, axis))
                values = coarse
            ends.append(values)
        return BrickRanges(*ends)

    def in_boxes(self, side: int, shape: Sequence[int]) -> BrickRanges:
        """Return the ranges in boxes of so many cells of a volume and those beside them, flat."""
        bricks = self.coarser(side // BRICK, 1) if side > BRICK else self
        some = tuple(slice(-(-n // side)) for n in shape)
        return BrickRanges(bricks.low[some].reshape(-1), bricks.high[some].reshape(-1))

    @functools.cached_property
    def pieces(self) -> tuple[Interval, np.ndarray, np.ndarray]:
        """The range of the field in pieces, and the first and last piece of each brick.

        Pieces are single values, and the gaps between them; the last piece is undefined. Few bricks
        end within one gap: values are quantiles of the ends of bricks.
        """
        known, varies = self.low <= self.high, self.low < self.high
        first, last = np.fmin.reduce(self.low, axis=None), np.fmax.reduce(self.high, axis=None)
        ends = [end[varies] for end in (self.low, self.high)]
        step = max(1, 2 * ends[0].size // _VALUES)
        sample = np.sort(np.concatenate([end[::step] for end in ends]))
        places = np.linspace(0, max(len(sample) - 1, 0), min(_QUANTILES, len(sample)))
        with np.errstate(all="ignore"):  # of all floating-point numbers the range is infinite
            equal = np.linspace(float(first), float(last), _EQUAL).astype(self.low.dtype)
        nodes = np.concatenate([[first, last], equal, sample[places.astype(int)]])
        nodes = np.unique(nodes[(nodes >= first) & (nodes <= last)].astype(self.low.dtype))

        def place(values: np.ndarray) -> np.ndarray:
            below = np.searchsorted(nodes, values, "right") - 1
            return np.asarray(2 * below + (nodes[below] < values), np.uint16)

        def placed(values: np.ndarray) -> np.ndarray:
            if values.dtype.kind != "u" or values.dtype.itemsize > 2:
                return np.where(known, place(values), np.uint16(2 * len(nodes) - 1))
            info = np.iinfo(values.dtype)  # as a table: a tenth of the time
            table = place(np.clip(np.arange(info.max + 1), first, last).astype(values.dtype))
            return np.asarray(table[values])

        low, high = np.repeat(nodes, 2)[:-1], np.repeat(nodes, 2)[1:]
        low, high = (np.append(v.astype(np.float64), np.nan) for v in (low, high))
        return Interval(low, high), placed(self.low), placed(self.high)


def box_side(shape: Sequence[int]) -> int:
    """Return the side of boxes of bricks of which there are 64³ at most."""
    return next(side for k in range(64) if 64 * (side := BRICK << k) >= max(shape))


def field_ranges(array: np.ndarray, window: Window) -> BrickRanges:
    """Return the range of a field in and around each brick."""
    low, high = (np.empty(window.shape(array.shape), array.dtype) for _ in range(2))
    for b in range(len(low)):
        first = min(max(b * BRICK - window.before, 0), len(array) - 1)
        layers = array[first : (b + 1) * BRICK + window.after]
        for ends, ufunc in ((low, np.minimum), (high, np.maximum)):
            plane = ufunc.reduce(layers, axis=0)
            ends[b] = _windows(_windows(plane, ufunc, window).T, ufunc, window).T
    return BrickRanges(low, high)


def ranges_of_field(cache: Any, name: str, window: Window) -> BrickRanges:
    """Return the ranges of a field in and around every brick; cached with the volume (`Cache`)."""
    key = ("ranges", name, cache.statistics.digest(name), window)
    volume, found = cache.volume, cache.get(key)
    made: BrickRanges = found or cache.put(key, field_ranges(volume.array(name), window))
    return made


def _windows(plane: np.ndarray, ufunc: np.ufunc, window: Window) -> np.ndarray:
    (count,) = window.shape(plane.shape[:1])
    end = max(count * BRICK + window.after - len(plane), 0)
    padded = np.pad(plane, [(window.before, end), (0, 0)], mode="edge")
    inner = padded[window.before : window.before + count * BRICK]
    within = ufunc.reduce(inner.reshape(count, BRICK, -1), axis=1)
    others = [*range(window.before), *(window.before + BRICK + k for k in range(window.after))]
    for first in others:
        within = ufunc(within, padded[first : first + count * BRICK : BRICK][:count])
    return np.asarray(within)


def coordinate_ranges(name: str, edges: Any, window: Window) -> Interval:
    """Return the range of a coordinate in and around each brick."""
    if name == "r":
        parts = [coordinate_ranges(axis, edges, window) for axis in "xyz"]
        squares = [part * part for part in parts]
        low, high = (sum(s.lo for s in squares), sum(s.hi for s in squares))
        return Interval(np.sqrt(low), np.sqrt(high))
    axis = "xyz".index(name)
    walls, last = edges[axis], len(edges[axis]) - 1
    first = np.arange(*window.shape([last])) * BRICK
    low = walls[np.clip(first - window.before, 0, last)]
    high = walls[np.minimum(first + BRICK + window.after, last)]
    shape = [1, 1, 1]
    shape[axis] = len(first)
    return Interval(low.reshape(shape), high.reshape(shape))


Ranges = dict[str, BrickRanges | Interval]
Limits = Callable[[dict[str, Interval]], Sequence[np.ndarray]]


@np.errstate(all="ignore")
def sums_in(medium: Any, bound: Any, ranges: Ranges, limits: Any) -> list[np.ndarray]:
    """Return upper limits of what a medium shows in every brick: sums over its parts.

    ``limits(bound, fields)`` gives those of a bound part. A medium of one field is taken as a
    whole, and parts of one field each are as cheap (`most_in`).
    """
    parts = [(medium, bound)]
    if sum(isinstance(ranges[name], BrickRanges) for name in medium.names) > 1:
        parts = list(zip(medium.components(), bound.parts, strict=True))
    found = []
    for part, numbers in parts:
        names = [*part.names, *(f"los.{axis}" for axis in part.sight)]
        own = {name: ranges[name] for name in names if name in ranges}
        found.append(most_in(own, functools.partial(limits, numbers)))
    return [functools.reduce(np.add, rows) for rows in zip(*found, strict=True)]


def most_in(ranges: Mapping[str, BrickRanges | Interval], limits: Limits) -> list[np.ndarray]:
    """Return upper limits of functions of fields in every brick, given their ranges there.

    `limits` gives those of ranges of fields. A function of one field is evaluated in the pieces
    of its range, and a brick has the largest of its pieces (512³ cells, four shells: 0.2 s of a
    processor; 9 s with intervals in each brick). Others are evaluated brick by brick.
    """
    fields = {n: r for n, r in ranges.items() if isinstance(r, BrickRanges)}
    others = {n: r for n, r in ranges.items() if isinstance(r, Interval)}
    shapes = [r.low.shape for r in fields.values()] + [r.lo.shape for r in others.values()]
    shape = np.broadcast_shapes(*shapes)
    size, pieces = int(np.prod(shape)), None
    if size > _FEW and len(fields) == 1 and all(r.lo.ndim == 0 for r in others.values()):
        ((name, field),) = fields.items()
        values, low, high = field.pieces
        pieces = _Maxima([np.broadcast_to(v, values.lo.shape) for v in limits({name: values})])
    found: list[np.ndarray] = []
    step = max(1, _CHUNK * (shape[0] if shape else 1) // max(size, 1))
    for begin in range(0, shape[0] if shape else 1, step):
        part = slice(begin, begin + step)
        if pieces is not None:
            rows = pieces(low[part], high[part])
        else:
            some = {n: r.interval(part) for n, r in fields.items()}
            some |= {n: _part(r, part, len(shape)) for n, r in others.items()}
            rows = [np.asarray(row) for row in limits(some)]
        if not found:
            found = [np.empty(shape, row.dtype) for row in rows]
        for whole, row in zip(found, rows, strict=True):
            whole[part if shape else ...] = row
    return found


def _part(ranges: Interval, part: slice, axes: int) -> Interval:
    if ranges.lo.ndim < max(axes, 1) or len(ranges.lo) == 1:
        return ranges
    return Interval(ranges.lo[part], ranges.hi[part])


class _Maxima:
    """The largest of consecutive numbers, from those of 2^k of them that begin at each."""

    def __init__(self, columns: Sequence[np.ndarray]) -> None:
        self.count = len(columns[0])
        self.tables = []
        for column in columns:
            rows = [column]
            for k in range(self.count.bit_length() - 1):
                ahead = np.minimum(np.arange(self.count) + (1 << k), self.count - 1)
                rows.append(np.maximum(rows[-1], rows[-1][ahead]))
            self.tables.append(np.concatenate(rows))
        self.level = np.log2(np.maximum(np.arange(self.count + 1), 1)).astype(np.uint8)

    def __call__(self, first: np.ndarray, last: np.ndarray) -> list[np.ndarray]:
        """Return the largest numbers from `first` to `last`."""
        level = self.level[last - first + 1].astype(np.int32)
        row = level * self.count
        both = row + first, row + last - (1 << level) + 1
        return [np.maximum(*(table[place] for place in both)) for table in self.tables]


def device_array(flat: np.ndarray, backend: Backend, *, whole_vectors: bool = False) -> Float:
    """Return numbers on the device; integers become floating point that holds them.

    Float arrays in the CPU's memory are used in place. `whole_vectors` are `backend.aligned`;
    gathers need not be.
    """
    if flat.dtype.kind != "f":
        flat = flat.astype(np.float32 if flat.dtype.itemsize <= 2 else np.float64)
    kind = backend.module.Float32 if flat.dtype == np.float32 else backend.module.Float64
    return kind(aligned(flat) if whole_vectors else flat)


class Numbers:
    """A field on the device for gathers: in place, as far as kernels can read its type.

    Of large fields of small integers there is no copy as floating point (1024³: 4 GiB): they are
    parts of words of 32 bits, which devices gather.
    """

    __slots__ = ("backend", "bits", "data", "sign")  # the size of a cache's entry leaves them out

    def __init__(self, flat: np.ndarray, backend: Backend) -> None:
        self.backend, self.bits, self.sign = backend, 0, 0
        if is_packed(flat):
            self.bits = 8 * flat.itemsize
            self.sign = 1 << (self.bits - 1) if flat.dtype.kind == "i" else 0
            octets = flat.view(np.uint8)
            octets = np.pad(octets, (0, -octets.size % 4)) if octets.size % 4 else octets
            self.data = backend.UInt(octets.view(np.uint32))
        else:
            self.data = device_array(flat, backend)

    def gather(self, index: Int, active: Mask = True) -> Float:
        """Return some of the numbers, of the type that they have on the device."""
        kind, index = type(self.data), self.backend.UInt(index)
        if not self.bits:
            return dr.gather(kind, self.data, index, active)
        shift = 2 if self.bits == 8 else 1
        word = dr.gather(kind, self.data, index >> shift, active)
        part = (word >> ((index & ((1 << shift) - 1)) * self.bits)) & ((1 << self.bits) - 1)
        return self.backend.Int(part ^ self.sign) - self.sign


def is_packed(array: np.ndarray) -> bool:
    """Return whether `Numbers` gathers parts of words."""
    return array.dtype.kind in "iub" and array.itemsize <= 2 and array.size >= _LARGE


@dataclass
class CellsInPlace:
    """The field's own array: outside of it the outermost values are repeated."""

    data: Numbers
    unit: float
    # Along each axis the number of cells minus one, and the stride.
    lasts: list[Any]
    strides: list[Any]

    @classmethod
    def of(cls, array: np.ndarray, backend: Backend) -> CellsInPlace:
        """Return a field of a Cartesian grid."""
        _, ny, nz = array.shape
        lasts = [dr.opaque(backend.UInt, n - 1) for n in array.shape]
        strides = [dr.opaque(backend.Int, n) for n in (ny * nz, nz, 1)]
        return cls(Numbers(array.reshape(-1), backend), 1.0, lasts, strides)

    def corners(self, chord: Any, active: Mask) -> list[list[list[Any]]]:
        first, steps, UInt = 0, [], self.data.backend.UInt
        for i, last, stride in zip(chord.index, self.lasts, self.strides, strict=True):
            first = first + dr.maximum(i - 1, 0) * stride
            steps.append(dr.select(UInt(i - 1) < last, stride, 0))  # else out of the volume
        x, y, z = steps
        return [
            [[self.data.gather(first + a + b + c, active) for c in (0, z)] for b in (0, y)]
            for a in (0, x)
        ]
