"""Views by their anatomical names."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from voluminous.cameras.views import view_angles
from voluminous.rotation import image_axes

# A picture's x axis, its y axis and where the observer is, as letters.
SEEN = {
    "anterior": "LSA",
    "posterior": "RSP",
    "left": "PSL",
    "right": "ASR",
    "superior": "RAS",
    "inferior": "LAI",
}
OPPOSITE = dict(zip("LRAPSI", "RLPAIS", strict=True))


@pytest.mark.parametrize("view", SEEN)
@pytest.mark.parametrize("code", ["LPS", "RAS", "ASL", "LIP"])
def test_what_is_where_in_a_view(view, code):
    axes = {}
    for letter, axis in zip(code, np.eye(3), strict=True):
        axes[letter], axes[OPPOSITE[letter]] = axis, -axis
    ex, ey, towards = image_axes(*view_angles({"orientation": code}, view))
    right, up, front = (axes[letter] for letter in SEEN[view])
    np.testing.assert_allclose([ey, towards], [up, front], atol=1e-12)
    # A code that is left-handed is a mirror image: what is on the right follows from the rest.
    np.testing.assert_allclose(ex, np.cross(up, front), atol=1e-12)
    if code in ("LPS", "RAS"):
        np.testing.assert_allclose(ex, right, atol=1e-12)


def test_default_views():
    assert view_angles({}, None) == (60.0, 30.0, 0.0)
    assert view_angles({"orientation": "LPS"}, None) == view_angles(
        {"orientation": "LPS"}, "anterior"
    )
    ex, ey, towards = image_axes(*view_angles({"y_down": True}, None))
    np.testing.assert_allclose([ex, ey, towards], [[1, 0, 0], [0, -1, 0], [0, 0, -1]], atol=1e-12)


def test_views_of_pictures():
    values = np.zeros((8, 8, 8))
    values[6, 1, 5:] = 1.0  # left, in front, at the top
    volume = vm.Volume(vm.CartesianGrid.uniform(8, (0, 8), unit="mm"), a=values)
    medium = vm.Coefficients("a", "a")
    with pytest.raises(vm.InputError, match="how the patient lies"):
        vm.render(volume, medium, view="anterior")
    volume.meta["orientation"] = "LPS"
    light = vm.render(volume, medium, view="anterior", scheme="first-order").intensity[..., 0]
    row, column = np.unravel_index(np.argmax(light), light.shape)
    assert row > 200
    assert column > 200
    camera = vm.framed(volume, medium, view="superior")
    assert camera.width < 8
    with pytest.raises(vm.InputError, match="one of the two"):
        vm.render(volume, medium, camera, view="left")
    with pytest.raises(vm.UnknownNameError, match="did you mean 'anterior'"):
        vm.framed(volume, medium, view="antrior")
