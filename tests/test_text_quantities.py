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
