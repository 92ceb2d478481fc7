"""Blocks of regular grids as one volume: joined where they make a box, else patches."""

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
from ..contract import FieldInfo
from ..payload import checked_shape
from ..scanners.placement import Arrangement
from .dataset import (
    UPRIGHT,
    Array,
    Dataset,
    Even,
    Source,
    Uneven,
    cell_counts,
    chosen_arrays,
    common_place,
    infos,
    volume_of,
)

if TYPE_CHECKING:
    from ...volume import Volume

LISTED = 8


@dataclass(frozen=True)
class Block:
    """A file that another names, and what it is called there."""

    name: str
    path: Path

    def __str__(self) -> str:
        """Return what a user can open."""
        return f"{self.name} ({self.path})" if self.name else str(self.path)


def listed(blocks: list[Block]) -> str:
    """Return lines that name blocks."""
    more = len(blocks) - LISTED
    lines = [f"  {block}" for block in blocks[:LISTED]]
    return "\n".join(lines + ([f"  … and {more} more"] if more > 0 else []))


def together(parts: Sequence[Dataset]) -> Dataset:
    """Return the smallest box that holds all pieces, with the arrays that all have."""
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
    starts = [np.subtract(part.low, low) for part in parts]
    known = [{(array.at, array.name): array for array in part.arrays} for part in parts]
    whole = Dataset(points, _arrange(parts, starts, low, points), [], first.active, first.meta)
    arrays = [
        _joined(whole, starts, [arrays[key] for arrays in known])
        for key in known[0]
        if all(key in arrays for arrays in known)
    ]
    return replace(whole, arrays=arrays, low=tuple(int(n) for n in low))


def _arrange(parts: Sequence[Dataset], starts: Any, low: Any, points: tuple[int, ...]) -> Any:
    first = parts[0].arrange
    if isinstance(first, Even):
        return replace(first, low=tuple(int(n) for n in low), points=points)
    lines = [np.full(n, np.nan) for n in points]
    for part, start in zip(parts, starts, strict=True):
        place: Any = part.arrange
        for axis, own in enumerate(place.lines):
            lines[axis][start[axis] : start[axis] + len(own)] = own
    return Uneven(tuple(lines))


def _joined(whole: Dataset, starts: Any, arrays: list[Array]) -> Array:
    first = arrays[0]
    if len({(array.dtype, array.components) for array in arrays}) > 1:
        raise FileFormatError(f"array {first.name!r} has another type in some of the pieces")

    def load() -> np.ndarray:
        shape = (*whole.shape(first.at)[::-1], first.components)
        size = math.prod(shape) * (first.dtype.itemsize + 1)
        check_memory(size, f"putting together {first.name!r}", "open one of the pieces")
        out, filled = np.empty(shape, first.dtype), np.zeros(shape[:3], bool)
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


# Of a cell, by which corners of blocks may be off: files round them.
_TOLERANCE = 1e-3
# Boxes between all walls of blocks, of which it is looked whether they are filled.
_MOST_BOXES = 10_000_000


def volume_of_blocks(blocks: dict[Block, Dataset], fields: Any = None, unit: Any = None) -> Volume:
    """Return the volume that blocks make together.

    Blocks of equal cells that fill a box are joined; others are patches, of which the finest
    counts.
    """
    whole = joined(blocks)
    if whole is not None:
        return volume_of(whole, fields, unit)
    from ...volume import Volume

    datasets = _alike(blocks)
    chosen = [chosen_arrays(dataset, fields) for dataset in datasets]
    at = common_place(chosen[0])
    unit = unit or datasets[0].meta.get("length_unit")
    placed = [dataset.arrange(at, unit) for dataset in datasets]
    volume = Volume(_patch_grid(list(blocks), placed, unit))
    volume.meta |= {name: v for name, v in datasets[0].meta.items() if name != "length_unit"}
    sources = [Source(d, c, a) for d, c, a in zip(datasets, chosen, placed, strict=True)]
    for name, (array, _) in chosen[0].items():
        volume[name] = Deferred(functools.partial(_load, sources, name), array.dtype, array.unit)
    return volume


def infos_of_blocks(blocks: dict[Block, Dataset]) -> tuple[FieldInfo, ...]:
    """Return what there is to read: shapes are those of the first of several patches."""
    return infos(joined(blocks) or _alike(blocks)[0])


def _load(sources: list[Source], name: str) -> list[np.ndarray]:
    return [source.load(name) for source in sources]


def joined(blocks: dict[Block, Dataset]) -> Dataset | None:
    """Return image data that fill a box together as one; None if blocks do not."""
    found = list(blocks.values())
    if len(found) == 1:
        return found[0]
    places = [part.arrange for part in found]
    if not all(isinstance(place, Even) for place in places):
        return None
    origins, spacings, directions = (
        np.array([getattr(place, name) for place in places])
        for name in ("origin", "spacing", "direction")
    )
    if not (np.all(directions == UPRIGHT) and _same(spacings, spacings[0], spacings[0])):
        return None
    shifts = (origins - origins[0]) / spacings[0]
    if not _same(shifts, np.rint(shifts), np.ones(3)):
        return None
    parts = [
        replace(part, low=tuple(int(n) for n in np.add(part.low, np.rint(shift).astype(np.int64))))
        for part, shift in zip(found, shifts, strict=True)
    ]
    # Two at one place are two volumes, not two parts of one.
    distinct = len({(part.low, part.points) for part in parts}) == len(parts)
    if not (distinct and _shared(parts) and _fill_box(parts)):
        return None
    return together(parts)


def _same(values: np.ndarray, others: np.ndarray, size: np.ndarray) -> bool:
    return bool(np.all(np.abs(values - others) <= _TOLERANCE * np.abs(size)))


def _fill_box(pieces: Sequence[Dataset]) -> bool:
    """Return True if every cell of the smallest box around pieces is in one of them."""
    low = np.array([piece.low for piece in pieces])
    # A layer of points is a layer of cells.
    high = low + [cell_counts(piece.points, "cell") for piece in pieces]
    walls = [np.unique(np.concatenate([low[:, a], high[:, a]])) for a in range(3)]
    shape = tuple(len(w) - 1 for w in walls)
    if np.prod(np.array(shape, float)) > _MOST_BOXES:
        return False
    filled = np.zeros(shape, bool)
    first, last = (
        np.stack([np.searchsorted(w, ends[:, a]) for a, w in enumerate(walls)], axis=1)
        for ends in (low, high)
    )
    for a, b in zip(first, last, strict=True):
        filled[tuple(slice(*ends) for ends in zip(a, b, strict=True))] = True
    return bool(filled.all())


def _alike(blocks: dict[Block, Dataset]) -> list[Dataset]:
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


def _shared(datasets: Sequence[Dataset]) -> set[tuple[Any, ...]]:
    return set.intersection(*({_kind(array) for array in part.arrays} for part in datasets))


def _kind(array: Array) -> tuple[Any, ...]:
    return array.place, array.components, array.dtype


def _patch_grid(blocks: list[Block], placed: list[Arrangement], unit: Any) -> Any:
    from ...grids import PatchGrid

    try:
        grids = [arrangement.grid for arrangement in placed]
        if any(a.direction is not None for a in placed) or not all(g.is_uniform for g in grids):
            raise InputError("expected equal cells along x, y and z in each")
        places = {(g.bounds.tobytes(), g.shape) for g in grids}
        if len(places) < len(grids):
            raise InputError("two of them are at the same place")
        low, high = (np.array([g.bounds[:, k] for g in grids]) for k in (0, 1))
        return PatchGrid(low, high, [g.shape for g in grids], unit=unit)
    except InputError as error:
        raise InputError(
            f"its blocks are no parts of one volume ({error}); open one of them:\n{listed(blocks)}"
        ) from error
