"""Path lengths and first media on any grid: those of the Cartesian grid that shows the same."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from toy_grids import ShuffledGrid
from voluminous.calibration.thickness import Profile, thicknesses
from voluminous.cli.info_text import describe_grid
from voluminous.expressions import Expression

EDGES = np.linspace(-1, 1, 9)


def octree(levels=3):
    def near(x, y, z, size):
        return np.abs(np.sqrt(x * x + y * y + z * z) - 0.6) < size

    return vm.OctreeGrid.from_function(EDGES, EDGES, EDGES, near, levels)


def octree_of_equal_cells(levels):
    return vm.OctreeGrid.from_function(EDGES, EDGES, EDGES, lambda x, y, z, size: x > -2, levels)


GRIDS = {
    "shuffled": lambda: ShuffledGrid(vm.CartesianGrid.uniform(32, (-1, 1))),
    "octree": octree,
    "spherical": lambda: vm.SphericalGrid(
        np.linspace(0.05, 1, 33), np.linspace(0, np.pi, 17), np.linspace(0, 2 * np.pi, 25)
    ),
    "cylindrical": lambda: vm.CylindricalGrid(
        np.linspace(0, 1, 25), np.linspace(0, 2 * np.pi, 25), np.linspace(-1, 1, 33)
    ),
}


@pytest.mark.parametrize("kind", GRIDS)
def test_a_shell_is_as_thick_as_it_is(kind):
    volume = vm.Volume(GRIDS[kind]())
    volume["f"] = "r**2"
    medium = vm.Gaussian("f", 0.36, 0.05, 1.0, 1.0, path_length="auto")
    # Effective width over gradient where the shell is: sqrt(2 pi) 0.05 / (2 · 0.6).
    expected = np.sqrt(2 * np.pi) * 0.05 / 1.2
    assert medium.calibrated(volume).path_length == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("kind", ["shuffled", "octree"])
def test_a_field_of_two_values_has_shells_between_its_cells(kind):
    """No cell holds a half, and beside the step each knows half of its slope."""
    grid = GRIDS["shuffled"]() if kind == "shuffled" else octree_of_equal_cells(2)
    volume = vm.Volume(grid)
    volume["f"] = "where(x > 0, 1, 0)"
    medium = vm.Rectangle("f", 0.5, 0.01, 1.0, 1.0, path_length="auto")
    # From one centre to the next it rises by one.
    assert medium.calibrated(volume).path_length == pytest.approx(0.02 * 2 / 32, rel=0.03)


@pytest.mark.parametrize("kind", GRIDS)
def test_lines_cross_a_closed_shell_twice(kind):
    volume = vm.Volume(GRIDS[kind]())
    volume["f"] = "r**2"
    medium = vm.Gaussian("f", 0.36, 0.05, 1.0, 1.0, path_length=1.0)
    expr = Expression("f")
    (found,) = thicknesses(volume, expr, [Profile(*medium.profile(None, None))])
    # Oblique crossings are longer: 2 / <cos> of lines that are spread evenly over the disc is 4.
    assert 2.0 < found.crossings < 4.5


@pytest.mark.parametrize("kind", GRIDS)
def test_a_first_medium_is_nearly_that_of_a_fine_cartesian_grid(kind):
    volumes = [vm.Volume(GRIDS[kind]()), vm.Volume(vm.CartesianGrid.uniform(48, (-1, 1)))]
    shells = []
    for volume in volumes:
        volume["f"] = "tanh((0.6 - r) / 0.1)"
        shells.append(vm.suggest_medium(volume, "f", n=1))
    # Both find the edge of the ball, where f is steepest.
    assert shells[0].center == pytest.approx(shells[1].center, abs=0.3)
    assert shells[0].path_length == pytest.approx(shells[1].path_length, rel=0.5)


def test_labels_have_their_background_at_the_surface():
    volume = vm.Volume(octree())
    volume["f"] = "where(r < 0.5, 2, where(r < 0.7, 5, 3))"
    medium = vm.suggest_medium(volume, "f")
    assert medium.numbers == [2, 5]


def test_components_of_spherical_vectors_are_not_looked_at_first():
    rng = np.random.default_rng(0)
    grid = vm.SphericalGrid(np.linspace(1, 2, 9), np.linspace(0, 3, 5), np.linspace(0, 6, 5))
    fields = {n: rng.normal(size=grid.shape) for n in ("v_r", "v_theta", "v_phi")}
    volume = vm.Volume(grid, {**fields, "stuff": np.linspace(0, 1, grid.size).reshape(grid.shape)})
    (first, *_) = vm.suggest_medium(volume).components()
    assert "stuff" in first.expr.text


def test_info_tells_levels_and_resolution():
    told = "\n".join(describe_grid(octree(2)))
    levels = np.bincount(octree(2).levels)
    assert f"grid: octree, {levels.sum()} cells, base 8 x 8 x 8" in told
    assert f"level 2: {levels[2]} cells of 0.0625 x 0.0625 x 0.0625" in told
    assert "effective resolution: 32 x 32 x 32" in told
    assert "x  -1 … 1" in told
