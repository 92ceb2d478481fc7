"""A picture that shows nothing says why."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import voluminous as vm
from voluminous.errors import InputError

CAMERA = vm.Orthographic(30, 20, resolution=12)


@pytest.fixture
def volume():
    grid = vm.CartesianGrid.uniform(6, (-1, 1))
    made = vm.Volume(grid, density=1 + np.arange(216.0).reshape(6, 6, 6))
    made.set_unit("density", "g / cm3")
    return made


@pytest.mark.parametrize(
    ("medium", "told"),
    [
        (
            vm.Isosurface("density", 500.0),
            r"isosurface at 500 lies .* density is from 1 to 216 g / cm3 in this volume.*vm.auto",
        ),
        (vm.Isosurface("density", levels=[300, 400]), r"isosurface at 300, 400 lies"),
        (vm.Gaussian("log10(density)", -4, 0.1, 1, 1, 1), r"gaussian at -4 .* from 0 to 2.33445 "),
        (vm.Rectangle("density", 300, 1, 1, 1, 1), "rectangle at 300 lies"),
        (vm.Isosurface("density", 500.0, where="x > 0"), "at 500 where x > 0 lies"),
        (
            vm.Isosurface("density", 500.0) + vm.Rectangle("density", 300, 1, (1, 1, 1), 1, 1),
            "isosurface at 500 .*; its rectangle at 300",
        ),
    ],
)
@pytest.mark.parametrize("tolerance", [1e-3, None])
def test_values_that_are_not_there(volume, medium, told, tolerance):
    with pytest.warns(UserWarning, match=told) as caught:
        vm.render(volume, medium, CAMERA, tolerance=tolerance)
    assert caught[0].filename == __file__


def test_a_camera_that_looks_away(volume):
    medium = vm.Isosurface("density", 100.0)
    away = vm.Perspective((5, 0, 0), (6, 0, 0), fov=10, resolution=4)
    with pytest.warns(UserWarning, match="no ray of this camera meets it"):
        vm.render(volume, medium, away)


def test_no_warning_where_anything_shows_or_other_things_are_drawn(volume):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        vm.render(volume, vm.Isosurface("density", 100.0), CAMERA)
        vm.render(volume, vm.Isosurface("density", 100.0, color=0.0), CAMERA)  # it absorbs
        stars = vm.Star((0, 0, 0), luminosity=1.0)
        vm.render(volume, vm.Isosurface("density", 500.0), CAMERA, objects=[stars])


@pytest.mark.parametrize("grid", [np.ones((3, 4, 5)), {"density": 1}, None, "sphere"])
def test_a_volume_needs_a_grid(grid):
    with pytest.raises(InputError, match=r"grid and its fields, such as vm\.Volume\("):
        vm.Volume(grid)
