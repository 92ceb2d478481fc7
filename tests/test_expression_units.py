"""Units of expressions: known, and converted for, or refused with the place and a remedy."""

from __future__ import annotations

import pickle

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from voluminous.expressions import IntervalOps
from voluminous.expressions.interval import Interval

CAMERA = vm.Orthographic(0, 0, width=0.1 * u.AU, resolution=1)
A0 = 1e-13  # 1 / cm
PER_AU = A0 * u.AU.to(u.cm)


def gas():
    """Return a uniform cloud 2 AU across: extinction, density, temperatures and velocities."""
    volume = vm.Volume(vm.CartesianGrid.uniform(4, (-1, 1), unit="AU"))
    ones = np.ones(volume.grid.shape)
    volume["a0"] = A0 * ones / u.cm
    volume["j0"] = 2e-13 * ones * u.erg / u.s / u.cm**3
    volume["watts"] = 2e-20 * ones * u.W / u.cm**3
    volume["density"] = 1e-20 * ones * u.g / u.cm**3
    volume["same"] = 1e-17 * ones * u.kg / u.m**3
    volume["temperature"] = volume["T"] = 10 * ones * u.K
    volume["share"] = 0.5 * ones
    volume["percentage"] = 20 * ones * u.percent
    volume["B_x"] = volume["B_y"] = volume["B_z"] = ones * u.uG / np.sqrt(3)
    volume["angle"] = 0.1 * ones * u.rad
    volume["velocity_x"] = 0.1 * ones * u.km / u.s
    volume["velocity_y"] = 1e4 * ones * u.cm / u.s
    volume["velocity_z"] = 1e2 * ones * u.m / u.s
    return volume


GAS = gas()
# Expression, unit, value in that unit.
KNOWN = [
    ("2*a0 + 1e-13 1/cm", "1/cm", 3e-13),
    ("a0 * exp(-(velocity_x / (0.2 km/s))**2)", "1/cm", A0 * np.exp(-0.25)),
    ("density * exp(-20 K/temperature)", "g/cm3", 1e-20 * np.exp(-2)),
    ("density + same", "g/cm3", 2e-20),
    ("velocity_x / velocity_y", "", 1),
    ("sqrt(velocity_x**2 + velocity_y**2)", "km/s", 0.1 * np.sqrt(2)),
    ("norm(velocity)", "km/s", 0.1 * np.sqrt(3)),
    ("0.5 * density * norm(velocity)**2", "g km2 / (cm3 s2)", 0.5e-20 * 0.03),
    ("max(velocity_x, velocity_y)", "km/s", 0.1),
    ("clip(density, 1e-21 g/cm3, 5e-18 kg/m3)", "g/cm3", 5e-21),
    ("where(share > 0.6, density, 0)", "g/cm3", 0),
    ("density if share > 0.6 else 3 kg/m3", "g/cm3", 3e-3),
    ("density > 1e-17 kg/m3", "", 0),
    ("density > 9e-21", "", 1),  # a number that is compared is in the unit of the other side
    ("velocity_x > velocity_y", "", 0),
    ("log10(density)", "dex(g/cm3)", -20),
    ("log10(density) + 20", "dex(g/cm3)", 0),
    ("log10(density) - log10(same)", "", 0),
    ("10**(log10(density) + 1)", "g/cm3", 1e-19),
    ("interp(temperature, [5 K, 20 K], [1 cm2/g, 4 cm2/g]) * density", "1/cm", 2e-20),
    ("interp(temperature, [5000 mK, 20 K], [1, 4])", "", 2),
    ("density % (3e-21 g/cm3)", "g/cm3", 1e-21),
    ("gradmag(log10(density))", "1/AU", 0),
    ("sin(velocity_x / (0.2 km/s))", "", np.sin(0.5)),
    ("theta_deg", "deg", 90),
    # Ratios are plain numbers wherever they meet one, whatever the units they are made of.
    ("velocity_x / velocity_y > 0.5", "", 1),
    ("(velocity_x / velocity_y) % 0.3", "", 0.1),
    ("where(share > 3, share, velocity_x / velocity_y)", "", 1),
    ("velocity_x / velocity_y > 2e-5 km/cm", "", 0),
    ("1 - percentage > 0.5", "", 1),
    ("max(share - percentage, 0.2)", "", 0.3),
    ("percentage > 0.3", "", 1),  # compared in percent, the unit of the field
    # Gauss are those of Gaussian units where no others fit.
    ("B_x**2 / (8*pi) + B_x * B_y / (8*pi)", "uG2", 1 / (12 * np.pi)),
    ("8*pi*(1 dyn/cm2) / norm(B)**2", "", 8e12 * np.pi),
    ("velocity_x + norm(B) / sqrt(4*pi*density)", "km/s", 0.1 + 1e-11 / np.sqrt(4e-20 * np.pi)),
    ("norm(B)**2 / (2 * (1.25663706e-6 N/A2)) + 0 Pa", "uG2 A2/N", 0.5 / 1.25663706e-6),
    # Radians are plain numbers, degrees become radians beside them.
    ("angle - theta_deg", "rad", 0.1 - np.pi / 2),
    ("where(share > 0.1, angle, share)", "", 0.1),
    ("atan2(velocity_x, velocity_y) > 30 deg", "", 1),
    ("atan2(velocity_x, velocity_y) + 1", "rad", 1 + np.pi / 4),
    ("atan2(velocity_x, velocity_y) / (1 deg)", "", 45),
    ("exp(-(angle / (1 deg))**2 / 100)", "", np.exp(-((0.1 * 180 / np.pi) ** 2) / 100)),
    ("interp(temperature, [0, 20 K], [0, 4 cm2/g]) * density", "1/cm", 2e-20),
    # What is a unit times a number is in that unit.
    ("10 K * (3 erg/cm3) / density / (1 km/s)**2", "K", 3e11),
    ("where(share > 3, T, T * (1 N/m2) / (1 dyn/cm2))", "K", 100),
    ("sqrt((4 erg/cm3) / density) * (1 s)", "cm", 2e10),
    ("density * (1 pc)**3", "g", 1e-20 * (3.0856775814913674e18) ** 3),
    ("(1 pc)**2 / (1 AU) + 0*x", "pc", 648000 / np.pi),
    ("velocity_x / (1 cm)", "1/s", 1e4),
]
# Expression, and what the message must show.
REFUSED = [
    ("2*a0 + 1e-13", "'1e-13' is a plain number, expected 1 / cm"),
    ("a0 * exp(-(velocity_x/0.2)**2)", "is in km2 / s2, a plain number is needed"),
    ("density * exp(-20/temperature)", "is in 1 / K, a plain number is needed"),
    ("density + temperature", "'temperature' is in K, expected g / cm3"),
    ("where(share > 0.5, density, 1e-21)", "'1e-21' is a plain number"),
    ("share > 3 K", "a plain number is needed"),
    ("log(density)", "log10(density) is in dex"),
    ("share * log10(density)", "'log10(density)' is in dex"),
    ("log10(density) > 1e-20 g/cm3", "expected dex"),
    ("density**share", "is in g / cm3, a plain number is needed"),
    ("tanh(temperature)", "is in K, a plain number is needed"),
    ("temperature // 3", "'3' is a plain number"),
    ("atan2(temperature, density)", "expected K"),
    ("density * exp(-x**2)", "is in AU2"),
    ("dot(vector(density, 0, 0), vector(temperature, temperature, 0)) + share", "expected"),
]


@pytest.fixture(scope="module", autouse=True)
def angles():
    GAS["theta_deg"] = np.full(GAS.grid.shape, 90.0) * u.deg


@pytest.mark.parametrize(("expression", "unit", "value"), KNOWN)
def test_the_unit_is_known_and_numbers_are_converted(expression, unit, value):
    assert GAS.expression_unit(vm.Expression(expression)) == (u.Unit(unit) if unit else None)
    np.testing.assert_allclose(GAS.evaluate(expression), value, rtol=1e-12, atol=1e-30)
    plain = GAS.without_units(vm.Expression(expression))
    assert GAS.without_units(plain) is plain
    read_back(GAS, expression)  # isosurfaces, messages and pickles make expressions of texts


def read_back(volume, expression):
    plain = volume.without_units(vm.Expression(expression))
    read = pickle.loads(pickle.dumps(plain))
    np.testing.assert_allclose(volume.evaluate(read), volume.evaluate(expression), rtol=1e-12)
    assert volume.expression_unit(read) == volume.expression_unit(plain)


BASES = {"temperature": "K", "x": "AU", "(3 Msun)": "Msun", "(2 yr)": "yr"}
# Units of the same kind.
ALIKE = [
    ("km/s", "cm/s"),
    ("erg", "g km2 / s2"),
    ("pc", "cm"),
    ("g", "Msun"),
    ("N/m2", "dyn/cm2"),
    ("W", "erg/yr"),
    ("cm2/g", "pc2/Msun"),
    ("erg/g", "km2/s2"),
]
RATIOS = st.lists(
    st.tuples(st.sampled_from(ALIKE), st.sampled_from([-2, -1, 1, 2]), st.floats(0.1, 10.0)),
    min_size=1,
    max_size=3,
)


@hypothesis.given(st.sampled_from(list(BASES)), RATIOS)
@hypothesis.settings(max_examples=60, deadline=None)
def test_what_is_a_unit_times_a_number_is_in_that_unit(base, ratios):
    text, factor = base, 1.0
    for (one, other), power, number in ratios:
        text += f" * (({number!r} {one}) / (2 {other}))**{power}"
        factor *= (number / 2 * u.Unit(one).to(other)) ** power
    expression = vm.Expression(text)
    unit = GAS.expression_unit(expression)
    assert len(unit.bases) == 1
    assert unit.scale == 1.0
    start = GAS.evaluate(base) * u.Unit(BASES[base]).to(unit)
    # Factors of 1e33 and their powers: each is rounded a few times.
    np.testing.assert_allclose(GAS.evaluate(text), start * factor, rtol=1e-11)
    plain, ops = GAS.without_units(expression), IntervalOps()
    x = GAS.evaluate("x")
    fields = {"temperature": Interval(*[np.array(10.0)] * 2), "x": Interval(x.min(), x.max())}
    found = ops.number(plain.evaluate(ops, {n: fields[n] for n in plain.names}))
    np.testing.assert_allclose([found.lo, found.hi], np.sort([start.min(), start.max()]) * factor)


def test_rays_see_the_same_units():
    hot = "10 K * (3 erg/cm3) / density / (1 km/s)**2"
    found = vm.column(GAS, hot, CAMERA)
    assert found.intensity.item() == pytest.approx(3e11 * 2, rel=1e-6)  # along 2 AU
    assert u.Unit(found.intensity_unit) == u.K * u.AU
    medium = vm.Gaussian(hot, 3e11 * u.K, 1e10 * u.K, 1.0, 0.5, 2 * u.AU)
    assert vm.render(GAS, medium, CAMERA).intensity.item() == pytest.approx(
        2 - 2 * np.exp(-0.5), rel=1e-3
    )


@pytest.mark.parametrize(("expression", "message"), REFUSED)
def test_what_has_no_unit_is_refused_with_the_place(expression, message):
    with pytest.raises(vm.UnitsError) as caught:
        GAS.evaluate(expression)
    assert message in str(caught.value)
    assert "write" in str(caught.value)


DOORS = {
    "coefficients": lambda e: vm.render(GAS, vm.Coefficients(0, e), CAMERA),
    "gate": lambda e: vm.render(GAS, vm.Gaussian("share", 1, 1, 1, 1, 1, where=e), CAMERA),
    "moments": lambda e: vm.moments(GAS, "density", CAMERA, velocity=e),
    "condition": lambda e: vm.measure(GAS, "density", where=e),
    "derived": lambda e: gas().__setitem__("derived", e),
    "gradient": lambda e: GAS.evaluate(f"gradmag({e})"),
    "slice": lambda e: GAS.slice(e, resolution=4),
    "function": lambda e: vm.render(
        GAS, vm.Medium.from_function(lambda x: (x, 0.0), [e], 1), CAMERA
    ),
}


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("expression", ["density + temperature", "exp(-temperature)"])
def test_every_door_refuses(door, expression):
    with pytest.raises(vm.UnitsError, match="cannot be derived"):
        DOORS[door](expression)


EXTINCTIONS = [
    ("a0", 2 * PER_AU),
    ("a0 * exp(-(los(velocity)/(0.2 km/s))**2)", 2 * PER_AU * np.exp(-0.25)),
    ("2*a0 + 1e-13 1/cm", 6 * PER_AU),
    ("density * (1e7 cm2/g)", 2 * PER_AU),
    ("3 1/AU", 6.0),
    ("0.5", 1.0),
]


@pytest.mark.parametrize("scheme", ["first-order", "second-order", "post-classified"])
@pytest.mark.parametrize(("extinction", "depth"), EXTINCTIONS)
def test_optical_depths_are_those_of_the_slab(extinction, depth, scheme):
    image = vm.render(GAS, vm.Coefficients(0, extinction), CAMERA, scheme=scheme)
    np.testing.assert_allclose(image.optical_depth, depth, rtol=1e-5)  # single precision


@pytest.mark.parametrize(
    ("emission", "extinction", "message"),
    [
        (0, "density", "inverse length"),
        (["j0", "density", 0], 0, "emissivit"),
        (["j0", 1.0, 0], 0, "emissivit"),
    ],
)
def test_coefficients_of_another_kind_are_refused(emission, extinction, message):
    with pytest.raises(vm.UnitsError, match=message):
        vm.render(GAS, vm.Coefficients(emission, extinction), CAMERA)


def test_emissivities_in_different_units_are_converted():
    image = vm.render(GAS, vm.Coefficients(["j0", "watts", 0], 0), CAMERA)
    assert u.Unit(image.intensity_unit) == u.Unit("erg AU / (s cm3)")
    np.testing.assert_allclose(image.intensity[0, 0], [4e-13, 4e-13, 0], rtol=1e-5)


def test_the_parts_of_a_sum_emit_in_one_unit():
    both = vm.Coefficients("j0", 0) + vm.Coefficients("watts", "a0") + vm.Coefficients(0, "a0")
    image = vm.render(GAS, both, CAMERA)
    assert u.Unit(image.intensity_unit) == u.Unit("erg AU / (s cm3)")
    depth = 4 * PER_AU
    expected = 4e-13 / (2 * PER_AU) * (1 - np.exp(-depth))
    np.testing.assert_allclose(image.intensity, expected, rtol=1e-4)
    with pytest.raises(vm.UnitsError, match="expected erg"):
        vm.render(GAS, vm.Coefficients("j0", 0) + vm.Coefficients("density", 0), CAMERA)


def test_measurements_have_the_unit_of_the_expression():
    total = vm.measure(GAS, "density * exp(-20 K/temperature)")["density * exp(-20 K/temperature)"]
    expected = 1e-20 * np.exp(-2) * u.g / u.cm**3 * (2 * u.AU) ** 3
    assert abs(total / expected - 1).to_value("") < 1e-12
    column = vm.column(GAS, "density * exp(-20 K/temperature)", CAMERA)
    expected = 1e-20 * np.exp(-2) * u.g / u.cm**3 * 2 * u.AU
    found = column.intensity.item() * u.Unit(column.intensity_unit)
    assert abs(found / expected - 1).to_value("") < 1e-6
    for measured in (vm.measure, vm.column):
        with pytest.raises(vm.UnitsError, match="depend on the unit"):
            measured(GAS, "log10(density)", camera=CAMERA)


def test_functions_of_fields_with_units_say_what_they_return():
    def bare(a, v):
        return 0.0, a * vm.math.exp(-((v / 0.2) ** 2))

    fields = ["a0", "los(velocity)"]
    with pytest.raises(vm.UnitsError, match="units="):
        vm.render(GAS, vm.Medium.from_function(bare, fields, 1), CAMERA)
    told = vm.Medium.from_function(bare, fields, 1, units=(None, "1/cm"))
    # Plain numbers in the fields' own units: los(velocity) is in km/s as velocity_x is.
    image = vm.render(GAS, told, CAMERA)
    np.testing.assert_allclose(image.optical_depth, 2 * PER_AU * np.exp(-0.25), rtol=1e-5)
    read = vm.Medium.from_function(
        lambda a, v: (0.0, a * vm.math.exp(-(v**2))), ["a0", "los(velocity) / (0.2 km/s)"], 1
    )
    image = vm.render(GAS, read, CAMERA)
    np.testing.assert_allclose(image.optical_depth, 2 * PER_AU * np.exp(-0.25), rtol=1e-5)


def test_a_volume_without_units_is_free():
    volume = vm.Volume(vm.CartesianGrid.uniform(4, (-1, 1)))
    volume["density"] = np.full(volume.grid.shape, 2.0)
    volume["temperature"] = np.full(volume.grid.shape, 3.0)
    assert np.all(volume.evaluate("density + temperature * exp(-x + x)") == 5.0 - 3 + 3)
    volume["mixed"] = "log(density) + density > temperature"
    image = vm.render(volume, vm.Coefficients(0, "density"), vm.Orthographic(0, 0, resolution=1))
    np.testing.assert_allclose(image.optical_depth, 4.0, rtol=1e-6)
