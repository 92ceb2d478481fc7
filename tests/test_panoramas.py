"""Panoramas and stereo pictures: where their rays start, and where they go."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from contracts import CameraContract
from contracts.camera import BOUNDS, rays_of

GRID = vm.CartesianGrid.uniform((3, 4, 5), BOUNDS)
EYE, AIM = (0.3, 0.2, -0.1), (0.5, 1.5, -0.5)


class TestEquirectangular(CameraContract):
    @pytest.fixture
    def camera(self):
        return vm.Panorama(EYE, AIM, resolution=12, posang=20)


class TestFulldome(CameraContract):
    @pytest.fixture
    def camera(self):
        return vm.Panorama(EYE, AIM, projection="fulldome", fov=200, resolution=7, up=(1, 0, 0))


class TestCube(CameraContract):
    @pytest.fixture
    def camera(self):
        return vm.Panorama(EYE, AIM, projection="cubemap", resolution=12)


class Stereo(CameraContract):
    def test_points_are_seen_where_rays_go(self, camera, grid):
        with pytest.raises(vm.InputError, match="each point twice"):
            camera.project(np.zeros((3, 1)), grid)


class TestStereoPanorama(Stereo):
    @pytest.fixture
    def camera(self):
        return vm.Panorama(EYE, AIM, resolution=8, stereo="over-under", eye_distance=0.1)


class TestStereoBesideEachOther(Stereo):
    @pytest.fixture
    def camera(self):
        return vm.Panorama(EYE, AIM, resolution=8, stereo="side-by-side")


class TestStereoScreen(Stereo):
    @pytest.fixture
    def camera(self):
        options = {"stereo": "side-by-side", "eye_distance": 0.2, "resolution": (6, 4)}
        return vm.Perspective((5, 4, 3), (0.5, 1.5, -0.5), 40, **options)


def axes():
    """Return the observer's axes: to the right, up, ahead."""
    right, up, back = vm.Panorama(EYE, AIM).frame(GRID).vectors[1:4]
    return right, up, -back


@pytest.mark.parametrize(
    ("projection", "places"),
    [
        ("equirectangular", [(0, 0), (np.pi / 2, 0), (0, np.pi / 2), (-np.pi / 2, 0)]),
        ("fulldome", [(0, 0), (np.pi / 2, 0), (0, np.pi / 2), (-np.pi / 2, 0)]),
        # Centres of the front, right, upper and left face.
        ("cubemap", [(0, -0.5), (-1, 0.5), (1, 0.5), (0, 0.5)]),
    ],
)
def test_directions(projection, places):
    right, up, ahead = axes()
    camera = vm.Panorama(EYE, AIM, projection=projection, resolution=12)
    origin, direction = rays_of(camera, GRID, *np.transpose(places))
    np.testing.assert_allclose(direction, [ahead, right, up, -right], atol=1e-15)
    np.testing.assert_allclose(origin, [EYE] * 4)


def test_faces_of_a_cube_meet_at_their_edges():
    camera = vm.Panorama(EYE, AIM, projection="cubemap", resolution=12)
    step, e = np.linspace(-0.4, 0.4, 5), 1e-12
    pairs = [
        ((0.5 - e, step - 0.5), (-1.5 + e, step + 0.5)),  # the front's right edge
        ((-0.5 + e, step - 0.5), (0.5 - e, step + 0.5)),  # its left one
        ((step, 0 - e), (step + 1, 0 + e)),  # its upper one
        ((step, -1 + e), (step - 1, 0 - e)),  # its lower one
    ]
    for one, other in pairs:
        found = [rays_of(camera, GRID, *np.broadcast_arrays(*p))[1] for p in (one, other)]
        np.testing.assert_allclose(found[0], found[1], atol=1e-11)


@pytest.mark.parametrize(("projection", "total"), [("equirectangular", 1), ("cubemap", 1)])
def test_a_sphere_around_the_observer_has_its_whole_solid_angle(projection, total):
    """Pixels weighted by their solid angles sum to 4π: each direction is seen once."""
    camera = vm.Panorama((0, 0, 0), (0, 1, 0), projection=projection, resolution=240)
    u, v = np.meshgrid(*camera.frame(GRID).coordinates())
    if projection == "equirectangular":
        weight = np.cos(v) * (2 * np.pi / 240) ** 2
    else:
        s, t = 2 * ((u + 1.5) % 1 - 0.5), 2 * ((v + 1) % 1 - 0.5)
        weight = (2 / 80) ** 2 * (1 + s**2 + t**2) ** -1.5
    assert weight.sum() == pytest.approx(4 * np.pi * total, rel=1e-4)  # midpoint rule: (π/240)²
    _, direction = rays_of(camera, GRID)
    mean = (direction * weight.reshape(-1, 1)).sum(axis=0)
    np.testing.assert_allclose(mean, 0, atol=1e-3)


def test_eyes_of_a_panorama_lie_across_the_direction():
    camera = vm.Panorama(EYE, AIM, resolution=8, stereo="over-under", eye_distance=0.1)
    origin, direction = rays_of(camera, GRID)
    origin, direction = (a.reshape(2, 4, 8, 3) for a in (origin, direction))
    np.testing.assert_array_equal(direction[0], direction[1])
    right = origin[0] - origin[1]  # the upper half is the left eye's
    np.testing.assert_allclose(np.linalg.norm(right, axis=-1), 0.1, rtol=1e-12)
    np.testing.assert_allclose(np.sum(right * direction[0], axis=-1), 0, atol=1e-15)
    _, up, _ = axes()
    level = direction[0] - np.sum(direction[0] * up, axis=-1)[..., None] * up
    assert np.all(np.sum(np.cross(right, up) * level, axis=-1) < 0)  # the right eye is on the right


def test_both_eyes_of_a_screen_see_the_target_in_the_middle():
    options = {"stereo": "side-by-side", "eye_distance": 0.2, "resolution": 5}
    camera = vm.Perspective((5, 4, 3), (0.5, 1.5, -0.5), 40, **options)
    half = 0.25 * camera.width[0]
    origin, direction = rays_of(camera, GRID, [-half, half], [0, 0])
    away = np.array([0.5, 1.5, -0.5]) - origin
    np.testing.assert_allclose(np.cross(away, direction), 0, atol=1e-13)
    assert np.linalg.norm(origin[1] - origin[0]) == pytest.approx(0.2, rel=1e-12)
    assert (origin[1] - origin[0]) @ camera.frame(GRID).vectors[1] > 0  # the left eye first


def test_a_picture_of_all_directions_is_that_of_the_screen():
    """In the middle a panorama sees what a flat screen sees, pixel by pixel of equal direction."""
    volume = vm.models.prestellar_core(16)
    medium = vm.suggest_medium(volume)
    wide = float(volume.grid.bounds[0, 1])
    at = {"position": (0.1 * wide, -0.5 * wide, 0.0), "target": (0, 0, 0)}
    panorama = vm.render(volume, medium, vm.Panorama(**at, resolution=720), precision="double")
    flat = vm.Perspective(**at, fov=0.5, resolution=1)  # the middle lies between four pixels
    middle = panorama.intensity[179:181, 359:361].mean(axis=(0, 1))
    one = vm.render(volume, medium, flat, precision="double").intensity[0, 0]
    np.testing.assert_allclose(middle, one, rtol=1e-3)  # curvature over half a degree


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"projection": "mercator"}, "equirectangular"),
        ({"fov": 90}, "fulldome"),
        ({"projection": "cubemap", "resolution": 100}, "multiple of 3"),
        ({"projection": "cubemap", "stereo": "over-under"}, "equirectangular"),
        ({"stereo": "anaglyph"}, "side-by-side"),
        ({"eye_distance": 1}, "stereo="),
        ({"stereo": "over-under", "eye_distance": -1}, "a length"),
        ({"target": EYE}, "coincide"),
        ({"projection": "fulldome", "fov": 400}, "360"),
    ],
)
def test_bad_arguments(options, message):
    with pytest.raises(vm.VoluminousError, match=message):
        vm.Panorama(EYE, **{"target": AIM} | options)


@pytest.mark.parametrize("projection", ["equirectangular", "fulldome", "cubemap"])
def test_there_is_a_picture_without_a_resolution(projection):
    nx, ny = vm.Panorama(EYE, AIM, projection=projection).frame(GRID).pixels
    assert nx >= 1000
    assert ny >= 500


def test_a_dome_is_empty_outside_its_disc():
    volume = vm.Volume(GRID, a=np.ones(GRID.shape))
    camera = vm.Panorama(EYE, AIM, projection="fulldome", resolution=32)
    image = vm.render(volume, vm.Coefficients("a", "a"), camera)
    u, v = np.meshgrid(image.x, image.y)
    inside = np.hypot(u, v) <= 0.5 * np.pi
    np.testing.assert_array_equal(image.intensity[..., 0] > 0, inside)
    np.testing.assert_array_equal(image.transparency[..., 0] == 1, ~inside)
