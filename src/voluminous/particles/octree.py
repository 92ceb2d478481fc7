"""Octree around particles, refined where they are many or small, without loops over cells."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..grids import OctreeGrid
from ..memory import check_memory
from ..progress import reported_range
from ..units import Unit

# Most base cells along the longest axis: kernels search all base cells.
_BASE_CELLS = 8
# The domain's volume may grow by this factor to reduce the number of base cells.
_WASTE = 1.1
_MARGIN = 1e-12
# Particles within a smaller extent count as one place: cubes of smaller lengths may underflow.
_LEAST = 1e-90


@dataclass(frozen=True)
class Base:
    """Equal base cells.

    Attributes
    ----------
    bounds : array, shape (3, 2)
    counts : array of int, shape (3,)
    periodic : bool
        Whether opposite walls are identified.
    """

    bounds: np.ndarray
    counts: np.ndarray
    periodic: bool = False

    @classmethod
    def around(cls, bounds: np.ndarray) -> Base:
        """Return few cubic base cells that cover the bounds."""
        # A margin, so that rounding does not lose particles at the walls.
        extent = np.ptp(bounds, axis=1) + _MARGIN * np.abs(bounds).max()
        longest = float(extent.max())
        longest = longest if longest > _LEAST else 1.0
        choices = [longest / n for n in range(1, _BASE_CELLS + 1)]
        filled = [np.prod(_cubes(extent, width) * width) for width in choices]
        width = next(w for w, f in zip(choices, filled, strict=True) if f <= _WASTE * min(filled))
        counts = _cubes(extent, width)
        middle = bounds.mean(axis=1)[:, None]
        return cls(middle + 0.5 * width * counts[:, None] * np.array([-1.0, 1.0]), counts)

    @classmethod
    def within(cls, bounds: np.ndarray, periodic: bool = False) -> Base:
        """Return nearly cubic base cells that fill the bounds exactly."""
        extent = np.ptp(bounds, axis=1)
        width = max(extent.min(), extent.max() / _BASE_CELLS)
        counts = np.maximum(np.rint(extent / width), 1).astype(int)
        return cls(bounds, counts, periodic)

    @property
    def edges(self) -> list[np.ndarray]:
        pairs = zip(self.bounds, self.counts, strict=True)
        return [np.linspace(low, high, n + 1) for (low, high), n in pairs]

    @property
    def width(self) -> np.ndarray:
        """Widths of the base cells along each axis, shape (3,)."""
        width: np.ndarray = np.ptp(self.bounds, axis=1) / self.counts
        return width

    def places(self, points: np.ndarray, level: int) -> np.ndarray:
        """Return the cells (n, 3) of a level, int64, that contain points (n, 3)."""
        cells = self.counts << level
        place = np.floor((points - self.bounds[:, 0]) * (cells / np.ptp(self.bounds, axis=1)))
        clipped: np.ndarray = np.clip(place, 0, cells - 1).astype(np.int64)
        return clipped

    def numbers(self, cells: np.ndarray, level: int | np.ndarray) -> np.ndarray:
        """Return the flat numbers, uint64, of cells (n, 3) of a level."""
        x, y, z = cells.astype(np.uint64).T
        nx, ny, _ = (np.uint64(n) << np.asarray(level, np.uint64) for n in self.counts)
        numbers: np.ndarray = x + nx * (y + ny * z)
        return numbers

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Return whether points (n, 3) are within the bounds."""
        low, high = self.bounds.T
        return ((points >= low) & (points <= high)).all(axis=1)

    def wrapped(self, points: np.ndarray) -> np.ndarray:
        """Return points, in a periodic domain mapped into it."""
        if not self.periodic:
            return points
        low, size = self.bounds[:, 0], np.ptp(self.bounds, axis=1)
        return low + (points - low) % size


def _cubes(extent: np.ndarray, width: float) -> np.ndarray:
    return np.maximum(np.ceil(extent / width - 1e-9), 1).astype(int)


# Particles per chunk, which limits the temporary arrays.
_CHUNK = 1 << 18


def claimed_cells(
    base: Base,
    points: np.ndarray,
    reach: np.ndarray,
    widest: np.ndarray,
    most: int,
    steps: int = 1,
) -> list[np.ndarray]:
    """Return for each level the ascending numbers of the cells to split.

    Parameters
    ----------
    base : Base
    points : array, shape (n, 3)
    reach, widest : array, shape (n,)
        Radius of each particle, and the largest cell width allowed within it.
    most : int
        Largest number of levels.
    steps : int
        Divisions per axis of the cube inscribed in a particle's sphere: the cell width is limited
        at their corners.
    """
    offsets = _offsets(steps)
    found: list[list[np.ndarray]] = [[np.empty(0, np.uint64)] for _ in range(most)]
    for first in reported_range(len(points), _CHUNK):
        part = slice(first, first + _CHUNK)
        for level, numbers in _claims(base, points[part], reach[part], widest[part], most, offsets):
            found[level].append(numbers)
    claimed = [np.unique(np.concatenate(numbers)) for numbers in found]
    for level in range(most - 1, 0, -1):
        parents = _parents(base, claimed[level], level)
        claimed[level - 1] = np.unique(np.concatenate([claimed[level - 1], parents]))
    return claimed


def _offsets(steps: int) -> np.ndarray:
    """Return the places where a particle limits the cell width, in radii from its centre.

    They are its centre and the corners of the inscribed cube. Without the corners, wide cells
    beside fine ones lie in many kernels, and interpolation smears these out (columns of an SPH
    disc: 11 % too much, with corners 0.5 %). With smaller cells, places in between are added.
    """
    ticks = np.linspace(-(3**-0.5), 3**-0.5, steps + 1)
    corners = np.array(list(itertools.product(ticks, repeat=3)))
    return np.concatenate([np.zeros((1, 3)), corners])


def _claims(
    base: Base,
    points: np.ndarray,
    reach: np.ndarray,
    widest: np.ndarray,
    most: int,
    offsets: np.ndarray,
) -> Iterator[tuple[int, np.ndarray]]:
    wanted = np.ceil(np.log2(base.width.max() / widest) - 1e-9)
    level = np.clip(wanted, 0, most).astype(np.int64) - 1
    for offset in offsets:
        near = base.wrapped(points + reach[:, None] * offset)
        here = np.flatnonzero(base.inside(near) & (level >= 0))
        cells = base.places(near[here], most) >> (most - level[here])[:, None]
        numbers = base.numbers(cells, level[here])
        for own in np.unique(level[here]):
            yield int(own), np.unique(numbers[level[here] == own])


def _parents(base: Base, numbers: np.ndarray, level: int) -> np.ndarray:
    nx, ny, _ = (np.uint64(n) << np.uint64(level) for n in base.counts)
    rows, x = np.divmod(numbers, nx)
    z, y = np.divmod(rows, ny)
    return np.unique(base.numbers(np.stack([x, y, z], axis=1) >> np.uint64(1), level - 1))


# The numbers of cells of the last level but one must fit into 64 bits.
DEEPEST = 20
# Memory per cell during construction, deposited values included.
_CELL_BYTES = 200
_ADVICE = "give larger cell_width or lower max_level, or check the units of the particles' sizes"


@dataclass(frozen=True)
class Refinement:
    """Criteria for splitting a cell.

    Attributes
    ----------
    count : int
        A cell is split if it holds more particles than this and is wider than `finest` of one.
    finest : array, shape (n,)
        Resolution limit of each particle.
    widest : array or None, shape (n,)
        A cell is split if it is wider than `widest` of a particle that reaches into it.
    reach : array, shape (n,)
        Radius of each particle.
    least, most : int
        Minimum level everywhere, and largest level.
    steps : int
        Divisions of each particle's inscribed cube; see `claimed_cells`.
    """

    count: int
    finest: np.ndarray
    widest: np.ndarray | None = None
    reach: np.ndarray | None = None
    least: int = 0
    most: int = DEEPEST
    steps: int = 1


def octree_around(
    base: Base, points: np.ndarray, rule: Refinement, unit: Unit = None
) -> OctreeGrid:
    """Return an octree that is refined where particles are.

    Parameters
    ----------
    base : Base
    points : array, shape (n, 3)
        Positions; particles outside are ignored.
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
    """Assigns particles to the cells of one level after the other, and drops those in leaves."""

    def __init__(self, base: Base, points: np.ndarray, finest: np.ndarray, levels: int) -> None:
        self.place, self.finest, self.below = base.places(points, levels), finest, levels
        self.cell = base.numbers(self.place >> levels, 0).astype(np.int64)

    def crowded(self, cells: int, count: int, width: float) -> np.ndarray:
        """Return which cells hold over `count` particles, one with `finest` below the width."""
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
    """Return the levels of the leaves in depth-first order.

    `splits` marks the split nodes of each level. The nodes of a level are the children, in groups
    of eight, of the split nodes of the level above.
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
