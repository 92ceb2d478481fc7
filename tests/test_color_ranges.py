"""Ranges of colours that are left open: of what a medium shows of another expression."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u
from matplotlib import colors

import voluminous as vm
from test_any_grid_calibration import GRIDS
from voluminous.media.bound import Binding

CAMERA = vm.Orthographic(60, 30, resolution=24)


def cube(cells=32, **fields):
    volume = vm.Volume(vm.CartesianGrid.uniform(cells, (-1, 1)))
    for name, text in fields.items():
        volume[name] = text
    return volume


def ends(medium, volume):
    """Return the range of the colours of a medium in a volume."""
    scale = medium.calibrated(volume).modulation.color.scale
    return np.array([scale.values[0], scale.values[-1]])


@pytest.mark.parametrize("kind", ["cartesian", *GRIDS])
def test_the_range_is_that_of_what_a_shell_shows(kind):
    volume = vm.Volume(
        vm.CartesianGrid.uniform(32, (-1, 1)) if kind == "cartesian" else GRIDS[kind]()
    )
    volume["f"] = "r**2"
    volume["z2"] = "10 * z"
    volume["far"] = "100 * r"
    shell = vm.Gaussian("f", 0.36, 0.02, vm.ColorBy("z2", "plasma"), 1.0)
    # A sphere of radius 0.6, evenly spread in z: all but a hundredth; cells are up to 0.25 wide.
    np.testing.assert_allclose(ends(shell, volume), [-5.9, 5.9], atol=1.3)
    steep = ends(vm.Gaussian("f", 0.36, 0.02, vm.ColorBy("far", "plasma"), 1.0), volume)
    assert np.all((steep > 40) & (steep < 80))


@pytest.mark.parametrize(
    "medium",
    [
        lambda by, gate: vm.Rectangle("x", 0.5, 0.25, by, 1.0, where=gate),
        lambda by, gate: vm.Isosurface("x", 0.5, by, opacity=0.5, where=gate),
        lambda by, gate: vm.Table("x", [0.3, 0.5, 0.7], by, [0.0, 1.0, 0.0], where=gate),
        lambda by, gate: vm.Gaussian("x", 0.5, 0.1, by, 1.0, where=gate),
    ],
    ids=["rectangle", "isosurface", "table", "gaussian"],
)
def test_gates_count_and_99_percent_are_between(medium):
    volume = cube(64, x2="x", t="100 * y")
    low, high = ends(medium(vm.ColorBy("t", "viridis"), None), volume)
    # Evenly spread from -100 to 100; a layer of cells is 3 of them.
    np.testing.assert_allclose([low, high], [-99, 99], atol=2)
    low, high = ends(medium(vm.ColorBy("t", "viridis"), "y > 0.5"), volume)
    np.testing.assert_allclose([low, high], [50, 100], atol=4)


def test_what_is_given_stays_and_what_is_measured_has_the_unit_of_the_field():
    volume = cube(24)
    volume["t"] = volume.evaluate("300 + 100 * y") * u.K
    by = vm.ColorBy("t", "inferno", vmax=0.35 * u.kK)
    found = vm.Gaussian("x", 0, 0.2, by, 1.0).calibrated(volume).describe()["color"]
    assert found["vmax"] == "0.35 kK"
    low, unit = found["vmin"].split()
    assert unit == "K"
    assert 200 < float(low) < 206
    norm = colors.Normalize(vmin=100, vmax=500)
    assert vm.ColorBy("t", "inferno", norm=norm).describe()["vmax"] == 500
    assert vm.ColorBy("t", "inferno", 1, 10, "log").describe()["norm"] == "log"


def test_a_picture_has_the_measured_range_and_measures_it_once(monkeypatch):
    from voluminous.calibration import open_numbers

    counted, runs = [], open_numbers.cell_runs
    monkeypatch.setattr(open_numbers, "cell_runs", lambda *args: counted.append(1) or runs(*args))
    x, y = (cube(16).evaluate(name).astype("f4") for name in "xy")
    grid = vm.CartesianGrid.uniform(16, (-1, 1))
    volume = vm.Volume(grid, f=x, t=y)
    shell = vm.Gaussian("f", 0.3, 0.1, vm.ColorBy("t", "plasma"), 1.0)
    image = vm.render(volume, shell, CAMERA)
    low, high = ends(shell, volume)
    given = vm.Gaussian("f", 0.3, 0.1, vm.ColorBy("t", "plasma", low, high), 1.0)
    np.testing.assert_array_equal(image.intensity, vm.render(volume, given, CAMERA).intensity)
    assert image.provenance["medium"]["color"]["vmin"] == low
    counted.clear()
    brighter = vm.Gaussian("f", 0.3, 0.1, vm.ColorBy("t", "plasma", brightness=2), 0.5)
    vm.render(volume, brighter, vm.Orthographic(10, 20, resolution=24))
    assert not counted
    x[:] = np.where(y > 0, x, 9.0)  # the shell is elsewhere, in place
    assert vm.render(volume, shell, CAMERA).provenance["medium"]["color"]["vmin"] > -0.2


@pytest.mark.parametrize("norm", [None, "log"])
def test_a_colormap_takes_the_range_of_its_own_expression(norm):
    volume = cube(32)
    volume["t"] = (10 ** (3 * volume.evaluate("y"))) * u.K
    medium = vm.Colormap("t", "viridis", opacity=0.3, norm=norm, where="y > 0")
    found = medium.calibrated(volume)
    told = found.describe()
    assert told["vmin"].endswith(" K")
    np.testing.assert_allclose(np.log10(found.values[[0, -1]]), [0, 3], atol=0.1)
    image = vm.render(volume, medium, CAMERA)
    np.testing.assert_array_equal(image.intensity, vm.render(volume, found, CAMERA).intensity)
    with pytest.raises(vm.InputError, match=r"take medium\.calibrated"):
        medium.bind(Binding()).coefficients({}, None)
    assert "vmin" not in medium.describe()


def test_mistakes_are_told_at_once_and_colours_without_a_range_when_they_are_needed():
    with pytest.raises(vm.errors.UnknownNameError, match="unknown colormap 'plasm'"):
        vm.ColorBy("t", "plasm")
    with pytest.raises(vm.errors.UnknownNameError, match="unknown norm 'logg'"):
        vm.ColorBy("t", "plasma", norm="logg")
    with pytest.raises(vm.InputError, match="samples must be"):
        vm.ColorBy("t", "plasma", samples=1)
    with pytest.raises(vm.InputError, match=r"give vmin and vmax, or take medium\.calibrated"):
        _ = vm.ColorBy("t", "plasma").scale
