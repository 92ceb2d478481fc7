"""path_length="auto": thicknesses with known answers, and where numbers take its place."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import voluminous as vm
from voluminous.calibration.open_numbers import extent_of
from voluminous.calibration.samples import cell_runs
from voluminous.calibration.thickness import Profile, thicknesses, weighted_median
from voluminous.expressions import Expression

SQRT_2PI = np.sqrt(2 * np.pi)


def ramp(slope=3.0, edges=None, *, axis=0, unit=None, across=40.0):
    """Return a volume whose field a rises linearly along one axis, with cells of any widths."""
    along = np.linspace(0, 30, 61) if edges is None else np.asarray(edges)
    sides = [np.linspace(0, across, 5)] * 3
    sides[axis] = along
    grid = vm.CartesianGrid(*sides, unit=unit)
    shape = [-1 if k == axis else 1 for k in range(3)]
    a = np.broadcast_to(slope * grid.centers[axis].reshape(shape), grid.shape)
    return vm.Volume(grid, a=a)


def length(medium, volume):
    return medium.calibrated(volume).path_length


@pytest.mark.parametrize("sigma", [0.01, 0.3, 2.0])  # thinner than a cell, and thicker
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_gaussian_on_a_ramp_is_as_thick_as_its_integral(sigma, axis):
    shell = vm.Gaussian("a", 40, sigma, 1, 1, "auto")
    # The Gaussian is integrated up to six sigma: 1 - erf(6 / sqrt 2) = 2e-9 is left out.
    np.testing.assert_allclose(
        length(shell, ramp(axis=axis)), SQRT_2PI * sigma / 3, rtol=1e-8, atol=0
    )


@pytest.mark.parametrize("half_width", [0.001, 0.2, 5.0])
def test_a_rectangle_on_a_ramp_is_as_thick_as_it_is_wide(half_width):
    shell = vm.Rectangle("a", 40, half_width, 1, 1, "auto")
    # A few roundings of numbers around 40.
    np.testing.assert_allclose(length(shell, ramp()), 2 * half_width / 3, rtol=1e-11)


@pytest.mark.parametrize("opacities", [[0, 1, 0], 0.0])
def test_a_table_counts_its_opacity_or_else_its_brightness(opacities):
    opacity = np.broadcast_to(opacities, 3)
    table = vm.Table("a", [30, 40, 50], [0, 2, 0], opacity, "auto")
    # A triangle of height one and base 20.
    np.testing.assert_allclose(length(table, ramp()), 10 / 3, rtol=1e-12)


def test_a_table_ends_where_the_data_end():
    # Opaque for all x, of which the volume has 0.75 to 89.25.
    table = vm.Table("a", [10, 20], [1, 1], [1, 1], "auto")
    assert extent_of(ramp(), Expression("a")) == (0.75, 89.25)
    np.testing.assert_allclose(length(table, ramp()), 88.5 / 3, rtol=1e-12)


def test_a_shell_that_is_nowhere_gets_the_shortest_side_and_shows_nothing():
    shell = vm.Gaussian("a", -1e3, 1, 1, 1, "auto")
    assert length(shell, ramp()) == pytest.approx(30, rel=1e-15)
    image = vm.render(ramp(), shell, vm.Orthographic(resolution=4), scheme="first-order")
    assert not image.intensity.any()


@pytest.mark.parametrize("center", [3.2, 3.5, 4.0])
@pytest.mark.parametrize("sigma", [0.003, 0.05])
def test_the_shells_of_a_prestellar_core_are_as_thick_as_the_closed_form(center, sigma):
    # x = log10(28) - 2 log10(r): r = sqrt(28 / 10^x), |dx/dr| = 2 / (r ln 10).
    core = vm.models.prestellar_core(64)
    radius = np.sqrt(28 / 10**center) * vm.models.PARSEC
    thickness = SQRT_2PI * sigma * radius * np.log(10) / 2
    found = length(vm.Gaussian("log10(density)", center, sigma, 1, 1, "auto"), core)
    # Weighting with the area moves the median outwards by 2 (σ ln 10 / 2)² = 0.7 % at σ = 0.05;
    # at 4.0 the radius is 13 cells, of which central differences make 1/(2·13²) = 0.3 %.
    np.testing.assert_allclose(found, thickness, rtol=0.012)


def test_the_number_is_in_the_volumes_unit_and_the_scalar_in_its_own():
    u = pytest.importorskip("astropy.units")
    volume = ramp(unit="pc")
    volume.set_unit("a", "km")
    shell = vm.Rectangle("a", 40e3 * u.m, 300 * u.m, 1, 1, "auto")
    np.testing.assert_allclose(length(shell, volume), 0.6 / 3, rtol=1e-11)
    assert isinstance(length(shell, volume), float)


def test_only_what_is_auto_is_changed_and_only_in_the_copy():
    automatic = vm.Gaussian("a", 40, 1, (1, 2), 0.1, "auto")
    given_length = vm.Gaussian("a", 20, 1, (1, 2), 0.1, 7.0)
    total = automatic + given_length
    done = total.calibrated(ramp())
    assert [type(p.path_length) for p in done.components()] == [float, float]
    assert done.components()[1] is given_length
    assert automatic.path_length == "auto"
    assert done.calibrated(ramp()) is done
    told = {**automatic.describe(), "path_length": done.components()[0].path_length}
    assert done.components()[0].describe() == told


@given(st.floats(-3, 3), st.floats(1e-9, 4))
def test_a_profile_is_averaged_over_a_cell(x, reach):
    # A trapezium with a jump, and the mean of it by a plain sum.
    profile = Profile(np.array([-1.0, 0.0, 0.0, 2.0]), np.array([0.0, 0.5, 1.0, 1.0]))
    places = x + reach * (2 * (np.arange(20000) + 0.5) / 20000 - 1)
    plain = np.where(places < 0, 0.5 * (places + 1), 1.0) * ((places >= -1) & (places < 2))
    found = profile.mean(np.array([x]), np.array([reach]))[0]
    # The sum errs by jumps of one within two of its steps; a narrow cell sees one value.
    near_jump = min(abs(x), abs(x - 2)) <= reach < 1e-2
    assert abs(found - plain.mean()) <= (1.0 if near_jump else 2e-3)


def test_shells_thinner_than_a_cell_are_found_between_cell_centres():
    # x is 0, 3, 6, … at the centres, and the shell is at 31 ± 0.01: no centre is in it.
    volume = ramp(1.0, np.arange(0, 60, 3) - 1.5)
    shell = vm.Rectangle("a", 31, 0.01, 1, 1, "auto")
    np.testing.assert_allclose(length(shell, volume), 0.02, rtol=1e-10)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("center", [0.3, 0.5, 0.7])
def test_a_field_of_two_values_has_shells_between_its_cells(axis, center):
    """Central differences make 0 to 0.25, and 0.75 to 1, of what such cells hold."""
    steep = ramp(1.0, np.arange(0, 31, 2), axis=axis)
    step = vm.Volume(steep.grid, a=(steep.array("a") > 12).astype("u1"))
    # From the centre at 11 to the one at 13 it rises by one.
    shell = vm.Rectangle("a", center, 0.01, 1, 1, "auto")
    np.testing.assert_allclose(length(shell, step), 0.02 * 2.0, rtol=1e-10)


def test_of_a_large_volume_layers_are_looked_at_and_all_if_those_miss_the_shell():
    volume = ramp()
    assert sum(p.x.size for p in cell_runs(volume, Expression("a"), 200)) <= 200
    shells = [Profile(np.array([c - 0.1, c + 0.1]), np.ones(2)) for c in np.arange(2.0, 88, 0.5)]
    found = thicknesses(volume, Expression("a"), shells, budget=200)
    np.testing.assert_allclose([shell.length for shell in found], 0.2 / 3, rtol=1e-9)


def test_a_line_crosses_a_closed_shell_twice_and_a_slanted_sheet_once():
    profile = Profile(np.array([0.45, 0.55]), np.ones(2))
    axis = np.linspace(-1, 1, 81)
    ball = vm.Volume(vm.CartesianGrid(axis, axis, axis))
    through = thicknesses(ball, Expression("(y + z) / sqrt(2)"), [profile])[0]
    closed = thicknesses(ball, Expression("r"), [profile])[0]
    # At 45 degrees; lines that leave the domain within the sheet see less.
    assert through.crossings == pytest.approx(np.sqrt(2), rel=0.05)
    # Lines that graze the shell see more than two of its thicknesses: the mean over the disc of
    # radius 0.55 is the shell's volume over area and thickness, 4/3 (0.55³ - 0.45³) / 0.55² / 0.1.
    # The rim of that disc is as uncertain as a cell, 0.025, is large: 2 · 0.0125 / 0.55.
    assert closed.crossings == pytest.approx(4 / 3 * (0.55**3 - 0.45**3) / 0.55**2 / 0.1, rel=0.045)


@pytest.mark.parametrize("wrong", ["Auto", ""])
def test_mistakes_are_named(wrong):
    with pytest.raises(vm.InputError, match="'auto'"):
        vm.Gaussian("a", 40, 1, 1, 1, wrong)
    with pytest.raises(vm.InputError, match=r"a vm\.Volume first, got str; vm\.open"):
        vm.Gaussian("a", 40, 1, 1, 1).calibrated("data.npz")
    with pytest.raises(vm.errors.UnknownNameError, match="'b'"):
        vm.Gaussian("b", 40, 1, 1, 1).calibrated(ramp())


@pytest.mark.parametrize("precision", ["single", "double"])
def test_a_picture_tells_the_number_and_one_crossing_shows_the_colour(precision):
    # Along the ramp each ray crosses the shell once: intensity j/α (1 - e^-τ) with τ = opacity.
    volume = ramp(1.0, np.linspace(0, 30, 601), axis=2)
    shell = vm.Gaussian("a", 15, 1.0, (0.3, 0.9), 0.5, "auto")
    image = vm.render(
        volume,
        shell,
        vm.Orthographic(0, 0, width=20, resolution=2),
        scheme="second-order",
        precision=precision,
    )
    told = image.provenance["medium"]["path_length"]
    assert told == pytest.approx(SQRT_2PI, rel=1e-8)
    expected = np.array([0.3, 0.9]) / 0.5 * (1 - np.exp(-0.5))
    # 20 cells per σ: the trapezoidal rule of the scheme is exact to far less than 1e-4.
    np.testing.assert_allclose(image.intensity, np.broadcast_to(expected, image.shape), rtol=1e-4)


@pytest.mark.parametrize(
    "make",
    [
        lambda **own: vm.Gaussian("a", 20, 2, (1, 0.5, 0.2), 0.3, **own),
        lambda **own: vm.Rectangle("a", 20, 2, (1, 0.5, 0.2), 0.3, **own),
        lambda **own: vm.Table("a", [10, 20, 30], [0, 1, 0], [0, 0.3, 0], **own),
        lambda **own: vm.Colormap("a", "viridis", 10, 30, 0.3, **own),
    ],
)
def test_a_path_length_that_is_not_given_is_measured(make):
    assert make().key() == make(path_length="auto").key()
    assert make().calibrated(ramp()).path_length > 0


def counted(monkeypatch):
    """Return a list to which every measurement adds how many shells it is of."""
    found = []

    def measured(volume, expr, profiles):
        found.append(len(profiles))
        return thicknesses(volume, expr, profiles)

    # The module, not the function of the same name.
    monkeypatch.setattr(sys.modules[extent_of.__module__], "thicknesses", measured)
    return found


def test_pictures_of_a_volume_measure_once(monkeypatch):
    found, volume = counted(monkeypatch), ramp(axis=2)
    camera = vm.Orthographic(resolution=4)
    shells = [vm.Gaussian("a", center, 1.0, 1.0, 0.1) for center in (20.0, 40.0)]

    def seen(*media):
        return vm.render(volume, sum(media), camera).intensity

    first = seen(*shells)
    assert found == [2]
    np.testing.assert_array_equal(seen(*shells), first)
    vm.render(volume, sum(shells), vm.Orthographic(30, 40, resolution=4))
    seen(vm.Gaussian("a", 20.0, 1.0, 5.0, 0.3))  # another colour, another opacity
    assert found == [2]
    seen(shells[0], vm.Gaussian("a", 60.0, 1.0, 1.0, 0.1))  # a new level
    assert found == [2, 1]
    seen(vm.Colormap("a", "viridis", 10.0, 60.0, 0.1), vm.Colormap("a", "magma", 10.0, 60.0, 0.1))
    assert found == [2, 1, 1]  # both are as wide
    assert shells[0].calibrated(volume).path_length == pytest.approx(SQRT_2PI / 3.0)


@pytest.mark.parametrize("spread", [0.1, 3.0])
def test_the_median_of_many_values_is_that_of_all_of_them_sorted(spread):
    rng = np.random.default_rng(5)
    values = np.minimum(rng.lognormal(0.0, spread, 100_000), 4.0)  # many are equal
    weights = rng.random(values.size)
    order = np.argsort(values, kind="stable")
    reached = np.cumsum(weights[order])
    median = values[order[np.searchsorted(reached, 0.5 * reached[-1])]]
    assert weighted_median(values, weights) == median
