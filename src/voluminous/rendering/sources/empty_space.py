"""Empty space: blocks and leaves in which a medium is invisible, and which rays skip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import Backend
from ...expressions.interval import Interval
from ...grids.cartesian.leap import BITS, Blocks, block_shape, make_blocks
from ...media.contract import Medium
from ...media.ranges import RangeContext
from ...volume import Volume
from ..cache import Cache
from .cells import CellEvaluator
from .corner_layouts import CornerPackets
from .wide_steps import difference_limits, wide_steps

if TYPE_CHECKING:
    from ...grids.contract import Grid

_WIDTH = 1 << BITS


@dataclass(frozen=True)
class Window:
    """The cells that affect a block of 2^bits steps of a walk, along each axis.

    Attributes
    ----------
    before, after : int
        Number of cells before the first and after the last of the block itself.
    extra : int
        Maximum number of steps of a walk minus the number of cells.
    worthwhile : float
        Fraction of filled blocks above which skipping does not pay: it costs as much as crossing
        some cells (first and second order: no gain at a third, 3 times as fast at 1/20).
    """

    before: int
    after: int
    extra: int
    worthwhile: float

    def count(self, cells: int) -> int:
        """Return the number of blocks along an axis with a number of cells."""
        return block_shape([cells + self.extra])[0]

    def shape(self, cells: Any) -> tuple[int, ...]:
        """Return the number of blocks along each axis."""
        return tuple(self.count(n) for n in cells)


# Dual cell i lies between the centres of cells i - 1 and i, and there is one more than cells.
DUAL = Window(before=1, after=0, extra=1, worthwhile=0.7)
# Coefficients at the vertices of a cell are means over its neighbours.
CELLS = Window(before=1, after=1, extra=0, worthwhile=0.25)


def field_ranges(array: np.ndarray, window: Window) -> Interval:
    """Return the range of a field in and around each block; all numbers where it has NaN."""
    low, high = (np.empty(window.shape(array.shape), np.float64) for _ in range(2))
    for b in range(len(low)):
        first = min(max(b * _WIDTH - window.before, 0), len(array) - 1)
        layers = array[first : (b + 1) * _WIDTH + window.after]
        for found, ufunc in ((low, np.minimum), (high, np.maximum)):
            plane = ufunc.reduce(layers, axis=0)
            found[b] = _windows(_windows(plane, ufunc, window).T, ufunc, window).T
    return Interval(low, high)


def _windows(plane: np.ndarray, ufunc: np.ufunc, window: Window) -> np.ndarray:
    count = window.count(len(plane))
    end = max(count * _WIDTH + window.after - len(plane), 0)
    padded = np.pad(plane, [(window.before, end), (0, 0)], mode="edge")
    own = padded[window.before : window.before + count * _WIDTH]
    within = ufunc.reduce(own.reshape(count, _WIDTH, -1), axis=1)
    others = [*range(window.before), *(window.before + _WIDTH + k for k in range(window.after))]
    for first in others:
        within = ufunc(within, padded[first : first + count * _WIDTH : _WIDTH][:count])
    return within


def coordinate_ranges(name: str, edges: Any, window: Window) -> Interval:
    """Return the range of a coordinate in and around each block."""
    if name == "r":
        squares = [_square(coordinate_ranges(axis, edges, window)) for axis in "xyz"]
        return Interval(*(np.sqrt(sum(getattr(s, end) for s in squares)) for end in ("lo", "hi")))
    axis = "xyz".index(name)
    walls = edges[axis]
    last, first = len(walls) - 1, np.arange(window.count(len(walls) - 1)) * _WIDTH
    low = walls[np.clip(first - window.before, 0, last)]
    high = walls[np.minimum(first + _WIDTH + window.after, last)]
    shape = [1, 1, 1]
    shape[axis] = len(first)
    return Interval(low.reshape(shape), high.reshape(shape))


def _square(x: Interval) -> Interval:
    return x * x


def visible_blocks(
    evaluator: CellEvaluator, ranges: dict[str, Interval], faint: float, window: Window
) -> np.ndarray:
    """Return which blocks may be visible, given the ranges of all fields in each."""
    volume = evaluator.volume
    context = RangeContext(volume.unit, volume.expression_unit, faint)
    with np.errstate(all="ignore"):
        seen = evaluator.medium.visible_in(ranges, context)
    return np.broadcast_to(seen, window.shape(volume.grid.shape))


def worthwhile_blocks(
    visible: np.ndarray, backend: Backend, window: Window, steps: np.ndarray | None = None
) -> Blocks | None:
    """Return blocks that rays can skip, or None if few are empty and steps are never wide."""
    if steps is None and np.count_nonzero(visible) > window.worthwhile * visible.size:
        return None
    return make_blocks(visible, backend, steps=steps)


# Fraction of visible leaves above which pruning does not pay: at a tenth, crossing the larger
# surrounding leaves is as fast (half a million leaves, a thin shell: 39 instead of 44 ms).
_WORTHWHILE = 0.05
# Leaves processed at once.
_CHUNK = 1 << 20


def pruned_walk(grid: Grid, visible: np.ndarray, backend: Backend, kind: str) -> Any:
    """Return a walk through the visible leaves, or None if most of them are visible."""
    if np.count_nonzero(visible) > _WORTHWHILE * len(visible):
        return None
    return grid.walk_through(grid.pruned(visible), backend, kind)


def can_be_pruned(evaluator: CellEvaluator) -> bool:
    """Return whether leaves can be pruned, with visibility given by the ranges of their fields."""
    names = evaluator.medium.names
    fields = all(name in evaluator.volume for name in names)
    return bool(evaluator.grid.can_be_pruned) and fields


def tabled(table: Any, faint: float) -> np.ndarray:
    """Return which leaves have coefficients above a fraction of their peak, from a table of all."""
    visible: Any = False
    position = 0
    for data, width in zip(table.packets, table.widths, strict=True):
        numbers = np.asarray(data).reshape(-1, width)
        for k in range(width):
            visible = visible | (np.abs(numbers[:, k]) > faint * table.largest[position + k])
        position += width
    return np.asarray(visible)


def interpolated(
    evaluator: CellEvaluator, octets: dict[str, CornerPackets], faint: float
) -> np.ndarray:
    """Return which leaves may be visible, given the values at their corners."""
    volume = evaluator.volume
    context = RangeContext(volume.unit, volume.expression_unit, faint)
    visible = np.empty(volume.grid.size, bool)
    values = {name: (np.asarray(o.data).reshape(-1, 8), o.unit) for name, o in octets.items()}
    for first in range(0, len(visible), _CHUNK):
        part = slice(first, first + _CHUNK)
        ranges = {name: _range(v[part], unit) for name, (v, unit) in values.items()}
        with np.errstate(all="ignore"):
            visible[part] = evaluator.medium.visible_in(ranges, context)
    return visible


def _range(corners: np.ndarray, unit: float) -> Interval:
    low = corners[:, 0].astype(np.float64)
    high = low.copy()
    for k in range(1, 8):
        np.minimum(low, corners[:, k], out=low)
        np.maximum(high, corners[:, k], out=high)
    return Interval(low * unit, high * unit)


# Coefficients below this fraction of the relevant size are neglected; the error includes a bound of
# them.
_FAINT = 1e-6
# Shells below this fraction of their peak are ignored: less than any rounding error.
_NOTHING = 1e-300


@dataclass
class Neglected:
    """Bounds of the emission per channel and the optical depth that skipping neglects."""

    emission: np.ndarray
    depth: float


def empty_blocks(
    evaluator: CellEvaluator, ranges: dict[str, Interval], tolerance: float
) -> tuple[Any, Neglected]:
    """Return blocks to skip (None if few are empty), and bounds of the neglected coefficients."""
    volume, grid = evaluator.volume, evaluator.grid
    if not grid.has_blocks:
        return None, Neglected(np.zeros(evaluator.medium.channels), 0.0)
    shape = DUAL.shape(grid.shape)
    context = RangeContext(volume.unit, volume.expression_unit, _NOTHING)
    with np.errstate(all="ignore"):
        emission, depth = _largest(evaluator.medium, ranges, context, shape)
    diagonal = float(np.linalg.norm(np.ptp(grid.bounds, axis=1)))
    bright = np.where(np.isfinite(emission), emission, 0.0).max()
    # The brightest pixel may be much fainter than a path across the volume at its brightest place.
    seen = (emission.max(axis=0) > _FAINT**2 * tolerance * bright) | (
        depth * diagonal > _FAINT * tolerance
    )
    blocks = worthwhile_blocks(seen, evaluator.backend, DUAL)
    if blocks is None:
        return None, Neglected(np.zeros(len(emission)), 0.0)
    missed = np.where(seen, 0.0, emission).max(axis=(1, 2, 3)) * diagonal
    return blocks, Neglected(missed, float(np.where(seen, 0.0, depth).max() * diagonal))


def _largest(
    medium: Medium, ranges: dict[str, Interval], context: RangeContext, shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    emission, depth = np.zeros((medium.channels, *shape)), np.zeros(shape)
    for part in medium.components():
        found = part.largest(ranges, context)
        j, alpha = (
            np.array([np.broadcast_to(most, shape) for most in values])
            for values in (found.emissivity, found.extinction)
        )
        emission, depth = emission + j, depth + alpha.max(axis=0)
    return emission, depth


def get_blocks(
    evaluator: CellEvaluator, cache: Cache, faint: float, window: Window, coarseness: float = 0.0
) -> Any:
    """Return the blocks that rays may skip, or None; cached with the volume."""
    medium, backend = evaluator.medium, evaluator.backend
    if not evaluator.grid.has_blocks:
        return None
    limits = difference_limits(evaluator, coarseness)

    def make() -> Any:
        ranges = get_ranges(evaluator, cache, window)
        visible = visible_blocks(evaluator, ranges, faint, window)
        steps = None if limits is None else wide_steps(evaluator, visible, ranges, limits)
        return worthwhile_blocks(visible, backend, window, steps)

    own = medium.visible_key()
    if own is None:
        return make()
    differences = None if limits is None else tuple(limit.key for limit in limits)
    key = (
        "blocks",
        own,
        faint,
        window,
        differences,
        cache.statistics.digests(medium.names),
        backend,
    )
    return cache.get_or_make(key, make)


def get_ranges(evaluator: CellEvaluator, cache: Cache, window: Window) -> dict[str, Interval]:
    """Return the ranges of all fields in and around every block; cached with the volume.

    Without blocks, the ranges in the whole volume.
    """
    names = evaluator.medium.names
    if not evaluator.grid.has_blocks:
        return {name: evaluator.statistics.range_of(name) for name in names}
    return {name: _ranges(evaluator.volume, cache, name, window) for name in names}


def _ranges(volume: Volume, cache: Cache, name: str, window: Window) -> Any:
    if name not in volume:
        return coordinate_ranges(name, volume.grid.edges, window)
    key = ("ranges", name, cache.statistics.digest(name), window)
    return cache.get_or_make(key, lambda: field_ranges(volume.array(name), window))
