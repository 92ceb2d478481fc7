"""Emissivities of any size: kernels count in a unit of their own."""

import numpy as np
import pytest

import voluminous as vm

VIEW = vm.Orthographic(20, 30, resolution=24)


def scene(size):
    rng = np.random.default_rng(0)
    grid = vm.CartesianGrid.uniform(12, (-1e18, 1e18))
    j = rng.random(grid.shape) * size * 1e-18
    return vm.Volume(grid, j=j, a=rng.random(grid.shape) * 1e-18)


@pytest.mark.parametrize("scheme", ["first-order", "second-order"])
@pytest.mark.parametrize("size", [1e-100, 1e-33, 1e30])
def test_single_precision_holds_emissivities_of_any_size(scheme, size):
    medium = vm.Coefficients(["j", "2*j"], "a")
    options = {"scheme": scheme, "background": [size, 0.0]}
    single = vm.render(scene(size), medium, VIEW, **options).intensity.astype(float) / size
    double = vm.render(scene(size), medium, VIEW, precision="double", **options).intensity / size
    # 24 segments, each rounded to 6e-8 in length, and exponentials of the same accuracy.
    np.testing.assert_allclose(single, double, rtol=0, atol=1e-5 * double.max())


def test_a_picture_below_single_precision_comes_in_double():
    image = vm.render(scene(1e-100), vm.Coefficients("j", "a"), VIEW)
    assert image.intensity.dtype == np.float64
