"""Cameras: the contract, the conventions of their angles, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u
from hypothesis import assume, given
from hypothesis import strategies as st

import voluminous as vm
from contracts import CameraContract
from contracts.camera import BOUNDS, rays_of

GRID = vm.CartesianGrid.uniform((3, 4, 5), BOUNDS)
IN_PC = vm.CartesianGrid.uniform(2, (-1, 1), unit="pc")
CENTER = np.mean(BOUNDS, axis=1)
EYE = (0.3, 0.2, -0.1)


class TestOrthographic(CameraContract):
    @pytest.fixture
    def camera(self):
        return vm.Orthographic(57, 213, 31, (4, 3), (8, 5), (0.1, 0.2, 0.3), shift=(0.5, -0.25))


class TestFraming(CameraContract):
    @pytest.fixture
    def camera(self):
        return vm.Orthographic(20, 30, resolution=(4, 7))


class TestFlatScreen(CameraContract):
    @pytest.fixture
    def camera(self):
        return vm.Perspective((5, 4, 3), CENTER, width=(0.8, 0.5), up=(1, 0, 1), resolution=(8, 5))


class TestDome(CameraContract):
    @pytest.fixture
    def camera(self):
        options = {"resolution": (7, 6), "projection": "spherical", "zenith": 20.0, "posang": 10.0}
        return vm.Perspective(EYE, CENTER, width=3.0, **options)


def axes_of(camera, grid=GRID):
    """Return the image's x axis, its y axis and the direction of view, from three rays."""
    vectors = camera.frame(grid).vectors
    # An orthographic camera's formulas are arithmetic, and as good for plain numbers.
    rays = [camera.rays(vectors, u, v) for u, v in ((0, 0), (1, 0), (0, 1))]
    origin, across, along = (np.array(ray.origin) for ray in rays)
    return across - origin, along - origin, np.array(rays[0].direction)


@pytest.mark.parametrize(
    ("angles", "right", "up", "view"),
    [
        ((0, 0), (1, 0, 0), (0, 1, 0), (0, 0, -1)),
        ((90, 0), (1, 0, 0), (0, 0, 1), (0, 1, 0)),
        ((90, 90), (0, -1, 0), (0, 0, 1), (1, 0, 0)),
        ((90, 180), (-1, 0, 0), (0, 0, 1), (0, -1, 0)),
        ((90, -90), (0, 1, 0), (0, 0, 1), (-1, 0, 0)),
        ((180, 0), (1, 0, 0), (0, -1, 0), (0, 0, 1)),
        ((0, 0, 90), (0, -1, 0), (1, 0, 0), (0, 0, -1)),
    ],
)
def test_angles_mean_what_they_mean_in_radmc3d(angles, right, up, view):
    # Exact: a right angle's cosine is 0, not 6e-17, or rays would drift through cell walls.
    for got, expected in zip(axes_of(vm.Orthographic(*angles)), (right, up, view), strict=True):
        np.testing.assert_array_equal(got, np.array(expected, dtype=float))


directions = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda d: np.linalg.norm(d) > 1e-3)


@given(directions, directions)
def test_looking_into_a_direction_is_looking_with_angles(view, up):
    view, up = np.array(view), np.array(up)
    # The direction upwards is found to the rounding of angles, over the sine between both.
    assume(np.linalg.norm(np.cross(view, up)) > 1e-3 * np.linalg.norm(view) * np.linalg.norm(up))
    right, top, away = axes_of(vm.Orthographic.looking(view, up))
    np.testing.assert_allclose(away, view / np.linalg.norm(view), rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.cross(right, top), -away, rtol=0, atol=1e-14)
    assert abs(np.dot(up, right)) < 1e-12
    assert np.dot(up, top) > 0


@given(st.floats(0, 180), st.floats(0, 360), st.floats(0, 360), st.sampled_from([(9, 9), (5, 20)]))
def test_default_width_shows_every_corner_and_no_more(incl, phi, posang, pixels):
    camera = vm.Orthographic(incl, phi, posang, resolution=pixels)
    right, up, _ = axes_of(camera)
    corners = np.array(np.meshgrid(*BOUNDS, indexing="ij")).reshape(3, -1).T - CENTER
    width, height = camera.frame(GRID).width
    across, along = 2 * np.abs(corners @ right).max(), 2 * np.abs(corners @ up).max()
    assert width / pixels[0] == pytest.approx(height / pixels[1], rel=1e-14)
    # It touches one pair of the frame's sides.
    assert max(across / width, along / height) == pytest.approx(1, rel=1e-14)


def test_pixels_are_where_the_note_in_the_documentation_says():
    camera = vm.Orthographic(width=(4, 3), resolution=(4, 2), center=(1, 2, 3), shift=(10, 20))
    x, y = camera.frame(GRID).coordinates()
    np.testing.assert_array_equal(x, 10 + np.array([-1.5, -0.5, 0.5, 1.5]))
    np.testing.assert_array_equal(y, 20 + np.array([-0.75, 0.75]))
    origins, _ = rays_of(camera, GRID)
    np.testing.assert_array_equal(origins[0][:2], [1 + 10 - 1.5, 2 + 20 - 0.75])


def test_one_width_is_the_longer_side():
    assert vm.Orthographic(width=4, resolution=(8, 2)).frame(GRID).width == (4.0, 1.0)
    assert vm.Orthographic(width=4, resolution=(2, 8)).frame(GRID).width == (1.0, 4.0)


def test_lengths_may_have_units():
    grid = vm.CartesianGrid.uniform(2, (-1, 1), unit="pc")
    plain = vm.Orthographic(30, 40, 0, (2, 1), 5, (0.1, 0.2, 0.3), shift=(0.5, 0.25))
    units = vm.Orthographic(
        0.5235987755982988 * u.rad,
        40 * u.deg,
        0,
        (2, 1) * u.pc,
        5,
        (100, 200, 300) * u.mpc,
        shift=[0.5 * u.pc, 250 * u.mpc],
    )
    np.testing.assert_allclose(rays_of(plain, grid), rays_of(units, grid), rtol=1e-14, atol=1e-15)
    eye = vm.Perspective((1, 2, 3), (0, 0, 0), 40, resolution=5)
    far = vm.Perspective((1, 2, 3) * u.pc, (0, 0, 0) * u.m, 40 * u.deg, resolution=5)
    np.testing.assert_allclose(rays_of(eye, grid), rays_of(far, grid), rtol=1e-14, atol=1e-15)
    some = vm.Perspective((1, 2, 3000 * u.mpc), (0, 0, 0 * u.m), 40, resolution=5)
    np.testing.assert_allclose(rays_of(eye, grid), rays_of(some, grid), rtol=1e-14, atol=1e-15)
    with pytest.raises(vm.UnitsError, match="width is in s, expected pc"):
        vm.Orthographic(width=1 * u.s).frame(grid)
    with pytest.raises(vm.UnitsError, match="expected dimensionless; give a plain number"):
        vm.Orthographic(width=1 * u.pc).frame(GRID)


def test_lengths_are_described_with_their_units():
    center, shift = (1, 2, 3) * u.cm, (1, 0) * u.m
    told = vm.Orthographic(width=0.25 * u.pc, center=center, shift=shift).describe()
    assert told["width"] == "0.25 pc"
    assert told["center"] == ["1.0 cm", "2.0 cm", "3.0 cm"]
    assert told["shift"] == ["1.0 m", "0.0 m"]
    assert "shift" not in vm.Orthographic().describe()
    mixed = vm.Perspective((0, 1, 3 * u.pc), (0, 0, 0)).describe()
    assert mixed["position"] == [0.0, 1.0, "3.0 pc"]
    assert mixed["target"] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("projection", ["flat", "spherical"])
def test_perspective_looks_at_its_target(projection):
    eye, target = np.array([1.0, -2.0, 4.0]), np.array([0.5, 1.0, -1.0])
    camera = vm.Perspective(eye, target, 60, projection=projection, up=(0.2, 0.9, 0.1))
    origins, rays = rays_of(camera, GRID, [0, 0.1, 0], [0, 0, 0.1])
    np.testing.assert_array_equal(origins, np.broadcast_to(eye, (3, 3)))
    ahead = (target - eye) / np.linalg.norm(target - eye)
    np.testing.assert_allclose(rays[0], ahead, rtol=0, atol=1e-14)
    right, up = rays[1] - rays[0], rays[2] - rays[0]
    assert np.dot(up, (0.2, 0.9, 0.1)) > 0
    assert np.dot(np.cross(right, up), ahead) < 0  # x to the right and y up, seen from the eye
    turned = vm.Perspective.looking(eye, ahead, fov=60, projection=projection, up=(0.2, 0.9, 0.1))
    again = rays_of(turned, GRID, [0, 0.1, 0], [0, 0, 0.1])[1]
    np.testing.assert_allclose(again, rays, rtol=0, atol=1e-14)


def test_perspective_has_z_up_and_the_right_angles():
    camera = vm.Perspective((0, -9, 0), (0, 0, 0), 90, resolution=(2, 2))
    assert camera.width == pytest.approx((2, 2), rel=1e-15)  # the screen is at unit distance
    _, corner = rays_of(camera, GRID, 1, 1)
    np.testing.assert_allclose(corner[0], np.array([1, 1, 1]) / np.sqrt(3), rtol=1e-15)
    dome = vm.Perspective((0, -9, 0), (0, 0, 0), 180, projection="spherical")
    assert dome.width == pytest.approx((np.pi, np.pi), rel=1e-15)
    _, edge = rays_of(dome, GRID, [np.pi / 2, 0], [0, np.pi / 4])
    np.testing.assert_allclose(edge[0], [1, 0, 0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(edge[1], [0, np.sqrt(0.5), np.sqrt(0.5)], rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: vm.Orthographic(np.nan), "incl must be finite"),
        (lambda: vm.Orthographic("steep"), "incl must be a number"),
        (lambda: vm.Orthographic(width=0), "width must be a positive number"),
        (lambda: vm.Orthographic(width=(1, 2, 3)), "pair"),
        (lambda: vm.Orthographic(width=np.inf), "width must be a positive number"),
        (lambda: vm.Orthographic(resolution=0), "resolution must be a positive whole"),
        (lambda: vm.Orthographic(resolution=4.5), "resolution must be a positive whole"),
        (lambda: vm.Orthographic(resolution=(4, 5, 6)), "resolution must be"),
        (lambda: vm.Orthographic(resolution=True), "resolution must be"),
        (lambda: vm.Orthographic(resolution=np.nan), "resolution must be"),
        (lambda: vm.Orthographic(resolution=(4, None)), "resolution must be"),
        (lambda: vm.Orthographic(center=(0, 0)), "center must be 3 finite numbers"),
        (lambda: vm.Orthographic(center=(0, 0, np.nan)), "center must be 3 finite numbers"),
        (lambda: vm.Orthographic(shift=(0, 0, 0)), "shift must be 2"),
        (lambda: vm.Orthographic.looking((0, 0, 0)), "non-zero vector"),
        (lambda: vm.Orthographic.looking((0, 0, 1), (0, 0, 2)), "up must not be parallel"),
        (lambda: vm.Perspective((0, 0, 1), (0, 0, 0), 40, width=1), "not both"),
        (lambda: vm.Perspective((0, 0, 1), (0, 0, 0), up=(1, 0, 0), posang=3), "not both"),
        (lambda: vm.Perspective((0, 0, 1), (0, 0, 1)), "must not coincide"),
        (lambda: vm.Perspective((0, 0, 1), (0, 0, 0), 180), "between 0 and 180 degrees"),
        (lambda: vm.Perspective((0, 0, 1), (0, 0, 0), -5, projection="spherical"), "positive"),
        (lambda: vm.Perspective((0, 0, 1), (0, 0, 0), 400, projection="spherical"), "2π"),
        (lambda: vm.Perspective((0, 0), (0, 0, 0)), "position must be 3"),
        (lambda: vm.Perspective((0, 0, 1), (0, 0, 0), up=(0, 0, 1)), "parallel"),
        (lambda: vm.Perspective((0, 0, 1) * u.pc, (0, 0, 1)).frame(IN_PC), "must not coincide"),
        (lambda: vm.Perspective((0, 0, 1), None), "target must be 3 finite numbers"),
        (lambda: vm.Perspective((0, 0, np.inf), (0, 0, 0)), "position must be 3 finite"),
        (lambda: vm.Perspective((0, 0, 1), (0, 0, 0), posang=np.inf), "posang must be finite"),
        (lambda: vm.Perspective((0, 0, 1), (0, 0, 0), zenith=np.nan), "zenith must be finite"),
        (lambda: vm.Perspective((0, 0, 1), (0, 0, 0), zenith="up"), "zenith must be a number"),
    ],
)
def test_cameras_that_cannot_be(make, told):
    with pytest.raises(vm.InputError, match=told):
        make()


def test_unknown_projection_names_the_nearest():
    with pytest.raises(vm.errors.UnknownNameError, match="did you mean 'spherical'"):
        vm.Perspective((0, 0, 1), (0, 0, 0), projection="sphericl")


def test_directions_take_the_place_of_angles():
    with pytest.raises(vm.InputError, match="takes the place of angles"):
        vm.Orthographic.looking((1, 0, 0), posang=30)


def test_a_class_is_no_camera():
    volume = vm.Volume(GRID, density=np.ones((3, 4, 5)))
    with pytest.raises(vm.InputError, match="got the class Orthographic"):
        vm.render(volume, vm.Coefficients("density", 0), vm.Orthographic)
