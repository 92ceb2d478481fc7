"""No ray leaks from a tree of cells: lengths add up to chords, whatever a ray grazes or hits."""

from __future__ import annotations

import numpy as np
import pytest

from contracts.bundle import box_limits, on_a_sphere
from contracts.grid import make_ray
from test_octree import random_octree
from test_patches import random_patches, tiles
from voluminous.backend import dr, get_backend

GRIDS = {
    "octree": lambda: random_octree(3, 6, 0.25),
    "rectilinear": lambda: random_octree(4, 5, edges=([0, 1, 3], [0, 0.7, 1, 2.5], [-1, 0, 1.3])),
    "patches of ratio 3": lambda: random_patches(6, 3),
    "anisotropic patches": lambda: random_patches(7, [2, 1, 4]),
    "tiles": tiles,
}
COUNT = 20_000


@pytest.fixture(scope="module", params=list(GRIDS))
def grid(request):
    return GRIDS[request.param]()


@pytest.fixture(params=["single", "double"])
def backend(request):
    return get_backend("cpu", request.param)


def measured(grid, backend, origins, directions):
    """Return the sum of the lengths of segments of each ray, the shortest, and their number."""
    walk = grid.walk(backend)
    track, cursor = walk.enter(make_ray(backend, origins, directions))

    def step(cursor, total, least, count):
        segment, cursor = walk.next(track, cursor)
        least = dr.minimum(least, segment.length)
        return cursor, total + backend.Wide(segment.length), least, count + 1

    start = (cursor, backend.Wide(0), backend.Float(1), backend.UInt(0))
    _, total, least, count = dr.while_loop(start, lambda c, *_: c.inside, step)
    return np.asarray(total) * grid.scale, np.asarray(least), np.asarray(count)


def corners_of(grid, rng, count):
    """Return corners of cells, of all levels alike."""
    cell = np.concatenate(
        [
            rng.choice(np.flatnonzero(grid.levels == level), count // len(grid.cells_per_level) + 1)
            for level, cells in enumerate(grid.cells_per_level)
            if cells
        ]
    )
    rng.shuffle(cell)
    low, high = grid.corners()
    upper = rng.random((3, count)) < 0.5
    return np.where(upper, high[:, cell[:count]], low[:, cell[:count]]).T


def random_lines(grid, rng, count):
    aims = rng.uniform(*grid.bounds.T, size=(count, 3))
    return aims, on_a_sphere(count, seed=5)


def through_corners(grid, rng, count):
    """Aim from a corner of a cell at another one, or along a diagonal."""
    aims = corners_of(grid, rng, count)
    towards = corners_of(grid, rng, count) - aims
    diagonal = rng.choice([-1.0, 0.0, 1.0], (count, 3))
    same = (np.abs(towards).max(axis=1) == 0) | (rng.random(count) < 0.3)
    towards[same] = diagonal[same]
    towards[np.abs(towards).max(axis=1) == 0] = [0, 1, 0]
    return aims, towards / np.linalg.norm(towards, axis=1, keepdims=True)


def along_walls(grid, rng, count):
    """Run within a wall, or along an edge."""
    aims, directions = random_lines(grid, rng, count)
    corners = corners_of(grid, rng, count)
    still = rng.random((count, 3)) < 0.5
    still[still.all(axis=1), 0] = False
    aims, directions = np.where(still, corners, aims), np.where(still, 0.0, directions)
    return aims, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def nearly_along_walls(grid, rng, count):
    """Run along inner walls, but for a tilt of any size, and beside them, by any distance.

    Whether a ray along an outer wall is inside may be rounding: such ones have no chord to compare.
    """
    aims, directions = along_walls(grid, rng, 4 * count)
    inner = ((aims > grid.bounds[:, 0]) & (aims < grid.bounds[:, 1])).all(axis=1)
    aims, directions = aims[inner][:count], directions[inner][:count]
    tilt = 10.0 ** rng.uniform(-17, -2, (2, count, 1)) * rng.standard_normal((2, count, 3))
    still = rng.random(count) < 0.5
    aims = aims + np.where(still[:, None], 0.0, tilt[0])
    directions = directions + tilt[1]
    return aims, directions / np.linalg.norm(directions, axis=1, keepdims=True)


@pytest.mark.each_value_once
@pytest.mark.parametrize("lines", [random_lines, through_corners, along_walls, nearly_along_walls])
def test_lengths_add_up_to_the_chord(grid, backend, lines):
    rng = np.random.default_rng(7)
    aims, directions = lines(grid, rng, COUNT)
    diagonal = np.linalg.norm(np.ptp(grid.bounds, axis=1))
    # From the point they aim at, from near it, and from outside.
    origins = aims - rng.choice([0.0, 0.1, 2.0], (COUNT, 1)) * diagonal * directions
    enter, leave = box_limits(grid.bounds, origins, directions)
    total, least, count = measured(grid, backend, origins, directions)
    assert least.min() >= 0
    chord = np.maximum(leave - enter, 0)
    eps = np.finfo(backend.dtype).eps
    slack = 1e-12 if backend.precision == "double" else 4 * eps * count.max()
    np.testing.assert_allclose(total, chord, rtol=0, atol=slack * diagonal)
