"""Empty space: bricks and leaves in which a medium is invisible, and which rays skip."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...backend import Backend
from ...expressions.interval import Interval
from ...grids.cartesian.grid import CartesianGrid
from ...grids.cartesian.leap import BITS, Bricks, brick_shape, make_bricks
from ...grids.trees.octree import OctreeGrid
from ...media.ranges import RangeContext
from ..cache import Cache
from .cells import CellEvaluator
from .corner_layouts import CornerPackets, FieldLattice
from .wide_steps import difference_limits, wide_steps

if TYPE_CHECKING:
    from ...volume import Volume

WIDTH = 1 << BITS
# Fraction of visible leaves above which pruning does not pay: at a tenth, crossing the larger
# surrounding leaves is as fast (half a million leaves, a thin shell: 39 instead of 44 ms).
_WORTHWHILE = 0.05
# Leaves processed at once.
_CHUNK = 1 << 20


class Window(NamedTuple):
    """The cells that affect a brick of 2^bits steps of a walk, along each axis."""

    # Number of cells before the first and after the last of the brick itself.
    before: int
    after: int
    # Maximum number of steps of a walk minus the number of cells.
    extra: int
    # Fraction of filled bricks above which skipping does not pay: it costs as much as crossing some
    # cells (first and second order: no gain at a third, 3 times as fast at 1/20).
    worthwhile: float

    def shape(self, cells: Any) -> tuple[int, ...]:
        """Return the number of bricks along axes with given numbers of cells."""
        return tuple(brick_shape([n + self.extra for n in cells]))


# Dual cell i lies between the centres of cells i - 1 and i, and there is one more than cells.
DUAL = Window(before=1, after=0, extra=1, worthwhile=0.7)
# Coefficients at the vertices of a cell are means over its neighbours.
CELLS = Window(before=1, after=1, extra=0, worthwhile=0.25)


def field_ranges(array: np.ndarray, window: Window) -> Interval:
    """Return the range of a field in and around each brick; NaN where it has NaN."""
    low, high = (np.empty(window.shape(array.shape), np.float64) for _ in range(2))
    for b in range(len(low)):
        first = min(max(b * WIDTH - window.before, 0), len(array) - 1)
        layers = array[first : (b + 1) * WIDTH + window.after]
        for ends, ufunc in ((low, np.minimum), (high, np.maximum)):
            plane = ufunc.reduce(layers, axis=0)
            ends[b] = _windows(_windows(plane, ufunc, window).T, ufunc, window).T
    return Interval(low, high)


def _windows(plane: np.ndarray, ufunc: np.ufunc, window: Window) -> np.ndarray:
    (count,) = window.shape(plane.shape[:1])
    end = max(count * WIDTH + window.after - len(plane), 0)
    padded = np.pad(plane, [(window.before, end), (0, 0)], mode="edge")
    inner = padded[window.before : window.before + count * WIDTH]
    within = ufunc.reduce(inner.reshape(count, WIDTH, -1), axis=1)
    others = [*range(window.before), *(window.before + WIDTH + k for k in range(window.after))]
    for first in others:
        within = ufunc(within, padded[first : first + count * WIDTH : WIDTH][:count])
    return np.asarray(within)


def coordinate_ranges(name: str, edges: Any, window: Window) -> Interval:
    """Return the range of a coordinate in and around each brick."""
    if name == "r":
        parts = [coordinate_ranges(axis, edges, window) for axis in "xyz"]
        squares = [part * part for part in parts]
        low, high = (sum(s.lo for s in squares), sum(s.hi for s in squares))
        return Interval(np.sqrt(low), np.sqrt(high))
    axis = "xyz".index(name)
    walls, last = edges[axis], len(edges[axis]) - 1
    first = np.arange(*window.shape([last])) * WIDTH
    low = walls[np.clip(first - window.before, 0, last)]
    high = walls[np.minimum(first + WIDTH + window.after, last)]
    shape = [1, 1, 1]
    shape[axis] = len(first)
    return Interval(low.reshape(shape), high.reshape(shape))


def get_ranges(evaluator: CellEvaluator, cache: Cache, window: Window) -> dict[str, Interval]:
    """Return the ranges of all fields in and around every brick; cached with the volume.

    Without bricks, the ranges in the whole volume.
    """
    volume = evaluator.volume

    def ranges(name: str) -> Interval:
        if not isinstance(volume.grid, CartesianGrid):
            return evaluator.statistics.range_of(name)
        if name not in volume:
            return coordinate_ranges(name, volume.grid.edges, window)
        key = ("ranges", name, cache.statistics.digest(name), window)
        return cache.get_or_make(key, lambda: field_ranges(volume.array(name), window))

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
        ranges = get_ranges(evaluator, cache, window)
        visible = _visible(evaluator, ranges, faint)
        visible = np.broadcast_to(visible, window.shape(volume.grid.shape))
        steps = None if limits is None else wide_steps(evaluator, visible, ranges, limits)
        return worthwhile_bricks(visible, backend, window, steps)

    key = medium.visible_key()
    if key is not None:
        differences = None if limits is None else tuple(limit.key for limit in limits)
        digests = cache.statistics.digests(medium.names)
        key = ("bricks", key, faint, window, differences, digests, backend)
    return cache.get_or_make(key, make)


def _visible(evaluator: CellEvaluator, ranges: dict[str, Interval], faint: float) -> np.ndarray:
    with np.errstate(all="ignore"):
        return np.asarray(evaluator.channels.bound.may_show(ranges, RangeContext(faint)))


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
