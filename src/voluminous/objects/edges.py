"""Edges of boxes on a lattice of whole numbers: those of each, or of all of them as one body."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

# Around an edge are four places for blocks, by their sides along two axes: bits 2 i + j. Two next
# to each other make a face that goes on, four the inside; all else is an edge of the body.
_FACE_ALONG_FIRST, _FACE_ALONG_SECOND = (0b0101, 0b1010), (0b0011, 0b1100)
_FLAT = (*_FACE_ALONG_FIRST, *_FACE_ALONG_SECOND, 0b1111)
_SIDES = ((0, 0), (0, 1), (1, 0), (1, 1))


@dataclass(frozen=True)
class Edges:
    """Edges along the axes of a lattice.

    Attributes
    ----------
    axis : int array, shape (n,)
        Which axis each is along.
    start : int array, shape (n, 3)
        Where it starts.
    stop : int array, shape (n,)
        Where it stops along its axis.
    seam : bool array, shape (n,)
        True for lines drawn on a face that goes on, to show how it curves.
    """

    axis: np.ndarray
    start: np.ndarray
    stop: np.ndarray
    seam: np.ndarray

    @classmethod
    def of(cls, parts: list[tuple[int, np.ndarray, np.ndarray, np.ndarray]]) -> Edges:
        """Return all edges of parts (axis, start, stop, seam)."""
        axis = np.repeat([part[0] for part in parts], [len(part[1]) for part in parts])
        return cls(axis, *(np.concatenate([part[k] for part in parts]) for k in (1, 2, 3)))

    def some(self, index: np.ndarray) -> Edges:
        """Return some of them."""
        return Edges(self.axis[index], self.start[index], self.stop[index], self.seam[index])

    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Return both ends, shape (n, 3) each."""
        last = self.start.copy()
        last[np.arange(len(last)), self.axis] = self.stop
        return self.start, last


def every_edge(low: np.ndarray, high: np.ndarray) -> Edges:
    """Return the twelve edges of each box between corners (n, 3)."""
    corners, parts = (low, high), []
    for axis in range(3):
        for sides in _SIDES:
            start = low.copy()
            for other, side in zip(_others(axis), sides, strict=True):
                start[:, other] = corners[side][:, other]
            parts.append((axis, start, high[:, axis], np.zeros(len(low), bool)))
    return Edges.of(parts)


def creases(
    block: np.ndarray, period: tuple[int, ...] = (0, 0, 0), seams: tuple = ((), (), ())
) -> Edges:
    """Return where the surface of the body that equal blocks make has an edge.

    Parameters
    ----------
    block : int array, shape (n, 3)
        Places of different blocks, in units of their size.
    period : tuple of three int
        After so many blocks an axis closes upon itself; 0 if it does not.
    seams : three sequences of int
        Places along each axis where faces that go on have a line, too.
    """
    parts = []
    for axis in range(3):
        first, second = _others(axis)
        start = np.concatenate([_moved(block, (first, second), sides) for sides in _SIDES])
        for other in (first, second):
            if period[other]:
                start[:, other] %= period[other]
        order, number = same_rows(start)
        bits = np.repeat([1 << k for k in range(4)], len(block))[order]
        around = np.bincount(number, weights=bits).astype(np.int64)
        start = start[order][np.diff(number, prepend=-1) > 0]
        seam = np.isin(start[:, first], seams[first]) & np.isin(around, _FACE_ALONG_FIRST)
        seam |= np.isin(start[:, second], seams[second]) & np.isin(around, _FACE_ALONG_SECOND)
        found = seam | ~np.isin(around, _FLAT)
        parts.append((axis, start[found], start[found, axis] + 1, seam[found]))
    return Edges.of(parts)


def joined(edges: Edges) -> Edges:
    """Return edges with those on one line that touch or overlap made one."""
    line, count = edges.start.copy(), len(edges.axis)
    if not count:
        return edges
    begin = line[np.arange(count), edges.axis]
    line[np.arange(count), edges.axis] = 0
    order, number = same_rows(np.column_stack([edges.axis, line]), begin)
    begin, stop = begin[order], edges.stop[order]
    # The farthest stop on the line so far: ranks, so that lines stay apart.
    values, rank = np.unique(stop, return_inverse=True)
    farthest = np.maximum.accumulate(number * len(values) + rank)
    reached = values[farthest - number * len(values)]
    new = np.diff(number, prepend=-1) > 0
    new[1:] |= begin[1:] > reached[:-1]
    last = np.append(np.flatnonzero(new)[1:], count) - 1
    return replace(edges.some(order[new]), stop=reached[last])


def same_rows(rows: np.ndarray, *then: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return an order that brings equal rows (n, k) together, and their numbers in that order.

    Equal rows are in the order of what is given `then`.
    """
    order = np.lexsort((*then, *rows.T[::-1]))
    apart = np.any(np.diff(rows[order], axis=0) != 0, axis=1)
    return order, np.concatenate([np.zeros(min(1, len(rows)), np.int64), np.cumsum(apart)])


def _others(axis: int) -> tuple[int, int]:
    return ((1, 2), (0, 2), (0, 1))[axis]


def _moved(block: np.ndarray, axes: tuple[int, int], sides: tuple[int, int]) -> np.ndarray:
    start = block.copy()
    start[:, axes] += sides
    return start
