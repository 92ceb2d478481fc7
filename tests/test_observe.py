"""What `vm.observe` and the media of physics refuse and warn of; surfaces at wavelengths."""

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from voluminous.physics.constants import CODATA

CORE = vm.models.prestellar_core(8)
CAMERA = vm.Orthographic(resolution=8)
KAPPA = vm.Opacity.power_law(3.5, 870.0, 1.8)
DUST = vm.Dust("density * 4.7e-26 g", 12 * u.K, KAPPA)
CO = vm.Molecule(
    "CO", 28.0, [0.0, 3.845], [1, 3], ["0", "1"], [1], [0], [7.203e-8], [115.2712018e9]
)


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
        (lambda: vm.Dust([], [], []), "there are 0 densities"),
        (lambda: vm.Lines("density", CO, temperature=12, populations=3), "populations are"),
        (lambda: vm.FreeFree("density", temperature=8e3, charge=-1), "charge of ions"),
        (lambda: vm.FreeFree("density", temperature=8e3, charge=0 * u.K), "charge"),
        (lambda: vm.Opacity([1, 2], [1, 2], [1, 2], asymmetry=[0.5, 2]), "1 at most"),
        (lambda: vm.Opacity.power_law(3.5, 870, "steep"), "beta"),
        (lambda: vm.observe(CORE, DUST, CAMERA, wavelengths=870, objects=3), "objects is a list"),
        (lambda: vm.observe(CORE, DUST, CAMERA, wavelengths=870, background=-1), "negative"),
        (lambda: vm.spectrum(3, DUST, wavelengths=870, distance="1 pc"), "needs a vm.Volume"),
        (
            lambda: vm.spectrum(CORE, DUST, wavelengths=870, distance=[1, 2] * u.pc),
            "distance must be positive",
        ),
        (
            lambda: vm.spectrum(
                CORE, DUST, wavelengths=870, aperture=[1, 2] * u.arcsec, distance="1 pc"
            ),
            "one circle",
        ),
    ],
)
def test_refusals_say_what_to_give(make, told):
    with pytest.raises(vm.InputError, match=told):
        make()


@pytest.mark.parametrize("verb", [vm.observe, vm.spectrum])
@pytest.mark.parametrize("option", ["resolution", "posang", "tolernace", "width"])
def test_unknown_options_are_named(verb, option):
    with pytest.raises(vm.errors.UnknownNameError, match=option):
        verb(CORE, DUST, CAMERA, wavelengths=870, distance=140 * u.pc, **{option: 3})


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
    cube = vm.observe(CORE, DUST, CAMERA, wavelengths=wavelength * u.micron)
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


SILICATE = vm.Opacity([0.5, 1.6, 100.0, 2000.0], [10.0, 5.0, 1.0, 0.01], [10.0, 5.0, 1e-3, 1e-9])


@pytest.mark.parametrize("scattering", [False, True])
@pytest.mark.parametrize("draw", [vm.observe, vm.spectrum])
def test_scattered_light_that_is_not_there_is_told_once(scattering, draw):
    """With an albedo of 0.5 at 1.6 micron most of the light would be scattered."""
    dust = vm.Dust("density * 4.7e-26 g", 12 * u.K, SILICATE, scattering=scattering)
    how = {"wavelengths": [1.6, 870.0], "distance": 140 * u.pc}
    with pytest.warns(UserWarning, match="albedo of 0.5 at 1.6 micron") as told:
        draw(CORE, dust, CAMERA, **how)
    assert sum("albedo" in str(one.message) for one in told) == 1
    assert told[0].filename == __file__


def test_scattering_that_does_not_matter_or_is_left_out_is_not_told(recwarn):
    for scattering, waves in (("none", 1.6 * u.micron), (False, [100.0, 870.0])):
        dust = vm.Dust("density * 4.7e-26 g", 12 * u.K, SILICATE, scattering=scattering)
        vm.observe(CORE, dust, CAMERA, wavelengths=waves)
    assert not [one for one in recwarn if "albedo" in str(one.message)]
    thick, plain = (
        vm.observe(
            CORE,
            vm.Dust("density * 4.7e-26 g", 12, SILICATE, scattering=s),
            CAMERA,
            wavelengths=1.6 * u.micron,
        ).optical_depth
        for s in (True, "none")
    )
    np.testing.assert_allclose(thick, 2.0 * plain, rtol=1e-3)  # what is scattered dims, or not
    assert SILICATE.albedo(2.99792458e14 / 1.6) == pytest.approx(0.5)
    assert vm.Opacity([1.0, 2.0], [0.0, 0.0]).albedo(2e14) == 0.0


@pytest.mark.parametrize("scattering", ["isotropic", "henyey-greenstein", None, 2, 0.5, []])
def test_scattering_that_is_not_computed_is_refused(scattering):
    with pytest.raises(vm.InputError, match="not computed yet"):
        vm.Dust("density", 12, SILICATE, scattering=scattering)


MEDIA = {
    "dust": lambda t: vm.Dust("density * 4.7e-26 g", t, KAPPA),
    "lines": lambda t: vm.Lines("density", CO, temperature=t),
    "free-free": lambda t: vm.FreeFree("density", temperature=t),
}


@pytest.mark.parametrize("name", MEDIA)
@pytest.mark.filterwarnings("ignore:no channel", "ignore:the picture")
def test_temperatures_below_zero_are_refused(name):
    """Wherever they come from; a bound of an expression below zero is none."""
    core = vm.models.prestellar_core(8)
    middle = core.array("density") > np.median(core.array("density"))
    core["cold"] = np.where(middle, -1.0, 10.0) * u.K
    core["some"] = np.where(middle, np.nan, 10.0)
    how = {"frequencies": 115.27 * u.GHz}
    for number in (-3, -3.0 * u.K):
        with pytest.raises(vm.InputError, match="temperature must not be negative"):
            MEDIA[name](number)
    for field, least in (("cold", "-1 K"), ("some - 12", "-2 K"), ("10 * x / abs(x)", "-10 K")):
        with pytest.raises(vm.InputError, match=f"0 K or more.*{least}"):
            vm.observe(core, MEDIA[name](field), CAMERA, **how)
    dark = () if name == "free-free" else ("max(cold, 0 K)", 0.0)  # its opacity has T^-1.35
    for field in ("some", "10 - 5 * density / density", *dark):
        cube = vm.observe(core, MEDIA[name](field), CAMERA, **how)
        assert np.isfinite(cube.intensity).all()


def test_molecules_and_black_bodies_refuse_temperatures_below_zero():
    with pytest.raises(vm.InputError, match="0 K or more, got -2 K"):
        CO.partition_function([10.0, -2.0, np.nan])
    with pytest.raises(vm.InputError, match="positive temperature"):
        vm.Blackbody(-2.0)
    assert np.isfinite(CO.partition_function([10.0, 0.5])).all()


@pytest.mark.parametrize("name", ["turbulence", "density", "electrons", "ions"])
def test_negative_numbers_are_refused(name):
    with pytest.raises(vm.InputError, match=f"{name} must not be negative"):
        {
            "turbulence": lambda: vm.Lines(
                "density", CO, temperature=9, turbulence=-1 * u.km / u.s
            ),
            "density": lambda: vm.Dust(-1.0, 12, KAPPA),
            "electrons": lambda: vm.FreeFree(-1.0, temperature=8000),
            "ions": lambda: vm.FreeFree(1.0, -1.0, temperature=8000),
        }[name]()


# --- the light of cells ---------------------------------------------------------------------------


def steep(opacity=1.0):
    """Return dust that is hot where it is thin, from cell to cell, and media of it."""
    edges = np.linspace(-1, 1, 13) * 1e16
    volume = vm.Volume(vm.CartesianGrid(edges, edges, edges, unit="cm"))
    volume["rho"] = np.where(volume.evaluate("r < 6e15"), 1e-20, 0.0)
    volume["T"] = "10 + 90 * (r > 6e15)"
    kappa = vm.Opacity([100.0, 3000.0], [opacity, 0.1 * opacity])
    return volume, vm.Dust("rho", "T", kappa), vm.Dust("rho", "cellwise(rho * T) / rho", kappa)


FINE = vm.Orthographic(60, 30, resolution=96)


@pytest.mark.parametrize("distance", [None, 140 * u.pc])
def test_a_thin_picture_with_another_sum_than_its_cells_says_so(distance):
    """Hot cells without dust warm those that have it, where both fields are interpolated."""
    volume, dust, _ = steep()
    kappa = dust.opacity[0].absorption(2.99792458e11)
    light = 1e-20 * kappa * CODATA.planck(2.99792458e11, 10.0)
    light *= (volume.array("rho") > 0).sum() * (1e16 / 6) ** 3
    unit = "erg / (s Hz sr)"
    if distance is not None:
        light, unit = light / distance.to_value("cm") ** 2 * 1e23, "Jy"
    with pytest.warns(UserWarning, match="its cells have") as told:
        cube = vm.observe(volume, dust, FINE, wavelengths=1000.0, distance=distance)
    assert told[0].filename == __file__
    assert cube.provenance["cells"]["unit"] == unit
    assert cube.provenance["cells"]["light"] == pytest.approx([light], rel=1e-6)
    if distance is not None:
        assert cube.total().flux[0] > 1.05 * light
        with pytest.warns(UserWarning, match="its cells have"):
            found = vm.spectrum(volume, dust, wavelengths=1000.0, distance=distance, tolerance=3e-3)
        assert found.provenance["cells"] == cube.provenance["cells"]


def test_pictures_that_agree_with_their_cells_say_nothing(recwarn):
    """Nor do thick ones, those of a part, and what stars and a background add to."""
    volume, dust, weighed = steep()
    _, thick, _ = steep(1e6)
    lights = {"background": vm.Blackbody(2.7), "objects": []}
    for medium, camera, more in (
        (weighed, FINE, {}),
        (dust, FINE, {"scheme": "first-order"}),
        (thick, FINE, {}),
        (dust, vm.Orthographic(width=5e15, resolution=16), {}),
        (dust, FINE, lights),
        (dust, FINE, {"memory": "1 GiB"}),
    ):
        cube = vm.observe(volume, medium, camera, wavelengths=1000.0, **more)
        assert "cells" not in cube.provenance
    assert not [one for one in recwarn if "cells" in str(one.message)]


def test_what_is_given_beside_a_model_is_obeyed():
    """Zero is a number, and a temperature that is given is not that of the model."""
    model = vm.Volume(CORE.grid)
    for name in ("numberdens_CO", "gas_temperature", "microturbulence", "electron_numdens"):
        model[name] = np.ones(CORE.grid.shape)
    for axis in "xyz":
        model[f"gas_velocity_{axis}"] = np.ones(CORE.grid.shape)
    gas = vm.Lines(model, CO, temperature=0.0, turbulence=0.0)
    assert (gas.temperature, gas.turbulence, gas.velocity) == (0.0, 0.0, "gas_velocity")
    ionised = vm.FreeFree(model, 2.0, 8000.0)
    assert (ionised.electrons.text, ionised.ions, ionised.temperature) == (
        "electron_numdens",
        2.0,
        8000.0,
    )
    with pytest.raises(vm.InputError, match="no ion_numdens"):
        vm.FreeFree(model)
