"""Blocks of regular grids as one volume: joined where they make a box, else patches."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import InputError
from ..contract import FieldInfo
from ..scanners.placement import Arrangement
from .attributes import real
from .axes import UPRIGHT, cell_counts
from .dataset import Array, Dataset
from .document import IMAGE, Document
from .multiblock import Block, listed
from .pieces import Piece
from .volumes import Source, chosen_arrays, common_place, infos, volume_of

if TYPE_CHECKING:
    from ...volume import Volume

# Attributes that tell where image data are, and what they are if there are none.
_PLACE = (("Origin", (0.0,) * 3), ("Spacing", (1.0,) * 3), ("Direction", UPRIGHT))
# Of a cell, by which corners of blocks may be off: files round them.
_TOLERANCE = 1e-3
# Boxes between all walls of blocks, of which it is looked whether they are filled.
_MOST_BOXES = 10_000_000


def volume_of_blocks(blocks: dict[Block, Document], fields: Any = None, unit: Any = None) -> Volume:
    """Return the volume that blocks make together.

    Blocks of equal cells that fill a box are joined; others are patches, of which the finest
    counts.

    Raises
    ------
    InputError
        If they are no parts of one volume; names them.
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


def infos_of_blocks(blocks: dict[Block, Document]) -> tuple[FieldInfo, ...]:
    """Return what there is to read: shapes are those of the first of several patches."""
    return infos(joined(blocks) or _alike(blocks)[0])


def _load(sources: list[Source], name: str) -> list[np.ndarray]:
    return [source.load(name) for source in sources]


def joined(blocks: dict[Block, Document]) -> Dataset | None:
    """Return image data that fill a box together as one; None if blocks do not."""
    found = list(blocks.values())
    if len(found) == 1:
        return found[0].dataset()
    if any(document.kind != IMAGE for document in found):
        return None
    origins, spacings, directions = (
        np.array([real(document.element, name, default) for document in found])
        for name, default in _PLACE
    )
    if not (np.all(directions == UPRIGHT) and _same(spacings, spacings[0], spacings[0])):
        return None
    shifts = (origins - origins[0]) / spacings[0]
    if not _same(shifts, np.rint(shifts), np.ones(3)) or _are_copies(found, shifts):
        return None
    pieces = [
        replace(piece, low=tuple(int(n) for n in np.add(piece.low, shift)))
        for document, shift in zip(found, np.rint(shifts).astype(np.int64), strict=True)
        for piece in document.pieces
    ]
    shared = set.intersection(*(set(piece.parts) for piece in pieces)) if pieces else ()
    if not shared or not _fill_box(pieces):
        return None
    return replace(found[0], pieces=pieces).dataset()


def _same(values: np.ndarray, others: np.ndarray, size: np.ndarray) -> bool:
    return bool(np.all(np.abs(values - others) <= _TOLERANCE * np.abs(size)))


def _are_copies(found: list[Document], shifts: np.ndarray) -> bool:
    """Return True if two blocks are at one place: they are two volumes, not two parts of one."""
    places = [
        (*np.rint(shift).tolist(), *((piece.low, piece.points) for piece in document.pieces))
        for document, shift in zip(found, shifts, strict=True)
    ]
    return len(set(places)) < len(places)


def _fill_box(pieces: Sequence[Piece]) -> bool:
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


def _alike(blocks: dict[Block, Document]) -> list[Dataset]:
    """Return the data of blocks, as far as all have them.

    Raises
    ------
    InputError
        If they have nothing in common.
    """
    datasets = [document.dataset() for document in blocks.values()]
    kinds = [{_kind(array) for array in dataset.arrays} for dataset in datasets]
    shared = set.intersection(*kinds)
    if not shared:
        raise InputError(
            f"its blocks have no arrays in common; open one of them:\n{listed(list(blocks))}"
        )
    return [
        replace(dataset, arrays=[a for a in dataset.arrays if _kind(a) in shared])
        for dataset in datasets
    ]


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
