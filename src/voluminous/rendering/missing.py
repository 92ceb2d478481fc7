"""Missing values: they are filled from their neighbours, and their cells are hidden.

A cell is missing where a field that the medium uses is NaN. Fields are interpolated between cells,
so a missing value is replaced by the mean of the cells that touch it, and the neighbours look as if
the field continued evenly. The cell itself is then hidden (`hidden`).
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import Backend, dr
from ..backend.types import Float, Int, Mask
from ..errors import InputError
from ..grids.contract import Segment
from ..grids.two_walks import TwoWalks
from ..schemes.base import Position, Scheme, Solution
from ..schemes.path import empty_path
from ..volume import Volume
from .cache import Cache

if TYPE_CHECKING:
    from ..grids.contract import Grid
    from ..schemes.base import Source


class HiddenCells:
    """A bit mask of cells that are hidden.

    Parameters
    ----------
    missing : array of bool
        One per cell, in the order of their numbers.
    """

    def __init__(self, missing: np.ndarray) -> None:
        self.count = int(missing.sum())
        packed = np.packbits(missing.reshape(-1), bitorder="little")
        self.words = np.pad(packed, (0, -len(packed) % 4)).view("<u4")

    def on(self, backend: Backend) -> Any:
        """Return the bits as a device array."""
        return backend.UInt(np.ascontiguousarray(self.words, np.uint32))


def through_cells(walk: Any, grid: Grid, backend: Backend) -> Any:
    """Return a walk whose segments each lie in one cell of the grid."""
    return walk if walk.in_cells else TwoWalks(walk, grid.walk(backend))


class Hiding(Scheme):
    """A scheme that leaves out segments in hidden cells; otherwise it is another."""

    def __init__(self, scheme: Scheme, bits: Int) -> None:
        self.scheme, self.bits = scheme, bits
        self.name, self.coefficients_at = scheme.name, scheme.coefficients_at
        self.controlled = scheme.controlled

    def start(self, position: Position, source: Source) -> list[Float]:
        return self.scheme.start(position, source)

    def after_skip(
        self, position: Position, source: Source, carried: list[Float], moved: Mask
    ) -> list[Float]:
        return self.scheme.after_skip(position, source, carried, moved)

    def solve(
        self, segment: Segment, source: Source, carried: list[Float]
    ) -> tuple[Solution, list[Float]]:
        cell = segment.own_cell
        word = dr.gather(type(self.bits), self.bits, cell >> 5, segment.active)
        hidden = (word >> (cell & 31)) & 1 == 1
        found, onward = self.scheme.solve(segment, source, carried)
        parts = (found.emission, found.transparency, found.error)
        nothing = empty_path(type(segment.length), *(len(part) for part in parts))
        beyond = self.scheme.after_hidden(carried, onward)
        return dr.select(hidden, nothing, found), dr.select(hidden, beyond, onward)


# Cells processed at once.
_CHUNK = 1 << 20
# Distance beyond a cell's centre at which its neighbours are located, in its widths.
_BEYOND = 0.5 + 2.0**-6
_AROUND = [way for way in itertools.product((-1, 0, 1), repeat=3) if any(way)]


@dataclass
class Completed:
    """A volume with missing values filled in the fields that are used.

    Attributes
    ----------
    cache : Cache
        Cache of the results for this volume.
    hidden : HiddenCells or None
        The cells in which a value was missing.
    counts : dict of str to int
        Number of missing values in each field.
    """

    volume: Volume
    cache: Cache
    hidden: HiddenCells | None
    counts: dict[str, int]


def complete(cache: Cache, names: Any, hashed: bool) -> Completed:
    """Return the volume with missing values filled; the volume itself if none is missing."""
    volume = cache.volume
    fields = sorted(volume.given(names))
    if hashed:
        cache.statistics.digests(fields)
    lacking = [name for name in fields if not _all_finite(volume, name, cache)]
    if not lacking:
        return Completed(volume, cache, None, {})
    key = ("completed", cache.statistics.digests(fields))
    whole, hidden, counts = cache.get_or_make(key, lambda: _complete(volume, lacking))
    seen = copy.copy(whole)
    seen.sight = volume.sight
    return Completed(seen, Cache(seen), hidden, counts)


def _all_finite(volume: Volume, name: str, cache: Any) -> bool:
    """Return whether a field has a value everywhere, judged by its least and largest."""
    if volume.array(name).dtype.kind != "f":
        return True
    return bool(np.all(np.isfinite(cache.statistics.extremes(name))))


def _complete(volume: Volume, names: list[str]) -> tuple[Any, HiddenCells, dict[str, int]]:
    """Return the filled volume, its incomplete cells, and the number of missing values."""
    missing, counts, arrays = np.zeros(volume.grid.size, bool), {}, {}
    for name in names:
        array = volume.array(name)
        own = np.isnan(array).reshape(-1)
        _check_finite(volume, name, own)
        counts[name] = int(own.sum())
        if counts[name]:
            missing |= own
            arrays[name] = filled(volume.grid, array, own)
    return volume.with_arrays(arrays), HiddenCells(missing), counts


def _check_finite(volume: Volume, name: str, missing: np.ndarray) -> None:
    array = volume.array(name).reshape(-1)
    count, first = 0, -1
    for start in range(0, array.size, _CHUNK):
        infinite = np.flatnonzero(np.isinf(array[start : start + _CHUNK]))
        if infinite.size and not count:
            first = start + int(infinite[0])
        count += infinite.size
    if count:
        place = tuple(int(i) for i in np.unravel_index(first, volume.grid.shape))
        raise InputError(
            f"field {name!r} has {count} infinite value{'s' * (count > 1)}; the first is "
            f"{array[first]} in cell {place}. Missing values are NaN (transparent): replace them, "
            f"or clip the field"
        )
    if missing.all():
        raise InputError(f"field {name!r} has no value at all: every cell is NaN")


def filled(grid: Grid, array: np.ndarray, missing: np.ndarray) -> np.ndarray:
    """Return a field whose missing cells hold the mean of the cells that touch them.

    Cells without a valid neighbour get the mean of the field; they are not visible.
    """
    out = array.copy()
    flat = out.reshape(-1)
    flat[missing] = flat[~missing].mean(dtype=np.float64)
    for cells, values in (_boxes if grid.is_structured else _located)(grid, array, missing):
        flat[cells] = values
    return out


def _boxes(
    grid: Grid, array: np.ndarray, missing: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield missing cells with valid neighbours, and the neighbours' means: boxes of 3 x 3 x 3."""
    gone = missing.reshape(array.shape)
    plane = array[0].size
    step = max(1, _CHUNK // plane)
    for first in range(0, len(array), step):
        last = min(first + step, len(array))
        if not gone[first:last].any():
            continue
        low, high = max(first - 1, 0), min(last + 1, len(array))
        there = ~gone[low:high]
        count = _box_sums(there.astype(np.float32))[first - low : last - low]
        total = _box_sums(np.where(there, array[low:high], 0.0))[first - low : last - low]
        place = np.flatnonzero(gone[first:last] & (count > 0))
        yield first * plane + place, total.reshape(-1)[place] / count.reshape(-1)[place]


def _box_sums(values: np.ndarray) -> np.ndarray:
    for axis in range(3):
        own = np.moveaxis(values, axis, 0)
        total = own.copy()
        total[1:] += own[:-1]
        total[:-1] += own[1:]
        values = np.moveaxis(total, 0, axis)
    return values


def _located(
    grid: Grid, array: np.ndarray, missing: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield missing cells with valid neighbours, and the neighbours' means: cells of any size."""
    step = _CHUNK >> 4
    for first in range(0, grid.size, step):
        last = min(first + step, grid.size)
        cells = np.flatnonzero(missing[first:last])
        if not cells.size:
            continue
        centers = grid.cell_centers(first, last)[:, cells]
        ways = (grid.basis(first, last) * grid.cell_sizes(first, last)[:, None])[:, :, cells]
        total, count = np.zeros(cells.size), np.zeros(cells.size)
        for way in _AROUND:
            points = centers + _BEYOND * np.einsum("k,kxn->xn", np.asarray(way, float), ways)
            beyond = grid.locate(points.T)
            there = (beyond >= 0) & ~missing[beyond]
            total += np.where(there, array[beyond], 0.0)
            count += there
        some = count > 0
        yield first + cells[some], total[some] / count[some]
