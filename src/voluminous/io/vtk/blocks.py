"""Combine parts of regular grids: one grid if they fill a box, otherwise patches."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import FileFormatError, InputError
from ...memory import check_memory
from ..payload import checked_shape
from ..scanners.placement import Arrangement
from .dataset import (
    CELL,
    UPRIGHT,
    ArrangedArrays,
    DataArray,
    Dataset,
    Even,
    Uneven,
    cell_counts,
    common_place,
)

if TYPE_CHECKING:
    from ...grids import PatchGrid
    from ...volume import Volume

# Tolerance of block corners, as a fraction of a cell: files round them.
_TOLERANCE = 1e-3
# Boxes between all walls of blocks, of which it is looked whether they are filled.
_MOST_BOXES = 10_000_000
_LISTED = 8


@dataclass(frozen=True)
class Block:
    """A file that another file refers to, and its name there."""

    name: str
    path: Path

    def __str__(self) -> str:
        """Return the name and the path, which a user can open."""
        return f"{self.name} ({self.path})" if self.name else str(self.path)


def listed(items: Sequence[object]) -> str:
    """Return one line per item, for the first `_LISTED` items."""
    more = [f"  … and {len(items) - _LISTED} more"] if len(items) > _LISTED else []
    return "\n".join([f"  {item}" for item in items[:_LISTED]] + more)


def together(parts: Sequence[Dataset]) -> Dataset:
    """Merge pieces into their bounding box; keep the arrays that all pieces have."""
    if not parts:
        raise FileFormatError("expected a piece with points in it, there is none")
    first = parts[0]
    if len(parts) == 1:
        return first
    low = np.min([part.low for part in parts], axis=0)
    counts = np.max([np.add(part.low, part.points) for part in parts], axis=0) - low
    points = checked_shape(counts, "the number of points")
    there = sum(math.prod(part.points) for part in parts)
    if there < math.prod(points):
        raise FileFormatError(
            f"the pieces have {there} points, expected at least {math.prod(points)} to fill a box "
            f"of {' x '.join(map(str, points))}"
        )
    lowest = tuple(int(n) for n in low)
    starts = [np.subtract(part.low, low) for part in parts]
    place: Any = first.arrange
    if isinstance(place, Even):
        place = replace(place, low=lowest, points=points)
    else:
        lines = tuple(np.full(n, np.nan) for n in points)
        for part, start in zip(parts, starts, strict=True):
            assert isinstance(part.arrange, Uneven)
            for axis, line in enumerate(part.arrange.lines):
                lines[axis][start[axis] : start[axis] + len(line)] = line
        place = Uneven(lines)
    known = [{(array.at, array.name): array for array in part.arrays} for part in parts]
    arrays = [
        _joined_array(cell_counts(points, key[0])[::-1], starts, [inner[key] for inner in known])
        for key in known[0]
        if all(key in inner for inner in known)
    ]
    return Dataset(points, place, arrays, first.active, first.meta, lowest)


def _joined_array(shape: tuple[int, ...], starts: Any, arrays: list[DataArray]) -> DataArray:
    first = arrays[0]
    if len({(array.dtype, array.components) for array in arrays}) > 1:
        raise FileFormatError(f"array {first.name!r} has another type in some of the pieces")

    def load() -> np.ndarray:
        size = math.prod(shape) * (first.components * first.dtype.itemsize + 1)
        check_memory(size, f"putting together {first.name!r}", "open one of the pieces")
        out = np.empty((*shape, first.components), first.dtype)
        filled = np.zeros(shape, bool)
        for array, start in zip(arrays, starts, strict=True):
            values = array.load()
            ends = zip(start[::-1], values.shape[:3], strict=True)
            box = tuple(slice(a, a + n) for a, n in ends)
            out[box], filled[box] = values, True
        if not filled.all():
            raise FileFormatError(
                f"array {first.name!r}: {np.count_nonzero(~filled)} of {filled.size} values are in "
                "none of the pieces"
            )
        return out

    return replace(first, load=load)


def joined(blocks: dict[Block, Dataset]) -> Dataset | None:
    """Merge blocks of image data that fill a box; return None if they do not."""
    found = list(blocks.values())
    if len(found) == 1:
        return found[0]
    places = [part.arrange for part in found if isinstance(part.arrange, Even)]
    if len(places) < len(found) or any(tuple(place.direction) != UPRIGHT for place in places):
        return None
    origins = np.array([place.origin for place in places])
    spacings = np.array([place.spacing for place in places])
    shifts = (origins - origins[0]) / spacings[0]
    whole = np.rint(shifts).astype(np.int64)
    different = np.abs(spacings - spacings[0]) > _TOLERANCE * np.abs(spacings[0])
    if np.any(different) or np.any(np.abs(shifts - whole) > _TOLERANCE):
        return None
    parts = [
        replace(part, low=tuple(int(n) for n in np.add(part.low, shift)))
        for part, shift in zip(found, whole, strict=True)
    ]
    # Two at one place are two volumes, not two parts of one.
    distinct = len({(part.low, part.points) for part in parts}) == len(parts)
    return together(parts) if distinct and _shared(parts) and _fill_box(parts) else None


def _fill_box(parts: Sequence[Dataset]) -> bool:
    """Return True if every cell of the smallest box around parts is in one of them."""
    low = np.array([part.low for part in parts])
    # A single layer of points counts as a layer of cells.
    high = low + [part.shape(CELL) for part in parts]
    walls = [np.unique(np.concatenate([low[:, a], high[:, a]])) for a in range(3)]
    shape = tuple(len(w) - 1 for w in walls)
    if math.prod(shape) > _MOST_BOXES:
        return False
    filled = np.zeros(shape, bool)
    first, last = (
        np.stack([np.searchsorted(w, ends[:, a]) for a, w in enumerate(walls)], axis=1)
        for ends in (low, high)
    )
    for a, b in zip(first, last, strict=True):
        filled[tuple(slice(*ends) for ends in zip(a, b, strict=True))] = True
    return bool(filled.all())


def _kind(array: DataArray) -> tuple[Any, ...]:
    return array.place, array.components, array.dtype


def _shared(datasets: Sequence[Dataset]) -> set[tuple[Any, ...]]:
    return set.intersection(*({_kind(array) for array in part.arrays} for part in datasets))


def alike(blocks: dict[Block, Dataset]) -> list[Dataset]:
    """Return the data of blocks, as far as all have them."""
    datasets = list(blocks.values())
    shared = _shared(datasets)
    if not shared:
        raise InputError(
            f"its blocks have no arrays in common; open one of them:\n{listed(list(blocks))}"
        )
    return [
        replace(dataset, arrays=[a for a in dataset.arrays if _kind(a) in shared])
        for dataset in datasets
    ]


def patches(blocks: dict[Block, Dataset], fields: Any, unit: Any) -> Volume:
    """Return the volume of blocks that fill no box: patches, of which the finest counts."""
    from ...volume import Volume

    datasets = alike(blocks)
    chosen = [dataset.chosen(fields) for dataset in datasets]
    at = common_place(chosen[0])
    unit = unit or datasets[0].meta.get("length_unit")
    placed = [dataset.arrange(at, unit) for dataset in datasets]
    volume = Volume(_patch_grid(list(blocks), placed, unit))
    volume.meta |= {name: v for name, v in datasets[0].meta.items() if name != "length_unit"}
    parts = [ArrangedArrays(*each) for each in zip(datasets, chosen, placed, strict=True)]
    for name, (array, _) in chosen[0].items():
        volume[name] = Deferred(functools.partial(_loaded, parts, name), array.dtype, array.unit)
    return volume


def _loaded(parts: list[ArrangedArrays], name: str) -> list[np.ndarray]:
    return [part.load(name) for part in parts]


def _patch_grid(blocks: list[Block], placed: list[Arrangement], unit: Any) -> PatchGrid:
    from ...grids import PatchGrid

    try:
        grids = [arrangement.grid for arrangement in placed]
        if any(a.direction is not None for a in placed) or not all(g.is_uniform for g in grids):
            raise InputError("expected equal cells along x, y and z in each")
        if len({(g.bounds.tobytes(), g.shape) for g in grids}) < len(grids):
            raise InputError("two of them are at the same place")
        low, high = (np.array([g.bounds[:, k] for g in grids]) for k in (0, 1))
        return PatchGrid(low, high, [g.shape for g in grids], unit=unit)
    except InputError as error:
        raise InputError(
            f"its blocks are no parts of one volume ({error}); open one of them:\n{listed(blocks)}"
        ) from error
