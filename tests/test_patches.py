"""Nested patches: the contract of grids for any ratio of refinement, hidden cells, and holes."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import voluminous as vm
from contracts import GridContract
from contracts.bundle import box_limits, on_a_sphere
from contracts.grid import make_ray, walk_along
from voluminous.backend import get_backend

EVEN = [np.linspace(0, 1, n + 1) for n in (6, 5, 4)]
UNEVEN = [np.array([0, 0.5, 1, 2, 5, 6, 7.0]), np.array([-1, 0, 2, 3, 4, 4.5]), np.arange(5.0)]


def random_patches(seed, ratio, levels=3, count=12, edges=EVEN):
    """Return a grid of random patches, inside of each other and overlapping."""
    rng = np.random.default_rng(seed)
    ratios = np.broadcast_to(np.atleast_2d(ratio), (levels, 3))
    level, low, shape = [0], [np.zeros(3, int)], [np.array([len(e) - 1 for e in edges])]
    while len(level) <= count:
        parent = rng.integers(len(level))
        if level[parent] < levels:
            first = rng.integers(0, shape[parent])
            end = rng.integers(first + 1, shape[parent] + 1)
            low.append((low[parent] + first) * ratios[level[parent]])
            shape.append((end - first) * ratios[level[parent]])
            level.append(level[parent] + 1)
    return vm.PatchGrid.from_boxes(*edges, level, low, shape, ratios)


def tiles(seed=0, blocks=3, cells=4):
    """Return blocks of equal shape that tile the domain at three levels, as FLASH has them."""
    rng = np.random.default_rng(seed)
    corner = np.indices((blocks,) * 3).reshape(3, -1).T
    eight = np.indices((2, 2, 2)).reshape(3, -1).T
    level, low = [], []
    for number in range(3):
        split = rng.random(len(corner)) < 0.3 * (number < 2)
        low.append(corner[~split] * cells)
        level += [number] * int(np.count_nonzero(~split))
        corner = (corner[split][:, None] * 2 + eight).reshape(-1, 3)
    edges = np.linspace(-1, 1, blocks * cells + 1)
    low = np.concatenate(low)
    return vm.PatchGrid.from_boxes(edges, edges, edges, level, low, np.full(low.shape, cells))


LAYERS = [
    [0, 2, 2, 1, 4, 2, 3],
    [1, 1, 1, 1, 2, 4, 3],
    [1, 4, 2, 2, 5, 2, 4],
    [0, 1, 1, 1, 1, 1, 1],
]

GRIDS = {
    "ratio 2": lambda: random_patches(1, 2),
    "ratio 3": lambda: random_patches(2, 3),
    "anisotropic": lambda: random_patches(3, [2, 1, 4]),
    "ratios differ": lambda: random_patches(4, [[3, 2, 1], [2, 2, 5], [1, 7, 1]]),
    "rectilinear": lambda: random_patches(5, [3, 2, 2], edges=UNEVEN),
    "tiles": tiles,
    "layers": lambda: vm.PatchGrid.from_layers(*EVEN, LAYERS),
}


@functools.cache
def grid_named(name):
    return GRIDS[name]()


class TestPatches(GridContract):
    # Vertices come with the second order.
    test_corners_are_an_interpolation = None
    test_values_are_continuous_from_cell_to_cell = None

    @pytest.fixture(params=list(GRIDS))
    def grid(self, request):
        return grid_named(request.param)

    def locate(self, grid, points):
        """Try all patches, the finest last."""
        patches = grid.patches
        order = np.argsort(patches.level, kind="stable")
        found = np.empty(len(points), int)
        numbers = grid.unpack(np.arange(grid.size))
        for patch in order:
            low, high = (grid.position(c[patch][:, None])[:, 0] for c in patches.corners)
            here = ((low <= points) & (points < high)).all(axis=1)
            size = patches.sizes[patches.level[patch]]
            place = (patches.low[patch] + np.indices(patches.shape[patch] + 1).T) * size
            walls = grid.position(place.T.reshape(3, -1)).reshape(3, *patches.shape[patch] + 1)
            axes = (walls[0, :, 0, 0], walls[1, 0, :, 0], walls[2, 0, 0, :])
            index = [
                np.searchsorted(w, p, side="right") - 1
                for w, p in zip(axes, points[here].T, strict=True)
            ]
            found[here] = numbers[patch][tuple(index)]
        return found


def rays_through(grid, count=300):
    low, high = grid.bounds.T
    directions = on_a_sphere(count, seed=4)
    aims = np.random.default_rng(3).uniform(low, high, (count, 3))
    return aims - 3 * np.linalg.norm(high - low) * directions, directions


@pytest.mark.parametrize("name", ["ratio 2", "layers", "tiles"])
def test_patches_are_the_octree_with_the_same_leaves(name):
    grid, backend = grid_named(name), get_backend("cpu", "double")
    low, size = grid.boxes(0, grid.size)
    octree, order = vm.OctreeGrid.from_leaves(*grid.base_edges, grid.levels, (low // size).T)
    rays = rays_through(grid)
    found, expected = (walk_along(g, backend, make_ray(backend, *rays)) for g in (grid, octree))
    np.testing.assert_array_equal(found.active, expected.active)
    active = found.active
    np.testing.assert_array_equal(found.cell[active], order[expected.cell[active]])
    np.testing.assert_allclose(found.length, expected.length, rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", GRIDS)
def test_fields_are_one_array_per_patch(name):
    grid = grid_named(name)
    numbers = grid.unpack(np.arange(grid.size, dtype=float))
    assert [n.shape for n in numbers] == [tuple(s) for s in grid.patches.shape]
    np.testing.assert_array_equal(grid.pack(numbers), np.arange(grid.size))
    np.testing.assert_array_equal(grid.pack(np.arange(grid.size)), np.arange(grid.size))
    # What is not seen is hidden by a finer patch.
    for patch, array in enumerate(numbers):
        size = grid.patches.sizes[grid.patches.level[patch]]
        index = np.argwhere(np.isnan(array))
        place = (grid.patches.low[patch] + index) * size
        above = grid.tree.find(place.T).number
        assert (grid.levels[above] >= grid.patches.level[patch]).all()
    np.testing.assert_allclose(
        grid.cell_volumes.sum(), np.prod(np.ptp(grid.bounds, axis=1)), rtol=1e-13
    )
    np.testing.assert_allclose(grid.cell_sizes().prod(axis=0), grid.cell_volumes, rtol=1e-14)


@pytest.mark.parametrize("name", ["ratio 3", "anisotropic", "ratios differ", "tiles"])
def test_corners_in_space_are_as_good_as_indices(name):
    grid = grid_named(name)
    corners = [
        np.array([grid.position(row[:, None])[:, 0] for row in c]) for c in grid.patches.corners
    ]
    again = vm.PatchGrid(*corners, grid.patches.shape, unit="pc")
    np.testing.assert_array_equal(again.levels, grid.levels)
    np.testing.assert_allclose(again.cell_centers(), grid.cell_centers(), rtol=1e-14, atol=1e-15)
    assert again.unit == vm.CartesianGrid([0, 1], [0, 1], [0, 1], unit="pc").unit


def test_one_shape_does_for_all_blocks():
    low = [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
    high = np.array(low) + 1
    every = vm.PatchGrid(low, high, np.full((3, 3), 8))
    one = vm.PatchGrid(low, high, (8, 8, 8))
    np.testing.assert_array_equal(one.cell_centers(), every.cell_centers())
    boxes = vm.PatchGrid.from_boxes(
        *[np.arange(n) for n in (25, 9, 9)], [0] * 3, [[0, 0, 0], [8, 0, 0], [16, 0, 0]], (8, 8, 8)
    )
    assert boxes.size == every.size
    for shape, told in [
        ((8, 8), "integers of shape"),
        (8, "integers of shape"),
        ((8, 8, 0.5), "float"),
    ]:
        with pytest.raises(vm.InputError, match=told):
            vm.PatchGrid(low, high, shape)


def test_rays_cross_holes_as_vacuum():
    # Three unit cubes, of 2, 4 and 6 cells, in a row with a gap, none of them covered.
    lower = np.array([[0, 0, 0], [2, 0, 0], [3, 0, 0.0]])
    shape = np.array([[2, 2, 2], [4, 4, 4], [4, 4, 4]])
    grid = vm.PatchGrid(lower, lower + 1, shape)
    backend = get_backend("cpu", "double")
    rays = np.array([[-1, 0.3, 0.4], [9, 0.7, 0.1]]), np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    steps = walk_along(grid, backend, make_ray(backend, *rays))
    np.testing.assert_allclose(steps.length.sum(axis=0), [3, 3], rtol=1e-14)
    assert (grid.locate(np.array([[1.5, 0.5, 0.5], [2.5, 0.5, 0.5]])) >= 0).tolist() == [
        False,
        True,
    ]
    np.testing.assert_allclose(grid.cell_volumes.sum(), 3, rtol=1e-14)
    np.testing.assert_allclose(steps.end.max(axis=0), [4, 4], rtol=1e-14)


CUBE = [[0, 0, 0]], [[4, 4, 4]], [[4, 4, 4]]


@pytest.mark.parametrize(
    ("lower", "upper", "shape", "told"),
    [
        (
            [0.5, 0, 0],
            [1.5, 1, 1],
            [2, 2, 2],
            "patch 1 .level 1. begins or ends inside a cell of patch 0",
        ),
        ([0.3, 0, 0], [1.3, 1, 1], [2, 2, 2], "patch 1 begins .* of its cells"),
        ([0, 0, 0], [1, 1, 1], [3, 2, 2], None),
        ([0, 0, 0], [1.5, 1, 1], [2, 1, 1], r"cells of patch 0 are \[1.33"),
        ([0, 0, 0], [0, 1, 1], [2, 2, 2], "patch 1: upper must be greater"),
        ([0, 0, np.nan], [1, 1, 1], [2, 2, 2], "lower must be finite; that of patch 1"),
        ([0, 0, 0], [1, 1, 1], [2, 0, 2], "shape must be positive; that of patch 1"),
    ],
)
def test_patches_that_do_not_fit(lower, upper, shape, told):
    corners = [[*a, b] for a, b in zip(CUBE, (lower, upper, shape), strict=True)]
    if told is None:
        assert vm.PatchGrid(*corners).size == 63 + 12
        return
    with pytest.raises(vm.InputError, match=told):
        vm.PatchGrid(*corners)


def test_a_patch_around_others_lets_them_begin_anywhere_in_it():
    lower, upper = [[0, 0, 0], [0, 0, 0], [0.5, 0, 0]], [[4, 4, 4], [2, 1, 1], [1.5, 1, 1]]
    grid = vm.PatchGrid(lower, upper, [[4, 4, 4], [4, 2, 2], [4, 4, 4]])
    assert grid.size == 62 + 8 + 64
    points = np.array([[0.3, 0.3, 0.3], [0.7, 0.3, 0.3], [1.7, 0.6, 0.6], [2.5, 0.5, 0.5]])
    np.testing.assert_array_equal(grid.levels[grid.locate(points)], [1, 2, 1, 0])
    assert grid.cell_volumes.sum() == 64


@pytest.mark.parametrize(
    ("layers", "told"),
    [
        ([[1, 1, 1, 1, 1, 1, 1]], "layer 1 must have a parent from 0 to 0, got 1"),
        ([[0, 0, 1, 1, 1, 1, 1]], "layer 1 covers cells .0, 1, 1. to"),
        ([[0, 2, 1, 1, 6, 1, 1]], "of its parent 0, which has .6, 5, 4."),
        ([[0, 1, 1, 1]], "rows of seven integers"),
        ([[0, 1, 1, 1], [0]], "all rows equally long"),
    ],
)
def test_layers_that_do_not_fit(layers, told):
    with pytest.raises(vm.InputError, match=told):
        vm.PatchGrid.from_layers(*EVEN, layers)


def test_boxes_that_do_not_fit():
    for level, low, shape, ratio, told in (
        ([0], [[0, 0, 0]], [[7, 5, 4]], 2, "patch 0 is not inside the domain"),
        ([-1], [[0, 0, 0]], [[6, 5, 4]], 2, "levels count from 0"),
        ([2], [[0, 0, 0]], [[6, 5, 4]], [2], "ratio must tell of 2 levels, got 1"),
        ([1], [[0, 0, 0]], [[6, 5, 4]], 0, "ratio must be positive"),
        ([1, 1], [[0, 0, 0]], [[6, 5, 4]], 2, "equally many patches"),
        ([2], [[0, 0, 0]], [[6, 5, 4]], [[2, 2], [2, 2]], r"of shape .levels, 3., got \[\[2, 2\]"),
        ([2], [[0, 0, 0]], [[6, 5, 4]], [[2], [2, 2]], "ratio must be .* all rows equally long"),
    ):
        with pytest.raises(vm.InputError, match=told):
            vm.PatchGrid.from_boxes(*EVEN, level, low, shape, ratio)


def test_field_must_have_the_shapes_of_the_patches():
    grid = grid_named("layers")
    arrays = grid.unpack(np.zeros(grid.size))
    with pytest.raises(vm.InputError, match="one array per patch: 5, got 4"):
        grid.pack(arrays[:-1])
    with pytest.raises(vm.InputError, match="array of patch 0 must have its shape"):
        grid.pack([arrays[0].T, *arrays[1:]])


@pytest.mark.parametrize(("ratio", "levels"), [(2, 30), (3, 20), (4, 20)])
def test_patches_within_patches_as_deep_as_octrees(ratio, levels):
    level = np.arange(levels + 1)
    # Each patch of four cells a side is half of the one before, about a point near a corner.
    low = np.zeros((levels + 1, 3), int)
    for k in range(levels):
        low[k + 1] = (low[k] + [1, 2, 1]) * ratio
    shape = np.full((levels + 1, 3), 2 * ratio)
    shape[0] = 4
    edges = np.linspace(0, 1, 5)
    grid = vm.PatchGrid.from_boxes(edges, edges, edges, level, low, shape, ratio)
    backend = get_backend("cpu", "double")
    assert grid.needs_double()
    assert grid.patches.tree.entries.nbytes < 1e6
    centers = grid.cell_centers()
    np.testing.assert_array_equal(grid.locate(centers.T), np.arange(grid.size))
    target = centers[:, grid.levels == levels][:, :64].T
    directions = on_a_sphere(len(target), seed=1)
    rays = make_ray(backend, target - 2 * directions, directions)
    steps = walk_along(grid, backend, rays)
    enter, leave = box_limits(grid.bounds, target - 2 * directions, directions)
    np.testing.assert_allclose(steps.length.sum(axis=0), leave - enter, rtol=0, atol=1e-14)
    here = np.argmin(np.abs(enter + steps.end - 0.5 * steps.length - 2), axis=0)
    # Where double precision does not tell the point on a ray from its neighbours, a level matters.
    found = grid.levels[np.take_along_axis(steps.cell, here[None], axis=0)[0]]
    assert found.min() >= min(levels, int(40 / np.log2(ratio)))
