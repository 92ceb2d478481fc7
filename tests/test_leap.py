"""Rays that leap over empty bricks see all that is not empty."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import voluminous as vm
from contracts.bundle import on_a_sphere
from contracts.grid import make_ray, walk_along
from voluminous.backend import dr, get_backend
from voluminous.grids.cartesian.leap import (
    BITS,
    BrickRays,
    brick_shape,
    empty_ahead,
    make_bricks,
)

RAYS = 64
numbers = st.integers(0, 2**32 - 1)


SIZES = np.array([0, 1, 2, 3, 4, 6, 8, 12, 15])


def brute_ahead(filled, down):
    """Return how many bricks are empty along all axes from each on, of the sizes told apart."""
    sense = [-1 if d else 1 for d in down]
    turned = filled[tuple(slice(None, None, s) for s in sense)]
    found = np.zeros(filled.shape, int)
    for place in np.ndindex(*filled.shape):
        for size in SIZES[1:]:
            if turned[tuple(slice(i, i + size) for i in place)].any():
                break
            found[place] = size
    return found[tuple(slice(None, None, s) for s in sense)]


@given(st.tuples(*(st.integers(1, 9),) * 3), st.floats(0, 1), numbers)
@settings(max_examples=40)
def test_empty_cubes_ahead(shape, share, seed):
    filled = np.random.default_rng(seed).uniform(size=shape) < share**3
    code = empty_ahead(filled)
    for octant, down in enumerate(itertools.product((False, True), repeat=3)):
        ahead = (code >> (4 * octant)) & 15
        np.testing.assert_array_equal(ahead, brute_ahead(filled, down))


def make_grid(shape, seed, even):
    """Return a grid with cells of equal or very unequal width."""
    rng = np.random.default_rng(seed)
    if even:
        return vm.CartesianGrid.uniform(shape, ((-1, 2), (0, 1), (5, 7)))
    widths = (10 ** rng.uniform(-1.5, 0.5, n) for n in shape)
    return vm.CartesianGrid(*(np.concatenate([[-1.0], -1 + np.cumsum(w)]) for w in widths))


def rays_of(grid, seed):
    """Return lines through a grid: any, along axes, along diagonals of cells, and from faces."""
    rng = np.random.default_rng(seed)
    low, high = grid.bounds.T
    origins = rng.uniform(low, high, (RAYS, 3))
    directions = on_a_sphere(RAYS, seed)
    directions[:12] = np.repeat(np.vstack([np.eye(3), -np.eye(3)]), 2, axis=0)
    directions[12:20, rng.integers(3)] = 0.0
    for k in range(20, 32):  # through corners, from cell to cell
        origins[k] = [rng.choice(e) for e in grid.edges]
    widths = (high - low) / grid.shape
    directions[32:40] = rng.choice([-1.0, 1.0], (8, 3)) * widths
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return origins, directions


def leaping(walk, ray, bricks):
    """Follow rays as a kernel does; return cells, lengths and which are visits, (N, R)."""
    track, cursor = walk.enter(ray)
    dr.eval(track, cursor)
    nowhere = np.zeros(len(np.asarray(cursor.t)))
    rows = [[nowhere.astype(int), nowhere, nowhere > 0]]
    while dr.any(cursor.inside):
        found = BrickRays(walk, track, bricks)(cursor)
        cursor = found.cursor
        dr.eval(found)
        while dr.any(within := cursor.inside & found.holds(cursor)):
            segment, following = walk.next(track, cursor)
            parts = (segment.cell, segment.length, within)
            rows.append([np.asarray(part) for part in parts])
            cursor = dr.select(within, following, cursor)
            dr.eval(cursor)
    return tuple(np.array(part) for part in zip(*rows, strict=True))


def cells_of(filled, grid):
    """Return which cells, flat, lie in filled bricks."""
    index = np.stack(np.unravel_index(np.arange(grid.size), grid.shape)) >> BITS
    return filled[tuple(index)]


def lengths_by_cell(cell, length, visited, size):
    """Return how far each ray runs in each cell, shape (R, cells)."""
    total = np.zeros((cell.shape[1], size))
    for c, d, here in zip(cell, length, visited, strict=True):
        np.add.at(total, (np.flatnonzero(here), c[here]), d[here])
    return total


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("precision", ["single", "double"])
@given(
    shape=st.tuples(*(st.integers(1, 25),) * 3),
    share=st.sampled_from([0.0, 0.02, 0.1, 0.5, 1.0]),
    seed=numbers,
)
@settings(max_examples=12)
def test_what_is_filled_is_seen_as_without_leaps(even, precision, shape, share, seed):
    grid, backend = make_grid(shape, seed, even), get_backend("cpu", precision)
    rng = np.random.default_rng(seed)
    filled = rng.uniform(size=brick_shape(shape)) < share
    origins, directions = rays_of(grid, seed)
    walk = grid.walk(backend)
    steps = walk_along(grid, backend, make_ray(backend, origins, directions))
    every = lengths_by_cell(steps.cell, steps.length, steps.active, grid.size)
    found = leaping(walk, make_ray(backend, origins, directions), make_bricks(filled, backend))
    cell, length, visited = found
    seen = lengths_by_cell(cell, length * grid.scale, visited, grid.size)
    mask = cells_of(filled, grid)
    # Cells touched at an edge or a corner: as far as rounding of distances lets rays stray.
    diagonal = np.linalg.norm(np.diff(grid.bounds, axis=1))
    slack = 64 * float(np.finfo(backend.dtype).eps) * diagonal
    np.testing.assert_allclose(seen[:, mask], every[:, mask], rtol=0, atol=slack)
    # Where a ray touches a corner, it may look into one cell more before it leaps.
    astray = (seen[:, ~mask] > slack).any(axis=1)
    touching = (visited & (length * grid.scale <= slack)).any(axis=0)
    assert not (astray & ~touching).any()


@pytest.mark.parametrize("share", [0.0, 0.05])
def test_rays_that_start_and_end_inside(share):
    grid, backend = make_grid((17, 9, 30), 3, False), get_backend("cpu", "double")
    filled = np.random.default_rng(4).uniform(size=brick_shape(grid.shape)) < share
    filled[0, 0, 0] = True
    origins, directions = rays_of(grid, 8)
    limits = {"first": 0.1, "last": 0.8}
    steps = walk_along(grid, backend, make_ray(backend, origins, directions, **limits))
    every = lengths_by_cell(steps.cell, steps.length, steps.active, grid.size)
    ray = make_ray(backend, origins, directions, **limits)
    cell, length, visited = leaping(grid.walk(backend), ray, make_bricks(filled, backend))
    seen = lengths_by_cell(cell, length * grid.scale, visited, grid.size)
    mask = cells_of(filled, grid)
    np.testing.assert_allclose(seen[:, mask], every[:, mask], rtol=0, atol=1e-12)
