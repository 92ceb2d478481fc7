"""Combine parts of regular grids: one grid if they fill a box, otherwise patches."""

from __future__ import annotations

import functools
import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import InputError
from ...memory import check_memory
from .dataset import (
    CELL,
    UPRIGHT,
    ArrangedArrays,
    DataArray,
    Dataset,
    Even,
    cell_counts,
    common_place,
)

if TYPE_CHECKING:
    from ...volume import Volume

# Tolerance of block corners, as a fraction of a cell: files round them.
_TOLERANCE = 1e-3
_LISTED = 8


# Data by name and path of the file, which a user can open.
Blocks = dict[str, Dataset]


def listed(items: Collection[str]) -> str:
    """Return one line per item, for the first `_LISTED` items."""
    items = list(items)
    more = [f"  … and {len(items) - _LISTED} more"] if len(items) > _LISTED else []
    return "\n".join([f"  {item}" for item in items[:_LISTED]] + more)


def joined(blocks: Blocks) -> Dataset | None:
    """Merge blocks of image data that fill a box; return None if they do not."""
    parts = list(blocks.values())
    if len(parts) == 1:
        return parts[0]
    places = [part.arrange for part in parts if isinstance(part.arrange, Even)]
    if len(places) < len(parts) or any(tuple(place.direction) != UPRIGHT for place in places):
        return None
    origins, spacings, lows = (
        np.array([getattr(place, name) for place in places])
        for name in ("origin", "spacing", "low")
    )
    shifts = (origins - origins[0]) / spacings[0] + lows - lows[0]
    starts = np.rint(shifts).astype(np.int64)
    uneven = np.abs(spacings / spacings[0] - 1).max() > _TOLERANCE
    if uneven or np.abs(shifts - starts).max() > _TOLERANCE or not _shared(parts):
        return None
    low = starts.min(axis=0)
    starts, cells = starts - low, np.array([part.shape(CELL) for part in parts])
    shape = tuple((starts + cells).max(axis=0))
    # Two at one place are two volumes, not two parts of one.
    if len(np.unique(starts, axis=0)) < len(parts) or cells.prod(axis=1).sum() < math.prod(shape):
        return None
    check_memory(math.prod(shape), "joining the blocks", "open one of them")
    filled = np.zeros(shape, bool)
    for start, size in zip(starts, cells, strict=True):
        filled[tuple(map(slice, start, start + size))] = True
    if not filled.all():
        return None
    points = tuple(int(n) for n in (starts + [p.points for p in parts]).max(axis=0))
    place = replace(places[0], low=tuple(lows[0] + low), points=points)
    known = [{_kind(array): array for array in part.arrays} for part in parts]
    arrays = [
        _joined_array(cell_counts(points, array.at), starts, [inner[key] for inner in known])
        for key, array in known[0].items()
        if key in _shared(parts)
    ]
    return Dataset(points, place, arrays, parts[0].active, parts[0].meta)


def _joined_array(shape: tuple[int, ...], starts: np.ndarray, arrays: list[DataArray]) -> DataArray:
    first = arrays[0]

    def load() -> np.ndarray:
        size = math.prod(shape) * first.components * first.dtype.itemsize
        check_memory(size, f"putting together {first.name!r}", "open one of the pieces")
        out = np.empty((*shape[::-1], first.components), first.dtype)
        for array, start in zip(arrays, starts[:, ::-1], strict=True):
            values = array.load()
            out[tuple(map(slice, start, start + values.shape[:3]))] = values
        return out

    return replace(first, load=load)


def _kind(array: DataArray) -> tuple[Any, ...]:
    return array.place, array.components, array.dtype


def _shared(datasets: Sequence[Dataset]) -> set[tuple[Any, ...]]:
    return set.intersection(*({_kind(array) for array in part.arrays} for part in datasets))


def alike(blocks: Blocks) -> list[Dataset]:
    """Return the data of blocks, as far as all have them."""
    datasets = list(blocks.values())
    shared = _shared(datasets)
    if not shared:
        raise InputError(
            f"its blocks have no arrays in common; open one of them:\n{listed(blocks)}"
        )
    return [
        replace(dataset, arrays=[a for a in dataset.arrays if _kind(a) in shared])
        for dataset in datasets
    ]


def patches(blocks: Blocks, fields: Any, unit: Any) -> Volume:
    """Return the volume of blocks that fill no box: patches, of which the finest counts."""
    from ...grids import PatchGrid
    from ...volume import Volume

    datasets = alike(blocks)
    chosen = [dataset.chosen(fields) for dataset in datasets]
    at = common_place(chosen[0])
    unit = unit or datasets[0].meta.get("length_unit")
    placed = [dataset.arrange(at, unit) for dataset in datasets]
    try:
        grids = [arrangement.grid for arrangement in placed]
        if any(a.direction is not None for a in placed) or not all(g.is_uniform for g in grids):
            raise InputError("expected equal cells along x, y and z in each")
        if len({(g.bounds.tobytes(), g.shape) for g in grids}) < len(grids):
            raise InputError("two of them are at the same place")
        low, high = (np.array([g.bounds[:, k] for g in grids]) for k in (0, 1))
        volume = Volume(PatchGrid(low, high, [g.shape for g in grids], unit=unit))
    except InputError as error:
        raise InputError(
            f"its blocks are no parts of one volume ({error}); open one of them:\n{listed(blocks)}"
        ) from error
    volume.meta |= {name: v for name, v in datasets[0].meta.items() if name != "length_unit"}
    parts = [ArrangedArrays(*each) for each in zip(datasets, chosen, placed, strict=True)]
    for name, (array, _) in chosen[0].items():
        volume[name] = Deferred(functools.partial(_loaded, parts, name), array.dtype, array.unit)
    return volume


def _loaded(parts: list[ArrangedArrays], name: str) -> list[np.ndarray]:
    return [part.load(name) for part in parts]
