"""Refined grids in every scheme: they equal uniform grids and each other where they should."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from contracts.bundle import Bundle, on_a_sphere
from test_octree import random_octree

SCHEMES = ["first-order", "second-order", "olson-kunasz", "post-classified"]
MEDIUM = vm.Gaussian("a", 0.4, 0.2, [1.0, 0.3], 0.8, 1.0)
# What is left of a picture by rounding, relative to its maximum.
ROUNDING = {"single": 2e-5, "double": 1e-11}
CAMERA = vm.Orthographic(57, 33, 20, width=4.0, resolution=16)
INSIDE = vm.Perspective((0.3, -0.2, 0.1), (1.2, 0.4, 0.3), width=1.4, resolution=16)


def picture(volume, camera, scheme, precision, medium=MEDIUM):
    """Return intensity and optical depth."""
    options = {"cutoff": 0, "tolerance": 1e-6} if scheme == "post-classified" else {"cutoff": 0}
    image = vm.render(volume, medium, camera, scheme=scheme, precision=precision, **options)
    return np.concatenate([image.intensity, image.optical_depth], axis=-1)


def assert_alike(found, expected, precision):
    assert np.abs(found - expected).max() <= ROUNDING[precision] * np.abs(expected).max()


def evenly_refined(levels=2):
    """Return an octree and the uniform grid of its cells."""
    octree = vm.OctreeGrid(*[np.linspace(-1, 1, 5)] * 3)
    for _ in range(levels):
        octree = octree.refine(np.ones(octree.size, bool))
    return octree, vm.CartesianGrid.uniform(4 << levels, (-1, 1))


def linear(grid):
    x, y, z = grid.cell_centers()
    return (0.4 + 0.6 * x - 0.5 * y + 0.8 * z).reshape(grid.shape)


def through_the_middle(count=64, start=False):
    """Return rays on which the medium below is seen in the middle of the domain only."""
    rng = np.random.default_rng(4)
    return Bundle(rng.uniform(-0.1, 0.1, (count, 3)), across(count), start=start)


def across(count):
    """Return directions that run steeply through planes of constant a."""
    normal = np.array([0.6, -0.5, 0.8]) / np.sqrt(1.25)
    directions = normal + 0.5 * on_a_sphere(count, 7)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("start", [False, True], ids=["outside", "inside"])
def test_every_tree_shows_a_linear_field_as_the_uniform_grid(start, precision):
    """Post-classified: fields are linear between cells of any size."""
    shell = vm.Gaussian("a", 0.4, 0.03, [1.0, 0.3], 20.0, 1.0)
    camera = through_the_middle(start=start)
    octree = random_octree(6, 3, 0.3, [np.linspace(-1, 1, 9)] * 3)
    grids = (
        vm.CartesianGrid.uniform(8, (-1, 1)),
        evenly_refined(1)[0],
        octree,
        vm.PatchGrid.from_boxes(
            *[np.linspace(-1, 1, 7)] * 3,
            [0, 1, 1, 2],
            [[0, 0, 0], [3, 4, 4], [9, 4, 4], [12, 12, 10]],
            [[6, 6, 6], [9, 4, 6], [6, 6, 4], [10, 4, 6]],
            [[3, 2, 2], [2, 2, 2]],
        ),
    )
    expected, *found = (
        picture(vm.Volume(g, a=linear(g)), camera, "post-classified", precision, shell)
        for g in grids
    )
    for other in found:
        # Values that are off by ε of the range are off by 50 ε of the shell's width; panels differ.
        slack = {"single": 2e-5, "double": 1e-6}[precision]
        assert np.abs(other - expected).max() <= slack * expected.max()


def layers_and_octree():
    """Return patches, and the octree with the same cells."""
    edges = [np.linspace(-1, 1, 5)] * 3
    rows = [[0, 1, 2, 1, 3, 2, 3], [1, 1, 1, 2, 4, 3, 4], [2, 2, 2, 2, 3, 2, 4]]
    patches = vm.PatchGrid.from_layers(*edges, rows)
    low, size = patches.boxes(0, patches.size)
    octree, order = vm.OctreeGrid.from_leaves(*edges, patches.levels, (low // size).T)
    return patches, octree, order


@pytest.mark.each_value_once
@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_patches_are_the_octree_with_the_same_cells(scheme, precision):
    patches, octree, order = layers_and_octree()
    a = np.random.default_rng(3).random(patches.size)
    for camera in (CAMERA, INSIDE):
        pair = [
            picture(volume, camera, scheme, precision)
            for volume in (vm.Volume(patches, a=a), vm.Volume(octree, a=a[order]))
        ]
        assert_alike(*pair, precision)
