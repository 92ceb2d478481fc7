"""What `vm.observe` and the media of physics refuse, and what they warn of."""

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm

CORE = vm.models.prestellar_core(8)
CAMERA = vm.Orthographic(resolution=8)
KAPPA = vm.Opacity.power_law(3.5, 870.0, 1.8)
DUST = vm.Dust("density * 4.7e-26 g", 12 * u.K, KAPPA)
CO = vm.Molecule("CO", 28.0, [0.0, 3.845], [1, 3], "01", [1], [0], [7.203e-8], [115.2712018e9])


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: vm.Dust("density", 12, "draine-2003"), "vm.Opacity"),
        (lambda: vm.Lines("density", None, temperature=12), "vm.Molecule"),
        (lambda: vm.Lines("density", CO, temperature=12, velocity=3.0), "vector's name"),
        (lambda: vm.Lines("density", CO, temperature=12, velocity=["x", "y"]), "three of x, y, z"),
        (lambda: vm.observe(CORE, CAMERA, wavelengths=870), "needs a medium"),
        (lambda: vm.observe(CORE, DUST, CAMERA, wavelengths=870, background=3 * u.K), "Blackbody"),
        (lambda: vm.spectrum(CORE, DUST, wavelengths=870, aperture=1 * u.arcsec), "distance"),
        (lambda: DUST.plot(CORE), "vm.observe"),
        (lambda: DUST(1.0), "vm.observe"),
    ],
)
def test_refusals_say_what_to_give(make, told):
    with pytest.raises(vm.InputError, match=told):
        make()


def test_a_spectral_function_returns_a_pair():
    grey = vm.SpectralMedium.from_function(lambda n, nu: n, ["density"])
    with pytest.raises(vm.InputError, match="returns j and alpha"):
        vm.observe(CORE, grey, CAMERA, wavelengths=870)


@pytest.mark.filterwarnings("ignore:the picture shows nothing")
def test_channels_beside_all_lines_are_told_where_the_nearest_is():
    gas = vm.Lines("density", CO, temperature=12)
    with pytest.warns(UserWarning, match=r"nearest is 1-0, at 115\.271202 GHz"):
        cube = vm.observe(CORE, gas, CAMERA, frequencies=115.2 * u.GHz)
    assert not cube.intensity.any()


@pytest.mark.parametrize("wavelength", [0.6, 0.87, 1.6])
def test_matter_too_cold_to_shine_is_dark(wavelength):
    """At 0.87 micron 12 K emit exp(-1378): not even double precision has such numbers."""
    cube = vm.observe(CORE, DUST, CAMERA, wavelengths=wavelength)
    assert np.all(cube.intensity < 1e-290)
    assert np.all(cube.optical_depth > 0.0)
