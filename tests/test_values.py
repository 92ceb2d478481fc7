"""Media, cameras, objects and regions are values: they cannot be changed, only replaced."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from voluminous.errors import ImmutableError, UnknownNameError
from voluminous.media.contract import Medium, MediumSample

SHELL = vm.Gaussian("a", 1.0, 0.1, (1, 0.5, 0), 0.1, 2.0)
VALUES = {
    "gaussian": (SHELL, {"sigma": 0.2}),
    "rectangle": (vm.Rectangle("a", 1.0, 0.1, 1, 0.1, 2.0), {"half_width": 0.2}),
    "table": (vm.Table("a", [0, 1], [0, 1], [0, 1], 1.0), {"opacities": [0, 2]}),
    "colormap": (vm.Colormap("a", "viridis", 0, 1), {"vmax": 2}),
    "isosurface": (vm.Isosurface("a", 1.0), {"shading": 0.5}),
    "coefficients": (vm.Coefficients("a", 1), {"extinction": 2}),
    "color_by": (vm.ColorBy("a", "viridis", 0, 1), {"vmin": -1}),
    "sum": (SHELL + SHELL, {"parts": (SHELL,)}),
    "function": (vm.Medium.from_function(abs, ["a"], 1), {"fields": ["b"]}),
    "orthographic": (vm.Orthographic(30, 40, width=2), {"incl": 60}),
    "perspective": (vm.Perspective((3, 0, 0), (0, 0, 0)), {"fov": 20}),
    "stars": (vm.Stars(np.zeros((2, 3)), "white", radii=1.0), {"colors": "red"}),
    "star": (vm.Stars([(0, 0, 0)], radii=1.0), {"colors": "red"}),
    "lines": (vm.Curves(np.eye(3)), {"width": 3}),
    "spheres": (vm.Spheres(np.zeros((1, 3)), 1.0), {"radii": 2.0}),
    "axes": (vm.Axes(), {"width": 4.0}),
    "box": (vm.regions.Box((0, 0, 0), (1, 1, 1)), {"high": (2, 2, 2)}),
}


@pytest.mark.parametrize("name", VALUES)
def test_attributes_cannot_be_assigned(name):
    value, changes = VALUES[name]
    for attribute in (*changes, "anything"):
        with pytest.raises(ImmutableError, match=r"replace\("):
            setattr(value, attribute, 1.0)
    for attribute in list(vars(value))[-1:]:
        with pytest.raises(AttributeError):
            delattr(value, attribute)


@pytest.mark.parametrize("name", VALUES)
def test_replace_makes_another(name):
    value, changes = VALUES[name]
    before = repr(value)
    other = value.replace(**changes)
    assert type(other) is type(value)
    assert repr(value) == before
    assert other is not value
    with pytest.raises(UnknownNameError, match="unknown argument 'sgima'"):
        value.replace(sgima=1)
    assert repr(
        other.replace(**{k: value.arguments()[k] for k in changes if k in value.arguments()})
    )


@pytest.mark.parametrize("name", [n for n in VALUES if n != "function"])
def test_copies_and_pickles_are_the_same(name):
    value, changes = VALUES[name]
    for other in (copy.copy(value), copy.deepcopy(value), pickle.loads(pickle.dumps(value))):
        assert repr(other) == repr(value)
        assert repr(other.replace(**changes)) == repr(value.replace(**changes))
        with pytest.raises(ImmutableError):
            setattr(other, next(iter(changes)), 1)


def test_arrays_belong_to_the_value():
    opacities = np.array([0.0, 1.0])
    table = vm.Table("a", [0, 1], [0, 1], opacities, 1.0)
    opacities[1] = 9.0
    assert table.opacity == (1.0,)
    with pytest.raises(ValueError, match="read-only"):
        table.values[0] = 3.0


def test_what_was_measured_stays_where_it_is_replaced():
    volume = vm.models.prestellar_core(16)
    shell = vm.Gaussian("log10(density)", 3.5, 0.1, 1.0, 0.1).calibrated(volume)
    assert isinstance(shell.path_length, float)
    assert shell.replace(color=2.0).path_length == shell.path_length
    assert shell.replace(path_length=1 * u.pc).path_length == 1 * u.pc


class Plain(Medium):
    """Somebody's medium."""

    channels, grey, names = 1, True, ("a",)

    def __init__(self, opacity=1.0):
        self.opacity = opacity

    def coefficients(self, fields, context):
        self._count = getattr(self, "_count", 0) + 1  # private attributes may be set
        alpha = context.number(self.opacity)
        return MediumSample([alpha * 0.0], [alpha])

    def key(self):
        return ("Plain", self.opacity)

    def describe(self):
        return {"type": "plain", "opacity": self.opacity}


def test_media_of_users_are_values_too():
    volume = vm.Volume(vm.CartesianGrid.uniform(4, (-1, 1)), a=np.ones((4, 4, 4)))
    camera = vm.Orthographic(0, 0, resolution=1)
    medium = Plain()
    np.testing.assert_allclose(vm.render(volume, medium, camera).optical_depth, 2.0, rtol=1e-6)
    with pytest.raises(ImmutableError):
        medium.opacity = 2.0
    doubled = medium.replace(opacity=2.0)
    np.testing.assert_allclose(vm.render(volume, doubled, camera).optical_depth, 4.0, rtol=1e-6)


@pytest.mark.parametrize("name", VALUES)
def test_values_are_equal_if_their_arguments_are(name):
    value, changes = VALUES[name]
    assert value.replace() == value
    assert hash(value.replace()) == hash(value)
    assert copy.deepcopy(value) == value
    assert value.replace(**changes) != value
