"""What folders of RADMC-3D say besides grids and fields: dust, molecules, stars, settings."""

from __future__ import annotations

import json

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from radmc3d_cases import MODELS, stored_model, write_model
from radmc3d_models import regular
from voluminous.errors import FileFormatError
from voluminous.files import MissingPathError
from voluminous.physics import RADMC3D
from voluminous.radmc3d.model import read_model

WAVES = "3\n1.0\n10.0\n100.0\n"
CO = """\
!MOLECULE (LAMDA)
CO
!MOLECULAR WEIGHT
28.0
!NUMBER OF ENERGY LEVELS
3
!LEVEL + ENERGIES(cm^-1) + WEIGHT + J
    1     0.000000000  1.0     0
    2     3.845033413  3.0     1
    3    11.534919938  5.0     2
!NUMBER OF RADIATIVE TRANSITIONS
2
!TRANS + UP + LOW + EINSTEINA(s^-1) + FREQ(GHz) + E_u(K)
    1     2     1  7.203e-08   115.2712018      5.53
    2     3     2  6.910d-07   230.5380000     16.60
!NUMBER OF COLL PARTNERS
0
"""


def hertz(*centimetres):
    return RADMC3D.c / np.array(centimetres)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "wavelength_micron.inp").write_text(WAVES)
    return tmp_path


def put(folder, **texts):
    for name, text in texts.items():
        (folder / f"{name}.inp").write_text(text)


def test_dust(folder):
    rule = "-------\n"
    put(
        folder,
        dustopac=f"2 format\n2 species\n{rule}1 way\n0 kind\nsmall\n{rule}10\n0\nlarge\n{rule}",
        dustkappa_small="# optool\n! and more\n\n 2\n 2\n1.0 30.0 3.0\n100. 0.3 0.03\n",
        dustkapscatmat_large="1\n2\n2\n\n1.0 5.0 2.0 0.5\n9.0 1.0d0 2.0 0.25\n\n0.0\n180.0\n1 2\n",
    )
    small, large = read_model(folder).opacities
    assert (small.name, large.name) == ("small", "large")
    nu = hertz(1e-4, 10e-4)
    np.testing.assert_allclose(small.absorption(nu), [30.0, 3.0])
    np.testing.assert_allclose(small.extinction(nu), [33.0, 3.3])
    np.testing.assert_allclose(large.absorption(hertz(1e-4, 9e-4)), [5.0, 1.0])
    np.testing.assert_allclose(large.asymmetry(hertz(1e-4, 9e-4)), [0.5, 0.25])
    np.testing.assert_allclose(small.grid, hertz(100e-4, 10e-4, 1e-4))


@pytest.mark.parametrize(
    "text",
    [
        "1 30 3 0.1\n100 0.3 0.03 0.2\n",
        "# lambda kabs ksca g\n1 30 3 0.1\n\n# more\n100 0.3 0.03 0.2",
        "3\n2\n1 30 3 0.1\n100 0.3 0.03 0.2\n",
        "3\n2\n100 0.3 0.03 0.2\n1 30 3 0.1\n",
        # Fortran reads as many numbers as it needs from each line
        "3\n2\n1 30 3 0.1 9 9\n100 0.3 0.03 0.2 9\n",
        "3 # format\n2 ! wavelengths\n1 30 3 0.1 # a\n100 0.3 0.03 0.2 ! 7 b\n",
        "3   Format number\n2   Nr of wavelengths\n1 30 3 0.1 a\n100 0.3 0.03 0.2\n",
        "3\n2\n1 30\n3 0.1\n100 0.3 0.03 0.2\n",
        "1 30 3 0.1 # a\n; b\n100 0.3 0.03 0.2 ; c\n",
        "\ufeff3\n2\n1 30 3 0.1\n100 0.3 0.03 0.2\n",
        "\ufeff# wavelengths\r\n1 30 3 0.1\r\n100 0.3 0.03 0.2\r\n",
    ],
)
def test_opacities_in_files(tmp_path, text):
    path = tmp_path / "dustkappa_grains.inp"
    path.write_text(text, "utf-8")
    dust = vm.Opacity.open(path)
    assert dust.name == "grains"
    np.testing.assert_allclose(dust.extinction(hertz(1e-4, 10e-4)), [33.0, 3.3])
    assert dust.asymmetry(RADMC3D.c / 1e-4) == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("7\n2\n1 2\n", "format 1, 2 or 3"),
        ("1\n3\n1 2\n3 4\n", "expected 3 wavelengths with 2 columns"),
        ("1 2\n3\n", "found 3 numbers"),
        ("1 2\n3 x\n", "expected a number, got 'x'"),
        ("1 2\n1 3\n", "rise, or fall"),
        ("# nothing\n", "a table of opacities, but the file ends"),
    ],
)
def test_damaged_opacities(tmp_path, text, message):
    path = tmp_path / "dustkappa_grains.inp"
    path.write_text(text)
    with pytest.raises(vm.InputError, match=message) as raised:
        vm.Opacity.open(path)
    assert str(path) in str(raised.value)


def test_molecules(folder):
    put(
        folder,
        lines="2\n2\nco leiden 0 0 2\np-h2\no-h2\nco_b leiden 0 0 0\n",
        molecule_co=CO,
        molecule_co_b=CO,
        partitionfunction_co_b="1\n2\n 10.0 4.0\n 20.0 8.0\n",
    )
    model = read_model(folder)
    assert list(model.molecules) == ["co", "co_b"]
    co = model.molecules["co"]
    assert (co.name, co.weight, co.labels) == ("co", 28.0, ("0", "1", "2"))
    np.testing.assert_array_equal(co.energies, [0.0, 3.845033413, 11.534919938])
    np.testing.assert_array_equal(co.weights, [1, 3, 5])
    np.testing.assert_array_equal([co.up, co.low], [[1, 2], [0, 1]])
    np.testing.assert_array_equal(co.einstein_a, [7.203e-8, 6.91e-7])
    np.testing.assert_array_equal(co.frequencies, [115.2712018e9, 230.538e9])
    assert co.partition is None
    assert model.molecules["co_b"].partition_function(15.0) == pytest.approx(6.0)
    assert vm.Molecule.open(folder / "molecule_co.inp").name == "CO"  # as the file says
    given = vm.Molecule.open(folder / "molecule_co.inp", partition={10: 4.0, 20: 8.0})
    assert given.partition_function(15.0) == pytest.approx(6.0)


@pytest.mark.parametrize(
    ("changes", "labels"),
    [
        ({"!MOLECULE (LAMDA)": "", "!MOLECULAR WEIGHT": "", "!LEVEL +": "\n!LEVEL +"}, "012"),
        ({"!NUMBER OF RADIATIVE TRANSITIONS": " ", "!TRANS": "\n\n!TRANS"}, "012"),
        (
            {"3.0     1": "3.0     1 ! J = 1", "!MOLECULE (LAMDA)": "comment", "28.0": "28.0 u"},
            "012",
        ),
        ({"5.0     2": "5.0     v=0 J=2 !no 3"}, ["0", "1", "v=0 J=2"]),
        ({"5.0     2": "5.0 ! J = 2"}, ["0", "1", "3"]),
        ({"!MOLECULE": "\ufeff!MOLECULE"}, "012"),
    ],
)
def test_molecules_with_comments_of_other_kinds(tmp_path, changes, labels):
    """A comment is a line, which may be empty; a label ends before an exclamation mark."""
    text = CO
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "co.dat"
    path.write_text(text, "utf-8")
    co = vm.Molecule.open(path)
    assert (co.name, co.weight, co.labels) == ("CO", 28.0, tuple(labels))
    np.testing.assert_array_equal(co.einstein_a, [7.203e-8, 6.91e-7])


def test_comments_behind_numbers(folder):
    """RADMC-3D reads as many numbers as it needs from a line, and knows no byte-order mark."""
    put(
        folder,
        wavelength_micron="\ufeff3 ! wavelengths\n1.0 # first\n10.0 ! second\n100.0 ; last\n",
        stars="2 ! format\n1 3 ! one star\n\n7e10 2e33 0 0 0 # of the sun\n1\n10\n100\n-5000 ! K\n",
    )
    (folder / "radmc3d.inp").write_text("\ufeffincl_dust = 1\nlines_mode = -1 ; LTE\n", "utf-8")
    model = read_model(folder)
    assert model.wavelengths.tolist() == [1.0, 10.0, 100.0]
    assert model.stars[0].radius == 7e10
    assert (model.settings["incl_dust"], model.line_mode) == (1, -1)


@pytest.mark.parametrize(
    ("wrong", "right", "message"),
    [
        ("28.0", "heavy", "line 4: expected a number, got 'heavy'"),
        ("    2     3     2", "    2     4     2", "between levels 1 to 3"),
        (
            "6.910d-07   230.5380000     16.60",
            "6.910d-07",
            "line 15: line 2 of 2: expected 5 numbers",
        ),
        (
            CO[CO.index("    2     3     2") :],
            "",
            "line 14: line 2 of 2: expected 5 numbers, but the file",
        ),
    ],
)
def test_damaged_molecules(folder, wrong, right, message):
    put(folder, molecule_co=CO.replace(wrong, right, 1))
    with pytest.raises(FileFormatError, match=message) as raised:
        vm.Molecule.open(folder / "molecule_co.inp")
    assert "molecule_co.inp" in str(raised.value)


def test_stars_and_background(folder):
    put(
        folder,
        stars="2\n2 3\n1e11 2e33 1 2 3\n2e11 4e33 -1 0 0\n1\n10\n100\n-5772\n1e-20\n2e-20\n3e-20\n",
        external_source="2\n3\n1\n10\n100\n1e-15\n2e-15\n4e-15\n",
    )
    model = read_model(folder)
    sun, other = model.stars
    assert (sun.radius, sun.mass, sun.position.tolist()) == (1e11, 2e33, [1, 2, 3])
    nu = RADMC3D.c / 10e-4
    for constants in ("codata", "radmc3d"):
        planck = vm.Blackbody(5772.0).intensity(nu, constants)
        assert sun.spectrum.intensity(nu, constants) == pytest.approx(planck, rel=1e-12)
        expected = 2e-20 * 3.08572e18**2 / (np.pi * 2e11**2)
        # the factor of SPEC.md has eight digits
        assert other.spectrum.intensity(nu, constants) == pytest.approx(expected, rel=1e-7)
        assert model.external.intensity(nu, constants) == pytest.approx(2e-15, rel=1e-12)
    assert sun.spectrum.intensity(RADMC3D.c / 1e-4, "radmc3d") == 0.0
    put(folder, external_source="2\n3\n1\n11\n100\n1e-15\n2e-15\n4e-15\n")
    with pytest.raises(FileFormatError, match=r"external_source.inp: .*those of wavelength_micron"):
        read_model(folder).external  # noqa: B018 - reading it is the test


def test_settings_and_small_files(folder):
    model = read_model(folder)
    assert (model.stars, model.external, model.settings, model.line_mode) == ((), None, {}, 1)
    put(
        folder,
        radmc3d="nphot = 1000000\n tgas_eq_tdust=1 ; a comment\nscattering_mode_max = 0\n"
        "# lines_mode = 3\nlines_mode = -1\ncatch_doppler_resolution = 5d-2\nword = yes\n",
        aperture_info="1\n2\n1.0 0.5\n100.0 2.0\n",
        camera_wavelength_micron="2\n870.0\n1300.0\n",
    )
    model = read_model(folder)
    assert model.settings == {
        "nphot": 1000000,
        "tgas_eq_tdust": 1,
        "scattering_mode_max": 0,
        "lines_mode": -1,
        "catch_doppler_resolution": 0.05,
        "word": "yes",
    }
    assert model.line_mode == -1
    waves, radii = model.apertures
    assert (waves.tolist(), radii.tolist()) == ([1.0, 100.0], [0.5, 2.0])
    assert model.camera_wavelengths.tolist() == [870.0, 1300.0]
    put(folder, camera_frequency="1\n2.99792458e11\n")
    np.testing.assert_allclose(read_model(folder).camera_wavelengths, [1000.0])


@pytest.mark.parametrize(
    ("attribute", "file"),
    [
        ("opacities", "dustopac.inp"),
        ("molecules", "lines.inp"),
        ("apertures", "aperture_info.inp"),
        ("camera_wavelengths", "camera_wavelength_micron.inp"),
    ],
)
def test_files_that_are_missing_have_names(folder, attribute, file):
    with pytest.raises(MissingPathError, match=rf"no file .*{file}, which says"):
        getattr(read_model(folder), attribute)


@pytest.mark.parametrize(
    ("files", "attribute", "message"),
    [
        ({"dustopac": "1\n1\n"}, "opacities", "dustopac.inp: line 1: expected format 2, got 1"),
        (
            {"dustopac": "2\n1\n--\n20\n0\nice\n--\n"},
            "opacities",
            "species ice has input of kind 20",
        ),
        ({"dustopac": "2\n1\n--\n1\n0\nice\n--\n"}, "opacities", "no file .*dustkappa_ice.inp"),
        (
            {"lines": "2\n1\nh2o linelist 0 0 0\n"},
            "molecules",
            "line 3: expected a molecule as 'NAME leiden",
        ),
        ({"lines": "2\n1\nco leiden 0 0 0\n"}, "molecules", "no file .*molecule_co.inp"),
        ({"stars": "2\n1 3\n1 1 0 0\n"}, "stars", "stars.inp: line 3: radius, mass and position"),
        ({"wavelength_micron": "2\n1\n-1\n"}, "wavelengths", "must be positive"),
    ],
)
def test_files_that_are_damaged_have_names(folder, files, attribute, message):
    put(folder, **files)
    with pytest.raises(vm.InputError, match=message):
        getattr(read_model(folder), attribute)


def test_volumes_know_their_folder(tmp_path):
    volume = vm.open(regular(tmp_path))
    assert volume.meta["radmc3d"] == str(tmp_path.resolve())
    assert vm.open(tmp_path / "gas_density.inp").meta["radmc3d"] == str(tmp_path.resolve())
    assert read_model(volume.meta["radmc3d"]).stars == ()
    volume.save(tmp_path / "kept.h5")
    assert vm.open(tmp_path / "kept.h5").meta == json.loads(json.dumps(volume.meta))
    with pytest.raises(MissingPathError):
        read_model(tmp_path / "elsewhere")


@pytest.mark.parametrize("name", MODELS)
def test_models_made_for_radmc3d(tmp_path, name):
    stored, meta = stored_model(name)
    model = read_model(write_model(stored, meta, tmp_path))
    assert len(model.stars) == len(meta["stars"] or ())
    for star, given in zip(model.stars, meta["stars"] or (), strict=True):
        assert star.radius == given["R"]
        np.testing.assert_array_equal(star.position, given["pos"])
    if "kappa_0" in stored:
        table = stored["kappa_0"][1:-1]
        nu = 2.9979e14 / table[:, 0]
        np.testing.assert_allclose(
            model.opacities[0].absorption(nu, "radmc3d"), table[:, 1], rtol=1e-12
        )
    if meta["molecules"]:
        for given in meta["molecules"]:
            molecule = model.molecules[given["name"]]
            levels = np.array(given["levels_cm1_g"])
            np.testing.assert_array_equal([molecule.energies, molecule.weights], levels.T)
            assert len(molecule.frequencies) == len(given["transitions_up_low_A_GHz"])
    if "partition_T" in stored:
        t = stored["partition_T"][1]
        assert molecule.partition_function(t) == pytest.approx(stored["partition_Z"][1], rel=1e-14)


def test_optical_depths_of_radmc3d(tmp_path):
    """Two tables, one of which ends before the longest wavelength: opacities to rounding."""
    stored, meta = stored_model("dust_cart")
    folder = write_model(stored, meta, tmp_path)
    (case,) = (case for case in meta["cases"] if case["id"] == "first_tau")
    volume, view = vm.open(folder), case["camera"]
    nu = np.array(case["nu_hz"])
    kappa = [dust.absorption(nu, "radmc3d") for dust in read_model(folder).opacities]
    camera = vm.Orthographic(
        incl=view["incl"],
        phi=view["phi"],
        width=2 * view["half_size"][0] * u.cm,
        resolution=view["nx"],
        center=(0, 0, 0),
    )
    alpha = [
        f"{a!r} cm2/g * dust_density_1 + {b!r} cm2/g * dust_density_2"
        for a, b in zip(*(k.tolist() for k in kappa), strict=True)
    ]
    medium = vm.Coefficients(["0 cm2/g * dust_density_1"] * len(nu), alpha)
    image = vm.render(volume, medium, camera, scheme="first-order", precision="double")
    reference = stored["img_first_tau"]
    error = np.abs(image.optical_depth - reference).max((0, 1)) / reference.max((0, 1))
    assert error.max() < 1e-13
