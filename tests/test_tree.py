"""Trees of blocks: places are found alike on the host and in kernels, in any number of axes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import voluminous as vm
from test_octree import random_octree, zoom
from test_patches import random_patches, tiles
from voluminous.backend import from_host, get_backend
from voluminous.grids.trees.octree_order import (
    Places,
    split_levels,
)
from voluminous.grids.trees.octree_tree import octree_tree
from voluminous.grids.trees.tree import NONE, TreeLookup

BASE = (3, 2, 4)
AXES = [a for n in (1, 2, 3) for a in itertools.combinations(range(3), n)]


def random_levels(axes, passes=6, seed=0):
    """Return the levels of a random tree over the base cells, of which some axes are halved."""
    rng, levels = np.random.default_rng(seed), np.zeros(int(np.prod(BASE)), np.uint8)
    for _ in range(passes):
        levels = split_levels(levels, rng.random(len(levels)) < 0.4, 1 << len(axes))
    return levels


def boxes_of(places):
    """Return corners and sizes of all leaves in finest units, (3, n)."""
    base, corner = places.corners()
    halved = np.isin(np.arange(3), places.axes)
    unit = np.where(halved, 1 << places.deepest, 1)[:, None]
    low = np.stack(np.unravel_index(base, BASE, order="F")) * unit + corner
    return low, np.where(halved[:, None], 1 << (places.deepest - places.levels.astype(int)), 1)


@pytest.mark.parametrize("axes", AXES)
def test_trees_halve_the_axes_they_are_told(axes):
    places = Places(random_levels(axes), axes)
    assert places.total() == (np.prod(BASE), True)
    low, size = boxes_of(places)
    tree = octree_tree(BASE, places)
    inner = np.random.default_rng(1).integers(0, 1 << 20, low.shape) % size
    found = tree.find(low + inner)
    np.testing.assert_array_equal(found.number, np.arange(len(places.levels)))
    np.testing.assert_array_equal(found.low, low)
    np.testing.assert_array_equal(found.size, size)
    # The leaves fill the domain, so each place is in one of them.
    assert size.prod(axis=0).sum() == tree.extent.prod()


def pruned(grid):
    """Return a tree with every ninth leaf only, and those near a corner."""
    near = np.linalg.norm(grid.cell_centers().T - grid.bounds[:, 0], axis=1) < 1
    return grid.pruned(near | (np.arange(grid.size) % 9 == 0))


TREES = {
    "halved along x and z": lambda: octree_tree(BASE, Places(random_levels((0, 2)), (0, 2))),
    "octree": lambda: random_octree(3, 6).tree,
    "even octree": lambda: vm.OctreeGrid.from_levels([0, 1], [0, 1], [0, 1], [4] * 4096).tree,
    "deep octree": lambda: zoom(12, (0.1, 0.2, 0.3)).tree,
    "with holes": lambda: pruned(random_octree(4, 5)),
    "with holes, an odd number of levels deep": lambda: pruned(random_octree(4, 4)),
    "with holes, one level deep": lambda: pruned(random_octree(4, 1)),
    "patches": lambda: random_patches(6, 2).tree,
    "patches of ratio 3": lambda: random_patches(6, 3).tree,
    "anisotropic patches": lambda: random_patches(7, [2, 1, 4]).tree,
    "tiles": lambda: tiles().tree,
}


@pytest.mark.each_value_once
@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("name", TREES)
def test_kernels_find_what_the_host_finds(name, precision):
    tree, backend = TREES[name](), get_backend("cpu", precision)
    rng = np.random.default_rng(5)
    place = rng.integers(0, tree.extent[:, None], (3, 5000))
    expected = tree.find(place)
    lookup = TreeLookup(tree, backend)
    down = rng.random(place.shape) < 0.5
    for mirrored in (None, down):
        # In the middle of a finest unit.
        own = place if mirrored is None else np.where(down, tree.extent[:, None] - 1 - place, place)
        there = [from_host(backend.Float, p + 0.5) for p in own]
        way = lookup.orient(
            None if mirrored is None else [from_host(backend.Bool, d) for d in down]
        )
        cell = lookup.find(there, way, backend.Bool(True))
        number = np.asarray(cell.number).astype(np.int64)
        np.testing.assert_array_equal(np.where(number == NONE, -1, number), expected.number)
        for axis, (low, size) in enumerate(zip(cell.low, lookup.sizes(cell), strict=True)):
            low, size = (np.asarray(v) + np.zeros(place.shape[1]) for v in (low, size))
            if mirrored is not None:
                low = np.where(down[axis], tree.extent[axis] - low - size, low)
            np.testing.assert_array_equal(low, expected.low[axis])
            np.testing.assert_array_equal(size, expected.size[axis])
