"""What is too large is refused before it is made, and masks mean that nothing is known."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u
from astropy.utils.masked import Masked

import voluminous as vm

GRID = vm.CartesianGrid.uniform(8, (-1, 1))
VALUES = np.random.default_rng(0).random(GRID.shape)
SHELL = vm.Gaussian("a", 0.5, 0.1, 1, 0.3, 1)


def test_a_picture_that_does_not_fit_says_what_it_needs():
    with pytest.raises(vm.errors.MemoryNeededError, match=r"40000 x 40000 pixels needs \d+ bytes"):
        vm.render(vm.Volume(GRID, a=VALUES), SHELL, vm.Orthographic(resolution=40000))


def test_a_picture_of_more_pixels_than_can_be_counted_is_refused():
    with pytest.raises(vm.InputError, match="1000000 x 1000000 pixels is too large"):
        vm.render(vm.Volume(GRID, a=VALUES), SHELL, vm.Orthographic(resolution=10**6))


def test_patches_of_too_many_cells_are_refused_at_once():
    with pytest.raises(vm.InputError, match="patches of 1e\\+27 cells in all are too many"):
        vm.PatchGrid([[0, 0, 0]], [[1, 1, 1]], [[10**9] * 3])
    edges = np.arange(3.0)
    with pytest.raises(vm.InputError, match="too many"):
        vm.PatchGrid.from_boxes(edges, edges, edges, [0], [[0, 0, 0]], [[10**6] * 3])


def test_a_grid_without_layers_is_its_base():
    edges = np.arange(4.0)
    grid = vm.PatchGrid.from_layers(edges, edges, edges, [])
    assert grid.cells_per_level == (27,)


@pytest.mark.parametrize(
    "masked",
    [
        np.ma.masked_where(VALUES > 0.5, VALUES),
        np.ma.masked_where(VALUES > 0.5, (10 * VALUES).astype(int)),
        Masked(VALUES * u.K, mask=VALUES > 0.5),
    ],
)
def test_what_is_masked_is_missing(masked):
    found = vm.Volume(GRID, a=masked).array("a")
    np.testing.assert_array_equal(np.isnan(found), VALUES > 0.5)


def test_a_mask_of_nothing_changes_nothing():
    whole = np.ma.masked_where(VALUES > 2, (10 * VALUES).astype(np.int16))
    found = vm.Volume(GRID, a=whole).array("a")
    assert found.dtype == np.int16
    np.testing.assert_array_equal(found, whole.data)


def test_masked_patches_are_missing_too():
    grid = vm.PatchGrid([[0, 0, 0], [2, 0, 0]], [[2, 2, 2], [4, 2, 2]], [[2, 2, 2]] * 2)
    parts = [np.ma.masked_less(np.arange(8.0).reshape(2, 2, 2), 3), np.ones((2, 2, 2))]
    assert np.count_nonzero(np.isnan(vm.Volume(grid, a=parts).array("a"))) == 3


def test_thicknesses_that_cannot_be_measured_say_so():
    # Differences of neighbours are numbers along each axis, but not across all three.
    corners = 5.9e307 * np.sum(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=0)
    volume = vm.Volume(vm.CartesianGrid.uniform(2, (0, 2)), a=corners)
    with np.errstate(all="ignore"), pytest.raises(vm.InputError, match="Take another unit"):
        vm.Gaussian("a", 0, 1e306, 1, 0.1).calibrated(volume)


def test_the_precision_follows_the_width_of_a_shell():
    volume, camera = vm.Volume(GRID, a=VALUES), vm.Orthographic(resolution=4)
    wide, thin = (vm.Gaussian("a", 0.5, sigma, 1, 0.3, 1) for sigma in (0.1, 1e-8))
    used = [vm.render(volume, m, camera).provenance["precision"] for m in (wide, thin, wide)]
    assert used == ["single", "double", "single"]


@pytest.mark.parametrize(
    "function", [lambda a: ([np.hypot(a, 1)], 0.1), lambda a: ([1.0 if a > 0.5 else 0.0], 0.1)]
)
def test_functions_that_cannot_be_traced_say_what_to_use(function):
    medium = vm.Medium.from_function(function, fields=["a"], channels=1)
    with pytest.raises(vm.InputError, match=r"vm\.math\.where"):
        vm.render(vm.Volume(GRID, a=VALUES), medium, vm.Orthographic(resolution=4))


def test_hints_for_files_and_lists():
    with pytest.raises(vm.InputError, match=r"vm\.open\(path\)"):
        vm.render("file.vti")
    with pytest.raises(vm.InputError, match="media are added"):
        vm.render(vm.Volume(GRID, a=VALUES), [SHELL, SHELL])
