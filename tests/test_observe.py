"""What `vm.observe` and the media of physics refuse and warn of; surfaces at wavelengths."""

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
        (lambda: vm.observe(CORE, DUST, CAMERA, wavelengths=870, distance=140), "140 [*] u.pc"),
        (lambda: vm.spectrum(CORE, DUST, wavelengths=870, distance=140), "140 [*] u.pc"),
        (lambda: vm.Dust("density", [12, 13] * u.K, KAPPA), "of several species a list"),
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
    with pytest.warns(UserWarning, match="nearest is 1-0"):  # between narrow channels
        vm.observe(CORE, gas, CAMERA, frequencies=[115.2709, 115.2715] * u.GHz)


@pytest.mark.parametrize("wavelength", [0.6, 0.87, 1.6])
def test_matter_too_cold_to_shine_is_dark(wavelength):
    """At 0.87 micron 12 K emit exp(-1378): not even double precision has such numbers."""
    cube = vm.observe(CORE, DUST, CAMERA, wavelengths=wavelength)
    assert np.all(cube.intensity < 1e-290)
    assert np.all(cube.optical_depth > 0.0)


def test_the_surface_of_optical_depth_one_at_two_wavelengths():
    """In uniform dust it is 1/(ρκ) below the side that faces the observer."""
    slab = vm.Volume(vm.CartesianGrid.uniform((2, 2, 8), ((0, 1),) * 3, unit="au"))
    slab["rho"] = np.full(slab.grid.shape, 1e-12) * u.g / u.cm**3
    dust = vm.Dust("rho", 30 * u.K, KAPPA)
    above = vm.Orthographic(0, width=0.5 * u.au, resolution=2)
    surface = vm.tau_surface(slab, dust, above, wavelengths=[0.45, 0.87] * u.mm)
    waves = np.array([450.0, 870.0])
    kappa = 3.5 * (870.0 / waves) ** 1.8
    expected = 1.0 - 1.0 / (1e-12 * kappa * (1 * u.au).to_value("cm"))
    np.testing.assert_allclose(
        surface.points[..., 2], np.broadcast_to(expected, (2, 2, 2)), rtol=1e-12
    )
