"""Refined grids in parts of consecutive cells, and the order in which rays come to them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..contract import BoxGrid, Grid, native_centers

if TYPE_CHECKING:
    from .octree import OctreeGrid
    from .patches import PatchGrid


@dataclass(frozen=True)
class Parts:
    """Parts of a grid of consecutive cells, in the order of these.

    Attributes
    ----------
    ends : array of int64, shape (n + 1,)
        Number of the first cell of each part, and of all cells.
    low, high : float64 arrays, shape (n, 3)
        Corners of boxes that hold all cells of a part, in the grid's unit.
    """

    ends: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def front_to_back(self, origin: np.ndarray, direction: np.ndarray | None) -> np.ndarray:
        """Return the numbers of the parts in the order in which rays come to them.

        Planes that cut none of the boxes tell, one after another, which are in front (Fuchs et al.
        1980). Where there is none, boxes are sorted by their distance: rays may come to one of
        them again after another.

        Parameters
        ----------
        origin : array, shape (3,)
            Where rays begin.
        direction : array, shape (3,), optional
            Of parallel rays, which begin far away.
        """
        order: list[np.ndarray] = []
        left = [np.arange(len(self.low))]
        while left:
            some = left.pop()
            cut = self._plane(some) if len(some) > 1 else None
            if cut is None:
                order.append(some[np.argsort(self._depth(some, origin, direction))])
                continue
            axis, place = cut
            below = self.high[some, axis] <= place
            upwards = origin[axis] < place if direction is None else direction[axis] >= 0
            near, far = some[below == upwards], some[below != upwards]
            left += [far, near]
        return np.concatenate(order)

    def _plane(self, some: np.ndarray) -> tuple[int, float] | None:
        best, found = 0, None
        for axis in range(3):
            order = np.argsort(self.low[some, axis], kind="stable")
            low = self.low[some[order], axis]
            reached = np.maximum.accumulate(self.high[some[order], axis])
            for k in (np.flatnonzero(reached[:-1] <= low[1:]) + 1).tolist():
                if min(k, len(some) - k) > best:
                    best, found = min(k, len(some) - k), (axis, float(low[k]))
        return found

    def _depth(
        self, some: np.ndarray, origin: np.ndarray, direction: np.ndarray | None
    ) -> np.ndarray:
        middle = 0.5 * (self.low[some] + self.high[some])
        if direction is not None:
            return np.asarray(middle @ direction)
        return np.asarray(np.linalg.norm(middle - origin, axis=1))


def parts_of_octree(grid: OctreeGrid, most: int) -> Parts:
    """Return boxes of consecutive leaves: halves of halves of the domain, see `TreeCells.parts`."""
    aligned, finest = grid.places.aligned_levels(), 1 << grid.places.deepest
    found: list[tuple[int, np.ndarray, np.ndarray]] = []

    def halves(
        starts: np.ndarray, shape: tuple[int, ...], low: np.ndarray, size: int, level: int
    ) -> None:
        """Cut a block of nodes, whose leaves begin at `starts`, with x fastest."""
        blocks = [(np.zeros(3, np.int64), np.array(shape))]
        while blocks:
            a, b = blocks.pop()
            first, last = (int(n[0] + shape[0] * (n[1] + shape[1] * n[2])) for n in (a, b - 1))
            begin, end = int(starts[first]), int(starts[last + 1])
            if end - begin <= most or (end - begin == 1):
                found.append((begin, low + a * size, low + b * size))
            elif first == last:
                below = begin + np.flatnonzero(aligned[begin:end] <= level + 1)
                halves(np.append(below, end), (2, 2, 2), low + a * size, size >> 1, level + 1)
            else:
                # Blocks are of whole rows, and of whole planes: consecutive.
                axis = int(np.flatnonzero(b - a > 1)[-1])
                middle = (a[axis] + b[axis]) // 2
                upper, lower = a.copy(), b.copy()
                upper[axis] = lower[axis] = middle
                blocks += [(upper, b), (a, lower)]

    starts = np.append(np.flatnonzero(aligned == 0), grid.size)
    halves(starts, grid.base_shape, np.zeros(3, np.int64), finest, 0)
    begins, low, high = (np.array(column) for column in zip(*found, strict=True))
    return Parts(np.append(begins, grid.size), grid.position(low.T).T, grid.position(high.T).T)


def parts_of_patches(grid: PatchGrid, most: int) -> Parts:
    """Return consecutive patches together, and large ones in pieces; see `TreeCells.parts`."""
    patches = grid.patches
    ends = [0, *_together(patches.ends, most), grid.size]
    corners, boxes = patches.corners, []
    for first, last in itertools.pairwise(ends):
        a, b = np.searchsorted(patches.ends, [first, last - 1], side="right")
        if a == b:  # within a patch
            _, index = patches.indices(first, last)
            size = patches.sizes[patches.level[a]]
            low = (patches.low[a] + index.min(axis=1)) * size
            high = (patches.low[a] + index.max(axis=1) + 1) * size
        else:
            seen = np.arange(a, b + 1)[patches.visible[a : b + 1] > 0]
            low, high = corners[0][seen].min(axis=0), corners[1][seen].max(axis=0)
        boxes.append((low, high))
    low, high = (np.array(column).T for column in zip(*boxes, strict=True))
    return Parts(np.array(ends), grid.position(low).T, grid.position(high).T)


def _together(ends: np.ndarray, most: int) -> Iterator[int]:
    """Yield where parts begin, all but the first: between patches, or within large ones."""
    total, begin = int(ends[-1]), 0
    while total - begin > most:
        # The last patch that ends within reach, or else as far as that goes.
        last = int(np.searchsorted(ends, begin + most, side="right"))
        reached = int(ends[last - 1]) if last else 0
        begin = reached if reached > begin else begin + most
        yield begin


class SomeCells(BoxGrid):
    """The cells from `first` to `last` of a grid. It is not walked through: `whole` is.

    Parameters
    ----------
    whole : Grid
    first, last : int
        Numbers of the first cell, and of the one after the last.
    """

    kind = "cells"
    size, shape, scale = 0, (0,), 1.0

    def __init__(self, whole: Grid, first: int, last: int) -> None:
        self.whole, self.first = whole, first
        self.size, self.shape = last - first, (last - first,)
        self.unit, self.scale, self.coordinates = whole.unit, whole.scale, whole.coordinates
        self.mirror = whole.mirror

    def cell_centers(self, first: int = 0, last: int | None = None) -> np.ndarray:
        return self.whole.cell_centers(*self._numbers(first, last))

    def native_centers(self, first: int = 0, last: int | None = None) -> np.ndarray:
        return native_centers(self.whole, *self._numbers(first, last))

    def cell_sizes(self, first: int = 0, last: int | None = None) -> np.ndarray:
        return self.whole.cell_sizes(*self._numbers(first, last))

    @property
    def cell_volumes(self) -> np.ndarray:
        """Volumes of the cells, of octrees and patches."""
        return np.asarray(np.prod(self.cell_sizes(), axis=0))

    def _numbers(self, first: int, last: int | None) -> tuple[int, int]:
        return self.first + first, self.first + (self.size if last is None else last)
