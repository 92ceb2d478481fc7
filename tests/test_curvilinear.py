"""Spherical and cylindrical grids: the contract, closed forms, and rays that are hard."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from curvilinear_rays import (
    CurvilinearContract,
    adversarial_rays,
    check_adversarial,
    check_ends_inside_cells,
    sums,
)
from twin.curvilinear import Frame, way_inside
from voluminous.backend import get_backend
from voluminous.geometry import unit_vectors

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
    "cylinder": vm.CylindricalGrid(np.linspace(0, 10, 8), CIRCLE, np.linspace(-5, 7, 6)),
    "tube": vm.CylindricalGrid(np.geomspace(1, 10, 8), CIRCLE + 0.3, [-5, -4, 0, 1, 5]),
    "slice": vm.CylindricalGrid(np.geomspace(1, 10, 8), np.linspace(0.5, 1.9, 6), [0, 1, 4]),
    "all but a slice": vm.CylindricalGrid([0, 1, 4, 5], np.linspace(-1, 4.5, 8), [-1, 0, 4]),
    "disc": vm.CylindricalGrid([0, 1, 4, 5], [0, 2 * pi], [-1, 0, 4]),
    "wide": vm.CylindricalGrid([0, 1, 4, 5], [-1, -0.5, 3.7], [-1, 0, 4]),
    "wide, closed": vm.CylindricalGrid([1, 4, 5], [0.3, 4.2, 0.3 + 2 * pi], [-1, 0, 4]),
    "nearly all in one": vm.CylindricalGrid([0, 1, 4, 5], [0.1, 6.2], [-1, 0, 4]),
    "flat and far": vm.CylindricalGrid([3, 4, 5], CIRCLE, [99.9, 100, 100.1]),
}
PRECISIONS = pytest.mark.parametrize("precision", ["single", "double"])


class TestCurvilinear(CurvilinearContract):
    @pytest.fixture(
        params=["all but a wedge", "open cones", "mirrored", "a wide cell", "cylinder", "all but a "
                "slice", "wide", "wide, closed"]
    )  # fmt: skip
    def grid(self, request):
        return GRIDS[request.param]


@pytest.mark.each_value_once
@PRECISIONS
@pytest.mark.parametrize("name", GRIDS)
def test_hard_rays_neither_hang_nor_leak(name, precision):
    grid, backend = GRIDS[name], get_backend("cpu", precision)
    check_adversarial(grid, backend, *adversarial_rays(grid, 3 * grid.edges[0][-1]))


@PRECISIONS
@pytest.mark.parametrize("name", ["all but a wedge", "all but a slice"])
def test_many_rays_find_their_way(name, precision):
    grid, backend = GRIDS[name], get_backend("cpu", precision)
    rng, reach = np.random.default_rng(3), 0.7 * GRIDS[name].edges[0][-1]
    directions = rng.normal(size=(10**5, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = rng.uniform(-reach, reach, size=(10**5, 3)) - 30 * directions
    found = sums(grid, backend, origins, directions)
    assert found.steps.max() < 2 * sum(grid.shape)
    assert found.shortest.min() >= 0
    off = np.abs(found.length - way_inside(Frame.of(grid), origins, directions)) / 10
    # A wall met at a small angle is met the later, or earlier: few rays, and by chance.
    assert np.quantile(off, 0.99) < 16 * np.finfo(backend.dtype).eps
    assert off.max() < (1e-12 if precision == "double" else 1e-3)


@PRECISIONS
def test_columns_through_shells_and_tubes(precision):
    """Σ κ_i (chord in r_i+1 - chord in r_i), whatever the angles do; tilted tubes: over sin i."""
    kappa = np.random.default_rng(0).random(8)
    tubes = vm.CylindricalGrid(RADII, CIRCLE, np.linspace(-50, 50, 6))
    for grid, incl, rows in ((GRIDS["cavity"], 40, 41), (tubes, 90, 5), (tubes, 60, 5)):
        volume = vm.Volume(grid, a=np.broadcast_to(kappa[:, None, None], grid.shape))
        camera = vm.Orthographic(incl, 70, 10 * (rows == 41), width=20, resolution=(41, rows))
        options = {"scheme": "first-order", "precision": precision, "cutoff": 0}
        image = vm.render(volume, vm.Coefficients(0, "a"), camera, **options)
        b2 = image.x[None, :] ** 2 + image.y[:, None] ** 2 * (grid is not tubes)
        chord = 2 * np.sqrt(np.maximum(RADII[:, None, None] ** 2 - b2, 0))
        expected = np.tensordot(kappa, np.diff(chord, axis=0), axes=1)
        expected = expected / (np.sin(np.radians(incl)) if grid is tubes else 1.0)
        atol = (2e-13 if precision == "double" else 1e-5) * expected.max()
        found = image.optical_depth[..., 0]
        np.testing.assert_allclose(found, expected + 0 * found, rtol=0, atol=atol)


def chord_between(grid, origin, direction, precision="double", **limits):
    """Return the length of one ray in a grid."""
    rays = [np.array([v], float) for v in (origin, direction)]
    return sums(grid, get_backend("cpu", precision), *rays, **limits).length[0]


def test_cones_cut_a_horizontal_line_at_their_radius():
    """At height 1 the cone of 60° is crossed at R = tan 60°."""
    half, whole = np.sqrt(np.tan(pi / 3) ** 2 - 0.3**2), np.sqrt(100 - 1 - 0.3**2)
    ways = {(0, pi / 3, pi): whole, (0, pi / 3): half, (pi / 3, pi): whole - half}
    for theta, way in ways.items():
        grid = vm.SphericalGrid([0, 10], theta)
        assert chord_between(grid, [-20, 0.3, 1], [1, 0, 0]) == pytest.approx(2 * way, rel=1e-14)


SLANT = np.array([np.sin(pi / 6), 0, np.cos(pi / 6)])
ALONG_WALLS = {
    vm.SphericalGrid(RADII, np.linspace(0, pi, 7), CIRCLE): [
        ([0, 0, -30], [0, 0, 1], 18),  # along the axis
        ([0, 0, 30], [0, 0, -1], 18),
        ([-30, 0, 0], [1, 0, 0], 18),  # through the centre, in the midplane, along φ walls
        ([0, -30, 0], [0, 1, 0], 18),
        ([-30, 1, 0], [1, 0, 0], 2 * np.sqrt(99)),  # grazing the cavity, in the midplane
        ([-30, 10, 0], [1, 0, 0], 0),  # grazing the outermost sphere
        ([1, 0, -30], [0, 0, 1], 2 * np.sqrt(99)),  # parallel to the axis, in a φ wall
        (-30 * SLANT, SLANT, 18),
    ],
    vm.CylindricalGrid(RADII, CIRCLE, [-5, 0, 5]): [
        ([0, 0, -30], [0, 0, 1], 0),  # along the axis, in the hole
        ([1, 0, -30], [0, 0, 1], 10),  # along the hole's wall
        ([5, 0, -30], [0, 0, -1], 10),  # parallel to the axis, in a φ wall
        ([11, 0, -30], [0, 0, 1], 0),
        ([-30, 0, 0], [1, 0, 0], 18),  # through the axis, in a plane of z and one of φ
        ([-30, 0, 5.1], [1, 0, 0], 0),
        ([-30, 1, 0.5], [1, 0, 0], 2 * np.sqrt(99)),  # grazing the hole
    ],
}


@PRECISIONS
@pytest.mark.parametrize("grid", ALONG_WALLS, ids=lambda grid: grid.kind)
def test_lines_along_walls_have_their_length(grid, precision):
    for origin, direction, way in ALONG_WALLS[grid]:
        found = chord_between(grid, origin, direction, precision)
        # What grazes a sphere within rounding ε may gain 2 sqrt(2 ε R).
        slack = 0.03 if way == 0 else 1e-11 if precision == "double" else 2e-4
        assert found == pytest.approx(way, abs=slack)


@pytest.mark.each_value_once
@PRECISIONS
@pytest.mark.parametrize("name", ["cavity", "all but a wedge", "mirrored"])
def test_rays_that_end_inside_a_cell_see_what_is_there(name, precision):
    check_ends_inside_cells(GRIDS[name], precision)


def picture(grid, scheme, camera, **fields):
    """Return the intensities of j and a."""
    medium = vm.Coefficients("j", "a")
    return vm.render(
        vm.Volume(grid, **fields), medium, camera, scheme=scheme, precision="double"
    ).intensity


@pytest.mark.parametrize("scheme", ["first-order", "second-order", "post-classified"])
def test_cells_wider_than_half_a_circle_are_two_of_half_the_width(scheme):
    """Rays leave such a cell and come back into it; where values depend on R and z alone."""
    values, images = np.random.default_rng(0).random((2, 3, 1, 2)), []
    camera = vm.Orthographic(80, 120, width=11, resolution=24)
    for edges in ([0, 1.5 * pi], [0, 0.75 * pi, 1.5 * pi]):
        grid = vm.CylindricalGrid([0, 1, 4, 5], edges, [-1, 0, 4])
        j, a = np.repeat(values, len(edges) - 1, axis=2)
        images.append(picture(grid, scheme, camera, j=j, a=a))
    # The default scheme keeps to a tolerance: its panels may end elsewhere.
    tolerance = 2e-3 if scheme == "post-classified" else 1e-12
    np.testing.assert_allclose(*images, rtol=0, atol=tolerance * images[0].max())


def test_the_mirror_image_is_what_it_says():
    theta = np.linspace(0.6, pi / 2, 6)
    whole = vm.SphericalGrid(RADII, np.append(theta, pi - theta[-2::-1]), CIRCLE)
    folded = vm.SphericalGrid(RADII, theta, CIRCLE, mirror=True)
    values = np.random.default_rng(1).random(folded.shape)
    both = np.concatenate([values, values[:, ::-1]], axis=1)
    camera = vm.Orthographic(70, 20, width=20, resolution=24)
    for scheme in ("first-order", "second-order"):
        a, b = (
            picture(grid, scheme, camera, a=f, j=f) for grid, f in ((folded, values), (whole, both))
        )
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-13)
    np.testing.assert_allclose(folded.cell_volumes.sum(), whole.cell_volumes.sum(), rtol=1e-14)


@pytest.mark.parametrize(("scheme", "order"), [("first-order", 1), ("second-order", 2)])
def test_order_of_convergence(scheme, order):
    """Cell averages of a smooth medium: the error falls with the cells' width to that power."""

    def image(n):
        axes = [(1, 2, n), (0, pi, 2 * n), (0, 2 * pi, 4 * n)]
        grid = vm.SphericalGrid(*(np.linspace(a, b, k + 1) for a, b, k in axes))
        x, y, z = (c.reshape(grid.shape) for c in grid.cell_centers())
        camera = vm.Orthographic(50, 20, width=3, resolution=16)
        fields = {"a": 0.5 + 0.2 * x * y + 0.1 * z, "j": 1 + 0.3 * z**2}
        return picture(grid, scheme, camera, **fields)

    exact = image(64)
    errors = [np.sqrt(np.mean((image(n) - exact) ** 2)) for n in (6, 12, 24)]
    assert np.log2(np.divide(errors[:-1], errors[1:])).mean() > order - 0.25


@pytest.mark.parametrize("name", GRIDS)
def test_host_side_agrees_with_itself(name):
    grid = GRIDS[name]
    centers = grid.cell_centers()
    np.testing.assert_array_equal(grid.locate(centers.T), np.arange(grid.size))
    part = slice(3, 11) if grid.size > 11 else slice(0, grid.size)
    np.testing.assert_array_equal(grid.cell_centers(part.start, part.stop), centers[:, part])
    low, high = grid.bounds.T[:, :, None]
    assert ((centers >= low) & (centers <= high)).all()
    basis = unit_vectors(grid.coordinates, grid.native_centers())
    product = np.einsum("ikn,jkn->ijn", basis, basis)
    np.testing.assert_allclose(product - np.eye(3)[:, :, None], 0, rtol=0, atol=1e-15)
    # The grid's own coordinates grow that way.
    for k, direction in enumerate(basis):
        step = 1e-6 * grid.edges[0][-1] * direction
        assert ((grid.native((centers + step).T) - grid.native(centers.T))[k] > 0).all()
    a, b, c = ((e[0], e[-1]) for e in grid.edges)
    if grid.kind == "spherical":
        volume = (a[1] ** 3 - a[0] ** 3) / 3 * (np.cos(b[0]) - np.cos(b[1])) * (c[1] - c[0])
    else:
        volume = 0.5 * (a[1] ** 2 - a[0] ** 2) * (b[1] - b[0]) * (c[1] - c[0])
    volume *= 2 if grid.mirror else 1
    np.testing.assert_allclose(grid.cell_volumes.sum(), volume, rtol=1e-13)


def test_bounds_are_tight():
    np.testing.assert_allclose(GRIDS["cavity"].bounds, [[-10, 10]] * 3, atol=1e-14)
    np.testing.assert_allclose(GRIDS["half"].bounds, [[-3, 3], [0, 3], [0, 3]], atol=1e-14)
    cone = vm.SphericalGrid([1, 2], [0, pi / 6], [0, pi / 2])
    np.testing.assert_allclose(cone.bounds, [[0, 1], [0, 1], [np.cos(pi / 6), 2]], atol=1e-14)


def test_units():
    grid = vm.SphericalGrid([1, 2] * u.au, [0, 90, 180] * u.deg, [0, 360] * u.deg)
    assert grid.unit == u.au
    np.testing.assert_allclose(grid.edges[1], [0, pi / 2, pi], rtol=1e-15)
    assert vm.SphericalGrid([1, 2], unit="pc").unit == u.pc
    mixed = vm.CylindricalGrid([1, 2] * u.km, [0, 1], [-1, 1] * u.m)
    np.testing.assert_allclose(mixed.edges[2], [-1e-3, 1e-3])
    with pytest.raises(vm.UnitsError, match="theta edges is in cm"):
        vm.SphericalGrid([1, 2], [0, 1] * u.cm)


def test_angles_in_single_precision_still_close():
    angles = [np.linspace(0, end, 5, dtype=np.float32) for end in (pi, 2 * pi)]
    grid = vm.SphericalGrid([1, 2], *angles)
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
        (([1, 2], [0, 90, 180]), "give a Quantity for degrees"),
        (([1, 2], [0, pi], [0, 7]), "phi edges must span at most a full circle"),
        (([1, 2], [0, 1], [0, 1], True), "mirror=True needs a last theta edge at the midplane"),
        (([1, 2], [0, pi / 2], [0, 1], "no"), "mirror must be True or False"),
    ],
)
def test_edges_that_cannot_be_used(arguments, told):
    mirror = {"mirror": arguments[3]} if len(arguments) > 3 else {}
    with pytest.raises(vm.InputError, match=told):
        vm.SphericalGrid(*arguments[:3], **mirror)


def test_double_precision_is_taken_where_cells_need_it():
    assert not vm.SphericalGrid(np.geomspace(1e-6, 1e6, 200)).needs_double()
    assert vm.SphericalGrid([1, 1.00001, 2]).needs_double()
    assert vm.SphericalGrid([1, 2], [0, 1, 1.00001]).needs_double()
    assert vm.CylindricalGrid([1, 1.00001], [0, 1], [0, 1]).needs_double()


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
