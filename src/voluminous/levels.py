"""A coarser level of a volume that is stored in pieces, as a volume of its own."""

from __future__ import annotations

import copy
import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from .deferred import Deferred, Pieces
from .errors import InputError
from .grids.cartesian.grid import CartesianGrid
from .store import FieldStore, level_factors

HOW_TO_STORE = (
    "`voluminous convert FILE big.zarr --levels --stats` stores them, as does "
    "volume.save('big.zarr', levels=True, stats=True)"
)


def level_of_volume(volume: Any, level: int, kind: Any) -> Any:
    """Return a level of a volume, unread, of the class `kind`; see `Volume.level`."""
    if type(level) is not int or level < 0:
        raise InputError(f"level must be a whole number, 0 for all cells, got {level!r}")
    if level == 0:
        return volume
    grid = volume.grid
    if not isinstance(grid, CartesianGrid):
        raise InputError(
            f"levels are of Cartesian grids, this is a {type(grid).__name__}: "
            "volume.resample(vm.CartesianGrid.uniform(…)) makes a coarse volume of it"
        )
    # What is set later is no part of the level.
    store = FieldStore(grid.shape, copy.copy(volume._fields))
    if store.levels == 1:
        raise InputError(f"this volume has no coarser levels: {HOW_TO_STORE}")
    shape = store.shape(level)
    factors = level_factors(grid.shape, shape) or (1, 1, 1)
    edges = [np.append(e[:-1:factor], e[-1]) for e, factor in zip(grid.edges, factors, strict=True)]
    coarse = kind(type(grid)(*edges, unit=grid.unit))
    coarser = tuple(store.shape(k) for k in range(level + 1, store.levels))
    for name in volume.fields:
        own = volume._fields.pieces(name)
        known = own is not None and own.extremes is not None
        extremes = functools.partial(_extremes, store, name, level) if known else None
        read = functools.partial(_box, store, name, level)
        pieces = Pieces(read, store.chunks, coarser, extremes)
        load = functools.partial(store.read, name, (0, 0, 0), shape, level)
        dtype = volume._fields.dtype(name)
        coarse[name] = Deferred(load, dtype, volume.field_unit(name), pieces=pieces)
        coarse._fields.set_origin(name, volume._fields.origin(name))
    coarse.own()
    coarse.meta.update({**volume.meta, "level": level + volume.meta.get("level", 0)})
    coarse.wcs = _coarse_wcs(volume.wcs, grid.shape, factors)
    return coarse


def kept_level(volume: Any, level: int) -> Any:
    """Return a level that is kept with a volume, so that it is read once; not to be changed."""
    if level == 0:
        return volume
    key = ("level", level)
    if key not in volume.tables:
        coarse = volume.level(level)
        volume.tables[key] = coarse, coarse.bytes_waiting
    return volume.tables[key][0]


def level_within(volume: Any, cells: int) -> int:
    """Return the finest level of no more than so many cells; the coarsest, if all have more."""
    if not isinstance(volume.grid, CartesianGrid) or volume.grid.size <= cells:
        return 0
    store = volume.store
    levels = range(store.levels)
    return next((k for k in levels if math.prod(store.shape(k)) <= cells), levels[-1])


def _box(
    store: FieldStore, name: str, level: int, low: Sequence[int], high: Sequence[int], coarser: int
) -> np.ndarray:
    return store.read(name, low, high, level + coarser)


def _extremes(store: FieldStore, name: str, level: int) -> np.ndarray:
    table = store.extremes(name, level)
    assert table is not None
    return table


def _coarse_wcs(wcs: Any, shape: Sequence[int], factors: Sequence[int]) -> Any:
    """Return the world coordinates of groups of pixels; None where the last ones are smaller."""
    if wcs is None or any(n % factor for n, factor in zip(shape, factors, strict=True)):
        return None
    coarse = wcs.slice([slice(None, None, factor) for factor in factors], numpy_order=False)
    coarse.pixel_shape = [n // factor for n, factor in zip(shape, factors, strict=True)]
    return coarse
