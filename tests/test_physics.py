"""Physics on the host: Planck's function, opacities, molecules and spectra."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from astropy import units as u
from astropy.table import Table
from scipy.integrate import trapezoid

from voluminous import Blackbody, Molecule, Opacity
from voluminous.errors import InputError, UnitsError, UnknownNameError
from voluminous.physics import CODATA, RADMC3D, TabulatedSpectrum, constants_named, molecule_files

# Constants and Planck's function


@pytest.mark.parametrize("x", [1e-12, 1e-6, 0.3, 2.8, 30.0, 600.0])
def test_planck_keeps_all_digits(x):
    temperature = 20.0
    nu = x * temperature / CODATA.planck_exponent
    with mpmath.workdps(40):
        exponent = mpmath.mpf(CODATA.planck_exponent) * nu / temperature
        exact = mpmath.mpf(CODATA.planck_factor) * mpmath.mpf(nu) ** 3 / mpmath.expm1(exponent)
    # rounding of the exponent is amplified x times by the exponential
    assert CODATA.planck(nu, temperature) == pytest.approx(float(exact), rel=1e-15 * (4 + 2 * x))


def test_planck_has_its_limits():
    nu = 1e-9 / CODATA.planck_exponent
    rayleigh_jeans = 2.0 * nu**2 * CODATA.k / CODATA.c**2
    assert CODATA.planck(nu, 1.0) == pytest.approx(rayleigh_jeans * (1 - 0.5e-9), rel=1e-14)
    nu = 100.0 / CODATA.planck_exponent
    wien = 2.0 * CODATA.h * nu**3 / CODATA.c**2 * np.exp(-100.0)
    assert CODATA.planck(nu, 1.0) == pytest.approx(wien, rel=1e-13)


def test_planck_is_zero_where_nothing_shines():
    found = CODATA.planck([1e11, 1e11, 0.0, 1e30], [[0.0], [-5.0], [10.0]])
    assert found.shape == (3, 4)
    np.testing.assert_array_equal(found[:2], 0.0)
    assert found[2, 0] > 0.0
    np.testing.assert_array_equal(found[2, 2:], 0.0)


def test_the_integral_of_planck_is_that_of_stefan_and_boltzmann():
    x = np.linspace(0.0, 60.0, 60001)
    temperature = 5772.0
    nu = x * temperature / CODATA.planck_exponent
    flux = np.pi * trapezoid(CODATA.planck(nu, temperature), nu)
    sigma = 2 * np.pi**5 * CODATA.k**4 / (15 * CODATA.h**3 * CODATA.c**2)
    assert flux == pytest.approx(sigma * temperature**4, rel=1e-8)  # of the trapezoids


def test_digits_of_radmc3d():
    # they contradict each other by these amounts
    assert RADMC3D.planck_factor / (2 * RADMC3D.h / RADMC3D.c**2) - 1 == pytest.approx(
        1.4676e-5, abs=1e-8
    )
    assert RADMC3D.planck_exponent / (RADMC3D.h / RADMC3D.k) - 1 == pytest.approx(-5.4e-5, abs=1e-6)
    assert RADMC3D.boltzmann == 1.4387519359588623
    assert RADMC3D.partition == pytest.approx(1.4387519267, rel=1e-10)
    ratio = RADMC3D.planck(230.538e9, 20.0) / CODATA.planck(230.538e9, 20.0)
    assert ratio == pytest.approx(1.0, abs=2e-4)


def test_constants_have_names():
    assert constants_named("codata") is CODATA
    assert constants_named("radmc3d") is RADMC3D
    assert constants_named(RADMC3D) is RADMC3D
    with pytest.raises(UnknownNameError, match="did you mean 'codata'"):
        constants_named("coddata")


# Opacities


def at(micron):
    return 1e4 * CODATA.c / np.asarray(micron, dtype=float)


def test_opacities_are_power_laws_between_and_beyond_the_long_end():
    waves = np.geomspace(1.0, 1000.0, 5)
    dust = Opacity(waves, 3.0 * waves**-1.7, 2.0 * waves**-4)
    found = np.geomspace(1.0, 1e5, 33)
    np.testing.assert_allclose(dust.absorption(at(found)), 3.0 * found**-1.7, rtol=1e-12)
    np.testing.assert_allclose(dust.scattering(at(found)), 2.0 * found**-4, rtol=1e-12)
    np.testing.assert_allclose(
        dust.extinction(at(found)), 3.0 * found**-1.7 + 2.0 * found**-4, rtol=1e-12
    )
    assert dust.absorption(at(0.01)) == pytest.approx(3.0)  # constant beyond the short end
    assert dust.absorption(at([[1.0, 2.0]])).shape == (1, 2)
    backwards = Opacity(waves[::-1] * u.um, 0.3 * waves[::-1] ** -1.7 * u.m**2 / u.kg)
    np.testing.assert_allclose(backwards.absorption(at(found)), dust.absorption(at(found)))


def test_quantities_are_converted():
    """Frequencies may be wavelengths, too; nothing drops a unit."""
    dust, star = Opacity([1.0, 1000.0], [1.0, 1e-3]), Blackbody(5772.0)
    nu = 230.538e9
    for given in (nu * u.Hz, 230.538 * u.GHz, CODATA.c / nu * u.cm):
        assert dust.absorption(given) == pytest.approx(dust.absorption(nu), rel=1e-12)
        assert star.intensity(given) == pytest.approx(star.intensity(nu), rel=1e-12)
        assert CODATA.planck(given, 20 * u.K) == pytest.approx(CODATA.planck(nu, 20), rel=1e-12)
    assert rotor(5).partition_function(2e4 * u.mK) == rotor(5).partition_function(20.0)
    with pytest.raises(UnitsError, match="frequency is in K"):
        dust.absorption(3 * u.K)


def test_zeros_in_opacities_are_zero():
    dust = Opacity([1.0, 10.0, 100.0], [1.0, 1.0, 1.0], [2.0, 1.0, 0.0])
    assert dust.scattering(at(1000.0)) == 0.0
    assert 0.0 < dust.scattering(at(30.0)) < 1.0
    assert Opacity([1, 2], [1, 1]).scattering(at(1.5)) == 0.0


def test_power_laws_and_published_opacities():
    law = Opacity.power_law(0.1 * u.m**2 / u.kg, 1.3 * u.mm, 1.5)
    np.testing.assert_allclose(law.absorption(at([1300.0, 5200.0, 13.0])), [1.0, 1 / 8, 1000.0])
    # the numbers of the papers
    ice = Opacity.published("ossenkopf-henning-1994")
    np.testing.assert_allclose(
        ice.absorption(at([1.0, 100, 350, 1300])), [13090, 86.47, 10.08, 0.8992]
    )
    diffuse = Opacity.published("draine-2003")
    full = {0.1318: 5.046e4, 0.547: 8551, 3.631: 854.6, 9.5: 2171, 100: 27.15, 850: 0.383}
    for wave, kappa in full.items():
        assert diffuse.absorption(at(wave)) == pytest.approx(kappa, rel=0.02), wave
    albedo = diffuse.scattering(at(0.547)) / diffuse.extinction(at(0.547))
    assert albedo == pytest.approx(0.674, abs=0.01)
    assert diffuse.asymmetry(at(0.547)) == pytest.approx(0.538, abs=0.01)
    assert Opacity.published("beckwith-1990").absorption(1e12) == pytest.approx(10.0)
    assert Opacity.published("hildebrand-1983").absorption(at(500.0)) == pytest.approx(2.5)
    with pytest.raises(UnknownNameError, match="did you mean 'draine-2003'"):
        Opacity.published("draine-2001")


def test_opacities_of_tables():
    table = Table({"lam": [1.0, 0.01] * u.cm, "kabs": [1.0, 2.0], "ksca": [0.0, 1.0]})
    dust = Opacity.from_table(table, "grains")
    assert dust.name == "grains"
    assert dust.absorption(at(100.0)) == pytest.approx(2.0)
    assert dust == Opacity.from_table(table, "grains")
    with pytest.raises(InputError, match="no column of absorption"):
        Opacity.from_table({"wavelength": [1, 2]})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([1.0], [1.0]), "two or more"),
        (([1, 3, 2], [1, 1, 1]), "rise, or fall"),
        (([1, 2], [1, -1]), "must be one finite number"),
        (([1, 2], [1, 1, 1]), "for each of the 2"),
        (([1, 2], [[1, 1]]), "expected a list"),
    ],
)
def test_bad_opacities(arguments, message):
    with pytest.raises(InputError, match=message):
        Opacity(*arguments)


def test_radmc3d_interpolates_opacities_in_its_own_way():
    waves, kappa = np.array([1.0, 4.0, 10.0]), np.array([8.0, 3.0, 1.0])
    own = 2.9979e14 / waves  # frequencies of the table
    grid = np.array([0.1, 2.0, 20.0, 200.0])
    globe = 2.99792458e14 / grid
    dust = Opacity(waves, kappa, grid=globe)

    def found(nu):
        return dust.absorption(nu, "radmc3d")

    middle = 0.5 * (own[0] + own[1])
    assert found(middle) == pytest.approx(5.5, rel=1e-14)  # linear in ν
    copy = {
        200.0: (1 / 3) ** (np.log(20) / np.log(2.5)),
        20.0: (1 / 3) ** (np.log(2) / np.log(2.5)),
    }
    for wave, power in copy.items():  # of the last two points
        nu = 2.99792458e14 / wave
        expected = (nu / own[2]) ** (np.log(3) / np.log(2.5))
        assert expected == pytest.approx(power, rel=1e-4)
        assert found(nu) == pytest.approx(expected, rel=1e-13)
    below, inside = globe[2], globe[1]  # what lies between is linear between these
    share = np.log(8.0 / 3.0) * (inside - own[1]) / (own[0] - own[1])
    beside = 3.0 * np.exp(share)  # log κ is linear in ν
    nu = 0.5 * (below + own[2])
    w = (nu - below) / (inside - below)
    assert found(nu) == pytest.approx((1 - w) * found(below) + w * beside, rel=1e-13)
    assert found(globe[0]) == pytest.approx(8.0)  # constant beyond the short end
    for end, sign in ((globe[3], -1), (globe[0], 1)):  # a ramp to zero, and nothing beyond
        assert found(end * (1 + 0.5e-4 * sign)) == pytest.approx(0.5 * found(end), rel=1e-9)
        assert found(end * (1 + 1.1e-4 * sign)) == 0.0
    assert dust.absorption(middle) != found(middle)
    without = Opacity(waves, kappa)
    assert without.absorption(middle, "radmc3d") == pytest.approx(
        without.absorption(middle), rel=1e-4
    )


# Molecules

CO_B = 57.635968e9  # Hz


def rotor(levels, partition=None):
    """A rigid linear rotor with the constant of CO."""
    j = np.arange(levels)
    energies = CO_B / CODATA.c * j * (j + 1)
    return Molecule(
        "rotor",
        28,
        energies,
        2 * j + 1,
        j.astype(str),
        j[1:],
        j[:-1],
        0 * j[1:] + 1e-7,
        2 * CO_B * j[1:],
        partition,
    )


@pytest.mark.parametrize("constants", [CODATA, RADMC3D])
def test_partition_function_of_a_rotor(constants):
    found = rotor(300).partition_function([20.0, 300.0, 1000.0], constants)
    x = constants.partition * CO_B / CODATA.c / np.array([20.0, 300.0, 1000.0])
    # Mulholland's series; RADMC-3D's is linear between its nodes, for which see below
    np.testing.assert_allclose(found, 1 / x + 1 / 3 + x / 15 + 4 * x**2 / 315, rtol=3e-6)
    assert rotor(300).partition_function(1e-3) == 1.0


def test_partition_function_in_a_table_is_linear():
    molecule = rotor(5, ([10.0, 20.0, 40.0], [4.0, 8.0, 20.0]))
    np.testing.assert_allclose(molecule.partition_function([5.0, 15, 30, 99]), [4.0, 6, 14, 20])


def test_lines_have_names():
    molecule = rotor(6)
    names = (
        2,
        "2-1",
        "rotor 2-1",
        "J=2-1",
        "2→1",
        ("2", "1"),
        "230.5 GHz",
        230.54 * u.GHz,
        1.3004 * u.mm,
    )
    assert {molecule.line(name) for name in names} == {1}
    for wrong in (0, 6, "7-6", "CO 2-1", "200 GHz", "1-2", "anything"):
        with pytest.raises(InputError, match=r"2 \(2-1, 230.544 GHz\)|lines 1 to 5"):
            molecule.line(wrong)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"up": [7, 1, 2]}, "between two of its 4 levels"),
        ({"weights": [1, 2]}, "one number for each level"),
        ({"weight": 0.0}, "must be positive"),
        ({"partition": ([2, 1], [1, 1])}, "which rise"),
    ],
)
def test_bad_molecules(changes, message):
    with pytest.raises(InputError, match=message):
        rotor(4).replace(**changes)


JPL = """\
             28001  CO
  115271.2018   .0005 -5.0105 2     .0000  3 -28001 101 1           0
  230538.0000   .0005 -4.1197 2    3.8450  5 -28001 101 2           1
  345795.9899   .0005 -3.6118 2   11.5350  7 -28001 101 3           2
"""
CO_PARTITION = {
    300: 108.8651,
    150: 54.5814,
    75: 27.4545,
    37.5: 13.8965,
    18.75: 7.1223,
    9.375: 3.7435,
}
LAMDA_RATES = [7.203e-8, 6.910e-7, 2.497e-6]


def test_catalogues_have_the_rates_of_the_leiden_database(tmp_path):
    path = tmp_path / "c028001.cat"
    path.write_text(JPL)
    with pytest.raises(InputError, match="partition=") as raised:
        Molecule.open(path)
    assert str(path) in str(raised.value)
    co = Molecule.open(path, "CO", partition=CO_PARTITION)
    # four digits of the logarithm of the intensity are 1e-4
    np.testing.assert_allclose(co.einstein_a, LAMDA_RATES, rtol=3e-4)
    np.testing.assert_allclose(co.frequencies, [115.2712018e9, 230.538e9, 345.7959899e9])
    np.testing.assert_allclose(co.energies, [0.0, 3.845, 11.535, 23.0695], atol=1e-4)
    assert (co.name, co.weight, co.labels) == ("CO", 28.0, ("0", "1", "2", "3"))
    assert co.line("CO 2-1") == 1
    # a power law between temperatures a factor of two apart
    t = np.array([12.0, 50.0, 220.0])
    np.testing.assert_allclose(co.partition_function(t), rotor(60).partition_function(t), rtol=5e-3)
    path.write_text(JPL.replace("-4.1197", "       "))
    with pytest.raises(InputError, match="line 3: expected a line of a catalogue"):
        Molecule.open(path, partition=CO_PARTITION)
    path.write_text(JPL.splitlines()[2])  # energies count from the ground state all the same
    part = Molecule.open(path, partition=CO_PARTITION)
    assert (part.labels, part.line("2-1")) == (("ground", "1", "2"), 0)
    np.testing.assert_allclose(part.energies, co.energies[:3], atol=1e-4)
    table = Table(
        {
            "FREQ": [115271.2018, 230538.0],
            "LGINT": [-5.0105, -4.1197],
            "ELO": [0.0, 3.845],
            "GUP": [3, 5],
            "TAG": [28001, 28001],
            "QN'": [1, 2],
            'QN"': [0, 1],
        }
    )
    table.write(tmp_path / "co.ecsv")
    saved = Molecule.open(tmp_path / "co.ecsv", partition=CO_PARTITION)
    np.testing.assert_allclose(saved.einstein_a, co.einstein_a[:2], rtol=1e-12)
    assert saved.labels == ("0", "1", "2")
    assert saved.name == "co"


def test_large_weights_of_catalogues_begin_with_a_letter():
    assert [molecule_files._weight(text) for text in (" 21", "999", "A05", "B10")] == [
        21,
        999,
        1005,
        1110,
    ]


# Spectra


def test_blackbodies():
    nu = np.array([1e11, 1e14])
    np.testing.assert_array_equal(Blackbody(5772 * u.K).intensity(nu), CODATA.planck(nu, 5772.0))
    grid = np.array([1e14, 3e14, 2e14])
    star = Blackbody(5772, grid=grid)
    np.testing.assert_array_equal(star.intensity(grid), CODATA.planck(grid, 5772.0))
    ends = RADMC3D.planck([1e14, 2e14], 5772.0)
    found = star.intensity([1.5e14, 1e14, 3e14, 9e13], "radmc3d")  # zero at the ends, too
    np.testing.assert_allclose(found, [ends.mean(), 0.0, 0.0, 0.0])
    for wrong in (0.0, [1, 2], np.nan):
        with pytest.raises(InputError, match="positive temperature"):
            Blackbody(wrong)


def test_tabulated_spectra():
    waves = np.array([1.0, 3.0, 100.0])
    table = TabulatedSpectrum(waves, waves**2)
    np.testing.assert_allclose(table.intensity(at([1.0, 2.0, 50.0])), [1.0, 4.0, 2500.0])
    np.testing.assert_array_equal(table.intensity(at([0.5, 200.0])), 0.0)
    halfway = 0.5 * (at(1.0) + at(3.0))
    np.testing.assert_allclose(table.intensity([halfway, at(1.0)], "radmc3d"), [5.0, 0.0])
    with_zero = TabulatedSpectrum(waves, [1.0, 0.0, 1.0])
    assert np.all(np.isfinite(with_zero.intensity(at([1.0, 2.0, 3.0, 50.0]))))
    with pytest.raises(InputError, match="3 intensities"):
        TabulatedSpectrum(waves, [1.0, 2.0])


def test_columns_of_catalogues_that_touch(tmp_path):
    """Weights of 1000 and more begin with a letter; energies, weights and tags may touch."""
    path = tmp_path / "c104501.cat"
    card = "  115271.2018   .0005 -5.0105 212345.6789{}{:>7} 101 1           0\n"
    for weight, tag, expected in (
        ("A05", -104501, 1005.0),
        ("B12", 104501, 1112.0),
        ("999", -104501, 999.0),
        (" 21", 28501, 21.0),
    ):
        path.write_text(card.format(weight, tag))
        molecule = Molecule.open(path, partition=CO_PARTITION)
        assert (molecule.weight, molecule.weights.max()) == (abs(tag) // 1000, expected)
        np.testing.assert_allclose(molecule.energies[1], 12345.6789)


def test_tags_of_astroquery(tmp_path):
    """In tables of CDMS the tag is without the weight; in those of JPL with it."""
    columns = {"FREQ": [115271.2018], "LGINT": [-5.0105], "ELO": [0.0], "GUP": [3]}
    for more, weight in (
        ({"MOLWT": [28], "TAG": [503]}, 28.0),
        ({"MOLWT": [-46], "TAG": [-1]}, 46.0),
        ({"MOLWT": [29]}, 29.0),
        ({"TAG": [-28001]}, 28.0),
    ):
        table = Table({**columns, **more, "QN'": ["1"], 'QN"': ["0"]})
        table.write(tmp_path / "co.ecsv", overwrite=True)
        assert Molecule.open(tmp_path / "co.ecsv", partition=CO_PARTITION).weight == weight
    Table({**columns, "TAG": [503], "QN'": ["1"], 'QN"': ["0"]}).write(
        tmp_path / "co.ecsv", overwrite=True
    )
    with pytest.raises(InputError, match="MOLWT"):
        Molecule.open(tmp_path / "co.ecsv", partition=CO_PARTITION)
