"""The octree around particles: split where there are many, or small ones; no loop over cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..grids import OctreeGrid
from ..memory import check_memory
from .base import Base
from .claims import claimed_cells

# The number of a cell of the deepest level but one must fit into 64 bits.
DEEPEST = 20
# Memory for a cell while it is made, and what is deposited in it.
_CELL_BYTES = 200
_ADVICE = "give larger cell_width or lower max_level, or check the units of the particles' sizes"


@dataclass(frozen=True)
class Refinement:
    """When a cell is split.

    Attributes
    ----------
    count : int
        If it holds more particles than this, and is wider than `finest` of one of them,
    finest : array, shape (n,)
        below which nothing is seen;
    widest : array or None, shape (n,)
        or if it is wider than `widest` of a particle that reaches into it.
    reach : array, shape (n,)
        How far particles reach.
    least, most : int
        Levels that there are everywhere, and that there are at most.
    steps : int
        At how many places within its reach a particle is looked at; see `claimed_cells`.
    """

    count: int
    finest: np.ndarray
    widest: np.ndarray | None = None
    reach: np.ndarray | None = None
    least: int = 0
    most: int = DEEPEST
    steps: int = 1


def octree_around(base: Base, points: np.ndarray, rule: Refinement, unit: Any = None) -> OctreeGrid:
    """Return an octree that is fine where particles are.

    Parameters
    ----------
    base : Base
    points : array, shape (n, 3)
        Positions; those outside do not count.
    rule : Refinement
    unit : unit, optional
        Of lengths.
    """
    claimed = [np.empty(0, np.uint64)] * rule.most
    if rule.widest is not None and rule.reach is not None:
        claimed = claimed_cells(base, points, rule.reach, rule.widest, rule.most, rule.steps)
    inside = np.flatnonzero(base.inside(points))
    crowd = _Crowd(base, points[inside], rule.finest[inside], rule.most)
    cells = np.stack(np.unravel_index(np.arange(base.counts.prod()), base.counts, "F"), axis=1)
    splits, width, count = [], float(base.width.max()), len(cells)
    for level in range(rule.most):
        split = crowd.crowded(len(cells), rule.count, width * 0.5**level)
        split |= _among(base.numbers(cells, level), claimed[level]) | (level < rule.least)
        splits.append(split)
        count += 7 * int(np.count_nonzero(split))
        check_memory(_CELL_BYTES * count, f"an octree of {count} cells", _ADVICE)
        crowd.descend(split)
        cells = _children(cells[split])
        if not len(cells):
            break
    else:
        splits.append(np.zeros(len(cells), bool))
    x, y, z = base.edges
    return OctreeGrid.from_levels(x, y, z, _depth_first(splits), unit=unit)


class _Crowd:
    """Particles in the cells of one level after the other; those in leaves stay behind."""

    def __init__(self, base: Base, points: np.ndarray, finest: np.ndarray, levels: int) -> None:
        self.place, self.finest, self.below = base.places(points, levels), finest, levels
        self.cell = base.numbers(self.place >> levels, 0).astype(np.int64)

    def crowded(self, cells: int, count: int, width: float) -> np.ndarray:
        """Return which cells hold more than `count`, one of which is finer than they are wide."""
        many = np.bincount(self.cell, minlength=cells) > count
        fine = np.zeros(cells, bool)
        fine[self.cell[self.finest < width]] = True
        crowded: np.ndarray = many & fine
        return crowded

    def descend(self, split: np.ndarray) -> None:
        deeper, self.below = split[self.cell], self.below - 1
        parent = (np.cumsum(split) - 1)[self.cell[deeper]]
        self.place, self.finest = self.place[deeper], self.finest[deeper]
        self.cell = 8 * parent + ((self.place >> self.below) & 1) @ np.array([1, 2, 4])


def _children(cells: np.ndarray) -> np.ndarray:
    octant = np.arange(8)[:, None] >> np.arange(3) & 1
    return (2 * cells[:, None, :] + octant).reshape(-1, 3)


def _among(numbers: np.ndarray, known: np.ndarray) -> np.ndarray:
    if not len(known):
        return np.zeros(len(numbers), bool)
    place = np.minimum(np.searchsorted(known, numbers), len(known) - 1)
    found: np.ndarray = known[place] == numbers
    return found


def _depth_first(splits: list[np.ndarray]) -> np.ndarray:
    """Return the levels of the leaves in their order, from which nodes of each level are split.

    The nodes of a level are the children, eight by eight, of the split ones of the level above.
    """
    sizes = [np.ones(len(splits[-1]), np.int64)]
    for split in reversed(splits[:-1]):
        size = np.ones(len(split), np.int64)
        size[split] = sizes[-1].reshape(-1, 8).sum(axis=1)
        sizes.append(size)
    levels = np.empty(int(sizes[-1].sum()), np.uint8)
    start = np.cumsum(sizes[-1]) - sizes[-1]
    for level, split in enumerate(splits):
        levels[start[~split]] = level
        if level + 1 < len(splits):
            below = sizes[-2 - level].reshape(-1, 8)
            start = (start[split][:, None] + np.cumsum(below, axis=1) - below).ravel()
    return levels
