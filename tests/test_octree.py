"""Octrees: the contract of grids, and rays through random, deep and evenly refined ones."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from contracts import GridContract
from contracts.bundle import on_a_sphere

UNEVEN = [-1.0, -0.3, 0.1, 0.8, 2.0]


def random_octree(seed, levels, share=0.3, edges=((0, 1, 2), (0, 1, 2, 3), (-1, 0, 1))):
    """Return an unbalanced octree, in which every leaf is split with the same probability."""
    rng = np.random.default_rng(seed)
    grid = vm.OctreeGrid(*edges)
    for _ in range(levels):
        grid = grid.refine(rng.random(grid.size) < share)
    return grid


def zoom(levels, point, edges=(-1, 1)):
    """Return an octree refined around one point only, as deep as it can be."""
    grid = vm.OctreeGrid(edges, edges, edges)
    for _ in range(levels):
        cell = grid.locate(np.array([point]))
        grid = grid.refine(np.arange(grid.size) == cell)
    return grid


class OctreeContract(GridContract):
    """Cells are found by comparing points with the corners of all of them."""

    # Vertices come with the second order.
    test_corners_are_an_interpolation = None
    test_values_are_continuous_from_cell_to_cell = None

    def locate(self, grid, points):
        low, high = grid.corners()
        found = np.empty(len(points), int)
        for k, point in enumerate(points[..., None]):
            (found[k],) = np.flatnonzero(((low <= point) & (point < high)).all(axis=0))
        return found


class TestUnbalanced(OctreeContract):
    @pytest.fixture
    def grid(self):
        return random_octree(1, 5)


class TestRectilinearBase(OctreeContract):
    @pytest.fixture
    def grid(self):
        return random_octree(2, 4, edges=(UNEVEN, [0.0, 0.5, 0.75, 3.0], [-2.0, -1.9, 1.0]))


class TestThirtyLevels(OctreeContract):
    precisions = ("double",)  # render() takes it by itself

    @pytest.fixture
    def grid(self):
        return zoom(30, (0.1, 1 / 3, -0.7))

    @pytest.fixture
    def lines(self, grid):
        """Lines past the finest cells, within a few sizes of cells of every level."""
        point, count = np.array([0.1, 1 / 3, -0.7]), 96
        apart = 2.0 ** -np.linspace(0, 31, count)[:, None] * on_a_sphere(count, seed=3)
        directions = on_a_sphere(count, seed=2)
        return point + apart - 8 * directions, directions


def test_split_flags_are_read_in_the_order_of_radmc3d():
    # The second base cell is split, and of its children the third (upper y) again.
    grid = vm.OctreeGrid([0, 8, 16], [0, 8], [0, 8], [0, 1, 0, 0, 1, *8 * [0], *5 * [0]])
    np.testing.assert_array_equal(grid.levels, [0, 1, 1, *8 * [2], *5 * [1]])
    centers = grid.cell_centers().T
    np.testing.assert_array_equal(centers[[0, 1, 2]], [[4, 4, 4], [10, 2, 2], [14, 2, 2]])
    np.testing.assert_array_equal(centers[3:6], [[9, 5, 1], [11, 5, 1], [9, 7, 1]])
    np.testing.assert_array_equal(centers[[7, 11, 15]], [[9, 5, 3], [14, 6, 2], [14, 6, 6]])


@pytest.mark.parametrize("levels", [0, 1, 5, 9, 10, 11, 25])
def test_flags_leaves_and_levels_tell_of_the_same_tree(levels):
    edges, rng = ((0, 1, 2), (0, 1, 2, 3), (-1, 0, 1)), np.random.default_rng(levels)
    grid = vm.OctreeGrid(*edges)
    while grid.places.deepest < levels:  # at most some 300 leaves more each time
        chosen = rng.choice(np.flatnonzero(grid.levels == grid.places.deepest), 1)
        where = rng.random(grid.size) < 30 / grid.size
        grid = grid.refine(where & (grid.levels < 24) | (np.arange(grid.size) == chosen))
    again = vm.OctreeGrid(*edges, grid.refined)
    np.testing.assert_array_equal(again.levels, grid.levels)
    np.testing.assert_array_equal(
        vm.OctreeGrid.from_levels(*edges, grid.levels).levels, grid.levels
    )
    low, size = grid.boxes(0, grid.size)
    shuffled = np.random.default_rng(9).permutation(grid.size)
    other, order = vm.OctreeGrid.from_leaves(
        *edges, grid.levels[shuffled], (low // size).T[shuffled]
    )
    np.testing.assert_array_equal(other.levels, grid.levels)
    np.testing.assert_array_equal(shuffled[order], np.arange(grid.size))


def test_function_says_where_to_refine():
    edges = np.linspace(-1, 1, 5)
    sizes = []

    def near_a_sphere(x, y, z, size):
        sizes.append(size[0])
        return np.abs(np.sqrt(x**2 + y**2 + z**2) - 0.6) < size

    grid = vm.OctreeGrid.from_function(edges, edges, edges, near_a_sphere, 3)
    assert sizes == [0.5, 0.25, 0.125]
    radius = np.linalg.norm(grid.cell_centers(), axis=0)
    width = grid.cell_sizes()[0]
    assert (np.abs(radius - 0.6) >= width)[grid.levels < 3].all()
    assert grid.levels.max() == 3


def test_grid_tells_of_itself():
    grid = vm.OctreeGrid([0, 1, 2], [0, 1], [0, 1], [0, 1] + 8 * [0], unit="pc")
    told = grid.describe()
    assert told["cells_per_level"] == [1, 8]
    assert told["levels"] == 2
    assert told["unit"] == "pc"
    assert "9 cells" in repr(grid)
    assert "per level 1/8" in repr(grid)


BOX = ([0, 1, 2], [0, 1], [0, 1])


@pytest.mark.parametrize(
    ("refined", "told"),
    [
        ([0], "too few flags: 2 base cells and 0 splits into 8 make 2 nodes, got 1"),
        ([0, 1] + 7 * [0], "too few"),
        ([0, 0, 0], "too many"),
        (8 * [0] + [1, 0], "complete after 2 flags, but 8 more follow"),
        ([0, 2], "flag 1 is 2"),
        ([0.5, 0], "flag 0 is 0.5"),
        ([[0, 0]], "1-D array"),
        (["a", "b"], "1-D array of 0 and 1"),
        ([[0], [1, 0]], "all rows equally long"),
        (31 * [1] + (7 * 31 + 2) * [0], "31 levels deep"),
    ],
)
def test_flags_that_are_no_tree(refined, told):
    with pytest.raises(vm.InputError, match=told):
        vm.OctreeGrid(*BOX, refined)


@pytest.mark.parametrize(
    ("level", "index", "told"),
    [
        ([0], [[0, 0, 0]], "hole: nothing fills the domain from base cell 1"),
        ([0], [[1, 0, 0]], "hole: between the beginning of the domain and leaf 0"),
        ([0, 0, 0], [[0, 0, 0], [1, 0, 0], [0, 0, 0]], "leaf 2 .level 0. overlaps leaf 0"),
        ([0, 1], [[0, 0, 0], [1, 0, 0]], "overlaps leaf 0"),
        ([0, 1], [[0, 0, 0], [2, 0, 0]], "hole: nothing fills"),
        ([0, 0], [[0, 0, 0], [2, 0, 0]], "leaf 1 is outside the domain"),
        ([0, -1], [[0, 0, 0], [1, 0, 0]], "between 0 and 30"),
        ([0, 31], [[0, 0, 0], [1, 0, 0]], "between 0 and 30"),
        ([0, 0], [[0, 0], [1, 0]], "integers of shape"),
        ([0.0, 0.0], [[0, 0, 0], [1, 0, 0]], "1-D array of integers"),
    ],
)
def test_leaves_that_are_no_tree(level, index, told):
    with pytest.raises(vm.InputError, match=told):
        vm.OctreeGrid.from_leaves(*BOX, level, index)


@pytest.mark.parametrize(
    ("levels", "told"),
    [([0], "fill 1 of them"), ([0, 1], "a part of one more"), (3 * [0], "fill 3")],
)
def test_levels_that_are_no_tree(levels, told):
    with pytest.raises(vm.InputError, match=told):
        vm.OctreeGrid.from_levels(*BOX, levels)


def test_leaves_are_chosen_by_booleans():
    grid = vm.OctreeGrid(*BOX)
    for where in ([True], [0, 2], np.ones((2, 1), bool)):
        with pytest.raises(vm.InputError, match="where must be 2 booleans"):
            grid.refine(where)


def test_a_function_that_refines_far_too_much_is_stopped(monkeypatch):
    """Before the memory is taken, not by the system."""
    from voluminous import memory

    monkeypatch.setattr(memory, "available_memory", lambda: 1 << 20)
    with pytest.raises(
        vm.errors.MemoryNeededError, match=r"cells of level 6 to split needs .* bytes"
    ):
        vm.OctreeGrid.from_function(*BOX, lambda x, y, z, size: x > -1, 30)
