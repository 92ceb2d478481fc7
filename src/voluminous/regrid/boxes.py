"""Which parts of space two sets of boxes share, exactly: for grids whose cells are boxes.

A box that is not inside one cell of the other grid is cut along the walls of the cell that its
centre is in: the part inside is done, and up to six smaller boxes are left over and treated alike.
All boxes are cut at once, so the number of rounds is what counts, and that grows with the logarithm
of the number of cells that a box overlaps.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..progress import reported_range

# Boxes cut at once.
_CHUNK = 1 << 18
# Of a cell's width: thinner slices are what rounding makes of walls that coincide.
_SLIVER = 1e-13
# Rounding of a wall's place, in units of it.
_ROUNDING = 8 * np.finfo(np.float64).eps
# How often a box is halved whose middle is in a hole of the other grid.
_HALVINGS = 12

Overlap = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass
class Boxes:
    """Boxes that wait for being cut: whose they are, corners (3, n), what is too thin, halvings."""

    owner: np.ndarray
    low: np.ndarray
    high: np.ndarray
    thin: np.ndarray
    halved: np.ndarray

    def chosen(self, which: Any) -> Boxes:
        """Return some of them."""
        return Boxes(
            self.owner[which],
            self.low[:, which],
            self.high[:, which],
            self.thin[:, which],
            self.halved[which],
        )

    def between(self, axis: int, low: np.ndarray, high: np.ndarray) -> Boxes:
        """Return what lies between coordinates along an axis, where that is not too thin."""
        new = replace(self, low=self.low.copy(), high=self.high.copy())
        new.low[axis], new.high[axis] = low, high
        return new.chosen(high - low > self.thin[axis])


def overlaps(cells: Any, others: Any) -> Iterator[Overlap]:
    """Yield what cells of one grid share with the cells of another.

    Parameters
    ----------
    cells, others : grids
        Both with cells that are boxes along x, y and z.

    Yields
    ------
    cell, other : int arrays, shape (n,)
        Flat numbers.
    volume : array, shape (n,)
        Of what they share. A pair may come more than once.
    """
    centers, half = others.cell_centers(0, others.size), 0.5 * others.cell_sizes(0, others.size)
    for first in reported_range(cells.size, _CHUNK):
        waiting = [_clipped(_boxes(cells, first, min(first + _CHUNK, cells.size)), others.bounds)]
        while waiting:
            boxes = waiting.pop()
            for start in range(0, len(boxes.owner), _CHUNK):
                part = boxes.chosen(slice(start, start + _CHUNK))
                other = others.locate(np.ascontiguousarray((0.5 * (part.low + part.high)).T))
                waiting += _halves(part.chosen((other < 0) & (part.halved < _HALVINGS)))
                part, other = part.chosen(other >= 0), other[other >= 0]
                floor = np.maximum(part.low, centers[:, other] - half[:, other])
                ceiling = np.minimum(part.high, centers[:, other] + half[:, other])
                yield part.owner, other, np.prod(ceiling - floor, axis=0)
                waiting += _left_over(part, floor, ceiling)


def _boxes(cells: Any, first: int, last: int) -> Boxes:
    middle, half = cells.cell_centers(first, last), 0.5 * cells.cell_sizes(first, last)
    rounding = _ROUNDING * np.max(np.abs(cells.bounds), axis=1)[:, None]
    thin = np.maximum(2 * _SLIVER * half, rounding)
    owner = np.arange(first, last)
    return Boxes(owner, middle - half, middle + half, thin, np.zeros(last - first, int))


def _clipped(boxes: Boxes, bounds: np.ndarray) -> Boxes:
    for axis in range(3):
        low = np.maximum(boxes.low[axis], bounds[axis, 0])
        boxes = boxes.between(axis, low, np.minimum(boxes.high[axis], bounds[axis, 1]))
    return boxes


def _left_over(boxes: Boxes, floor: np.ndarray, ceiling: np.ndarray) -> list[Boxes]:
    """Return what there is of boxes around their parts between floor and ceiling."""
    found = []
    for axis in range(3):
        found.append(boxes.between(axis, boxes.low[axis], floor[axis]))
        found.append(boxes.between(axis, ceiling[axis], boxes.high[axis]))
        boxes = replace(boxes, low=boxes.low.copy(), high=boxes.high.copy())
        boxes.low[axis], boxes.high[axis] = floor[axis], ceiling[axis]
    found = [boxes for boxes in found if len(boxes.owner)]
    return [_joined(found)] if found else []


def _halves(boxes: Boxes) -> list[Boxes]:
    """Return both halves of boxes, along their longest axes compared with what is too thin."""
    if not len(boxes.owner):
        return []
    width = boxes.high - boxes.low
    long = np.argmax(width, axis=0)
    middle = 0.5 * (boxes.low + boxes.high)
    cut = np.arange(3)[:, None] == long
    halved = boxes.halved + 1
    lower = replace(boxes, high=np.where(cut, middle, boxes.high), halved=halved)
    upper = replace(boxes, low=np.where(cut, middle, boxes.low), halved=halved)
    return [lower, upper]


def _joined(parts: list[Boxes]) -> Boxes:
    return Boxes(
        np.concatenate([p.owner for p in parts]),
        np.concatenate([p.low for p in parts], axis=1),
        np.concatenate([p.high for p in parts], axis=1),
        np.concatenate([p.thin for p in parts], axis=1),
        np.concatenate([p.halved for p in parts]),
    )
