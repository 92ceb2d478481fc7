"""Refined spherical and cylindrical grids: octrees in their own coordinates."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from contracts.grid import RaysFromAnywhere
from curvilinear_rays import (
    adversarial_rays,
    check_adversarial,
    check_ends_inside_cells,
)
from random_trees import random_flags
from twin.camera import Camera
from twin.curvilinear import Frame
from twin.curvilinear_refined import Leaves, render_refined
from voluminous.backend import get_backend

PI = np.pi
CIRCLE = np.linspace(0, 2 * PI, 7)
RADII = [1.0, 3.0, 6.0, 10.0]


def refined(kind, *edges, **options):
    """Return a grid with a random tree."""
    base = kind(*edges, **options)
    closing = [len(e) == 2 and np.ptp(e) > 3.1 for e in base.edges[:2]] + [False]
    if kind is vm.SphericalGrid:
        closing = [False, *(len(e) == 2 and np.ptp(e) > 3.1 for e in base.edges[1:])]
    children = 1 << (3 - sum(closing))
    return kind(*edges, refined=random_flags(base.size, children), **options)


GRIDS = {
    "full": refined(vm.SphericalGrid, [0, 3, 6, 10], np.linspace(0, PI, 5), CIRCLE),
    "open cones": refined(vm.SphericalGrid, RADII, np.linspace(0.5, 2.5, 5), CIRCLE + 0.3),
    "wedge": refined(vm.SphericalGrid, RADII, np.linspace(0, PI, 5), np.linspace(0.3, 5.5, 4)),
    "mirrored": refined(vm.SphericalGrid, RADII, np.linspace(0.4, PI / 2, 4), CIRCLE, mirror=True),
    "axisymmetric": refined(vm.SphericalGrid, RADII, np.linspace(0.4, PI, 5)),
    "radial": refined(vm.SphericalGrid, RADII),
    "cylinder": refined(vm.CylindricalGrid, RADII, CIRCLE, [-5, 0, 2, 5]),
}
CAMERAS = {
    "oblique": Camera(20, 20, (11.0, 11.0), incl=57.3, phi=33.0, posang=20.0),
    "along the axis": Camera(20, 20, (11.0, 11.0), phi=7.0),
    "inside": Camera(20, 20, (0.6, 0.6), observer=(3.0, -1.0, 2.0), point=(0.0, 2.0, 0.5)),
}


class TestRefinedRays(RaysFromAnywhere):
    @pytest.fixture(params=["open cones", "wedge", "mirrored", "cylinder"])
    def grid(self, request):
        return GRIDS[request.param]


def unrefined(grid, edges):
    """Return a grid of the same kind with these walls, not refined."""
    kind = vm.CylindricalGrid if grid.kind == "cylindrical" else vm.SphericalGrid
    return kind(*edges, **({"mirror": True} if grid.mirror else {}))


def leaves_of(grid):
    """Return the twin's view of a grid."""
    fine = Frame(grid.kind, grid.fine_edges, grid.mirror)
    even = unrefined(grid, grid.fine_edges)
    return Leaves(fine, grid.locate(even.cell_centers().T), *grid.boxes(0, grid.size))


def vm_camera(camera):
    """Return the package's camera for the twin's."""
    width, pixels = [2 * half for half in camera.half_size], (camera.nx, camera.ny)
    if camera.observer is None:
        angles = camera.incl, camera.phi, camera.posang
        return vm.Orthographic(*angles, width=width, resolution=pixels, center=(0, 0, 0))
    return vm.Perspective(camera.observer, camera.point, width=width, resolution=pixels)


def pictures(grid, camera, scheme, **options):
    """Return what the twin and the package make of random coefficients."""
    j, a = np.random.default_rng(2).random((2, grid.size))
    turn = 0.1 if grid.kind == "spherical" and scheme == "olson-kunasz" else 0.0
    expected = render_refined(leaves_of(grid), j, 0.2 * a, camera, scheme, turn)
    volume = vm.Volume(grid, j=j, a=0.2 * a)
    image = vm.render(
        volume,
        vm.Coefficients("j", "a"),
        vm_camera(camera),
        scheme=scheme,
        cutoff=0,
        **{"precision": "double", **options},
    )
    return image.intensity[..., 0], expected


@pytest.mark.each_value_once
@pytest.mark.parametrize("view", CAMERAS)
@pytest.mark.parametrize("name", GRIDS)
def test_first_order_is_the_twin(name, view):
    found, expected = pictures(GRIDS[name], CAMERAS[view], "first-order")
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * expected.max())


@pytest.mark.each_value_once
@pytest.mark.parametrize("view", ["oblique", "along the axis"])
@pytest.mark.parametrize("name", GRIDS)
def test_olson_kunasz_is_the_twin(name, view):
    """RADMC-3D's rule for vertices, the finer cell's face, and its sub-steps."""
    found, expected = pictures(GRIDS[name], CAMERAS[view], "olson-kunasz")
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * expected.max())


@pytest.mark.each_value_once
@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("name", ["full", "wedge", "mirrored", "cylinder"])
def test_rays_that_end_inside_a_leaf_see_what_is_there(name, precision):
    check_ends_inside_cells(GRIDS[name], precision)


@pytest.mark.each_value_once
@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("name", GRIDS)
def test_hard_rays_neither_hang_nor_leak(name, precision):
    grid, backend = GRIDS[name], get_backend("cpu", precision)
    # Vertices of the base cells: levels meet there too.
    check_adversarial(grid, backend, *adversarial_rays(grid, 3 * grid.edges[0][-1]))


@pytest.mark.parametrize("name", GRIDS)
def test_host_side_agrees_with_itself(name):
    grid = GRIDS[name]
    base = unrefined(grid, grid.edges)
    assert grid.shape == (grid.size,) == grid.levels.shape
    assert sum(grid.cells_per_level) == grid.size
    np.testing.assert_allclose(grid.cell_volumes.sum(), base.cell_volumes.sum(), rtol=1e-13)
    np.testing.assert_array_equal(grid.locate(grid.cell_centers().T), np.arange(grid.size))
    np.testing.assert_array_equal(grid.cell_centers(3, 5), grid.cell_centers()[:, 3:5])
    assert (grid.locate([[99.0, 0, 0]]) == -1).all()
    told = grid.describe()
    assert told["cells_per_level"] == list(grid.cells_per_level)
    assert f"{grid.size} cells" in repr(grid)


def test_leaves_are_in_radmc3ds_order():
    """Base cells with r fastest; children with r fastest, then θ, then φ."""
    flags = [0, 1, *8 * [0], 0, 0, 0, 0, 0, 0]
    grid = vm.SphericalGrid([1, 2, 4], [0, PI / 2, PI], [0, PI, 2 * PI], refined=flags)
    r, theta, phi = grid.native_centers()
    np.testing.assert_allclose(r[:3], [1.5, 2.5, 3.5])
    np.testing.assert_allclose(theta[1:5], np.array([1, 1, 3, 3]) * PI / 8)
    np.testing.assert_allclose(phi[1:9], np.repeat([PI / 4, 3 * PI / 4], 4))


@pytest.mark.parametrize(
    ("flags", "told"),
    [
        ([0, 0], "too few flags"),
        ([1, 0, 0, 0], "too few flags"),
        ([0, 0, 2], "refined must be 0 or 1"),
    ],
)
def test_flags_that_cannot_be(flags, told):
    with pytest.raises(vm.InputError, match=told):
        vm.SphericalGrid(RADII, refined=flags)
