"""Cylindrical grids: the contract, closed forms, and rays that are hard."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from curvilinear_rays import CurvilinearContract, adversarial_rays, check_adversarial, sums
from twin.curvilinear import Frame, way_inside
from voluminous.backend import get_backend

pi = np.pi
CIRCLE = np.linspace(0, 2 * pi, 13)
GRIDS = {
    "full": vm.CylindricalGrid(np.linspace(0, 10, 8), CIRCLE, np.linspace(-5, 7, 6)),
    "hole": vm.CylindricalGrid(np.geomspace(1, 10, 8), CIRCLE + 0.3, [-5, -4, 0, 1, 5]),
    "wedge": vm.CylindricalGrid(np.geomspace(1, 10, 8), np.linspace(0.5, 1.9, 6), [0, 1, 4]),
    "all but a wedge": vm.CylindricalGrid([0, 1, 4, 5], np.linspace(-1, 4.5, 8), [-1, 0, 4]),
    "axisymmetric": vm.CylindricalGrid([0, 1, 4, 5], [0, 2 * pi], [-1, 0, 4]),
    "a wide cell": vm.CylindricalGrid([0, 1, 4, 5], [-1, -0.5, 3.7], [-1, 0, 4]),
    "a wide cell, closed": vm.CylindricalGrid([1, 4, 5], [0.3, 4.2, 0.3 + 2 * pi], [-1, 0, 4]),
    "nearly all in one": vm.CylindricalGrid([0, 1, 4, 5], [0.1, 6.2], [-1, 0, 4]),
    "flat and far": vm.CylindricalGrid([3, 4, 5], CIRCLE, [99.9, 100, 100.1]),
}


class TestCylindrical(CurvilinearContract):
    @pytest.fixture(params=["full", "all but a wedge", "a wide cell", "a wide cell, closed"])
    def grid(self, request):
        return GRIDS[request.param]


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("name", GRIDS)
def test_hard_rays_neither_hang_nor_leak(name, precision):
    grid, backend = GRIDS[name], get_backend("cpu", precision)
    check_adversarial(grid, backend, *adversarial_rays(grid, 3 * grid.edges[0][-1]))


@pytest.mark.parametrize("precision", ["single", "double"])
def test_many_rays_find_their_way(precision):
    grid, backend = GRIDS["all but a wedge"], get_backend("cpu", precision)
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(10**5, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = rng.uniform(-4, 4, size=(10**5, 3)) - 30 * directions
    found = sums(grid, backend, origins, directions)
    assert found.steps.max() < 2 * sum(grid.shape)
    assert found.shortest.min() >= 0
    off = np.abs(found.length - way_inside(Frame.of(grid), origins, directions)) / 10
    eps = np.finfo(backend.dtype).eps
    assert np.quantile(off, 0.99) < 16 * eps
    assert off.max() < (1e-12 if precision == "double" else 1e-3)


@pytest.mark.parametrize("scheme", ["first-order", "second-order", "post-classified"])
def test_cells_wider_than_half_a_circle_are_two_of_half_the_width(scheme):
    """Rays leave such a cell and come back into it; where values depend on R and z alone."""
    values = np.random.default_rng(0).random((2, 3, 1, 2))
    images = []
    for edges in ([0, 1.5 * pi], [0, 0.75 * pi, 1.5 * pi]):
        grid = vm.CylindricalGrid([0, 1, 4, 5], edges, [-1, 0, 4])
        j, a = np.repeat(values, len(edges) - 1, axis=2)
        camera = vm.Orthographic(80, 120, width=11, resolution=24)
        volume, medium = vm.Volume(grid, j=j, a=a), vm.Coefficients("j", "a")
        image = vm.render(volume, medium, camera, scheme=scheme, precision="double")
        images.append(image.intensity)
    # The default scheme keeps to a tolerance: its panels may end elsewhere.
    tolerance = 2e-3 if scheme == "post-classified" else 1e-12
    np.testing.assert_allclose(*images, rtol=0, atol=tolerance * images[0].max())


@pytest.mark.parametrize("precision", ["single", "double"])
def test_column_through_tubes_seen_from_the_side(precision):
    """Σ κ_i (chord in R_i+1 - chord in R_i), at any height and azimuth; tilted: over sin i."""
    R, kappa = np.geomspace(1, 10, 9), np.random.default_rng(0).random(8)
    grid = vm.CylindricalGrid(R, CIRCLE, np.linspace(-50, 50, 6))
    volume = vm.Volume(grid, a=np.broadcast_to(kappa[:, None, None], grid.shape))
    for incl in (90, 60):
        camera = vm.Orthographic(incl, 20, width=20, resolution=(41, 5))
        image = vm.render(
            volume,
            vm.Coefficients(0, "a"),
            camera,
            scheme="first-order",
            precision=precision,
            cutoff=0,
        )
        chord = 2 * np.sqrt(np.maximum(R[:, None] ** 2 - image.x**2, 0)) / np.sin(np.radians(incl))
        expected = np.broadcast_to(kappa @ np.diff(chord, axis=0), image.shape[:2])
        tolerance = 2e-13 if precision == "double" else 1e-5
        np.testing.assert_allclose(
            image.optical_depth[..., 0], expected, rtol=0, atol=tolerance * expected.max()
        )


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize(
    ("origin", "direction", "way"),
    [
        ([0, 0, -30], [0, 0, 1], 0),  # along the axis, in the hole
        ([1, 0, -30], [0, 0, 1], 10),  # along the hole's wall
        ([5, 0, -30], [0, 0, -1], 10),  # parallel to the axis, in a φ wall
        ([11, 0, -30], [0, 0, 1], 0),
        ([-30, 0, 0], [1, 0, 0], 18),  # through the axis, in a plane of z and one of φ
        ([-30, 0, 5.1], [1, 0, 0], 0),
        ([-30, 1, 0.5], [1, 0, 0], 2 * np.sqrt(99)),  # grazing the hole
    ],
)
def test_lines_along_walls_have_their_length(origin, direction, way, precision):
    grid = vm.CylindricalGrid(np.geomspace(1, 10, 9), CIRCLE, [-5, 0, 5])
    rays = [np.array([v], float) for v in (origin, direction)]
    found = sums(grid, get_backend("cpu", precision), *rays).length[0]
    assert found == pytest.approx(way, abs=1e-12 if precision == "double" else 2e-5)


@pytest.mark.parametrize("name", GRIDS)
def test_host_side_agrees_with_itself(name):
    grid = GRIDS[name]
    centers = grid.cell_centers()
    np.testing.assert_array_equal(grid.locate(centers.T), np.arange(grid.size))
    low, high = grid.bounds.T[:, :, None]
    assert ((centers >= low) & (centers <= high)).all()
    basis, step = grid.basis(), 1e-6
    for k, direction in enumerate(basis):
        ahead = grid.native((centers + step * direction).T) - grid.native(centers.T)
        assert (ahead[k] > 0).all()
    R, phi, z = grid.edges
    volume = 0.5 * (R[-1] ** 2 - R[0] ** 2) * (phi[-1] - phi[0]) * (z[-1] - z[0])
    np.testing.assert_allclose(grid.cell_volumes.sum(), volume, rtol=1e-13)
    np.testing.assert_allclose(
        np.prod(grid.cell_sizes(), axis=0), grid.cell_volumes.ravel(), rtol=1e-12
    )


def test_units():
    from astropy import units as u

    grid = vm.CylindricalGrid([1, 2] * u.au, [0, 360] * u.deg, [-1, 1] * u.au)
    assert grid.unit == u.au
    mixed = vm.CylindricalGrid([1, 2] * u.km, [0, 1], [-1, 1] * u.m)
    np.testing.assert_allclose(mixed.edges[2], [-1e-3, 1e-3])
    with pytest.raises(vm.UnitsError, match="z edges is in s"):
        vm.CylindricalGrid([1, 2] * u.km, [0, 1], [-1, 1] * u.s)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (([-1, 1], [0, 1], [0, 1]), "R edges must not be negative"),
        (([0, 1], [0, 7], [0, 1]), "phi edges must span at most a full circle"),
        (([0, 1], [0, 1], [1, 0]), "z edges must increase strictly"),
        (([0, 1], [0, 1], 3), "z edges must be a 1-D array"),
    ],
)
def test_edges_that_cannot_be_used(arguments, told):
    with pytest.raises(vm.InputError, match=told):
        vm.CylindricalGrid(*arguments)
