"""Columns: closed forms, nothing lost at any angle, and agreement with rays and slices."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from astropy import units as u
from astropy.wcs import WCS
from hypothesis import example, given, settings
from hypothesis import strategies as st

import voluminous as vm
from twin.shadows import mean_column
from voluminous.backend import get_backend
from voluminous.measuring.exact_projection import Screen, empty_sums, project_cells, received

BACKEND = get_backend("cpu", "double")
ANGLES = st.one_of(
    st.sampled_from([0.0, 30.0, 45.0, 90.0, 1e-3, 1e-6, 180.0]), st.floats(-180, 180)
)
WALLS = np.linspace(-1, 1, 7)
UNEVEN = np.cumsum(np.random.default_rng(3).uniform(0.1, 1.0, 8)) - 2.5


def near(x, y, z, size):
    return np.sqrt((x - 0.3) ** 2 + y**2 + (z + 0.2) ** 2) < 1.5 * size


GRIDS = {
    "even": vm.CartesianGrid(WALLS, WALLS, WALLS),
    "uneven": vm.CartesianGrid(UNEVEN, WALLS, UNEVEN[:5]),
    "octree": vm.OctreeGrid.from_function(WALLS[::2], WALLS[::2], WALLS[::2], near, 5),
    "patches": vm.PatchGrid.from_boxes(
        WALLS, WALLS, WALLS, [0, 1], [[0, 0, 0], [4, 6, 2]], [[6, 6, 6], [6, 4, 8]]
    ),
}


def random_volume(kind, seed=0):
    grid = GRIDS[kind]
    return vm.Volume(grid, a=np.random.default_rng(seed).normal(size=grid.shape) ** 3)


def total(image):
    return float(image.intensity.sum() * np.prod(image.pixel_size))


@settings(max_examples=60, deadline=None)
@given(ANGLES, ANGLES, ANGLES, st.floats(0.05, 3.0), st.integers(0, 99))
@example(0.0, 0.0, 0.0, 1.0, 0)
@example(90.0, 0.0, 0.0, 0.5, 1)
@example(54.735610317245346, 45.0, 0.0, 0.5, 2)
def test_shadows_of_boxes_are_those_of_their_slices(incl, phi, posang, width, seed):
    rng = np.random.default_rng(seed)
    camera = vm.Orthographic(incl, phi, posang, width=5 * width, resolution=5, center=(0, 0, 0))
    screen = Screen.of(camera.frame(GRIDS["even"]))
    center, size = rng.uniform(-0.3, 0.3, 3), rng.uniform(0.2, 2.0, 3)
    sums = empty_sums(screen, 1)
    project_cells(screen, center[:, None], size[:, None], np.ones((1, 1)), BACKEND, sums)
    (found,) = received(screen, sums)
    place = center + np.linalg.pinv(screen.axes) @ screen.origin
    for (j, i), value in np.ndenumerate(found):
        expected = mean_column(screen.axes, place, size, np.array([i, j]), np.array([i + 1, j + 1]))
        # Directions within 3e-5 of the line of sight are left out; both lose some digits there.
        assert value == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("kind", GRIDS)
def test_nothing_is_lost_from_any_of_a_hundred_angles(kind):
    rng = np.random.default_rng(1)
    volume = random_volume(kind)
    inside = float((volume.array("a") * volume.grid.cell_volumes).sum())
    size = float(np.abs(volume.array("a") * volume.grid.cell_volumes).sum())
    for resolution in (*rng.integers(1, 40, 97), 200, 301, 2):
        direction = rng.normal(size=3)
        camera = vm.Orthographic.looking(direction, width=9.0, resolution=int(resolution))
        image = vm.column(volume, "a", camera, method="exact")
        assert abs(total(image) - inside) < 1e-13 * size  # sums of some thousand numbers


@pytest.mark.parametrize("long", [30.0, 1e5])
def test_needles_and_plates_keep_all_of_theirs(long):
    walls = np.array([0, 0.2, 1])
    needles = vm.CartesianGrid(walls, [0, 3, 4], walls * long)
    plates = vm.CartesianGrid(walls * long, walls, [0, long])
    for grid, pixels in itertools.product((needles, plates), (1, (7, 3), 33)):
        volume = vm.Volume(grid, a=np.random.default_rng(2).random(grid.shape))
        inside = float((volume.array("a") * grid.cell_volumes).sum())
        for incl, phi in ((50, 30), (120, -60)):
            # Wider than what frames the volume: rounding at its edge must not cut a needle.
            camera = vm.Orthographic(incl, phi, width=(4 * long, 4 * long), resolution=pixels)
            found = vm.column(volume, "a", camera, method="exact")
            assert total(found) == pytest.approx(inside, rel=1e-12)


def test_pixels_too_small_for_exact_columns_are_refused():
    camera = vm.Orthographic(50, 30, width=1e-6, resolution=4)
    with pytest.raises(vm.InputError, match="in pixels that small method='rays'"):
        vm.column(random_volume("even"), "a", camera, method="exact")


@pytest.mark.parametrize("kind", GRIDS)
def test_rays_converge_to_the_exact_mean(kind):
    volume = random_volume(kind)
    camera = vm.Orthographic(52, 21, 7, resolution=12)
    exact = vm.column(volume, "a", camera, method="exact").intensity

    def error(samples):
        rays = vm.column(volume, "a", camera, samples=samples, precision="double")
        return np.sqrt(np.mean((rays.intensity - exact) ** 2))

    wrong = [error(n) for n in (2, 4, 8, 16)]
    slope = np.polyfit(np.log([2, 4, 8, 16]), np.log(wrong), 1)[0]
    # Columns are continuous with creases: the midpoint rule is of second order, 1.5 near outlines.
    assert slope < -1.4
    assert wrong[-1] < 0.01 * np.abs(exact).max()


def test_units_lengths_are_taken_in_that_of_the_quantity():
    grid = vm.CartesianGrid.uniform(4, (0, 1), unit="pc")
    ones = np.ones(grid.shape)
    volume = vm.Volume(grid, rho=ones * u.g / u.cm**3, velocity_x=ones * u.km / u.s, plain=ones)
    volume["velocity_y"], volume["velocity_z"] = (0 * ones * u.km / u.s for _ in range(2))
    camera = vm.Orthographic(width=1, resolution=2)
    parsec = (1 * u.pc).to_value(u.cm)
    for method in ("rays", "exact"):
        image = vm.column(volume, "rho", camera, method=method)
        assert u.Unit(image.intensity_unit) == u.g / u.cm**2
        np.testing.assert_allclose(image.intensity, parsec, rtol=1e-6)
        image = vm.column(volume, "rho * velocity_x", camera, method=method)
        assert u.Unit(image.intensity_unit) == u.g * u.km / u.s / u.cm**2
        image = vm.column(volume, "rho", camera, method=method, unit="Msun/pc2")
        expected = (parsec * u.g / u.cm**2).to_value("Msun/pc2")
        np.testing.assert_allclose(image.intensity, expected, rtol=1e-6)
        assert vm.column(volume, "plain", camera, method=method).intensity_unit == "pc"
        mean = vm.column(volume, "velocity_x", camera, weight="rho", method=method)
        assert mean.intensity_unit == "km / s"
        np.testing.assert_allclose(mean.intensity, 1.0, rtol=1e-6)
    with pytest.raises(vm.UnitsError, match=r"g / cm2, which is not K"):
        vm.column(volume, "rho", camera, unit="K")


def test_a_camera_that_looks_elsewhere_is_told_in_the_words_of_a_measurement():
    volume = vm.models.prestellar_core(20)
    beside = vm.Orthographic(width=0.01 * u.pc, resolution=8, center=(9 * u.pc, 0 * u.pc, 0 * u.pc))
    with pytest.warns(UserWarning, match="^density: zero along every ray of this camera"):
        column = vm.column(volume, "density", beside)
    assert not column.intensity.any()


@pytest.mark.parametrize("method", ["rays", "exact"])
def test_means_are_of_cells_in_which_everything_is_known(method):
    volume = random_volume("uneven")
    rng = np.random.default_rng(4)
    weight, value = rng.random((2, *volume.grid.shape))
    value[rng.random(value.shape) < 0.2] = np.nan
    volume["t"], volume["w"] = value, weight
    volume["known"] = np.where(np.isnan(value), 0.0, weight)
    volume["filled"] = np.nan_to_num(value)
    camera = vm.Orthographic(50, 30, resolution=12)
    how = {"method": method, "precision": "double"}
    found = vm.column(volume, "t", camera, weight="w", **how).intensity
    expected = vm.column(volume, "filled", camera, weight="known", **how).intensity
    np.testing.assert_allclose(found, expected, atol=1e-9)
    speeds = vm.moments(volume, "w", camera, "t", 1, **how)
    np.testing.assert_allclose(speeds.mean.intensity, expected, atol=1e-9)


SPHERE = vm.SphericalGrid(np.linspace(0, 1, 4), np.linspace(0, np.pi, 4))
EYE = vm.Perspective((9, 0, 0), (0, 0, 0), fov=30)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"method": "exat"}, "did you mean 'exact'"),
        ({"quantity": "b"}, "unknown field 'b'"),
        ({"quantity": "grad(a)"}, "one number per cell, got the vector"),
        ({"quantity": None}, "a field or an expression"),
        ({"volume": np.ones((2, 2, 2))}, "need a Volume first, got ndarray"),
        ({"unit": "g"}, "in no unit, which is not g"),
        ({"camera": EYE, "method": "exact"}, r"parallel.*method='rays'"),
        ({"volume": vm.Volume(SPHERE, a="r"), "method": "exact"}, r"boxes.*SphericalGrid"),
    ],
)
def test_what_cannot_be_measured(asked, message):
    usual = {"volume": random_volume("even"), "quantity": "a", "camera": vm.Orthographic()}
    with pytest.raises(vm.VoluminousError, match=message):
        vm.column(**{**usual, **asked})


def test_maps_of_a_cube_know_the_sky():
    volume = vm.Volume(vm.CartesianGrid.uniform((6, 5, 4), (-1, 1), unit="deg"))
    volume["a"] = "1 deg + x"
    wcs = WCS(naxis=3)
    wcs.wcs.ctype, wcs.wcs.crval = ["RA---TAN", "DEC--TAN", "VRAD"], [12.5, -30, 1000]
    wcs.wcs.cunit, wcs.wcs.crpix, wcs.wcs.cdelt = ["deg", "deg", "m/s"], [3.5, 3, 1], [-1, 1, 10]
    wcs.pixel_shape = volume.grid.shape
    volume.wcs = wcs
    camera = vm.Orthographic(resolution=(6, 5), width=(2, 2))
    rendered = vm.render(volume, vm.Coefficients("a", 0), camera).wcs
    column = vm.column(volume, "a", camera)
    assert rendered.wcs.compare(column.wcs.wcs)
    np.testing.assert_allclose(column.wcs.wcs_pix2world([[2.5, 2]], 0), [[12.5, -30]], atol=1e-9)
    assert vm.moments(volume, "a", camera, velocity="z").mean.wcs is not None
