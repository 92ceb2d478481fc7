"""Patches of any ratios and places: which cells there are, beside asking every patch."""

import numpy as np
import pytest

import voluminous as vm

pytestmark = pytest.mark.exhaustive

LARGEST = 3e5  # cells of a patch


def random_boxes(rng):
    """Return base cells, ratios, and levels, corners and shapes of patches within patches."""
    count = rng.integers(10, 50, 3)
    ratios = rng.choice([1, 2, 3, 4, 5], (rng.integers(1, 4), 3))
    ratios[(ratios == 1).all(axis=1)] = 2
    levels, lows, shapes = [0], [np.zeros(3, int)], [count]
    for level, ratio in enumerate(ratios):
        outer = [k for k, own in enumerate(levels) if own == level]
        for _ in range(rng.integers(1, 4) if outer else 0):
            k = rng.choice(outer)
            first = rng.integers(0, shapes[k])
            last = rng.integers(first + 1, shapes[k] + 1)
            shape = (last - first) * ratio
            if np.prod(shape, dtype=float) < LARGEST:
                levels.append(level + 1)
                lows.append((lows[k] + first) * ratio)
                shapes.append(shape)
    return count, ratios, levels, lows, shapes


def check(count, ratios, levels, lows, shapes, rng):
    edges = [np.linspace(0, 1, n + 1) for n in count]
    grid = vm.PatchGrid.from_boxes(*edges, levels, lows, shapes, ratios)
    low, size = grid.boxes(0, grid.size)
    extent = grid.extent
    # They fill the domain, and none twice.
    assert size.prod(axis=0).sum() == extent.prod()
    points = rng.integers(0, extent, (200, 3)).T
    number = grid.tree.find(points).number
    assert (low[:, number] <= points).all()
    assert (points < (low + size)[:, number]).all()
    ratios = np.array(ratios)[: max(levels)]
    finest = np.concatenate([np.cumprod(ratios[::-1], axis=0)[::-1], np.ones((1, 3), int)])
    expected = np.zeros(200, int)
    for level, first, shape in zip(levels, lows, shapes, strict=True):
        begin, end = first * finest[level], (first + shape) * finest[level]
        inside = ((begin <= points.T) & (end > points.T)).all(axis=1)
        expected = np.where(inside, np.maximum(expected, level), expected)
    np.testing.assert_array_equal(grid.levels[number], expected)


@pytest.mark.parametrize("seed", range(25))
def test_cells_are_those_of_the_finest_patch_at_each_place(seed):
    rng = np.random.default_rng(seed)
    check(*random_boxes(rng), rng)


def test_entries_of_the_tree_may_begin_and_end_inside_cells():
    # Of two, three and nine units in turn: cells of patches that are seen partly were lost.
    lows = np.array([[0, 0, 0], [10, 30, 45], [20, 60, 135]])
    shapes = np.array([[20, 40, 60], [10, 30, 90], [10, 30, 135]])
    ratios = [[2, 3, 3], [2, 2, 3]]
    check([20, 40, 60], ratios, [0, 1, 2], lows, shapes, np.random.default_rng(0))


@pytest.mark.parametrize("seed", range(12))
def test_patches_far_apart_in_a_domain_of_any_number_of_cells(seed):
    # A large prime number of cells has no parts: blocks of all of them took gigabytes.
    rng = np.random.default_rng(seed)
    count, ratio = rng.choice([37, 101, 509, 4099, 100003], 3), rng.integers([2, 1, 1], 4)
    low, shape = rng.integers(0, count - 8, (30, 3)), rng.integers(1, 8, (30, 3))
    low[:2] = np.zeros(3, int), count - shape[1]
    inner, level = rng.integers(0, shape[2:10]), np.repeat([0, 1], [30, 8])
    lows = np.concatenate([low, (low[2:10] + inner) * ratio])
    shapes = np.concatenate([shape, (shape[2:10] - inner) * ratio])
    bounds = (
        np.stack([lows, lows + shapes], axis=-1) / np.where(level, ratio[:, None], 1).T[..., None]
    )
    grid = vm.PatchGrid(*np.moveaxis(bounds, -1, 0), shapes)
    centers = grid.cell_centers().T
    np.testing.assert_array_equal(grid.locate(centers), np.arange(grid.size))
    assert (grid.locate(rng.random((100, 3)) * count) < 0).sum() > 50 * (count.prod() > 1e9)
    volume = vm.Volume(grid, f=rng.lognormal(size=grid.size))
    # All that a ray along an axis meets is in one row of cells.
    for angles, axis in (((0, 0), 2), ((180, 0), 2), ((90, 0), 1), ((90, 90), 0), ((90, 270), 0)):
        cell = rng.integers(grid.size)
        here, sizes = centers[cell] + 1e-4, grid.cell_sizes().T
        camera = vm.Orthographic(*angles, width=1e-6, resolution=1, center=here)
        image = vm.render(
            volume, vm.Coefficients("f", 0), camera, scheme="first-order", precision="double"
        )
        others = [k for k in range(3) if k != axis]
        met = (np.abs(centers - here) < sizes / 2)[:, others].all(axis=1)
        expected = (volume.array("f") * sizes[:, axis])[met].sum()
        np.testing.assert_allclose(image.intensity.item(), expected, rtol=1e-9)
