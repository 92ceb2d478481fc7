"""Post-classification on refined grids: errors told honestly, bounds, surfaces."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import voluminous as vm
from test_octree import random_octree
from test_patches import random_patches, tiles

EVEN = [np.linspace(-1, 1, 5)] * 3


def noise(grid):
    """Return a volume of a random field, rough from cell to cell."""
    return vm.Volume(grid, a=10 ** np.random.default_rng(3).uniform(-0.5, 0.5, grid.size))


def blob(grid):
    """Return a volume of a smooth field."""
    return vm.Volume(grid, a="exp(-2*(x**2 + 1.3*y**2 + 0.8*z**2)) + 0.2*sin(3*x*y + z)")


def around_a_shell(base=8, levels=3):
    """Return a tree refined where it is near a sphere."""
    edges = np.linspace(-1, 1, base + 1)

    def near(x, y, z, size):
        return np.abs(np.sqrt(x * x + y * y + z * z) - 0.6) < 0.7 * size

    return vm.OctreeGrid.from_function(edges, edges, edges, near, levels)


VOLUMES = {
    "noise": lambda: noise(random_octree(1, 3, 0.3, EVEN)),
    "noise on patches": lambda: noise(random_patches(2, 3, 2, 6, EVEN)),
    "noise on tiles": lambda: noise(tiles(1, 2, 2)),
    "blob": lambda: blob(around_a_shell()),
}
MEDIA = {
    "thin": vm.Gaussian("a", 0.6, 0.003, [300.0, 100.0], 30.0, 1.0),
    "wide": vm.Gaussian("a", 0.6, 0.3, [1.0, 0.5], 2.0, 1.0),
    "two": vm.Gaussian("a", 0.5, 0.02, [40.0, 0.0], 10.0, 1.0)
    + vm.Rectangle("a", 0.8, 0.05, [0.0, 20.0], 5.0, 1.0),
    "powers": vm.Coefficients(["a**2", "1 / (1 + a)"], "0.5*(a + 0.3)"),
}
CAMERA = vm.Orthographic(57, 33, 20, width=3.2, resolution=16, center=(0, 0, 0))
INSIDE = vm.Perspective((0.31, -0.2, 0.13), (1.2, 0.4, 0.3), width=1.4, resolution=16)
# Observers outside and inside, both precisions: not all at once, since kernels take their time.
VIEWS = {
    "noise": [(CAMERA, "single"), (CAMERA, "double")],
    "noise on patches": [(INSIDE, "single")],
    "noise on tiles": [(INSIDE, "double")],
    "blob": [(CAMERA, "single"), (INSIDE, "double")],
}


@functools.cache
def volume_named(name):
    return VOLUMES[name]()


@functools.cache
def truth(name, kind, camera):
    """Return the picture to a millionth."""
    image = vm.render(
        volume_named(name), MEDIA[kind], camera, precision="double", tolerance=1e-6, cutoff=0
    )
    return image.intensity


@pytest.mark.exhaustive
@pytest.mark.parametrize("kind", MEDIA)
@pytest.mark.parametrize("name", VOLUMES)
def test_claimed_errors_are_honest(name, kind):
    for camera, precision in VIEWS[name]:
        exact = truth(name, kind, camera)
        image = vm.render(volume_named(name), MEDIA[kind], camera, precision=precision)
        off = np.abs(image.intensity - exact).max(axis=-1)
        # The "truth" itself is off by a millionth of the brightest.
        assert np.mean(off <= image.error + 1e-6 * exact.max()) >= 0.97
        assert np.median(image.error) <= 1.2e-3 * exact.max()


@pytest.mark.parametrize("name", ["noise", "blob"])
def test_bounds_contain_the_truth(name):
    volume, exact = volume_named(name), truth(name, "wide", CAMERA)
    image = vm.render(volume, MEDIA["wide"], CAMERA, bounds=True, max_panels=64)
    slack = 1e-6 * exact.max()
    assert (image.lower <= exact + slack).all()
    assert (image.upper >= exact - slack).all()
    assert (image.upper - image.lower).max() <= 0.05 * exact.max()


def test_a_shell_much_thinner_than_a_cell_has_no_seams():
    """An optical depth per crossing of √(2π) σ / |da/ds|, wherever the walls of cells are."""
    grid = random_octree(6, 3, 0.3, [np.linspace(-1, 1, 9)] * 3)
    x, y, z = grid.cell_centers()
    volume = vm.Volume(grid, a=0.6 * x - 0.5 * y + 0.8 * z)
    medium = vm.Gaussian("a", 0.013, 1e-4, [0.0], 1e3, 1.0)
    camera = vm.Orthographic(20, 10, width=0.6, resolution=100, center=(0, 0, 0))
    depth = vm.render(volume, medium, camera).optical_depth[..., 0]
    # All rays cross it alike, since the field is linear: values in single precision are off.
    assert np.ptp(depth) <= 5e-3 * depth.mean()
