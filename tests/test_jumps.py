"""Media that jump where two sides of a comparison are equal."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from voluminous.expressions import Expression, NumpyOps

CAMERA = vm.Orthographic(60, 30, width=3, resolution=40)


def make_volume():
    """Return a volume with a field that is bent along rays."""
    volume = vm.Volume(vm.CartesianGrid.uniform(18, (-1, 1)))
    volume["f"] = "x + 0.3*y*y + 0.2*z"
    return volume


def test_margins_are_the_differences_of_all_comparisons():
    margins = Expression("where(a < 2*b, a, 0) + (1 < b <= c) * abs(a)").margins()
    values = {"a": np.array(3.0), "b": np.array(5.0), "c": np.array(11.0)}
    assert [float(m.evaluate(NumpyOps(), values)) for m in margins] == [-7.0, -4.0, -6.0]
    assert [m.names for m in margins] == [("a", "b"), ("b",), ("b", "c")]
    assert Expression("log10(a) + where(b, 1, 0)").margins() == ()


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4])
@pytest.mark.parametrize("precision", ["single", "double"])
def test_a_jump_is_found_wherever_it_is(tolerance, precision):
    """Against the rectangle, the jumps of which are known in closed form."""
    volume = make_volume()
    jump = vm.Coefficients("where(f < 0.1, 1, 0)", 0)
    exact = vm.Rectangle("f", -9.9, 10, 1.0, 0, 1.0)
    found = vm.render(volume, jump, CAMERA, tolerance=tolerance, precision=precision)
    truth = vm.render(volume, exact, CAMERA, tolerance=1e-9, precision="double").intensity
    off = np.abs(found.intensity - truth).max(axis=-1)
    # Panels are not narrower than 1/256 of a segment in single precision.
    reached = max(tolerance, 1e-4 if precision == "single" else 0)
    assert off.max() <= reached * truth.max()
    assert np.mean(off <= found.error) >= 0.95


def test_two_jumps_within_a_segment():
    """A layer thinner than a cell, of which no sample may be inside."""
    volume = make_volume()
    thin = vm.Coefficients("where((f > 0.1) & (f < 0.104), 1, 0)", 0)
    exact = vm.Rectangle("f", 0.102, 0.002, 1.0, 0, 1.0)
    found = vm.render(volume, thin, CAMERA, tolerance=1e-2).intensity
    truth = vm.render(volume, exact, CAMERA, tolerance=1e-7, precision="double").intensity
    assert np.abs(found - truth).max() <= 0.02 * truth.max()


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("center", [-13, -28])
def test_logarithms_of_fields_with_zeros_beside_tiny_values_are_finite(precision, center):
    # Between 0 and 1e-12 a cubic is rounded to 0 on the way: both ends of a panel are -inf there.
    rng = np.random.default_rng(0)
    grid = vm.CartesianGrid.uniform(8, (-1, 1))
    values = 10 ** rng.uniform(-31, -12, grid.shape)
    values[rng.random(grid.shape) < 0.2] = 0.0
    volume = vm.Volume(grid, density=values, t=rng.random(grid.shape))
    shell = {"center": center, "opacity": 0.3, "path_length": 0.1}
    camera = vm.Orthographic(60, 30, resolution=24)
    for medium in (
        vm.Gaussian("log10(density)", sigma=0.2, color=(1, 1, 1), **shell),
        vm.Gaussian("log10(density)", sigma=0.2, color=(1,), where="t > 0.3", **shell),
        vm.Rectangle("log10(density)", half_width=0.2, color=(1, 1, 1), **shell),
    ):
        image = vm.render(volume, medium, camera, precision=precision)
        assert np.isfinite(image.intensity).all()
        assert image.intensity.max() > 0
