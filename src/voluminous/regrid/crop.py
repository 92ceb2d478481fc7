"""A part of a volume: the cells between two walls along each axis."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..errors import InputError
from ..grids.arguments import on_grid
from ..grids.cartesian.grid import CartesianGrid
from ..units import shown
from .resample import meta_on


def cropped_volume(volume: Any, limits: dict[str, Any], later: Callable[..., Any]) -> Any:
    """Return the cells within limits; `later` makes a field of boxes. See `Volume.crop`."""
    grid = volume.grid
    if not isinstance(grid, CartesianGrid):
        raise InputError(
            f"crop drops cells of Cartesian grids, this is a {type(grid).__name__}: clip= draws a "
            "part of it, as in vm.render(…, clip=vm.regions.Box(low, high)), and "
            "volume.resample(vm.CartesianGrid.uniform(…)) makes a volume of a part"
        )
    ends = [_ends(*axis, grid) for axis in zip(limits.items(), grid.edges, strict=True)]
    low, high = zip(*ends, strict=True)
    edges = [e[a : b + 1] for e, (a, b) in zip(grid.edges, ends, strict=True)]
    other = type(volume)(CartesianGrid(*edges, unit=grid.unit))
    before = volume.with_arrays({})  # what is set later is no part of it
    for name in volume.fields:
        if name in volume.waiting and before._fields.pieces(name) is not None:
            read = functools.partial(_box, before.store, name, low)
            other[name] = later(read, before._fields.dtype(name), other.grid.shape)
            other._fields.set_origin(name, before._fields.origin(name))
        else:  # a copy, so that the others need no memory
            other[name] = volume.array(name)[tuple(map(slice, low, high))].copy()
        other._fields.own(name)
        other.set_unit(name, volume.field_unit(name))
    other.meta |= meta_on(volume, other.grid)
    if volume.wcs is not None:
        other.wcs = volume.wcs.slice(list(map(slice, low, high)), numpy_order=False)
        other.wcs.pixel_shape = list(other.grid.shape)
    return other


def _ends(limit: tuple[str, Any], edges: np.ndarray, grid: CartesianGrid) -> tuple[int, int]:
    """Return the first cell, and the one after the last, of which some is within a limit."""
    name, between = limit
    if between is None:
        return 0, len(edges) - 1
    try:
        low, high = between
    except (TypeError, ValueError):
        raise InputError(f"{name} must be (low, high), got {shown(between)}") from None
    low = edges[0] if low is None else on_grid(low, grid, name)
    high = edges[-1] if high is None else on_grid(high, grid, name)
    if np.ndim(low) or np.ndim(high) or not low < high:
        raise InputError(f"{name} must be (low, high), two numbers in this order, got {between}")
    first = max(int(np.searchsorted(edges, low, "right")) - 1, 0)
    last = min(int(np.searchsorted(edges, high, "left")), len(edges) - 1)
    if first >= last:
        raise InputError(
            f"{name}={shown(between)} has no cells: they are from {edges[0]:.6g} to {edges[-1]:.6g}"
        )
    return first, last


def _box(
    store: Any, name: str, first: Sequence[int], low: Any, high: Any, level: int = 0
) -> np.ndarray:
    places = ([a + b for a, b in zip(first, end, strict=True)] for end in (low, high))
    return np.asarray(store.read(name, *places, level))
