"""The order of each scheme: how fast the error falls when cells, or pixels, are refined."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import Chebyshev

import voluminous as vm
from contracts import Bundle
from contracts.camera import rays_of
from voluminous.schemes import get_scheme

# Fields that are smooth, positive, and alike in no direction.
EMISSIVITY = "1 + 0.5*sin(2*x + y) + 0.3*cos(3*z - x)"
EXTINCTION = "1.5 + sin(x - 2*z)*cos(1.5*y)"
VIEWS = {
    "orthographic": vm.Orthographic(50, 20, 10, width=1.0, resolution=9),
    "perspective": vm.Perspective((2.1, -1.3, 1.7), (0, 0, 0), 20, resolution=9),
    "inside": vm.Perspective((0.21, 0.13, -0.17), (0.9, 0.7, 1), 40, resolution=9),
}


def emissivity(x, y, z):
    return 1 + 0.5 * np.sin(2 * x + y) + 0.3 * np.cos(3 * z - x)


def extinction(x, y, z):
    return 1.5 + np.sin(x - 2 * z) * np.cos(1.5 * y)


def volume_of(cells):
    """Return the fields on a cube of so many cells per side."""
    volume = vm.Volume(vm.CartesianGrid.uniform(cells, (-1, 1)))
    volume["j"], volume["a"] = EMISSIVITY, EXTINCTION
    return volume


def integral(origin, direction, begin, end):
    """Return the intensity of a ray, to rounding: series and quadrature of high order."""

    def along(function):
        return lambda t: function(*(origin[:, None] + direction[:, None] * t))

    depth = Chebyshev.interpolate(along(extinction), 60, domain=[begin, end]).integ(lbnd=begin)
    x, w = np.polynomial.legendre.leggauss(80)
    t = begin + 0.5 * (end - begin) * (1 + x)
    return 0.5 * (end - begin) * np.sum(w * along(emissivity)(t) * np.exp(-depth(t)))


def exact_picture(camera):
    """Return the picture of the fields themselves."""
    grid = vm.CartesianGrid.uniform(1, (-1, 1))
    origins, directions = rays_of(camera, grid)
    walls = np.sort((np.array([[-1.0], [1.0]])[:, None] - origins) / directions, axis=0)
    begin = np.maximum(walls[0].max(axis=1), 0 if isinstance(camera, vm.Perspective) else -np.inf)
    rays = zip(origins, directions, begin, walls[1].min(axis=1), strict=True)
    return np.array([integral(*ray) for ray in rays])


def slope(sizes, errors):
    """Return minus the exponent of the errors as a power of the size."""
    return -np.polyfit(np.log(sizes), np.log(errors), 1)[0]


@pytest.mark.each_value_once
@pytest.mark.parametrize("view", sorted(VIEWS))
@pytest.mark.parametrize(
    ("scheme", "order"), [("first-order", 0.9), ("second-order", 1.9), ("olson-kunasz", 1.9)]
)
def test_error_falls_with_the_size_of_cells(scheme, order, view):
    camera, sizes = VIEWS[view], (16, 32, 64)
    exact = exact_picture(camera)
    medium, errors = vm.Coefficients("j", "a"), []
    for cells in sizes:
        image = vm.render(
            volume_of(cells), medium, camera, scheme=scheme, precision="double", cutoff=0
        )
        errors.append(np.abs(image.intensity.ravel() - exact).mean())
    assert slope(sizes, errors) > order


# A line along the walls sees cells half a cell beside it: nothing cancels.
ALONG_WALL = Bundle([0.0, 0.0, -9.0], [0.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("scheme", "order"), [("first-order", 1), ("second-order", 2), ("olson-kunasz", 2)]
)
def test_order_of_one_ray_is_what_the_scheme_says(scheme, order):
    exact = integral(np.zeros(3), np.array([0.0, 0.0, 1.0]), -1, 1)
    medium, errors, sizes = vm.Coefficients("j", "a"), [], (16, 32, 64)
    for cells in sizes:
        options = {"scheme": scheme, "precision": "double", "cutoff": 0}
        image = vm.render(volume_of(cells), medium, ALONG_WALL, **options)
        errors.append(abs(ALONG_WALL.flat(image.intensity)[0] - exact))
    assert slope(sizes, errors) == pytest.approx(order, abs=0.1)
    assert get_scheme(scheme).order == order


def test_samples_converge_to_the_mean_over_a_pixel():
    # A ball in a pixel: its edge is not smooth, and a ray is a point.
    volume = vm.models.sphere(16, radius=0.8)
    medium = vm.Coefficients("inside", "inside")

    def picture(samples, resolution=3):
        camera = vm.Orthographic(50, 20, width=2, resolution=resolution)
        options = {"precision": "double", "scheme": "first-order", "samples": samples}
        return vm.render(volume, medium, camera, **options).intensity[..., 0]

    counts = (1, 2, 4, 8, 16)
    fine = picture(1, resolution=3 * 96).reshape(3, 96, 3, 96).mean(axis=(1, 3))
    errors = [np.abs(picture(n) - fine).mean() for n in counts]
    assert slope(counts, errors) > 0.9
    assert errors[-1] < 2e-3 * fine.max()


def test_flux_conserving_is_as_many_samples_as_cells_need():
    volume, medium = volume_of(8), vm.Coefficients("j", "a")
    for pixels, samples in ((8, 1), (7, 2), (4, 2), (3, 4), (1, 8)):
        camera = vm.Orthographic(50, 20, width=2.0, resolution=pixels)
        same = [
            vm.render(volume, medium, camera, precision="double", **rays).intensity
            for rays in ({"antialias": "radmc3d"}, {"samples": samples})
        ]
        np.testing.assert_array_equal(*same)
