"""A picture that shows nothing of a medium says why."""

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
        (vm.Isosurface("density", 500.0), r"density is from 1 to 216 g / cm3 .*vm.suggest_medium"),
        (vm.Gaussian("log10(density)", -4, 0.1, 1, 1, 1), r"log10\(density\) .* 0 to 2.33445 dex"),
        (vm.Isosurface("density", 500.0, where="x > 0"), "from 1 to 216"),
        (vm.Isosurface("density", 100.0, where="density > 300"), "from 1 to 216"),
        (vm.Isosurface("density", 500.0) + vm.Rectangle("density", 300, 1, (1, 1, 1), 1, 1), "216"),
    ],
)
@pytest.mark.parametrize("tolerance", [1e-3, None])
def test_values_that_are_not_there(volume, medium, told, tolerance):
    with pytest.warns(UserWarning, match=told) as caught:
        vm.render(volume, medium, CAMERA, tolerance=tolerance)
    # Files that other tests left open are warned of at any time.
    (own,) = {w.filename for w in caught if w.category is UserWarning}
    assert own == __file__


def test_a_camera_that_looks_away(volume):
    medium = vm.Isosurface("density", 100.0)
    away = vm.Perspective((5, 0, 0), (6, 0, 0), fov=10, resolution=4)
    with pytest.warns(UserWarning, match="no ray crosses an emitting or absorbing region"):
        vm.render(volume, medium, away)


def test_no_warning_where_anything_shows_or_other_things_are_drawn(volume):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        vm.render(volume, vm.Isosurface("density", 100.0), CAMERA)
        vm.render(volume, vm.Isosurface("density", 100.0, color=0.0), CAMERA)  # it absorbs
        stars = vm.Stars([(0, 0, 0)], luminosities=1.0)
        vm.render(volume, vm.Isosurface("density", 500.0), CAMERA, objects=[stars])


@pytest.mark.parametrize("grid", [np.ones((3, 4, 5)), {"density": 1}, None, "sphere"])
def test_a_volume_needs_a_grid(grid):
    with pytest.raises(InputError, match="grid"):
        vm.Volume(grid)


CO = vm.Molecule("CO", 28.0, [0.0, 3.845], [1, 3], "01", [1], [0], [7.203e-8], [115.2712018e9])


@pytest.mark.parametrize("scheme", ["first-order", "post-classified"])
def test_channels_beside_a_line_are_no_reason_to_warn(scheme):
    """Of many channels, which are drawn in groups, those of some groups show nothing."""
    grid = vm.CartesianGrid.uniform(4, (-1, 1), unit="au")
    gas = vm.Volume(grid, n=np.full(grid.shape, 1e3))
    medium = vm.Lines("n", CO, temperature=20.0)
    camera = vm.Orthographic(30, 20, resolution=3)
    options = {"scheme": scheme}
    line = vm.channels(-300, 300, 151, line="CO 1-0")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert vm.observe(gas, medium, camera, velocities=line, **options).intensity.max() > 0
    beside = vm.channels(200, 300, 151, line="CO 1-0")
    with pytest.warns(UserWarning, match="shows nothing") as caught:
        vm.observe(gas, medium, camera, velocities=beside, **options)
    own = [w for w in caught if "shows nothing" in str(w.message)]
    assert [w.filename for w in own] == [__file__]
