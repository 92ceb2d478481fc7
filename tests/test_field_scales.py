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
    volume["d"] = "1e-24*exp(-4*(r/(3e18 cm))**2)"
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


GREATER = 1e6
# What looks at small differences of a field of large numbers, without being a shell of it.
DIFFERENCES = {
    "coefficients": lambda: vm.Coefficients(f"(a - {GREATER})**2", "0.1"),
    "branches": lambda: vm.Coefficients(f"where(c > 0, a - {GREATER}, 0)", "0.1"),
    "function": lambda: vm.Medium.from_function(
        lambda a: (np.exp(a - GREATER), 0.1 + 0 * a), fields=["a"], channels=1
    ),
    "gate": lambda: vm.Gaussian("c", 0, 0.5, 1, 0.5, 0.3, where=f"a > {GREATER + 0.3}"),
    "soft gate": lambda: vm.Isosurface("c", 0.1, 1, 0.5, where=f"a - {GREATER}"),
    "colours": lambda: vm.Gaussian(
        "c", 0, 0.5, vm.ColorBy("a", "viridis", GREATER - 1, GREATER + 1), 0.5, 0.3
    ),
}


@pytest.mark.parametrize("name", DIFFERENCES)
def test_small_differences_of_large_numbers_are_kept(name):
    """In single precision numbers of 1e6 are 0.06 apart: the picture was off by 2 to 30 %."""
    rng = np.random.default_rng(3)
    shape = (6, 7, 8)
    a, c = rng.normal(size=(2, *shape))
    volume = vm.Volume(vm.CartesianGrid.uniform(shape, (-1, 1)), a=a + GREATER, c=c)
    found = vm.render(volume, DIFFERENCES[name](), CAMERA)
    exact = vm.render(volume, DIFFERENCES[name](), CAMERA, tolerance=1e-6, precision="double")
    off = np.abs(found.intensity - exact.intensity).max(axis=-1)
    assert off.max() <= 1e-3 * exact.intensity.max()
    assert np.mean(off > found.error + exact.error) <= 0.01


def test_labels_and_poles_are_drawn_in_single_precision():
    """Equal numbers may be compared, and a few cells beside a pole be far off."""
    rng = np.random.default_rng(3)
    shape = (6, 7, 8)
    volume = vm.Volume(
        vm.CartesianGrid.uniform(shape, (-1, 1)),
        label=rng.integers(0, 9, shape),
        a=10 ** rng.uniform(0, 8, shape),
    )
    for where in ("label == 3", "label >= 3 and a > 1e4", "log10(a - 1.5)", "1 / (a - 3)"):
        shell = vm.Gaussian("log10(a)", 4, 1, 1, 0.5, 0.3, where=where)
        assert vm.render(volume, shell, CAMERA).provenance["precision"] == "single", where
