"""A picture does not depend on the units of a field, however small or large its numbers become."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm

EDGES = [np.linspace(-1, 1, 17)] * 3
CAMERA = vm.Orthographic(40, 30, resolution=16)


def pictured(make, scale):
    volume = vm.Volume(vm.CartesianGrid(*EDGES))
    volume["d"] = f"{scale}*exp(-4*r**2)"
    return vm.render(volume, make(scale), CAMERA).intensity


MEDIA = {
    "shaded": lambda s: vm.Isosurface("d", 0.5 * s, 1, opacity=1, shading=1),
    "sheet": lambda s: vm.Isosurface("d", 0.5 * s, 1, opacity=0.5, density="gradient"),
    "shell": lambda s: vm.Gaussian("d", 0.5 * s, 0.05 * s, 1, 0.3, 0.1),
    "steep": lambda s: vm.Gaussian("gradmag(d)", 0.5 * s, 0.05 * s, 1, 0.3, 0.1),
}


# Squares of 1e-24 underflow in single precision, and 1e-45 is its smallest number.
@pytest.mark.parametrize("scale", [1e-24, 1e-45, 1e60])
@pytest.mark.parametrize("name", MEDIA)
def test_a_picture_is_the_same_in_all_units(name, scale):
    expected = pictured(MEDIA[name], 1.0)
    assert expected.max() > 0.05
    found = pictured(MEDIA[name], scale)
    # The tolerance of both pictures: one may be drawn in single, the other in double precision.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3 * expected.max())


def test_shading_shows_in_cgs_units():
    flat = pictured(lambda s: vm.Isosurface("d", 0.5 * s, 1, opacity=1), 1e-24)
    assert np.abs(pictured(MEDIA["shaded"], 1e-24) - flat).max() > 0.3


def test_lengths_in_cm_make_gradients_small():
    lengths = [3e18 * edges for edges in EDGES]
    volume = vm.Volume(vm.CartesianGrid(*lengths, unit="cm"))
    volume["d"] = "1e-24*exp(-4*(r/3e18)**2)"
    steepness = float(np.median(volume.evaluate("gradmag(d)")))
    assert 0 < steepness < 1e-42
    shell = vm.Gaussian("gradmag(d)", steepness, 0.3 * steepness, 1, 0.3)
    single, double = (
        vm.render(volume, shell, CAMERA, precision=p).intensity for p in ("single", "double")
    )
    assert double.max() > 1
    np.testing.assert_allclose(single, double, rtol=0, atol=1e-3 * double.max())


@pytest.mark.parametrize("tolerance", [None, 1e-3])
@pytest.mark.parametrize("kind", ["gaussian", "table"])
def test_widths_may_be_in_any_unit(tolerance, kind):
    """Steps are as wide as structures allow: a width of 0.1 km/s is one of 1e4 cm/s."""
    volume = vm.Volume(vm.CartesianGrid.uniform(32, (-1, 1)))
    volume["a"] = volume.evaluate("5*r + sin(9*x)*cos(7*y)") * u.km / u.s

    def shell(unit):
        center, width = (3 * u.km / u.s).to(unit), (0.1 * u.km / u.s).to(unit)
        if kind == "gaussian":
            return vm.Gaussian("a", center, width, 1, 0.3, 0.1)
        places = [(center + k * width).value for k in (-1, 0, 1)]
        return vm.Table("a", places * width.unit, [0, 1, 0], [0, 0.3, 0], 0.1)

    own, other = (
        vm.render(volume, shell(unit), CAMERA, tolerance=tolerance) for unit in ("km/s", "cm/s")
    )
    assert own.provenance["precision"] == other.provenance["precision"] == "single"
    np.testing.assert_allclose(other.intensity, own.intensity, rtol=0, atol=1e-5)
