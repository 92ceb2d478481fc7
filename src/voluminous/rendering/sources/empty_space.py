"""Empty space: bricks and leaves in which a medium is invisible, and which rays skip."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import Backend
from ...expressions.interval import Interval
from ...grids.cartesian.grid import CartesianGrid
from ...grids.cartesian.leap import Bricks, make_bricks
from ...grids.trees.octree import OctreeGrid
from ...media.bound import BoundMedium
from ...media.ranges import RangeContext
from ...ranges import BrickRanges, Ranges, Window, coordinate_ranges, ranges_of_field, sums_in
from ..cache import Cache
from ..precision import exactness_of
from .cells import CellEvaluator
from .corner_layouts import CornerPackets, FieldLattice
from .wide_steps import difference_limits, wide_steps

if TYPE_CHECKING:
    from ...volume import Volume

# Fraction of visible leaves above which pruning does not pay: at a tenth, crossing the larger
# surrounding leaves is as fast (half a million leaves, a thin shell: 39 instead of 44 ms).
_WORTHWHILE = 0.05
# Leaves processed at once.
_CHUNK = 1 << 20


def get_ranges(evaluator: CellEvaluator, cache: Cache, window: Window) -> Ranges:
    """Return the ranges of all fields in and around every brick.

    Without bricks, the ranges in the whole volume.
    """
    volume = evaluator.volume

    def ranges(name: str) -> BrickRanges | Interval:
        if not isinstance(volume.grid, CartesianGrid):
            return evaluator.statistics.range_of(name)
        if name not in volume:
            return coordinate_ranges(name, volume.grid.edges, window)
        return ranges_of_field(cache, name, window)

    return {name: ranges(name) for name in evaluator.medium.names}


def get_bricks(
    evaluator: CellEvaluator, cache: Cache, faint: float, window: Window, coarseness: float = 0.0
) -> Bricks | None:
    """Return the bricks that rays may skip, or None; cached with the volume."""
    medium, backend, volume = evaluator.medium, evaluator.backend, evaluator.volume
    if not isinstance(evaluator.grid, CartesianGrid):
        return None
    limits = difference_limits(evaluator, coarseness)

    def make() -> Bricks | None:
        ranges, steps = get_ranges(evaluator, cache, window), None
        visible = _visible(evaluator, ranges, faint)
        visible = np.broadcast_to(visible, window.shape(volume.grid.shape))
        if limits is not None:
            single = exactness_of(cache, medium)[0]
            steps = wide_steps(evaluator, visible, ranges, limits, single)
        return worthwhile_bricks(visible, backend, window, steps)

    key = medium.visible_key()
    if key is not None:
        differences = None if limits is None else tuple(limit.key for limit in limits)
        digests = cache.statistics.digests(medium.names)
        key = ("bricks", key, faint, window, differences, digests, backend)
    return cache.get_or_make(key, make)


def _visible(evaluator: CellEvaluator, ranges: Any, faint: float) -> np.ndarray:
    def seen(bound: BoundMedium, fields: dict[str, Interval]) -> list[np.ndarray]:
        return [np.asarray(bound.may_show(fields, RangeContext(faint)))]

    return sums_in(evaluator.medium, evaluator.channels.bound, ranges, seen)[0]


def worthwhile_bricks(
    visible: np.ndarray, backend: Backend, window: Window, steps: np.ndarray | None = None
) -> Bricks | None:
    """Return bricks that rays can skip, or None if few are empty and steps are never wide."""
    if steps is None and np.count_nonzero(visible) > window.worthwhile * visible.size:
        return None
    return make_bricks(visible, backend, steps=steps)


def get_pruned_walk(
    evaluator: CellEvaluator,
    cache: Cache,
    faint: float,
    kind: str,
    lattices: Mapping[str, FieldLattice],
) -> Any:
    """Return a walk through visible leaves of a tree, or None; cached with the volume.

    The lattices have the values at their corners, if they have such.
    """
    medium, grid, backend = evaluator.medium, evaluator.grid, evaluator.backend
    in_cells = all(name in evaluator.volume for name in medium.names)
    if not isinstance(grid, OctreeGrid) or not in_cells:
        return None

    def make() -> Any:
        visible = np.empty(grid.size, bool)
        for part, ranges in ranges_of_cells(evaluator.volume, medium.names, lattices):
            visible[part] = _visible(evaluator, ranges, faint)
        return pruned_walk(grid, visible, backend, kind)

    key = medium.visible_key()
    if key is not None:
        key = ("pruned", kind, key, faint, backend, cache.statistics.digests(medium.names))
    return cache.get_or_make(key, make)


def pruned_walk(grid: OctreeGrid, visible: np.ndarray, backend: Backend, kind: str) -> Any:
    """Return a walk through the visible leaves, or None if most of them are visible."""
    if np.count_nonzero(visible) > _WORTHWHILE * len(visible):
        return None
    return grid.walk_through(grid.pruned(visible), backend, kind)


def ranges_of_cells(
    volume: Volume, names: Iterable[str], lattices: Mapping[str, Any]
) -> Iterator[tuple[slice, dict[str, Interval]]]:
    """Yield parts of all cells, and ranges of fields in each of them, flat.

    Those of the values at corners, of lattices with such, else of the cell's own value.
    """
    values: dict[str, tuple[np.ndarray, float]] = {}
    for name in names:
        values[name] = volume.array(name).reshape(-1), 1.0
        if isinstance(lattice := lattices.get(name), CornerPackets):
            values[name] = np.asarray(lattice.data).reshape(-1, 8), lattice.unit
    for first in range(0, volume.grid.size, _CHUNK):
        part, ranges = slice(first, min(first + _CHUNK, volume.grid.size)), {}
        for name, (own, unit) in values.items():
            columns = own[part].astype(np.float64).reshape(part.stop - first, -1).T
            low, high = (functools.reduce(end, columns) for end in (np.minimum, np.maximum))
            ranges[name] = Interval(low * unit, high * unit)
        yield part, ranges
