"""Quantities of other packages keep their unit at every door, or are refused."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from voluminous.units import as_quantity, plain, unit_of

unyt = pytest.importorskip("unyt")
pint = pytest.importorskip("pint")
xr = pytest.importorskip("xarray")

REGISTRY = pint.UnitRegistry()
MAKERS = {
    "astropy": lambda value, unit: value * u.Unit(unit),
    "unyt": lambda value, unit: unyt.unyt_array(value, unit),
    "pint": lambda value, unit: REGISTRY.Quantity(value, {"kpc": "kiloparsec"}.get(unit, unit)),
    "xarray": lambda value, unit: xr.DataArray(value, attrs={"units": unit}),
    "xarray of pint": lambda value, unit: xr.DataArray(
        REGISTRY.Quantity(np.asarray(value), {"kpc": "kiloparsec"}.get(unit, unit))
    ),
}
HALF = 0.5 * u.kpc


def lengths(make):
    """Return what each door makes of half a kiloparsec, in parsecs."""
    half = make(0.5, "kpc")
    cube = np.array([[-0.5, 0.5]] * 3)
    grid = vm.CartesianGrid.uniform(2, make(cube, "kpc"))
    image = vm.Image(np.ones((2, 2, 1)), x=make(np.array([0.5, 1.0]), "kpc"), unit="pc")
    return {
        "path_length": vm.Gaussian("a", 1, 0.1, 1, 0.1, half).path_length,
        "camera": vm.Orthographic(width=half).width,
        "center": vm.Orthographic(center=make([0.5, 0, 0], "kpc")).center[0],
        "position": vm.Perspective(make([0.5, 0, 0], "kpc"), make([0, 0, 0], "kpc")).position[0],
        "region": vm.regions.Sphere((0, 0, 0), half).radius,
        "box": vm.regions.Box(make([0, 0, 0], "kpc"), make([0.5, 1, 1], "kpc")).high[0],
        "grid": grid.bounds[0, 1] * grid.unit,
        "pairs": vm.CartesianGrid.uniform(2, [(-half, half)] * 3).bounds[0, 1] * u.kpc,
        "edges": vm.CartesianGrid(*[make(np.array([0, 0.5]), "kpc")] * 3).bounds[0, 1] * u.kpc,
        "sphere": vm.SphericalGrid(make(np.array([0.1, 0.5]), "kpc"), [0, 1]).bounds.max() * u.kpc,
        "stars": vm.Stars(make(np.array([[0.5, 0, 0]]), "kpc"), "white", radii=1.0).positions[0, 0],
        "lines": vm.Curves(make(np.array([[0.5, 0, 0], [1, 0, 0]]), "kpc")).places[0, 0] * u.kpc,
        "width": vm.Curves(np.eye(3), width=half).width,
        "image": image.x[0] * u.pc,
        "particles": vm.Volume.from_particles(
            make(np.array([[0.1, 0.1, 0.1], [0.5, 0.4, 0.3]]), "kpc"), np.ones(2)
        ).unit.to(u.kpc)
        * HALF,
    }


@pytest.mark.parametrize("package", MAKERS)
def test_lengths_keep_their_unit_at_every_door(package):
    for door, found in lengths(MAKERS[package]).items():
        assert u.isclose(u.Quantity(found), HALF, rtol=1e-6), door


@pytest.mark.parametrize("package", MAKERS)
def test_fields_keep_their_unit(package):
    make = MAKERS[package]
    volume = vm.Volume(vm.CartesianGrid.uniform(2, (0, 1)), v=make(np.full((2, 2, 2), 3.0), "km/s"))
    assert volume.field_unit("v") == u.km / u.s
    assert np.all(volume.array("v") == 3.0)
    shell = vm.Gaussian("v", make(3e3, "m/s"), make(0.5, "km/s"), 1, 0.1, 1)
    image = vm.render(volume, shell, vm.Orthographic(0, 0, resolution=1))
    # In the middle of the shell: tau = 0.1 over a path length of one.
    np.testing.assert_allclose(image.optical_depth, 0.1, rtol=1e-5)


@pytest.mark.parametrize("package", MAKERS)
def test_coefficients_may_be_quantities(package):
    volume = vm.Volume(vm.CartesianGrid.uniform(2, (0, 1), unit="pc"), v=np.ones((2, 2, 2)))
    extinction = MAKERS[package](
        np.float64(0.5), "1/kpc" if "pint" not in package else "1/kiloparsec"
    )
    image = vm.render(volume, vm.Coefficients(0, extinction), vm.Orthographic(0, 0, resolution=1))
    np.testing.assert_allclose(image.optical_depth, 0.5e-3, rtol=1e-5)


@pytest.mark.parametrize("package", MAKERS)
def test_numbers_without_a_unit_are_numbers(package):
    value = MAKERS[package](0.5, "dimensionless" if "pint" in package else "")
    assert unit_of(value) is None
    assert plain(value, None, "value") == 0.5


@pytest.mark.parametrize("unit", [unyt.km / unyt.s, REGISTRY.km / REGISTRY.s])
def test_units_themselves_may_be_of_other_packages(unit):
    volume = vm.Volume(vm.CartesianGrid.uniform(2, (0, 1), unit="pc"), v=np.ones((2, 2, 2)))
    volume.set_unit("v", unit)
    assert volume.field_unit("v") == u.km / u.s
    camera = vm.Orthographic(0, 0, resolution=1)
    column = vm.column(
        volume,
        "v",
        camera,
        unit=unit * (unyt.kpc if "unyt" in str(type(unit)) else REGISTRY.kiloparsec),
    )
    np.testing.assert_allclose(column.intensity, 1e-3, rtol=1e-6)


def test_units_that_cancel_are_none():
    mixing = as_quantity(xr.DataArray(np.ones(3), attrs={"units": "kg kg**-1"}))
    assert unit_of(mixing) is None


class Furlongs(np.ndarray):
    """Numbers of a package that nobody knows."""

    units = "furlong"


@pytest.mark.parametrize(
    "value",
    [
        np.ones(3).view(Furlongs),
        xr.DataArray(np.ones(3), attrs={"units": "furlongs of yore"}),
        unyt.unyt_array(np.ones(3), unyt.Unit("code_length", registry=unyt.UnitRegistry()))
        if "code_length" in unyt.UnitRegistry()
        else np.ones(3).view(Furlongs),
    ],
)
def test_what_cannot_be_converted_is_refused(value):
    with pytest.raises(vm.UnitsError, match="cannot be converted to astropy's"):
        as_quantity(value)
    for door in (
        lambda: vm.Orthographic(center=value),
        lambda: vm.Volume(vm.CartesianGrid.uniform((3, 1, 1), (0, 1)), a=value),
        lambda: vm.CartesianGrid(value, value, value),
        lambda: vm.Curves([value, value]),
    ):
        with pytest.raises(vm.UnitsError, match="cannot be converted"):
            door()


@pytest.mark.parametrize("package", ["astropy", "unyt", "pint"])
def test_colours_and_backgrounds_are_plain_numbers(package):
    volume = vm.Volume(vm.CartesianGrid.uniform(2, (0, 1)), a=np.ones((2, 2, 2)))
    odd = MAKERS[package](0.5, "K")
    with pytest.raises(vm.InputError, match="plain numbers"):
        vm.Gaussian("a", 1, 0.1, odd, 0.1, 1)
    with pytest.raises(vm.InputError, match="plain numbers"):
        vm.Gaussian("a", 1, 0.1, 1, odd, 1)
    with pytest.raises(vm.InputError, match="plain numbers"):
        vm.render(volume, vm.Coefficients(1, 1), vm.Orthographic(resolution=1), background=odd)
