"""Boxes of fields, put together from chunks that are read ahead and unpacked once if possible."""

from __future__ import annotations

import itertools
import math
import os
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from ..fields import held_dtype

if TYPE_CHECKING:
    from .view import VolumeView

# Chunks that are unpacked at the same time: more threads do not unpack faster, but wait together.
_MOST_THREADS = 8
# One part of this many of the room is for layers; six are 1/21 of a chunk of 128³ cells.
_LAYERS = 4

# A field, and the first cells of a chunk and those after the last.
Part: TypeAlias = tuple[str, tuple[int, ...], tuple[int, ...]]


class Prefetch:
    """The chunks of a volume's fields.

    Parameters
    ----------
    room : int
        Bytes of chunks and layers that may be kept.
    again : bool
        The same chunks will be asked for again, in the same order: those that there is room for are
        kept. They are the first ones: of the last ones, each would go before it is asked for.
    layers : bool
        Single layers of chunks that were read before will be asked for: their outer ones are kept.
    """

    def __init__(self, volume: VolumeView, room: int, again: bool, layers: bool) -> None:
        self.volume, self.room, self.again, self.layers = volume, room, again, layers
        self.store = volume.store
        self._coming: dict[Part, Future[np.ndarray]] = {}
        self._whole: dict[Part, np.ndarray] = {}
        self._layers: OrderedDict[tuple[Part, int, int], np.ndarray] = OrderedDict()
        self._held = 0
        self._rooms: dict[str, np.ndarray] = {}
        self._threads = ThreadPoolExecutor(min(os.cpu_count() or 1, _MOST_THREADS))

    def ahead(
        self, name: str, low: Sequence[int], high: Sequence[int], needed: np.ndarray | None = None
    ) -> None:
        """Begin to read a box; see `box`."""
        for part, first, last, place in self._parts(name, low, high):
            read = needed is None or needed[place]
            if read and part not in self._coming and self._kept(part, first, last) is None:
                self._coming[part] = self._threads.submit(self.store.read, *part)

    def forget(self) -> None:
        """Do not read what is not read yet."""
        for future in self._coming.values():
            future.cancel()
        self._coming.clear()

    def box(
        self,
        name: str,
        low: Sequence[int],
        high: Sequence[int],
        needed: np.ndarray | None = None,
        rim: int = 0,
    ) -> np.ndarray:
        """Return the cells ``low <= i < high`` of a field, in memory that the next box overwrites.

        Parameters
        ----------
        needed : bool array
            Which chunks must be read; cells of others are the least of them.
        rim : int
            Layers around the box, which repeat its outermost cells.
        """
        self.ahead(name, low, high, needed)
        shape = [b - a + 2 * rim for a, b in zip(low, high, strict=True)]
        values = self._room_for(name, shape)
        inner = values[(slice(rim, -rim or None),) * len(shape)]
        for part, first, last, place in self._parts(name, low, high):
            own = inner[
                tuple(slice(a - o, b - o) for a, b, o in zip(first, last, low, strict=True))
            ]
            if needed is not None and not needed[place]:
                own[...] = self.volume.extremes(name)[place][0]
                continue
            cells = self._kept(part, first, last)
            if cells is None:
                # A layer that was kept when the box was asked for may have gone since.
                coming = self._coming.pop(part, None)
                whole = self.store.read(*part) if coming is None else coming.result()
                cells = _cells(part, self._keep(part, whole, low, high), first, last)
            own[...] = cells
        for axis in range(len(shape) if rim else 0):
            lines = np.moveaxis(values, axis, 0)
            lines[:rim], lines[-rim:] = lines[rim], lines[-rim - 1]
        return values

    def _room_for(self, name: str, shape: list[int]) -> np.ndarray:
        """Return an array for a box: new memory takes half as long to get as to fill."""
        size, kind = math.prod(shape), held_dtype(self.volume.dtype(name))
        if name not in self._rooms or self._rooms[name].size < size:
            self._rooms[name] = np.empty(size, kind)
        return self._rooms[name][:size].reshape(shape)

    def _parts(
        self, name: str, low: Sequence[int], high: Sequence[int]
    ) -> Iterator[tuple[Part, tuple[int, ...], tuple[int, ...], tuple[int, ...]]]:
        """Yield what is read of a box, the cells of it that are in the box, and the chunk's number.

        Of fields that are not stored in chunks those cells alone are read.
        """
        sides, shape = self.store.chunks, self.volume.grid.shape
        packed = self.volume.is_packed(name)
        ranges = [range(a // c, -(-b // c)) for a, b, c in zip(low, high, sides, strict=True)]
        for place in itertools.product(*ranges):
            start = tuple(i * c for i, c in zip(place, sides, strict=True))
            end = tuple(min(s + c, n) for s, c, n in zip(start, sides, shape, strict=True))
            first, last = tuple(map(max, low, start)), tuple(map(min, high, end))
            part = (name, start, end) if packed else (name, first, last)
            yield part, first, last, place

    def _kept(self, part: Part, first: tuple[int, ...], last: tuple[int, ...]) -> np.ndarray | None:
        if part in self._whole:
            return _cells(part, self._whole[part], first, last)
        for axis, (a, b) in enumerate(zip(first, last, strict=True)):
            if b == a + 1 and (key := (part, axis, a)) in self._layers:
                self._layers.move_to_end(key)
                low = tuple(a if k == axis else s for k, s in enumerate(part[1]))
                return _cells((part[0], low, part[2]), self._layers[key], first, last)
        return None

    def _keep(
        self, part: Part, whole: np.ndarray, low: Sequence[int], high: Sequence[int]
    ) -> np.ndarray:
        """Keep a chunk if there is room, else its layers at the ends of a box; the oldest go."""
        if not self.volume.is_packed(part[0]):
            return whole
        if self.again and self._held + whole.nbytes <= self.room - self.room // _LAYERS:
            self._whole[part] = whole
            self._held += whole.nbytes
        elif self.layers:
            for axis, (start, end) in enumerate(zip(*part[1:], strict=True)):
                # Of a box with a layer of others the outer one of its own is the second.
                near = {low[axis], low[axis] + 1, high[axis] - 2, high[axis] - 1}
                for index in {start, end - 1} & near:
                    layer = whole.take([index - start], axis)
                    self._layers[part, axis, index] = layer
                    self._held += layer.nbytes
            while self._held > self.room and self._layers:
                self._held -= self._layers.popitem(last=False)[1].nbytes
        return whole


def _cells(
    part: Part, values: np.ndarray, first: tuple[int, ...], last: tuple[int, ...]
) -> np.ndarray:
    return values[tuple(slice(a - s, b - s) for a, b, s in zip(first, last, part[1], strict=True))]
