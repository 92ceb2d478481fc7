"""A text such as "0.1 pc" is taken wherever a quantity is, and says the same."""

from __future__ import annotations

import astropy.units as u
import numpy as np
import pytest

import voluminous as vm
from voluminous.errors import InputError, UnitsError

THINGS = {
    "shell": lambda q: vm.Gaussian("a", q(0.5, "K"), q(0.1, "K"), (1, 0), 0.1, q(0.1, "pc")),
    "surface": lambda q: vm.Isosurface("a", [q(0.5, "K"), q(300, "mK")], "viridis", 0.3),
    "colours": lambda q: vm.ColorBy("a", "viridis", q(0, "K"), q(2, "K")),
    "orthographic": lambda q: vm.Orthographic(
        q(0.5, "rad"), width=(q(2, "pc"), q(1, "AU")), center=(q(1, "pc"), q(2, "AU"), q(0, "pc"))
    ),
    "perspective": lambda q: vm.Perspective(
        (q(1, "pc"), q(2, "pc"), q(3, "pc")), (0, 0, 0), fov=q(0.5, "rad")
    ),
    "looking": lambda q: vm.Perspective.looking((q(1, "pc"), q(2, "pc"), q(3, "AU")), (0, 0, -1)),
    "cartesian": lambda q: vm.CartesianGrid.uniform(4, (q(0, "pc"), q(2, "kpc"))),
    "spherical": lambda q: vm.SphericalGrid(
        [q(0.1, "pc"), q(1, "pc")], [q(0, "deg"), q(90, "deg")], [0, 1]
    ),
    "point": lambda q: vm.Stars([(0, 0, 0)], luminosities=1, psf=q(0.1, "pc")),
    "line": lambda q: vm.Curves([[0, 0, 0], [1, 1, 1]], "red", width=q(0.1, "pc")),
    "boxes": lambda q: vm.Boxes(colors="red", width=q(0.1, "pc")),
    "axes": lambda q: vm.Axes(length=q(1, "pc"), origin=(q(0, "pc"), q(1, "pc"), q(2, "pc"))),
    "stars": lambda q: vm.Stars([(q(0, "pc"), q(1, "pc"), q(2, "pc"))], radii=q(0.1, "pc")),
}


def with_astropy(number, unit):
    return number * u.Unit(unit)


def as_text(number, unit):
    return f"{float(number)} {unit}"  # as a quantity is described


@pytest.mark.parametrize("thing", THINGS)
def test_texts_are_quantities(thing):
    text, quantity = (THINGS[thing](q).describe() for q in (as_text, with_astropy))
    assert text == quantity


def test_pictures_are_the_same():
    grid = vm.CartesianGrid.uniform(6, ("0 pc", "2 pc"))
    volume = vm.Volume(grid, a=np.random.default_rng(1).random((6, 6, 6)) * u.K)
    images = [
        vm.render(volume, THINGS["shell"](q), vm.Orthographic(60, 30, width=q(3, "pc")))
        for q in (as_text, with_astropy)
    ]
    np.testing.assert_array_equal(images[0].intensity, images[1].intensity)


@pytest.mark.parametrize("text", ["wide", "", "1 2", "pc", "nan pc", "1e3e4 pc"])
def test_what_is_no_quantity_is_said_with_its_name(text):
    with pytest.raises((InputError, UnitsError), match="width"):
        vm.Orthographic(width=text)


def test_unknown_units_are_named():
    with pytest.raises(UnitsError, match="'parsnip' is not a unit"):
        vm.Gaussian("a", "1 parsnip", 1, (1,), 1)
    with pytest.raises(InputError, match=r"such as '0.1 pc', or 'auto', got 'some'"):
        vm.Gaussian("a", 1, 1, (1,), 1, path_length="some")


def far_too_small():
    """Return what is done in a volume of 1e18 cm with plain numbers that were meant in parsecs."""
    ones = np.ones((8, 8, 8))
    grid = vm.CartesianGrid.uniform(8, (-1e18, 1e18), unit="cm")
    volume = vm.Volume(grid, density=ones * 1e-20 * u.g / u.cm**3, T=ones * 15 * u.K)
    medium = vm.Coefficients("density * (1 cm2/g)", "density * (1 cm2/g)")
    camera = vm.Orthographic(resolution=4)

    def seen(**changes):
        return lambda: vm.render(volume, medium, camera.replace(**changes))

    def summed(region):
        return lambda: vm.measure(volume, "density", clip=region)

    ball, box = vm.regions.Sphere, vm.regions.Box
    near = vm.Perspective((0, -2, 0), (0, 0, 0), resolution=4)
    round_ = vm.Panorama((0.1, 0, 0), target=(0, 1, 0), resolution=4)
    stars = vm.Spheres([(0.1, 0.2, 0.3)], 1e15)
    shell = vm.Gaussian("T", 15 * u.K, 1 * u.K, 1.0, 0.5, 0.1)
    return {
        "width": seen(width=0.25),
        "width in lists": seen(width=(0.25, 0.5)),
        "width of millimetres": seen(width=3e30),
        "center": seen(center=(0.2, 0.1, 0)),
        "shift": seen(shift=(0.2, 0)),
        "position": lambda: vm.render(volume, medium, near),
        "position inside": lambda: vm.render(volume, medium, round_),
        "width of a projection": lambda: vm.project(volume, "density", camera.replace(width=0.25)),
        "at": lambda: vm.probe(volume, medium, camera, at=(0.1, 0.2)),
        "radius": summed(ball((0, 0, 0), 0.25)),
        "center of two": summed(ball((0, 0, 0), 1e17) | ~ball((0.2, 0, 0), 1e17)),
        "low": summed(box((-0.1, -0.1, -0.1), (1e17, 1e17, 1e17))),
        "positions": lambda: vm.render(volume, medium, camera, objects=[stars]),
        "path_length": lambda: vm.render(volume, shell, camera),
    }


@pytest.mark.parametrize("name", far_too_small())
def test_plain_lengths_of_another_unit_are_refused(name):
    with pytest.raises(vm.InputError, match=rf"unit, cm, and {name.split()[0]} is .* \* u\.pc"):
        far_too_small()[name]()


def test_plain_lengths_in_the_unit_of_the_volume_are_taken():
    grid = vm.CartesianGrid.uniform(8, (-1e18, 1e18), unit="cm")
    volume = vm.Volume(grid, a=np.ones((8, 8, 8)))
    medium = vm.Coefficients("a/(1e18 cm)", "a/(1e18 cm)")
    # A centre with nothing but rounding, a part of a cell, a far observer; and no unit at all.
    for camera in (
        vm.Orthographic(width=1e15, center=(1e18 * np.sin(np.pi), 0, 0)),
        vm.Orthographic(width="0.1 AU"),
        vm.Perspective((0, -1e23, 0), (0, 0, 0), width=1e-5),
    ):
        assert vm.render(volume, medium, camera.replace(resolution=2)).intensity.max() > 0.5
    plain = vm.Volume(vm.CartesianGrid.uniform(8, (-1e18, 1e18)), a=np.full((8, 8, 8), 1e-18))
    tiny = vm.Orthographic(width=0.25, resolution=2)
    assert vm.render(plain, vm.Coefficients("a", "a"), tiny).intensity.max() > 0.5


def test_plain_wavelengths_and_frequencies_of_another_unit_are_refused():
    core = vm.models.prestellar_core(8)
    dust = vm.Dust("density * 2e-26 g", 15.0, vm.Opacity.power_law(3.5, 870.0, 1.8))
    camera = vm.Orthographic(resolution=2)
    for given in ({"wavelengths": 0.85}, {"wavelengths": [0.85, 1.3]}, {"frequencies": [345.0]}):
        for measured in (vm.observe, vm.spectrum):
            with pytest.raises(vm.InputError, match=r"plain numbers are (micron|Hz).*u\.(mm|GHz)"):
                measured(core, dust, camera, distance=140 * u.pc, **given)
    for given in ({"wavelengths": 0.85 * u.micron}, {"wavelengths": 850}, {"frequencies": 345e9}):
        vm.observe(core, dust, camera, **given)
    # What is in front of light is seen at any wavelength.
    light = vm.observe(core, dust, camera, wavelengths=0.85, background=vm.Blackbody(3000 * u.K))
    assert light.intensity.max() > 0
