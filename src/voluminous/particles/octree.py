"""Octree around particles, refined where they are many or small, without loops over cells."""

from __future__ import annotations

import itertools
from typing import NamedTuple

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


class Base(NamedTuple):
    """Equal base cells; opposite walls of a periodic domain are identified."""

    bounds: np.ndarray  # (3, 2)
    counts: np.ndarray  # int, (3,)
    periodic: bool = False

    @classmethod
    def around(cls, bounds: np.ndarray) -> Base:
        """Return few cubic base cells that cover the bounds."""
        # A margin, so that rounding does not lose particles at the walls.
        extent = np.ptp(bounds, axis=1) + _MARGIN * np.abs(bounds).max()
        longest = float(extent.max())
        longest = longest if longest > _LEAST else 1.0
        widths = longest / np.arange(1, _BASE_CELLS + 1)[:, None]
        cubes = np.maximum(np.ceil(extent / widths - 1e-9), 1).astype(int)
        filled = np.prod(cubes * widths, axis=1)
        first = int(np.argmax(filled <= _WASTE * filled.min()))
        width, counts = widths[first, 0], cubes[first]
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
        within: np.ndarray = ((points >= low) & (points <= high)).all(axis=1)
        return within

    def wrapped(self, points: np.ndarray) -> np.ndarray:
        """Return points, in a periodic domain mapped into it."""
        if not self.periodic:
            return points
        low, size = self.bounds[:, 0], np.ptp(self.bounds, axis=1)
        wrapped: np.ndarray = low + (points - low) % size
        return wrapped


# The numbers of cells of the last level but one must fit into 64 bits.
DEEPEST = 20
# Memory per cell during construction, deposited values included.
_CELL_BYTES = 200
_ADVICE = "give larger cell_width or lower max_level, or check the units of the particles' sizes"
# Particles per chunk, which limits the temporary arrays.
_CHUNK = 1 << 18


class Refinement(NamedTuple):
    """Criteria for splitting a cell."""

    crowd: int  # it has more particles than this, and is wider than `finest` of one
    finest: np.ndarray  # resolution limit of each particle, (n,)
    widest: np.ndarray | None = None  # it is wider than `widest` of one that reaches into it, (n,)
    reach: np.ndarray | None = None  # radius of each particle, (n,)
    least: int = 0  # minimum level everywhere
    most: int = DEEPEST  # largest level
    steps: int = 1  # divisions per axis of the cube inscribed in a particle's sphere


def octree_around(
    base: Base, points: np.ndarray, rule: Refinement, unit: Unit = None
) -> OctreeGrid:
    """Return an octree that is refined where particles at `points` (n, 3) are.

    Particles outside are ignored.
    """
    claimed = _claimed_cells(base, points, rule)
    inside = base.inside(points)
    # Each particle's cell: place on the finest level, and index among the cells of a level.
    place, finest = base.places(points[inside], rule.most), rule.finest[inside]
    number = base.numbers(place >> rule.most, 0).astype(np.int64)
    cells = np.stack(np.unravel_index(np.arange(base.counts.prod()), base.counts, "F"), axis=1)
    splits, width, count = [], float(base.width.max()), len(cells)
    for level in range(rule.most):
        fine = np.zeros(len(cells), bool)
        fine[number[finest < width * 0.5**level]] = True
        split = fine & (np.bincount(number, minlength=len(cells)) > rule.crowd)
        split |= np.isin(base.numbers(cells, level), claimed[level]) | (level < rule.least)
        splits.append(split)
        count += 7 * int(np.count_nonzero(split))
        check_memory(_CELL_BYTES * count, f"an octree of {count} cells", _ADVICE)
        deeper, parent = split[number], (np.cumsum(split) - 1)[number]
        place, finest = place[deeper], finest[deeper]
        octant = (place >> (rule.most - level - 1)) & 1
        number = 8 * parent[deeper] + octant @ np.array([1, 2, 4])
        children = np.arange(8)[:, None] >> np.arange(3) & 1
        cells = (2 * cells[split][:, None, :] + children).reshape(-1, 3)
        if not len(cells):
            break
    else:
        splits.append(np.zeros(len(cells), bool))
    x, y, z = base.edges
    return OctreeGrid.from_levels(x, y, z, _depth_first(splits), unit=unit)


def _claimed_cells(base: Base, points: np.ndarray, rule: Refinement) -> list[np.ndarray]:
    """Return for each level the ascending numbers of the cells that are too wide for a particle.

    A particle limits the cell width at its centre and at the corners of the inscribed cube. Without
    the corners, wide cells beside fine ones lie in many kernels, and interpolation smears these out
    (columns of an SPH disc: 11 % too much, with corners 0.5 %). With smaller cells, places in
    between are added.
    """
    claimed: list[list[np.ndarray]] = [[np.empty(0, np.uint64)] for _ in range(rule.most)]
    if rule.widest is not None and rule.reach is not None:
        ticks = np.linspace(-(3**-0.5), 3**-0.5, rule.steps + 1)
        offsets = [np.zeros(3), *map(np.array, itertools.product(ticks, repeat=3))]
        wanted = np.ceil(np.log2(base.width.max() / rule.widest) - 1e-9)
        level = np.clip(wanted, 0, rule.most).astype(np.int64) - 1
        for first in reported_range(len(points), _CHUNK):
            part = slice(first, first + _CHUNK)
            for offset in offsets:
                near = base.wrapped(points[part] + rule.reach[part, None] * offset)
                here = np.flatnonzero(base.inside(near) & (level[part] >= 0))
                cell_level = level[part][here]
                cells = base.places(near[here], rule.most) >> (rule.most - cell_level)[:, None]
                numbers = base.numbers(cells, cell_level)
                for k in np.unique(cell_level):
                    claimed[k].append(np.unique(numbers[cell_level == k]))
    result = [np.unique(np.concatenate(numbers)) for numbers in claimed]
    for k in range(rule.most - 1, 0, -1):
        nx, ny, _ = (np.uint64(n) << np.uint64(k) for n in base.counts)
        rows, x = np.divmod(result[k], nx)
        z, y = np.divmod(rows, ny)
        parents = base.numbers(np.stack([x, y, z], axis=1) >> np.uint64(1), k - 1)
        result[k - 1] = np.unique(np.concatenate([result[k - 1], parents]))
    return result


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
