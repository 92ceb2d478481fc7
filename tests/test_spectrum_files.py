"""Spectra: units against closed forms, plots, and tables in files."""

import numpy as np
import pytest
from astropy import units as u
from astropy.table import Table

import voluminous as vm
from voluminous.errors import FileFormatError, InputError, UnitsError, UnknownNameError
from voluminous.files import MissingPathError
from voluminous.image import SpectralAxis

LINE = vm.channels(-3, 3, 7, line="CO 2-1", rest=230.538 * u.GHz)


def sed(**known):
    return vm.Spectrum([10, 100, 1000] * u.micron, [0.5, 4.0, 0.2] * u.Jy, **known)


def test_units_of_fluxes():
    spectrum = sed(error=[0.1, 0.2, 0.01])
    nu = 2.99792458e14 / np.array([10, 100, 1000])
    flux = np.array([0.5, 4.0, 0.2]) * 1e-26 * nu  # W / m²
    per_length = spectrum.to("W / (m2 micron)")
    assert spectrum.to("W / m2").flux == pytest.approx(flux, rel=1e-12)
    assert spectrum.to("erg / (s cm2 Hz)").flux == pytest.approx(1e-23 * spectrum.flux, rel=1e-12)
    assert per_length.flux == pytest.approx(flux / [10, 100, 1000], rel=1e-12)
    assert per_length.to("Jy").flux == pytest.approx(spectrum.flux, rel=1e-12)
    assert per_length.error / per_length.flux == pytest.approx([0.2, 0.05, 0.05])
    with pytest.raises(UnitsError, match="distance"):
        spectrum.to("L_sun")
    far = spectrum.replace(distance=140 * u.pc)
    luminosity = (4 * np.pi * (140 * u.pc) ** 2 * flux * u.W / u.m**2).to_value(u.L_sun)
    assert far.to("L_sun").flux == pytest.approx(luminosity, rel=1e-12)
    assert far.to("L_sun").to("Jy").flux == pytest.approx(spectrum.flux, rel=1e-12)
    with pytest.raises(UnitsError, match="cannot be converted"):
        far.to("km")


def test_temperatures_of_intensities():
    spectrum = vm.Spectrum(LINE, np.arange(7.0), "erg / (s cm2 Hz sr)")
    nu = LINE.frequencies
    kelvin = np.arange(7.0) * 2.99792458e10**2 / (2 * 1.380649e-16 * nu**2)
    assert spectrum.to("K").flux == pytest.approx(kelvin, rel=1e-12)


def test_plots():
    axes = sed(error=[0.1, 0.2, 0.01]).plot(unit="W / m2", color="red")
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert axes.get_xlabel() == "wavelength [µm]"
    assert axes.get_ylabel() == r"$\nu F_\nu$ [W m⁻²]"
    line = vm.Spectrum(LINE, np.arange(7.0), "K")
    axes = line.plot()
    assert axes.lines[0].get_drawstyle() == "steps-mid"
    assert (axes.get_xlabel(), axes.get_title()) == ("velocity [km s⁻¹]", "CO 2-1")
    assert line.plot(x="frequency").lines[0].get_xdata()[0] == pytest.approx(230.5357, abs=1e-4)
    with pytest.raises(UnknownNameError, match="velocity"):
        line.plot(x="speed")


@pytest.mark.parametrize("suffix", [".fits", ".ecsv"])
@pytest.mark.parametrize(
    "spectrum",
    [
        sed(distance=140 * u.pc, error=[0.1, 0.2, 0.01]),
        vm.Spectrum(LINE, np.random.default_rng(1).random(7), "K", provenance={"a": "it's & so"}),
        vm.Spectrum(SpectralAxis([230.1, 230.7], "GHz"), [1.0, 2.0]),
        vm.Spectrum(vm.channels(-1, 1, 2), [1.0, 2.0], "W / m2"),
    ],
)
def test_files_keep_spectra(tmp_path, spectrum, suffix):
    spectrum.save(tmp_path / f"a{suffix}")
    assert vm.Spectrum.load(tmp_path / f"a{suffix}") == spectrum


def test_tables_of_other_programs(tmp_path):
    table = Table({"wavelength": [1.0, 2.0] * u.mm, "flux": [3.0, 4.0] * u.mJy})
    table.write(tmp_path / "a.ecsv")
    spectrum = vm.Spectrum.load(tmp_path / "a.ecsv")
    assert spectrum.spectral.wavelengths.tolist() == [1000, 2000]
    assert (spectrum.unit, spectrum.flux.tolist()) == ("mJy", [3, 4])
    Table({"flux": [3.0]}).write(tmp_path / "b.fits")
    with pytest.raises(FileFormatError, match="one of velocity"):
        vm.Spectrum.load(tmp_path / "b.fits")
    with pytest.raises(MissingPathError, match=r"nothing\.fits"):
        vm.Spectrum.load(tmp_path / "nothing.fits")
    with pytest.raises(UnknownNameError, match=r"\.ecsv"):
        spectrum.save(tmp_path / "a.txt")


def test_spectra_that_cannot_be():
    with pytest.raises(InputError, match="expected one number for each of 2 channels"):
        vm.Spectrum([1, 2], [1.0, 2.0, 3.0])
    with pytest.raises(InputError, match="positive length"):
        sed(distance=-1)


def test_spectra_of_radmc3d(tmp_path):
    """The file has fluxes at 1 pc; Fortran leaves out the E of exponents with three digits."""
    path = tmp_path / "spectrum.out"
    path.write_text("    1\n   3\n \n 1.0E+01 2.0E-20\n 1.0E+02 4.0D-21\n 1.0E+03 6.0-105\n")
    found = vm.Spectrum.load(path)
    assert found.spectral.wavelengths.tolist() == [10.0, 100.0, 1000.0]
    assert found.flux.tolist() == [2e-20, 4e-21, 6e-105]
    parsec = 3.08572e18  # RADMC-3D's own
    assert (found.unit, found.distance) == ("erg / (Hz s cm2)", parsec)
    luminosity = 4 * np.pi * parsec**2 * found.flux
    assert found.to("erg / (s Hz)").flux == pytest.approx(luminosity, rel=1e-12)
    far = sed(distance=2 * parsec)
    far.save(tmp_path / "far.out")
    again = vm.Spectrum.load(tmp_path / "far.out")
    assert again.flux == pytest.approx(4e-23 * far.flux, rel=1e-12)
    assert again.spectral.wavelengths == pytest.approx(far.spectral.wavelengths, rel=1e-12)
    with pytest.raises(UnitsError, match=r"replace\(distance"):
        sed().save(path)
    assert vm.Spectrum.load(path) == found
    for damaged in (
        "1\n2\n1 2\n3 4",
        "1\n2\n1 2\n3\n",
        "2\n1\n1 2\n",
        "1\nx\n1 2\n",
        "",
        "hello\n",
    ):
        path.write_text(damaged)
        with pytest.raises(FileFormatError, match=r"spectrum\.out"):
            vm.Spectrum.load(path)
