"""What every camera must do."""

from __future__ import annotations

import json

import numpy as np
import pytest

import voluminous as vm
from voluminous.backend import dr, from_host, get_backend

BOUNDS = ((-1.0, 2.0), (0.0, 3.0), (-2.0, 1.0))


def rays_of(camera, grid, u=None, v=None):
    """Return origins and directions (n, 3) through image-plane points; all pixels by default."""
    frame = camera.frame(grid)
    if u is None:
        u, v = (a.ravel() for a in np.meshgrid(*frame.coordinates()))
    Wide = get_backend("cpu", "double").Wide
    vectors = [[Wide(float(c)) for c in vector] for vector in frame.vectors]
    u, v = (np.atleast_1d(np.asarray(a, dtype=float)) for a in (u, v))
    ray = camera.rays(vectors, from_host(Wide, u), from_host(Wide, v))

    def stacked(parts):
        return np.stack([np.broadcast_to(np.asarray(p), u.shape) for p in parts], axis=-1)

    return stacked(ray.origin), stacked(ray.direction)


class CameraContract:
    """Rays have unit directions, pictures the pixels asked for; a camera is plain data.

    A subclass gives the fixture ``camera``, for a volume of the bounds `BOUNDS` without a unit.
    """

    @pytest.fixture
    def grid(self):
        return vm.CartesianGrid.uniform((3, 4, 5), BOUNDS)

    def test_directions_have_unit_length(self, camera, grid):
        _, directions = rays_of(camera, grid)
        np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, rtol=1e-14)

    def test_every_pixel_has_a_ray_of_its_own(self, camera, grid):
        rays = np.hstack(rays_of(camera, grid))
        assert np.isfinite(rays).all()
        assert len(np.unique(rays, axis=0)) == len(rays)

    def test_points_are_seen_where_rays_go(self, camera, grid):
        rng = np.random.default_rng(0)
        frame = camera.frame(grid)
        u, v = (
            shift + width * rng.uniform(-0.5, 0.5, 50)
            for width, shift in zip(frame.width, frame.shift, strict=True)
        )
        origin, direction = rays_of(camera, grid, u, v)
        depth = rng.uniform(0.1, 5, 50)
        points = origin + depth[:, None] * direction
        # Rounding of points of a few lengths, seen from a tenth of one.
        for found, given in zip(camera.project(points.T, grid), (u, v, depth), strict=True):
            np.testing.assert_allclose(found, given, rtol=0, atol=1e-13)

    def test_frame_is_plain_numbers(self, camera, grid):
        frame = camera.frame(grid)
        assert all(isinstance(n, int) and n >= 1 for n in frame.pixels)
        assert all(isinstance(w, float) and w > 0 for w in frame.width)
        assert frame.vectors.dtype == np.float64
        assert frame.vectors.shape[1] == 3
        for values, n, step in zip(frame.coordinates(), frame.pixels, frame.pixel, strict=True):
            assert len(values) == n
            np.testing.assert_allclose(np.diff(values), step, rtol=1e-12)

    def test_picture_has_its_pixels(self, camera, grid):
        volume = vm.Volume(grid, a=np.ones(grid.shape))
        image = vm.render(volume, vm.Coefficients("a", "a"), camera)
        nx, ny = camera.frame(grid).pixels
        assert image.shape == (ny, nx, 1)
        assert image.camera == camera.describe()
        np.testing.assert_array_equal(image.x, camera.frame(grid).coordinates()[0])

    def test_a_picture_fits_into_so_many_pixels(self, camera, grid):
        for size in ((53, 37), (37, 53)):
            fitted = camera.within(size)
            assert type(fitted) is type(camera)
            unused = [n - used for n, used in zip(size, fitted.frame(grid).pixels, strict=True)]
            assert min(unused) in (0, 1, 2)
        assert min(camera.within((1, 1)).frame(grid).pixels) >= 1

    def test_description_is_plain_values_and_makes_the_camera_again(self, camera, grid):
        told = camera.describe()
        assert json.loads(json.dumps(told)) == told
        arguments = {k: v for k, v in told.items() if k != "type"}
        again = type(camera)(**arguments)
        np.testing.assert_array_equal(again.frame(grid).vectors, camera.frame(grid).vectors)
        assert again.frame(grid).width == pytest.approx(camera.frame(grid).width, rel=1e-15)
        assert type(camera).__name__ in repr(camera)

    def test_turning_it_compiles_nothing(self, camera, grid, kernels):
        volume = vm.Volume(grid, a=np.ones(grid.shape))
        medium = vm.Coefficients("a", "a")
        frame = camera.frame(grid)

        class Moved(type(camera)):
            """The same kind of camera somewhere else."""

            def __init__(self):
                pass

            def frame(self, grid):
                shifted = 0.01 + np.roll(frame.vectors, 1, axis=1)
                return type(frame)(frame.pixels, frame.width, (0.1, 0.2), shifted)

            def describe(self):
                return camera.describe()

        moved = Moved()
        vars(moved).update(vars(camera))
        first = kernels(vm.render, volume, medium, camera)
        assert kernels(vm.render, volume, medium, moved) <= first
        dr.sync_thread()
