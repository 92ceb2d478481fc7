"""Grids: the contract, and what is special about Cartesian ones."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u

import voluminous as vm
from contracts import GridContract
from contracts.grid import make_ray, walk_along
from voluminous.backend import dr

UNEVEN = [-1.0, -0.3, 0.1, 0.8, 2.0]


class CartesianContract(GridContract):
    """Cells are found by bisection of the edges."""

    def locate(self, grid, points):
        index = [
            np.clip(np.searchsorted(e, p, side="right") - 1, 0, len(e) - 2)
            for e, p in zip(grid.edges, points.T, strict=True)
        ]
        return np.ravel_multi_index(index, grid.shape)

    def thinnest(self, grid):
        return min(np.diff(e).min() for e in grid.edges)

    def test_interpolation_is_exact_for_linear_functions(self, grid, backend, lines):
        vertices = np.stack(np.meshgrid(*grid.edges, indexing="ij"), axis=-1).reshape(-1, 3)
        enter, _ = self.enter_leave(grid, *lines)
        low = grid.bounds[:, 0]  # weights add up to one to rounding only
        origins, directions = lines

        def check(corners, t, active):
            dr.eval(corners)
            point = sum(
                np.asarray(w)[:, None] * (vertices[np.where(active, np.asarray(v), 0)] - low)
                for v, w in zip(corners.vertex, corners.weight, strict=True)
            )
            expected = origins - low + (enter + t * grid.scale)[:, None] * directions
            slack = 64 * self.tolerance(grid, backend)
            np.testing.assert_allclose(point[active], expected[active], rtol=0, atol=slack)

        def visit(walk, track, cursor, segment):
            active = np.asarray(segment.active)
            check(walk.entry_corners(track, cursor), np.asarray(cursor.t), active)
            check(walk.exit_corners(track, segment), np.asarray(segment.end), active)

        walk_along(grid, backend, make_ray(backend, *lines), visit)


class TestUniform(CartesianContract):
    @pytest.fixture
    def grid(self):
        return vm.CartesianGrid.uniform((5, 4, 3), ((-1, 2), (0, 3), (-2, 1)))


class TestRectilinear(CartesianContract):
    @pytest.fixture
    def grid(self):
        return vm.CartesianGrid(UNEVEN, [0.0, 0.5, 0.75, 3.0], [-2.0, -1.9, 1.0])


class TestManyWidths(CartesianContract):
    """Cells of very different widths, a million to one."""

    precisions = ("double",)  # render() takes it by itself

    @pytest.fixture
    def grid(self):
        widths = [1.0, 1e-6, 1e-3, 1.0, 1e-5, 0.1]
        edges = np.concatenate([[0.0], np.cumsum(widths)])
        return vm.CartesianGrid(edges, -edges[::-1], [0.0, 1e-6, 1.0])


def test_uniform_cells_are_recognised_to_rounding():
    edges = np.linspace(-1, 1, 11) / 3
    assert vm.CartesianGrid(edges, 3 * edges, [0, 1]).is_uniform
    assert vm.CartesianGrid([0.1 * i for i in range(40)], [0, 1], [0, 1]).is_uniform
    assert not vm.CartesianGrid(edges * (1 + 1e-9 * np.arange(11)), edges, edges).is_uniform


def test_uniform_makes_equal_cells():
    grid = vm.CartesianGrid.uniform((2, 4, 5), ((0, 1), (-2, 2), (5, 10)))
    assert grid.shape == (2, 4, 5)
    assert grid.size == 40
    np.testing.assert_array_equal(grid.edges[1], [-2, -1, 0, 1, 2])
    np.testing.assert_array_equal(grid.centers[0], [0.25, 0.75])
    np.testing.assert_array_equal(vm.CartesianGrid.uniform(3, (-1, 2)).bounds, [[-1, 2]] * 3)
    assert grid.first_cell_width() == 0.5


def test_units_come_from_quantities_or_are_said():
    edges = np.array([0.0, 1.0, 2.0])
    assert vm.CartesianGrid(edges, edges, edges).unit is None
    assert vm.CartesianGrid(edges, edges, edges, unit="pc").unit == u.pc
    mixed = vm.CartesianGrid(edges * u.pc, edges * 1000 * u.mpc, edges)
    assert mixed.unit == u.pc
    np.testing.assert_allclose(mixed.edges[1], edges, rtol=1e-15)
    assert vm.CartesianGrid.uniform(2, (-1, 1) * u.kpc).unit == u.kpc
    each = vm.CartesianGrid.uniform(2, ((0, 1) * u.pc, (0, 1000) * u.mpc, (0, 2) * u.pc))
    np.testing.assert_allclose(each.bounds, [[0, 1], [0, 1], [0, 2]], rtol=1e-15)
    with pytest.raises(vm.UnitsError, match="y edges is in s, expected pc"):
        vm.CartesianGrid(edges * u.pc, edges * u.s, edges)


@pytest.mark.parametrize("unit", ["pc", "arcsec", "km / s", "1 / Mpc", "pix"])
def test_cells_are_measured_in_lengths_and_angles_and_what_is_made_of_them(unit):
    edges = np.array([0.0, 1.0, 2.0])
    assert vm.CartesianGrid(edges, edges, edges, unit=unit).unit == u.Unit(unit)


@pytest.mark.parametrize(
    ("edges", "told"),
    [
        ([0.0, 1.0, 1.0], "edge 1 is 1 and edge 2 is 1"),
        ([0.0, 2.0, 1.0], "must increase strictly; edge 1"),
        ([2.0, 1.0, 0.0], "Flip the axis"),
        ([0.0, np.nan, 1.0], "must be finite; edge 1 is nan"),
        ([0.0, np.inf], "must be finite"),
        ([0.0], "at least two"),
        ([[0.0, 1.0]], "1-D array"),
        (3.0, "1-D array"),
        (["a", "b"], "must be numbers"),
        ([0.0, 1j], "must be numbers"),
        (None, "1-D|numbers"),
    ],
)
def test_edges_that_cannot_be_used(edges, told):
    with pytest.raises(vm.InputError, match=f"y edges.*({told})"):
        vm.CartesianGrid([0, 1], edges, [0, 1])


@pytest.mark.parametrize(
    ("shape", "bounds", "told"),
    [
        (0, (0, 1), "positive whole"),
        ((2, 2), (0, 1), "positive whole"),
        ((2, 2.5, 2), (0, 1), "positive whole"),
        ((2, None, 2), (0, 1), "positive whole"),
        (np.nan, (0, 1), "positive whole"),
        ("many", (0, 1), "positive whole"),
        (2, (0, 1, 2), "bounds must be"),
        (2, (1, 0), "must increase"),
    ],
)
def test_uniform_grids_that_cannot_be(shape, bounds, told):
    with pytest.raises(vm.InputError, match=told):
        vm.CartesianGrid.uniform(shape, bounds)


def test_double_precision_is_taken_where_cells_need_it():
    assert not vm.CartesianGrid.uniform(512, (0, 1)).needs_double()
    fine = vm.CartesianGrid([0, 1e-6, 1], [0, 1], [0, 1])
    assert fine.needs_double()
    volume = vm.Volume(fine, a=np.ones(fine.shape))
    image = vm.render(volume, vm.Coefficients("a", "a"), vm.Orthographic(resolution=4))
    assert image.intensity.dtype == np.float64
    assert image.provenance["precision"] == "double"
