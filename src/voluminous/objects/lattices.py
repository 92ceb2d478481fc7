"""Where the boxes of a grid's levels are: whole numbers, and the coordinates they stand for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..geometry import CARTESIAN, CYLINDRICAL, SPHERICAL
from ..grids.boxes import expanded

# Leaves looked at at once.
_CHUNK = 1 << 20
_ROUNDING = 1e-9
_QUARTERS = 4
# The domain as a single block.
_ONE = np.zeros((1, 3), np.int64)


@dataclass
class Lattice:
    """Blocks of one size that fill a part of a grid, and the boxes that it is made of.

    Attributes
    ----------
    own : callable
        Whole numbers, (3, n), → the grid's own coordinates.
    block : int array, shape (n, 3)
        Places of the blocks, in units of their size.
    size : int array, shape (3,)
        Size of a block in the whole numbers of `own`.
    boxes : pair of int arrays, shape (m, 3), optional
        Corners of the boxes, in the same; None where there is but the domain.
    system : tuple of str
        Names of the own coordinates.
    period : tuple of three int
        After how many blocks an axis closes upon itself; 0 if it does not.
    seams : tuple of three sequences of int
        Blocks before which there is a line on surfaces that go on.
    """

    own: Callable[[np.ndarray], np.ndarray]
    block: np.ndarray
    size: np.ndarray
    boxes: tuple[np.ndarray, np.ndarray] | None = None
    system: tuple[str, ...] = CARTESIAN
    period: tuple[int, ...] = (0, 0, 0)
    seams: tuple[Any, ...] = ((), (), ())


def level_count(grid: Any) -> int:
    """Return how many levels a grid has; level 0 is the domain."""
    if grid.patches is not None:
        return int(grid.patches.level.max()) + 1
    return 1 if grid.places is None else int(grid.places.deepest) + 1


def lattice_of(grid: Any, level: int) -> Lattice:
    """Return what is refined `level` times or more; of level 0 the domain, and its patches."""
    if grid.patches is not None:
        return _of_patches(grid, level)
    if level == 0:
        curved = grid.coordinates in (SPHERICAL, CYLINDRICAL)
        return replace(_bent(grid, _ends(grid), _ONE), boxes=None) if curved else _of_bounds(grid)
    nodes, size = _nodes(grid, level - 1)
    if grid.base_edges:
        corners = (nodes * size, (nodes + 1) * size)
        return Lattice(grid.position, nodes, size, corners)
    walls = [e[::step] for e, step in zip(grid.fine_edges, size, strict=True)]
    return _bent(grid, walls, nodes)


def _of_bounds(grid: Any) -> Lattice:
    return Lattice(_between(list(grid.bounds)), _ONE, np.ones(3, np.int64))


def _between(walls: list[np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    return lambda place: np.stack([w[k] for w, k in zip(walls, place, strict=True)])


def _of_patches(grid: Any, level: int) -> Lattice:
    """Return the patches of a level, and what they and finer ones cover in blocks."""
    patches = grid.patches
    low, high = patches.corners
    boxes = tuple(corner[patches.level == level] for corner in (low, high))
    if level == 0:
        boxes = (np.vstack([0 * grid.extent, boxes[0]]), np.vstack([grid.extent, boxes[1]]))
    cell, some = patches.sizes[level], patches.level >= level
    first, last = low[some] // cell, -(-high[some] // cell)
    common = np.gcd.reduce(np.concatenate([first, last]), axis=0)
    _, index = expanded(first // common, last // common)
    block = np.unique(index, axis=1).T
    return Lattice(lambda place: grid.position(place), block, cell * common, boxes)


def _nodes(grid: Any, level: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes of a level that are refined, counted in their own size, and that size."""
    size = np.array(grid.divisions)
    size[list(grid.places.axes)] >>= level
    # The first leaf in each of them: finer than it, and where it begins.
    first = (grid.places.aligned_levels() <= level) & (grid.levels > level)
    found = [np.empty((3, 0), np.int64)]
    for begin in range(0, grid.size, _CHUNK):
        chosen = np.flatnonzero(first[begin : begin + _CHUNK])
        if chosen.size:
            low, _ = grid.boxes(begin, min(begin + _CHUNK, grid.size))
            found.append(low[:, chosen] // size[:, None])
    return np.concatenate(found, axis=1).T, size


def _ends(grid: Any) -> list[np.ndarray]:
    return [np.array(_limits(e)) for e in grid.edges]


def _limits(walls: np.ndarray) -> tuple[float, float]:
    return float(walls[0]), float(walls[-1])


def _bent(grid: Any, walls: list[np.ndarray], block: np.ndarray) -> Lattice:
    """Return blocks between walls of r, θ, φ or R, φ, z; a mirror shows them twice.

    An azimuth that is one closed block is cut in quarters, and θ above and below the midplane in
    two: there would be no line to be seen of a sphere.
    """
    phi = grid.coordinates.index("phi")
    walls, block = list(walls), np.asarray(block)
    if "theta" in grid.coordinates:
        walls[1], block = _both_halves(grid, walls[1], block)
    if grid.is_periodic and len(walls[phi]) == 2:
        walls[phi], block = _cut(np.linspace(*_limits(walls[phi]), _QUARTERS + 1), block, phi)
    counts = [len(w) - 1 for w in walls]
    period, seams = [0, 0, 0], [np.array([], int) for _ in range(3)]
    if grid.is_periodic:
        period[phi] = counts[phi]
        seams[phi] = np.unique(np.round(np.arange(_QUARTERS) * counts[phi] / _QUARTERS)).astype(int)
    if "theta" in grid.coordinates:
        seams[1] = np.flatnonzero(np.abs(walls[1] - 0.5 * np.pi) < _ROUNDING)
    size = np.ones(3, np.int64)
    boxes = (block, block + 1)
    return Lattice(
        _between(walls), block, size, boxes, grid.coordinates, tuple(period), tuple(seams)
    )


def _both_halves(grid: Any, walls: np.ndarray, block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if grid.mirror:
        below = block.copy()
        below[:, 1] = 2 * (len(walls) - 1) - 1 - block[:, 1]
        return np.concatenate([walls, np.pi - walls[-2::-1]]), np.concatenate([block, below])
    middle = 0.5 * np.pi
    if len(walls) == 2 and walls[0] < middle < walls[1]:
        return _cut(np.array([walls[0], middle, walls[1]]), block, 1)
    return walls, block


def _cut(walls: np.ndarray, block: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Return walls, and blocks that fill an axis of one block so far with all of them."""
    parts = np.repeat(block[None], len(walls) - 1, axis=0)
    parts[:, :, axis] = np.arange(len(walls) - 1)[:, None]
    return walls, parts.reshape(-1, 3)
