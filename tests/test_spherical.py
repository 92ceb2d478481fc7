"""Spherical grids: the contract, closed forms, and rays that are hard."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from curvilinear_rays import (
    CurvilinearContract,
    adversarial_rays,
    check_adversarial,
    check_ends_inside_cells,
    sums,
)
from voluminous.backend import get_backend

pi = np.pi
CIRCLE = np.linspace(0, 2 * pi, 13)
RADII = np.geomspace(1, 10, 9)
GRIDS = {
    "full": vm.SphericalGrid(np.linspace(0, 10, 8), np.linspace(0, pi, 7), CIRCLE),
    "cavity": vm.SphericalGrid(RADII, np.linspace(0, pi, 7), CIRCLE + 0.3),
    "wedge": vm.SphericalGrid(RADII, np.linspace(0, pi, 7), np.linspace(0.5, 1.9, 6)),
    "all but a wedge": vm.SphericalGrid(RADII, np.linspace(0, pi, 6), np.linspace(-1, 4.5, 8)),
    "open cones": vm.SphericalGrid(RADII, np.linspace(0.4, 2.5, 9), CIRCLE),
    "mirrored": vm.SphericalGrid(RADII, np.linspace(0.6, pi / 2, 6), CIRCLE, mirror=True),
    "mirrored ball": vm.SphericalGrid([0, 1, 3], np.linspace(0, pi / 2, 5), CIRCLE, mirror=True),
    "axisymmetric": vm.SphericalGrid(RADII, np.linspace(0.2, 2.0, 6)),
    "radial": vm.SphericalGrid(RADII),
    "half": vm.SphericalGrid([0, 2, 3], [0, 0.5, pi / 2], np.linspace(0, pi, 4)),
    "one ball": vm.SphericalGrid([0, 2]),
    "a wide cell": vm.SphericalGrid(RADII, np.linspace(0.4, 2.5, 9), [-1, -0.5, 3.7]),
}


class TestSpherical(CurvilinearContract):
    @pytest.fixture(params=["all but a wedge", "open cones", "mirrored", "a wide cell"])
    def grid(self, request):
        return GRIDS[request.param]


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("name", GRIDS)
def test_hard_rays_neither_hang_nor_leak(name, precision):
    grid, backend = GRIDS[name], get_backend("cpu", precision)
    check_adversarial(grid, backend, *adversarial_rays(grid, 3 * grid.edges[0][-1]))


@pytest.mark.parametrize("precision", ["single", "double"])
def test_column_through_shells_at_an_impact_parameter(precision):
    """Σ κ_i (chord in r_i+1 - chord in r_i), whatever θ and φ do."""
    grid = GRIDS["cavity"]
    kappa = np.random.default_rng(0).random(grid.shape[0])
    volume = vm.Volume(grid, a=np.broadcast_to(kappa[:, None, None], grid.shape))
    camera = vm.Orthographic(40, 70, 10, width=20, resolution=41)
    image = vm.render(
        volume, vm.Coefficients(0, "a"), camera, scheme="first-order", precision=precision, cutoff=0
    )
    b2 = image.x[None, :] ** 2 + image.y[:, None] ** 2
    chord = 2 * np.sqrt(np.maximum(grid.edges[0][:, None, None] ** 2 - b2, 0))
    expected = np.tensordot(kappa, np.diff(chord, axis=0), axes=1)
    tolerance = 2e-14 if precision == "double" else 4e-6
    np.testing.assert_allclose(
        image.optical_depth[..., 0], expected, rtol=0, atol=tolerance * expected.max()
    )


def chord_between(grid, origin, direction, precision="double", **limits):
    """Return the length of one ray in a grid."""
    backend = get_backend("cpu", precision)
    rays = [np.array([v], float) for v in (origin, direction)]
    return sums(grid, backend, *rays, **limits).length[0]


def test_cones_cut_a_horizontal_line_at_their_radius():
    """At height 1 the cone of 60° is crossed at R = tan 60°."""
    grid = vm.SphericalGrid([0, 10], [0, pi / 3, pi])
    cone = vm.SphericalGrid([0, 10], [0, pi / 3])
    outside = vm.SphericalGrid([0, 10], [pi / 3, pi])
    y = 0.3
    half = np.sqrt(np.tan(pi / 3) ** 2 - y**2)
    whole = np.sqrt(100 - 1 - y**2)
    line = [-20, y, 1], [1, 0, 0]
    assert chord_between(grid, *line) == pytest.approx(2 * whole, rel=1e-14)
    assert chord_between(cone, *line) == pytest.approx(2 * half, rel=1e-14)
    assert chord_between(outside, *line) == pytest.approx(2 * (whole - half), rel=1e-14)


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize(
    ("origin", "direction", "way"),
    [
        ([0, 0, -30], [0, 0, 1], 18),  # along the axis
        ([0, 0, 30], [0, 0, -1], 18),
        ([-30, 0, 0], [1, 0, 0], 18),  # through the centre, in the midplane, along φ walls
        ([0, -30, 0], [0, 1, 0], 18),
        ([-30, 1, 0], [1, 0, 0], 2 * np.sqrt(99)),  # grazing the cavity, in the midplane
        ([-30, 10, 0], [1, 0, 0], 0),  # grazing the outermost sphere
        ([1, 0, -30], [0, 0, 1], 2 * np.sqrt(99)),  # parallel to the axis, in a φ wall
        ([-30 * np.sin(pi / 6), 0, -30 * np.cos(pi / 6)], [np.sin(pi / 6), 0, np.cos(pi / 6)], 18),
    ],
)
def test_lines_along_walls_have_their_length(origin, direction, way, precision):
    grid = vm.SphericalGrid(RADII, np.linspace(0, pi, 7), CIRCLE)
    tolerance = 1e-12 if precision == "double" else 2e-5
    found = chord_between(grid, origin, direction, precision)
    # What grazes a sphere within rounding ε may gain 2 sqrt(2 ε R).
    slack = 0.03 if way == 0 else 10 * tolerance
    assert found == pytest.approx(way, abs=slack)


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize(
    ("observer", "way"), [([0, 0, 0], 9), ([0.5, 0, 0], 9), ([2, 0, 0], 8), ([-2, 0, 0], 10)]
)
def test_observers_inside_see_what_is_ahead(observer, way, precision):
    first = np.zeros(1)
    found = chord_between(GRIDS["cavity"], observer, [1, 0, 0], precision, first=first)
    assert found == pytest.approx(way, rel=1e-6 if precision == "single" else 1e-14)
    last = chord_between(GRIDS["cavity"], observer, [-1, 0, 0], precision, last=first)
    assert last == pytest.approx(way, rel=1e-6 if precision == "single" else 1e-14)


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("name", ["cavity", "all but a wedge", "mirrored"])
def test_rays_that_end_inside_a_cell_see_what_is_there(name, precision):
    check_ends_inside_cells(GRIDS[name], precision)


def test_the_mirror_image_is_what_it_says():
    theta = np.linspace(0.6, pi / 2, 6)
    whole = vm.SphericalGrid(RADII, np.append(theta, pi - theta[-2::-1]), CIRCLE)
    folded = vm.SphericalGrid(RADII, theta, CIRCLE, mirror=True)
    values = np.random.default_rng(1).random(folded.shape)
    both = np.concatenate([values, values[:, ::-1]], axis=1)
    camera = vm.Orthographic(70, 20, width=20, resolution=24)
    for scheme in ("first-order", "second-order"):
        a, b = (
            vm.render(
                vm.Volume(grid, a=field),
                vm.Coefficients("a", "a"),
                camera,
                scheme=scheme,
                precision="double",
            ).intensity
            for grid, field in ((folded, values), (whole, both))
        )
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-13)
    np.testing.assert_allclose(folded.cell_volumes.sum(), whole.cell_volumes.sum(), rtol=1e-14)


@pytest.mark.parametrize(("scheme", "order"), [("first-order", 1), ("second-order", 2)])
def test_order_of_convergence(scheme, order):
    """Cell averages of a smooth medium: the error falls with the cells' width to that power."""

    def image(n):
        grid = vm.SphericalGrid(
            np.linspace(1, 2, n + 1),
            np.linspace(0, pi, 2 * n + 1),
            np.linspace(0, 2 * pi, 4 * n + 1),
        )
        x, y, z = (c.reshape(grid.shape) for c in grid.cell_centers())
        a = 0.5 + 0.2 * x * y + 0.1 * z
        volume = vm.Volume(grid, a=a, j=1 + 0.3 * z**2)
        camera = vm.Orthographic(50, 20, width=3, resolution=16)
        return vm.render(
            volume, vm.Coefficients("j", "a"), camera, scheme=scheme, precision="double"
        ).intensity

    exact = image(64)
    errors = [np.sqrt(np.mean((image(n) - exact) ** 2)) for n in (6, 12, 24)]
    slopes = np.log2(np.divide(errors[:-1], errors[1:]))
    assert slopes.mean() > order - 0.25


@pytest.mark.parametrize("name", GRIDS)
def test_host_side_agrees_with_itself(name):
    grid = GRIDS[name]
    centers = grid.cell_centers()
    np.testing.assert_array_equal(grid.locate(centers.T), np.arange(grid.size))
    part = slice(3, 11) if grid.size > 11 else slice(0, grid.size)
    np.testing.assert_array_equal(grid.cell_centers(part.start, part.stop), centers[:, part])
    low, high = grid.bounds.T[:, :, None]
    assert ((centers >= low) & (centers <= high)).all()
    basis = grid.basis()
    np.testing.assert_allclose(
        np.einsum("ikn,jkn->ijn", basis, basis),
        np.eye(3)[:, :, None] + np.zeros(grid.size),
        rtol=0,
        atol=1e-15,
    )
    # Azimuth, polar angle and radius grow that way.
    step = 1e-6 * grid.edges[0][-1]
    for k, direction in enumerate(basis):
        ahead = grid.native((centers + step * direction).T) - grid.native(centers.T)
        assert (ahead[k] > 0).all()
    assert grid.levels.shape == grid.shape
    assert not grid.levels.any()
    thin = np.prod(grid.cell_sizes(), axis=0).reshape(grid.shape)
    if grid.shape[0] == 8 and min(grid.shape) > 4:  # cells small enough
        np.testing.assert_allclose(
            thin,
            np.ravel(grid.cell_volumes).reshape(thin.shape) / (2 if grid.mirror else 1),
            rtol=0.3,
        )


def test_volumes_are_exact():
    grid = GRIDS["wedge"]
    np.testing.assert_allclose(grid.cell_volumes.sum(), 1.4 / 3 * 2 * (10**3 - 1), rtol=1e-14)
    assert GRIDS["one ball"].cell_volumes.item() == pytest.approx(4 / 3 * pi * 8, rel=1e-15)


def test_bounds_are_tight():
    np.testing.assert_allclose(GRIDS["cavity"].bounds, [[-10, 10]] * 3, atol=1e-14)
    np.testing.assert_allclose(GRIDS["half"].bounds, [[-3, 3], [0, 3], [0, 3]], atol=1e-14)
    cone = vm.SphericalGrid([1, 2], [0, pi / 6], [0, pi / 2])
    np.testing.assert_allclose(cone.bounds, [[0, 1], [0, 1], [np.cos(pi / 6), 2]], atol=1e-14)


def test_units():
    from astropy import units as u

    grid = vm.SphericalGrid([1, 2] * u.au, [0, 90, 180] * u.deg, [0, 360] * u.deg)
    assert grid.unit == u.au
    np.testing.assert_allclose(grid.edges[1], [0, pi / 2, pi], rtol=1e-15)
    assert grid.is_periodic
    assert vm.SphericalGrid([1, 2], unit="pc").unit == u.pc
    with pytest.raises(vm.UnitsError, match="theta edges is in cm"):
        vm.SphericalGrid([1, 2], [0, 1] * u.cm)


def test_angles_in_single_precision_still_close():
    grid = vm.SphericalGrid(
        [1, 2], np.linspace(0, pi, 5, dtype=np.float32), np.linspace(0, 2 * pi, 5, dtype=np.float32)
    )
    assert grid.is_periodic
    assert grid.edges[1][-1] == pi
    assert vm.SphericalGrid([1, 2], [0, np.float32(pi / 2)], mirror=True).mirror


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (([-1, 1],), "r edges must not be negative; the first is -1"),
        (([1, 1],), "r edges must increase strictly; edge 0 is 1 and edge 1 is 1"),
        (([1],), "r edges must be a 1-D array of at least two"),
        (([1, np.nan],), "r edges must be finite; edge 1 is nan"),
        ((["a", "b"],), "r edges must be numbers"),
        (([1, 2], [0, 4]), "theta edges must lie between 0 and pi"),
        (([1, 2], [-0.1, 1]), "theta edges must lie between 0 and pi"),
        (([1, 2], [0, 90, 180]), "give a Quantity for degrees"),
        (([1, 2], [0, pi], [0, 7]), "phi edges must span at most a full circle"),
        (([1, 2], [0, pi], [0, 360]), "give a Quantity for degrees"),
        (([1, 2], [0, pi], [1, 0]), "phi edges must increase strictly"),
    ],
)
def test_edges_that_cannot_be_used(arguments, told):
    with pytest.raises(vm.InputError, match=told):
        vm.SphericalGrid(*arguments)


def test_double_precision_is_taken_where_cells_need_it():
    assert not vm.SphericalGrid(np.geomspace(1e-6, 1e6, 200)).needs_double()
    assert vm.SphericalGrid([1, 1.00001, 2]).needs_double()
    assert vm.SphericalGrid([1, 2], [0, 1, 1.00001]).needs_double()


def test_description():
    told = GRIDS["mirrored"].describe()
    assert told["type"] == "spherical"
    assert told["extent"]["theta"] == [0.6, pi / 2]
    assert told["mirror"] is True
    assert "8x5x12 cells" in repr(GRIDS["mirrored"])
    assert "mirrored" in repr(GRIDS["mirrored"])


@pytest.mark.parametrize("refined", [None, [1] + 8 * [0] + 7 * [0]])
def test_middles_along_each_axis(refined):
    grid = vm.SphericalGrid([1, 2, 4], [0.4, 1, 2], [0, 1, 3], refined=refined)
    r, theta, phi = grid.centers
    np.testing.assert_allclose(np.stack([r, theta, phi]), [[1.5, 3], [0.7, 1.5], [0.5, 2]])
    if refined is None:
        every = np.meshgrid(r, theta, phi, indexing="ij")
        np.testing.assert_array_equal(grid.native_centers(), np.reshape(every, (3, -1)))
