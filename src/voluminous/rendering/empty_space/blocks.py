"""Which blocks of a volume show nothing, so that rays need not look into them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...expressions.interval import Interval
from ...grids.cartesian.leap import BITS, Blocks, block_shape, make_blocks
from ...media.ranges import RangeContext
from ..coefficients.classify import Classifier

_WIDTH = 1 << BITS


@dataclass(frozen=True)
class Window:
    """Which cells matter in a block of 2^bits steps of a walk, along each axis.

    Attributes
    ----------
    before, after : int
        How many cells before the first and after the last of the block's own number.
    extra : int
        How many more steps than cells a walk may take.
    worthwhile : float
        The part of all blocks that may be filled for leaping to pay: it costs as much as crossing
        some cells does (first and second order: nothing won at a third, 3 times as fast at 1/20).
    """

    before: int
    after: int
    extra: int
    worthwhile: float

    def count(self, cells: int) -> int:
        """Return the number of blocks along an axis of so many cells."""
        return block_shape([cells + self.extra])[0]

    def shape(self, cells: Any) -> tuple[int, ...]:
        """Return the number of blocks along each axis."""
        return tuple(self.count(n) for n in cells)


# Dual cell i lies between the centres of cells i - 1 and i, and there is one more than cells.
DUAL = Window(before=1, after=0, extra=1, worthwhile=0.7)
# Coefficients at the vertices of a cell are means over its neighbours.
CELLS = Window(before=1, after=1, extra=0, worthwhile=0.25)


def field_ranges(array: np.ndarray, window: Window) -> Interval:
    """Return the values that a field has in and around each block; all where there is NaN."""
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
    """Return the values of a coordinate in and around each block."""
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
    classifier: Classifier, ranges: dict[str, Interval], faint: float, window: Window
) -> np.ndarray:
    """Return which blocks may show something, given the ranges of all fields in each."""
    volume = classifier.volume
    context = RangeContext(volume.unit, volume.expression_unit, faint)
    with np.errstate(all="ignore"):
        seen = classifier.medium.visible_in(ranges, context)
    return np.broadcast_to(seen, window.shape(volume.grid.shape))


def worthwhile_blocks(
    visible: np.ndarray, backend: Any, window: Window, steps: np.ndarray | None = None
) -> Blocks | None:
    """Return blocks for rays to leap over, or None if few are empty and steps are never wide."""
    if steps is None and np.count_nonzero(visible) > window.worthwhile * visible.size:
        return None
    return make_blocks(visible, backend, steps=steps)
