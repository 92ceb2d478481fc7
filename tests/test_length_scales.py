"""A picture does not depend on the unit of length, however small or large its numbers become."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from voluminous.errors import InputError

RADII, PHI = np.array([0.1, 0.3, 0.6, 1.0]), np.linspace(0, 2 * np.pi, 5)
THETA, HEIGHTS = np.linspace(0.3, 2.9, 4), np.array([-1.0, -0.2, 0.3, 1.0])
SPLIT = [0, 1, *8 * [0]]
CORNERS = np.array([[-1, -1, -1], [-0.5, -0.5, -0.5]])
GRIDS = {
    "uniform": lambda s: vm.CartesianGrid.uniform(4, (-s, s)),
    "rectilinear": lambda s: vm.CartesianGrid(*[np.array([-1, -0.3, 0.1, 1]) * s] * 3),
    "octree": lambda s: vm.OctreeGrid(*[np.linspace(-s, s, 3)] * 3, [*SPLIT, *6 * [0]]),
    "patches": lambda s: vm.PatchGrid(CORNERS * s, -CORNERS * s, [[4, 4, 4], [4, 4, 4]]),
    "spherical": lambda s: vm.SphericalGrid(RADII * s, THETA, PHI),
    "cylindrical": lambda s: vm.CylindricalGrid(RADII * s, PHI, HEIGHTS * s),
    "refined": lambda s: vm.SphericalGrid(RADII * s, THETA, PHI, refined=[*SPLIT, *34 * [0]]),
}
CAMERAS = {
    # No ray meets an edge of a cell, where rounding would decide which side it passes.
    "orthographic": lambda s: vm.Orthographic(
        30, 20, width=2.2 * s, shift=(0.01 * s, 0.02 * s), resolution=5
    ),
    # Parallel to walls, some rays never come between.
    "along": lambda s: vm.Orthographic(0, 0, width=2.2 * s, resolution=5),
    "inside": lambda s: vm.Perspective(
        np.array([0.2, 0.1, -0.3]) * s, np.array([1, 0.3, 0]) * s, fov=80, resolution=5
    ),
}


def pictured(grid, camera, size, **options):
    volume = vm.Volume(GRIDS[grid](size))
    cells = np.random.default_rng(1).uniform(1, 9, volume.grid.size)
    volume["a"] = cells.reshape(volume.grid.shape)
    medium = vm.Gaussian("a", 5, 2, (1, 0.5), 0.3, 0.5 * size)
    return vm.render(volume, medium, CAMERAS[camera](size), **options)


@pytest.mark.exhaustive
@pytest.mark.parametrize("precision", ["single"])
@pytest.mark.parametrize("scheme", ["post-classified", "second-order", "first-order"])
@pytest.mark.parametrize("grid", GRIDS)
def test_a_picture_is_the_same_in_all_units(grid, scheme, precision):
    most = 1e-5 if precision == "single" else 1e-11
    for camera in CAMERAS if grid == "uniform" else ["orthographic"]:
        expected, *others = (
            pictured(grid, camera, size, scheme=scheme, precision=precision)
            for size in (1.0, 1e-99, 1e31, 1e99)
        )
        assert expected.intensity.max() > 0.3
        for found in others:
            np.testing.assert_allclose(found.intensity, expected.intensity, rtol=0, atol=most)
            np.testing.assert_allclose(found.optical_depth, expected.optical_depth, atol=most)


@pytest.mark.parametrize("grid", ["uniform", "octree"])
def test_bounds_are_the_same_in_all_units(grid):
    expected, *others = (
        pictured(grid, "orthographic", size, precision="double", bounds=True)
        for size in (1.0, 1e-99, 1e31, 1e99)
    )
    for found in others:
        np.testing.assert_allclose(found.lower, expected.lower, atol=1e-11)
        np.testing.assert_allclose(found.upper, expected.upper, atol=1e-11)
        assert (found.upper - found.lower).max() < 1e-2


@pytest.mark.parametrize("precision", ["single"])
@pytest.mark.parametrize("size", [1e29, 1e31, 1e99])
def test_a_path_is_as_long_as_it_is(size, precision):
    volume = vm.Volume(vm.CartesianGrid.uniform(4, (-size, size)), a=np.ones((4, 4, 4)))
    camera = vm.Orthographic(30, 20, width=0.5 * size, resolution=3)
    image = vm.render(volume, vm.Coefficients("a", 0), camera, precision=precision, bounds=True)
    exact = 2 / np.cos(np.radians(30))
    assert image.intensity[1, 1, 0] / size == pytest.approx(exact, rel=1e-6)
    assert image.lower[1, 1, 0] / size == pytest.approx(exact, rel=1e-6)
    assert np.isfinite(image.error).all()


def test_objects_are_at_their_depth_in_all_units():
    def image(size):
        volume = vm.Volume(vm.CartesianGrid.uniform(4, (-size, size)), a=np.ones((4, 4, 4)))
        star = vm.Spheres([[0, 0, 0]], 0.3 * size, 1.0)
        medium = vm.Gaussian("a", 1, 1, 0.3, 1, size)
        return vm.render(volume, medium, CAMERAS["orthographic"](size), objects=[star]).intensity

    np.testing.assert_allclose(image(1e99), image(1.0), atol=1e-5)


@pytest.mark.parametrize("size", [1e-300, 1e-101, 1e101, 1e300])
@pytest.mark.parametrize("grid", GRIDS)
def test_lengths_that_cannot_be_multiplied_are_refused(grid, size):
    with pytest.raises(InputError, match=r"1e-100 and 1e\+100 long.*runs from.*another unit"):
        GRIDS[grid](size)
