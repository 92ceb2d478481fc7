"""Fields of one kind in different units: what would have to be converted is refused, by name."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm

CAMERA = vm.Orthographic(resolution=4)


def moving():
    """Return a volume that moves with 1 km/s along each axis, one of them given in cm/s."""
    volume = vm.Volume(vm.CartesianGrid.uniform(4, (-1, 1), unit="pc"))
    ones = np.ones(volume.grid.shape)
    volume["density"] = ones * u.g / u.cm**3
    volume["velocity_x"] = ones * u.km / u.s
    volume["velocity_y"] = 1e5 * ones * u.cm / u.s
    volume["velocity_z"] = ones * u.km / u.s
    return volume


MIXED = [
    "velocity_x + velocity_y",
    "velocity_x - velocity_y",
    "max(velocity_x, velocity_y)",
    "velocity_x > velocity_y",
    "velocity_x != velocity_y",
    "where(x > 0, velocity_x, velocity_y)",
    "clip(velocity_x, 0, velocity_y)",
    "norm('velocity')",
    "0.5*density*norm('velocity')**2",
]


@pytest.mark.parametrize("expression", MIXED)
def test_numbers_that_need_converting_are_refused(expression):
    with pytest.raises(vm.UnitsError, match=r"velocity_x in km / s, velocity_y in cm / s"):
        moving().evaluate(expression)


def test_once_converted_they_are_right():
    volume = moving()
    volume["velocity_y"] = volume["velocity_y"].to("km/s")
    np.testing.assert_allclose(volume.evaluate("norm('velocity')"), np.sqrt(3), rtol=1e-14)
    assert volume.expression_unit(vm.Expression("norm('velocity')")) == u.km / u.s
    assert not volume.evaluate("velocity_x > velocity_y").any()


@pytest.mark.parametrize(
    "medium",
    [
        vm.Gaussian("norm('velocity')", 1, 0.1, 1, 0.1, 1),
        vm.Gaussian("density", 1, 0.1, 1, 0.1, 1, where="velocity_x > velocity_y"),
        vm.Coefficients("velocity_x + velocity_y", 0.1),
        vm.Isosurface("density", 1, vm.ColorBy("velocity_x - velocity_y", "viridis", 0, 1)),
    ],
)
def test_media_do_not_look_at_them(medium):
    with pytest.raises(vm.UnitsError, match="convert one of them first"):
        vm.render(moving(), medium, CAMERA)


def test_measurements_do_not_either():
    with pytest.raises(vm.UnitsError, match="convert one of them first"):
        vm.measure(moving(), {"energy": "0.5*density*norm('velocity')**2"})


def test_products_components_and_other_kinds_go_on():
    volume = moving()
    assert np.all(volume.evaluate("velocity_x*velocity_y") == 1e5)
    np.testing.assert_allclose(volume.evaluate("velocity_r**2").max(), 3, rtol=1e-12)
    # Of different kinds: plain numbers, and no unit.
    assert np.all(volume.evaluate("velocity_x + density") == 2)
    assert volume.expression_unit(vm.Expression("velocity_x + density")) is None
    # The same unit by another name.
    volume["pressure"] = np.ones(volume.grid.shape) * u.dyn / u.cm**2
    volume["energy"] = np.ones(volume.grid.shape) * u.erg / u.cm**3
    assert np.all(volume.evaluate("pressure + energy") == 2)
