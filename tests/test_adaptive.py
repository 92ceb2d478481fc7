"""Adaptive sampling: pixels are means over their area, and off by no more than is told."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm

GRID = vm.CartesianGrid.uniform(8, (-1, 1))
NOISE = vm.Volume(GRID, a=np.random.default_rng(1).random(GRID.shape))
PIXELS, FINER = 8, 64


def view(resolution):
    return vm.Orthographic(37, 61, 20, width=2.4, resolution=resolution, center=(0, 0, 0))


def picture(medium, **options):
    return vm.render(NOISE, medium, view(PIXELS), antialias="adaptive", tolerance=1e-2, **options)


def mean_over_pixels(medium, **options):
    fine = vm.render(NOISE, medium, view(PIXELS * FINER), **options).intensity
    return fine.reshape(PIXELS, FINER, PIXELS, FINER, -1).mean(axis=(1, 3), dtype=np.float64)


def check_errors(image, exact):
    """Nearly all pixels are off by less than is told, and that is not much."""
    off = np.abs(image.intensity - exact).max(axis=-1)
    assert np.mean(off <= image.error) >= 0.95
    assert np.median(image.error) <= 0.1 * exact.max()


@pytest.mark.parametrize("brightness", [1.0, 1e-17, 1e10])
def test_errors_are_in_the_unit_of_light(brightness):
    surface = vm.Isosurface("a", 0.6, brightness * np.array([1.0, 0.5, 0.2]), 0.8)
    check_errors(picture(surface), mean_over_pixels(surface))


def test_errors_of_coefficients_are_in_the_unit_of_light():
    medium = vm.Coefficients("1e-17 * (a > 0.6)", "5 * (a > 0.5)")
    check_errors(picture(medium), mean_over_pixels(medium))


@pytest.mark.parametrize("light", [0.0, 0.01])
@pytest.mark.parametrize("background", [1000.0, 1e-6])
def test_what_dims_a_background_is_off_by_as_much_as_that_is_bright(light, background):
    surface = vm.Isosurface("a", 0.6, light * background, 0.8)
    image = picture(surface, background=background)
    check_errors(image, mean_over_pixels(surface, background=background))


def test_pixels_show_more_than_their_surroundings_tell():
    """Centres of neighbours may be alike where a pixel holds edges: its own rays tell."""
    surface = vm.Isosurface("a", 0.6, 1.0, 0.8)
    image = picture(surface)
    off = np.abs(image.intensity - mean_over_pixels(surface))[..., 0]
    assert np.all(off <= 3 * image.error)  # all sixteen rays may miss a corner
    assert np.mean(off <= image.error) >= 0.98


@pytest.mark.parametrize("opacity", [1.0, 0.5])
def test_what_lies_in_front_of_objects_scatters_too(opacity):
    ball = vm.Spheres([(0, 0, 0)], [0.8], 0.5, opacity=opacity)
    surface = vm.Isosurface("a", 0.6, [1.0, 0.5, 0.2], 0.6)
    image = picture(surface, objects=ball)
    off = np.abs(image.intensity - mean_over_pixels(surface, objects=ball)).max(axis=-1)
    x, y = np.meshgrid(image.x, image.y)
    covered = np.hypot(x, y) < 0.55
    assert np.mean((off <= image.error)[covered]) >= 0.95
    assert np.median(image.error[covered]) <= 0.1


@pytest.mark.parametrize("resolution", [1, (1, 6)])
def test_one_pixel_is_more_than_its_centre(resolution):
    """It has no neighbours that would tell whether the picture is smooth."""
    surface = vm.Isosurface("a", 0.6, 1.0, 0.8)
    camera = vm.Orthographic(37, 61, 20, width=2.4, resolution=resolution, center=(0, 0, 0))
    image = vm.render(NOISE, surface, camera, antialias="adaptive", tolerance=1e-2)
    exact = vm.render(NOISE, surface, camera, samples=64)
    off = np.abs(image.intensity - exact.intensity)[..., 0]
    assert np.all(off <= 0.04)
    assert np.all(off <= 3 * image.error)


@pytest.mark.parametrize("where", [None, "a > 0.6"])
def test_pixels_that_pass_for_smooth_are_off_by_no_more_than_told(where):
    """Where neighbours differ by less than is allowed no rays are added, and means differ still."""
    shell = vm.Gaussian("a", 0.6, 0.2, 1.0, 1.0, 0.5, where=where)
    pixels, finer = 32, 16
    image = vm.render(NOISE, shell, view(pixels), antialias="adaptive", tolerance=0.1)
    fine = vm.render(NOISE, shell, view(pixels * finer)).intensity[..., 0]
    exact = fine.reshape(pixels, finer, pixels, finer).mean(axis=(1, 3), dtype=np.float64)
    off = np.abs(image.intensity[..., 0] - exact)
    assert np.mean(off <= image.error) >= 0.95
