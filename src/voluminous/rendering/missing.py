"""Missing values: they are filled from their neighbours, and their cells are hidden.

A cell is missing where a field that the medium uses is NaN. Fields are interpolated between cells,
so a missing value is replaced by the mean of the cells that touch it, and the neighbours look as if
the field continued evenly. The cell itself is then hidden (`hidden`).
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import Backend
from ..backend.types import Int
from ..errors import InputError
from ..grids.contract import basis
from ..grids.structured import is_structured
from ..grids.two_walks import TwoWalks
from ..volume import Volume
from .cache import Cache

if TYPE_CHECKING:
    from ..grids.contract import Grid


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

    def on(self, backend: Backend) -> Int:
        return backend.UInt(np.ascontiguousarray(self.words, np.uint32))


def through_cells(walk: Any, grid: Grid, backend: Backend) -> Any:
    """Return a walk whose segments each lie in one cell of the grid."""
    return walk if walk.in_cells else TwoWalks(walk, grid.walk(backend))


# Cells processed at once.
_CHUNK = 1 << 20
# Distance beyond a cell's centre at which its neighbours are located, in its widths.
_BEYOND = 0.5 + 2.0**-6
_AROUND = [way for way in itertools.product((-1, 0, 1), repeat=3) if any(way)]


Completed = tuple[Volume, Cache, HiddenCells | None, dict[str, int]]


def complete(cache: Cache, names: Iterable[str], hashed: bool) -> Completed:
    """Return a volume with missing values filled in the fields that are used, and its cache.

    Also the cells in which a value was missing, or None, and their number in each field.
    """
    volume, statistics = cache.volume, cache.statistics
    fields = sorted(volume.given(names))
    if hashed:
        statistics.digests(fields)
    # Judged by the least and largest values.
    lacking = [
        name
        for name in fields
        if volume.array(name).dtype.kind == "f"
        and not np.all(np.isfinite(statistics.extremes(name)))
    ]
    if not lacking:
        return volume, cache, None, {}

    def fill() -> tuple[Volume, HiddenCells, dict[str, int]]:
        missing, counts, arrays = np.zeros(volume.grid.size, bool), {}, {}
        for name in lacking:
            array = volume.array(name)
            gone = np.isnan(array).reshape(-1)
            _check_finite(volume, name, gone)
            counts[name] = int(gone.sum())
            if counts[name]:
                missing |= gone
                arrays[name] = filled(volume.grid, array, gone)
        return volume.with_arrays(arrays), HiddenCells(missing), counts

    key = ("completed", statistics.digests(fields))
    whole, hidden, counts = cache.get_or_make(key, fill)
    seen = copy.copy(whole)
    seen.sight = volume.sight
    return seen, Cache(seen), hidden, counts


def _check_finite(volume: Volume, name: str, missing: np.ndarray) -> None:
    array = volume.array(name).reshape(-1)
    parts = (slice(first, first + _CHUNK) for first in range(0, array.size, _CHUNK))
    places = np.concatenate([part.start + np.flatnonzero(np.isinf(array[part])) for part in parts])
    if count := places.size:
        cell = tuple(int(i) for i in np.unravel_index(places[0], volume.grid.shape))
        raise InputError(
            f"field {name!r} has {count} infinite value{'s' * (count > 1)}; the first is "
            f"{array[places[0]]} in cell {cell}. Missing values are NaN (transparent): replace "
            f"them, or clip the field"
        )
    if missing.all():
        raise InputError(f"field {name!r} has no value at all: every cell is NaN")


def filled(grid: Grid, array: np.ndarray, missing: np.ndarray) -> np.ndarray:
    """Return a field whose missing cells hold the mean of the cells that touch them.

    Cells without a valid neighbour get the mean of the field; they are not visible.
    """
    out: np.ndarray = array.copy()
    flat = out.reshape(-1)
    flat[missing] = flat[~missing].mean(dtype=np.float64)
    means = _means_in_boxes(array, missing) if is_structured(grid) else _means(grid, array, missing)
    for cells, values in means:
        flat[cells] = values
    return out


def _means_in_boxes(
    array: np.ndarray, missing: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield missing cells with valid neighbours, and the neighbours' means: boxes of 3 x 3 x 3."""
    gone, plane = missing.reshape(array.shape), array[0].size
    step = max(1, _CHUNK // plane)
    for first in range(0, len(array), step):
        part = gone[first : first + step]
        if not part.any():
            continue
        low, high = max(first - 1, 0), min(first + step + 1, len(array))
        there, inner = ~gone[low:high], slice(first - low, first - low + len(part))
        count = _box_sums(there.astype(np.float32))[inner]
        total = _box_sums(np.where(there, array[low:high], 0.0))[inner]
        place = np.flatnonzero(part & (count > 0))
        yield first * plane + place, total.reshape(-1)[place] / count.reshape(-1)[place]


def _box_sums(values: np.ndarray) -> np.ndarray:
    for axis in range(3):
        planes = np.moveaxis(values, axis, 0)
        total = planes.copy()
        total[1:] += planes[:-1]
        total[:-1] += planes[1:]
        values = np.moveaxis(total, 0, axis)
    return values


def _means(
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
        offsets = (basis(grid, first, last) * grid.cell_sizes(first, last)[:, None])[:, :, cells]
        total, count = np.zeros(cells.size), np.zeros(cells.size)
        for side in _AROUND:
            points = centers + _BEYOND * np.einsum("k,kxn->xn", np.asarray(side, float), offsets)
            beyond = grid.locate(points.T)
            there = (beyond >= 0) & ~missing[beyond]
            total += np.where(there, array[beyond], 0.0)
            count += there
        some = count > 0
        yield first + cells[some], total[some] / count[some]
