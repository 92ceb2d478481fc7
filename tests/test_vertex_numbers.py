"""Numbers of the vertices of cells of trees: each corner has one, and it tells where it is."""

import itertools

import numpy as np
import pytest

import voluminous as vm
from voluminous.backend import get_backend

BASE = [np.linspace(-1, 1, n + 1) for n in (3, 2, 4)]
CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))


def random_octree():
    rng, grid = np.random.default_rng(3), vm.OctreeGrid(*BASE)
    for _ in range(5):
        grid = grid.refine(rng.random(grid.size) < 0.3)
    return grid


def refined_disc(phi):
    rng = np.random.default_rng(4)
    flags = np.zeros(200 if len(phi) > 2 else 600, np.uint8)
    grid = vm.CylindricalGrid([0, 1, 2, 3], phi, [-1, 0, 1], refined=None)
    flags = rng.random(grid.size) < 0.4
    children = 4 if len(phi) == 2 else 8
    refined = np.concatenate([[1, *[0] * children] if flag else [0] for flag in flags])
    return vm.CylindricalGrid([0, 1, 2, 3], phi, [-1, 0, 1], refined=refined)


GRIDS = {
    "base cells": lambda: vm.OctreeGrid(*BASE),
    "octree": random_octree,
    "evenly refined": lambda: vm.OctreeGrid.from_function(*BASE, lambda x, y, z, s: x < 9, 4),
    "patches": lambda: vm.PatchGrid(
        [[0, 0, 0], [1, 1, 1], [1, 1, 1]],
        [[4, 4, 4], [2, 2, 3], [1.5, 1.5, 2]],
        [[20, 40, 60], [10, 30, 90], [10, 30, 135]],
    ),
    "patches with holes": lambda: vm.PatchGrid(
        [[0, 0, 0], [1, 1, 1]], [[1, 1, 1], [2, 2, 2]], [[2, 2, 2], [4, 4, 40]]
    ),
    "refined cylinder": lambda: refined_disc(np.linspace(0, 2 * np.pi, 5)),
    "refined, axisymmetric": lambda: refined_disc(np.array([0, 2 * np.pi])),
}


def places(vertices, first, last):
    found = vertices.places(first, last, get_backend("cpu", "double"))
    return np.stack([np.asarray(v) for v in found])


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
def test_corners_of_cells_are_where_their_numbers_say(grid):
    grid = grid()
    vertices = grid.vertex_numbers
    where = places(vertices, 0, vertices.count)
    low, size = grid.boxes(0, grid.size)
    first, packed = vertices.cells.T.astype(np.int64)
    strides = np.stack([packed >> 20, packed >> 10 & 1023, packed & 1023])
    for corner in CORNERS:
        number = first + corner @ strides
        assert number.max() < vertices.count
        # Whole numbers, in double precision: exactly.
        np.testing.assert_array_equal(where[:, number], low + size * corner[:, None])


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
def test_places_of_a_part_are_those_of_the_whole(grid):
    vertices = grid().vertex_numbers
    whole = places(vertices, 0, vertices.count)
    for first, last in ((0, 1), (5, 40), (vertices.count - 3, vertices.count)):
        np.testing.assert_array_equal(places(vertices, first, last), whole[:, first:last])


def test_no_leaf_needs_more_than_eight_vertices_and_even_parts_need_fewer():
    assert GRIDS["base cells"]().vertex_numbers.count == 8 * 24
    # Lattices span three levels: (9/8)^3 points per leaf.
    even = GRIDS["evenly refined"]()
    assert even.vertex_numbers.count == even.size // 512 * 729
    # Siblings share 27 points; mixed ones at least do not have more than eight each.
    tree = random_octree()
    assert tree.vertex_numbers.count < 0.5 * 8 * tree.size
