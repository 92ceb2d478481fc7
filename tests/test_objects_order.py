"""The order in which rays to objects are followed, and what may not depend on it."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from voluminous.objects.balls import nearby

RNG = np.random.default_rng(5)
GRID = vm.CartesianGrid.uniform(9, (-1, 1))
VOLUME = vm.Volume(GRID, a=RNG.random(GRID.shape) + 0.1)
MEDIUM = vm.Coefficients(["a", "2 * a"], "2 * a")
CAMERA = vm.Orthographic(33, 44, 55, width=2.6, resolution=24)
PLACES, RADII = RNG.uniform(-1, 1, (30, 3)), RNG.uniform(0.02, 0.3, 30)


def test_what_is_not_in_the_picture_comes_last():
    x, depth = np.array([np.nan, 3.0, 700.0, 5.0]), np.array([np.nan, 2.0, 0.0, 1.0])
    np.testing.assert_array_equal(nearby(x, x, depth), [3, 1, 2, 0])


@pytest.mark.parametrize("scheme", ["first-order", "second-order", "post-classified"])
def test_the_order_of_a_list_does_not_matter(scheme):
    """Depths differ, so which one is in front does not depend on the list."""
    colors, dense = RNG.random((30, 2)), RNG.random(30)
    order = RNG.permutation(30)
    one = vm.Spheres(PLACES, RADII, colors, opacity=dense)
    other = vm.Spheres(PLACES[order], RADII[order], colors[order], opacity=dense[order])
    images = [
        vm.render(VOLUME, MEDIUM, CAMERA, scheme=scheme, objects=[thing], precision="double")
        for thing in (one, other)
    ]
    np.testing.assert_allclose(images[0].intensity, images[1].intensity, rtol=1e-13)
