"""Consecutive leaves of a tree, and the leaves around them that values at their corners need.

A value at a corner is made of the cells in the eight octants around it and of their slopes, which
need their neighbours. Where the corner lies on a wall of a larger cell (it hangs) it is that of the
larger cell, whose other corners may lie further away (`rendering.sources.vertex_values`).
"""

from __future__ import annotations

import functools
import itertools
from copy import copy
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr, from_host
from ...backend.functions import first_true
from ...backend.types import Float, Int, Mask
from .tree import Cell
from .vertices import OCTANTS, Surroundings

if TYPE_CHECKING:
    from ...backend.device import Backend
    from .cells import TreeCells

# Places that are looked up at once.
_CHUNK = 1 << 16
# What slopes look at beyond a face: its axis, its side, and quarters along both other axes.
_FACES = [
    (axis, up, quarters)
    for axis in range(3)
    for up in (False, True)
    for quarters in itertools.product((1, 3), repeat=2)
]


class LeavesWithGhosts:
    """Leaves from `first` to `last`, numbered from zero, and others, the ghosts, after them.

    It is what `CornerValues` asks of a tree; corner values of the leaves are those of the whole.

    Attributes
    ----------
    ghosts : array of int64
        Numbers of the others in the whole tree, ascending.
    """

    def __init__(self, whole: TreeCells, first: int, last: int) -> None:
        self.whole, self.first, self.own, self.tree = whole, first, last - first, whole.tree
        # Numbers (n,), lower corners and sizes (3, n) of cells.
        surface = whole.surface(first, last)
        corners = self._at_corners(*surface)
        near = (np.concatenate(each, axis=1) for each in zip(surface, corners[1:], strict=True))
        beyond = zip(corners, self._beyond_faces(*near), strict=True)
        found = (np.concatenate(each, axis=-1) for each in beyond)
        self.ghosts, self._low, self._size = _distinct(*found)
        self.size = self.own + len(self.ghosts)

    @functools.cached_property
    def levels(self) -> np.ndarray:
        own = self.whole.levels[self.first : self.first + self.own]
        return np.concatenate([own, self.whole.levels[self.ghosts]])

    @functools.cached_property
    def cells_per_level(self) -> tuple[int, ...]:
        return tuple(np.bincount(self.levels).tolist())

    def boxes(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        begin, end = min(first, self.own), min(last, self.own)
        some = slice(max(first - self.own, 0), max(last - self.own, 0))
        parts = [(self._low[:, some], self._size[:, some])]
        if begin < end:
            parts.insert(0, self.whole.boxes(self.first + begin, self.first + end))
        low, size = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
        return low, size

    def surroundings(self, backend: Backend) -> GhostSurroundings:
        return GhostSurroundings(self, backend)

    def _at_corners(
        self, low: np.ndarray, size: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        known = np.zeros(0, np.int64)  # larger cells whose corners were looked at
        while low.shape[1]:
            corners = [low + np.array(up)[:, None] * size for up in OCTANTS]
            vertex = _distinct_columns(np.concatenate(corners, axis=1))
            larger: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
            for k in range(0, vertex.shape[1], _CHUNK):
                cells, hung = self._around(vertex[:, k : k + _CHUNK])
                found.append(cells)
                larger.append(hung)
            number, low, size = _distinct(
                *(np.concatenate(part, axis=-1) for part in zip(*larger, strict=True))
            )
            new = ~np.isin(number, known)
            known = np.concatenate([known, number[new]])
            low, size = low[:, new], size[:, new]
        if not found:
            nothing = np.zeros((3, 0), np.int64)
            return nothing[0], nothing, nothing
        return _distinct(*(np.concatenate(part, axis=-1) for part in zip(*found, strict=True)))

    def _around(self, vertex: np.ndarray) -> tuple[Any, Any]:
        """Return the other cells around vertices, and those on the walls of which these hang.

        Of several of these the largest counts.
        """
        others, largest = [], np.zeros(vertex.shape[1], np.int64)
        hung = np.full(vertex.shape[1], -1), np.zeros_like(vertex), np.zeros_like(vertex)
        for up in OCTANTS:
            number, low, size = self._find(vertex - 1 + np.array(up)[:, None])
            corner = ((vertex == low) | (vertex == low + size)).all(axis=0)
            larger = (number >= 0) & ~corner & (size.sum(axis=0) > largest)
            largest[larger] = size.sum(axis=0)[larger]
            for kept, new in zip(hung, (number, low, size), strict=True):
                kept[..., larger] = new[..., larger]
            others.append(self._others(number, low, size))
        cells = _distinct(*(np.concatenate(part, axis=-1) for part in zip(*others, strict=True)))
        return cells, self._others(*hung)

    def _beyond_faces(
        self, low: np.ndarray, size: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        found = []
        for axis, up, quarters in _FACES:
            for k in range(0, low.shape[1], _CHUNK):
                part = slice(k, k + _CHUNK)
                place = low[:, part].copy()
                place[axis] += size[axis, part] if up else -1
                for other, quarter in zip({0, 1, 2} - {axis}, quarters, strict=True):
                    place[other] += quarter * size[other, part] // 4
                found.append(_distinct(*self._others(*self._find(place))))
        return _distinct(*(np.concatenate(part, axis=-1) for part in zip(*found, strict=True)))

    def _find(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the cells around places; -1 outside the domain, and in holes."""
        inside = ((place >= 0) & (place < self.tree.extent[:, None])).all(axis=0)
        cells = self.tree.find(np.where(inside, place, 0))
        return np.where(inside, cells.number, -1), cells.low, cells.size

    def _others(
        self, number: np.ndarray, low: np.ndarray, size: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        own = (number >= self.first) & (number < self.first + self.own)
        other = np.flatnonzero((number >= 0) & ~own)
        return number[other], low[:, other], size[:, other]


class GhostSurroundings(Surroundings):
    """Finds cells around vertices among some leaves; others are not there."""

    def __init__(self, leaves: LeavesWithGhosts, backend: Backend) -> None:
        whole = leaves.whole.surroundings(backend)
        vars(self).update(vars(whole))
        UInt = backend.UInt
        self.first, self.own = dr.opaque(UInt, leaves.first), dr.opaque(UInt, leaves.own)
        self.ghosts, self.count = (
            from_host(UInt, leaves.ghosts.astype(np.uint32)),
            len(leaves.ghosts),
        )
        self.backend = backend

    def cell_at(self, place: list[Float], active: Mask) -> tuple[Cell, Mask]:
        cell, there = super().cell_at(place, active)
        UInt = self.backend.UInt
        number = cell.number - self.first
        own = number < self.own
        if self.count:
            other = there & ~own

            def reached(index: Int) -> Mask:
                return dr.gather(UInt, self.ghosts, index, other) >= cell.number

            last = dr.opaque(UInt, self.count - 1)
            index = dr.minimum(first_true(self.count, UInt, reached), last)
            found = other & (dr.gather(UInt, self.ghosts, index, other) == cell.number)
            number = dr.select(own, number, self.own + index)
            own = own | found
        cell = copy(cell)
        cell.number = number
        return cell, there & own


def _distinct(
    number: np.ndarray, low: np.ndarray, size: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    number, index = np.unique(number, return_index=True)
    return number, low[:, index], size[:, index]


def _distinct_columns(vertex: np.ndarray) -> np.ndarray:
    vertex = vertex[:, np.lexsort(vertex)]
    new = np.append(True, (np.diff(vertex, axis=1) != 0).any(axis=0))
    return np.asarray(vertex[:, new[: vertex.shape[1]]])
