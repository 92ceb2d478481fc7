"""Planes through volumes, and cells as tables."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u
from astropy.table import QTable

import voluminous as vm
from toy_grids import ShuffledGrid
from voluminous.errors import InputError, UnitsError, UnknownNameError

GRID = vm.CartesianGrid(
    [0.0, 1.0, 3.0], [0.0, 1.0, 2.0, 3.0], [-1.0, 0.0, 1.0, 2.0, 4.0], unit="pc"
)
COUNTED = np.arange(24.0).reshape(GRID.shape)


def test_a_slice_across_an_axis_is_a_layer():
    volume = vm.Volume(GRID, a=COUNTED * u.K)
    found = volume.slice("a", "z", 1.5, resolution=(6, 6))
    np.testing.assert_array_equal(found.values[::2, ::2].T, COUNTED[[0, 1, 1], :, 2])
    assert found.extent == pytest.approx((0.0, 3.0, 0.0, 3.0))
    assert (found.unit, found.length_unit) == ("K", "pc")
    across = volume.slice("a", "x", 2 * u.pc, resolution=(3, 10)).values
    np.testing.assert_array_equal(across[::2], COUNTED[1][:, [0, 1, 2, 3, 3]].T)
    # z to the right and x up.
    sideways = volume.slice("a", "y", 0.5, resolution=(5, 3)).values
    np.testing.assert_array_equal(sideways, COUNTED[[0, 1, 1], 0][:, [0, 1, 2, 3, 3]])


@pytest.mark.parametrize("make", [lambda g: g, ShuffledGrid], ids=["axes", "flat"])
def test_any_plane_shows_the_cells_that_its_points_are_in(make):
    grid = make(GRID)
    volume = vm.Volume(grid)
    volume["f"] = "x + 10*y + 100*z"
    found = volume.slice("f", (1, -2, 0.5), 0.3, center=(1.0, 1.0, 1.0), width=6, resolution=20)
    plane = found.plane
    points = plane.points()
    normal = np.array([1, -2, 0.5]) / np.sqrt(5.25)
    np.testing.assert_allclose(points @ normal, 0.3, atol=1e-14)
    assert plane.up[2] > 0
    assert abs(plane.right[2]) < 1e-15
    number = grid.locate(points)
    expected = np.where(number >= 0, volume.array("f").reshape(-1)[number], np.nan)
    np.testing.assert_array_equal(found.values.ravel(), expected)
    assert 0 < np.isnan(expected).sum() < 400


def test_all_of_the_volume_is_in_a_slice_by_default():
    volume = vm.Volume(vm.SphericalGrid([1.0, 2.0, 3.0]))
    volume["f"] = "r"
    found = volume.slice("f", resolution=60)
    assert found.values.shape == (60, 60)
    assert found.extent == pytest.approx((-3, 3, -3, 3))
    radius = np.linalg.norm(found.plane.points(), axis=1).reshape(60, 60)
    inside = (radius > 1) & (radius < 3)
    np.testing.assert_array_equal(np.isnan(found.values), ~inside)
    np.testing.assert_allclose(found.values[inside], np.where(radius < 2, 1.5, 2.5)[inside])


def test_vectors_and_lines_of_sight_in_slices():
    volume = vm.Volume(GRID)
    volume["v_x"], volume["v_y"], volume["v_z"] = "x", "1 pc", "z"
    whole = volume.slice("vector(v_x, v_y, v_z)", resolution=(4, 4))
    assert whole.values.shape == (3, 4, 4)
    assert np.all(whole.values[1] == 1)
    seen = volume.slice("los('v')", resolution=(4, 4), camera=vm.Orthographic())
    np.testing.assert_array_equal(seen.values, -whole.values[2])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"normal": "w"}, "unknown axis 'w'"),
        ({"normal": (0, 0, 0)}, "normal must not be zero"),
        ({"normal": (1, 0)}, "normal must be 'x', 'y', 'z' or three finite numbers"),
        ({"normal": "z", "up": (0, 0, 1)}, "up must not be parallel"),
        ({"width": -1}, "width must be a positive"),
        ({"width": (1, 2, 3)}, "width must be a positive"),
        ({"resolution": 2.5}, "resolution must be a positive whole"),
        ({"resolution": None}, "resolution must be a positive whole"),
        ({"resolution": "many"}, "resolution must be a positive whole"),
        ({"resolution": np.inf}, "resolution must be a positive whole"),
        ({"position": np.nan}, "position must be a finite number"),
        ({"position": (1, 2)}, "position must be a finite number"),
    ],
)
def test_bad_planes_are_refused(options, message):
    with pytest.raises((InputError, UnknownNameError), match=message):
        vm.Volume(GRID, a=COUNTED).slice("a", **options)


@pytest.mark.parametrize("options", [{"position": 40.0}, {"center": (9.0, 9.0, 9.0), "width": 1.0}])
def test_a_slice_beside_the_volume_says_where_that_is(options):
    with pytest.raises(InputError, match=r"x: 0 … 3, y: 0 … 3, z: -1 … 4 pc: the slice is out"):
        vm.Volume(GRID, a=COUNTED).slice("a", "z", **options)


def test_a_slice_through_a_gap_says_so():
    corners = [[0, 0, 0], [0, 0, 2]], [[1, 1, 1], [1, 1, 3]]
    volume = vm.Volume(vm.PatchGrid(*corners, [[2] * 3] * 2), a=[np.ones((2, 2, 2))] * 2)
    with pytest.raises(InputError, match="the grid has a gap"):
        volume.slice("a", "z")


def test_a_table_of_cells():
    volume = vm.Volume(GRID, a=COUNTED * u.K, volume=COUNTED)
    table = volume.cells()
    x, _, z = np.meshgrid(*GRID.centers, indexing="ij")
    np.testing.assert_array_equal(table["x"].value, x.ravel())
    np.testing.assert_array_equal(table["z"].value, z.ravel())
    assert table["y"].unit == u.pc
    assert table["volume"].unit == u.pc**3
    assert table["volume"].sum().value == pytest.approx(3 * 3 * 5)
    np.testing.assert_allclose(
        table["volume"].value, (table["size_x"] * table["size_y"] * table["size_z"]).value
    )
    np.testing.assert_array_equal(table["cell"], np.arange(24))
    assert not table["level"].any()
    np.testing.assert_array_equal(table["a"], COUNTED.ravel() * u.K)
    np.testing.assert_array_equal(table["volume_"], COUNTED.ravel())


def test_some_cells_and_expressions():
    volume = vm.Volume(GRID, a=COUNTED)
    table = volume.cells(["a", "log10(a + 1)"], where="a > 20", kind="astropy")
    assert isinstance(table, QTable)
    assert len(table) == 3
    np.testing.assert_allclose(table["log10(a + 1)"], np.log10([22, 23, 24]))
    rows = volume.cells(kind="numpy")
    assert rows.dtype.names[:4] == ("cell", "x", "y", "z")
    assert rows[5]["a"] == 5
    with pytest.raises(UnknownNameError, match="unknown kind of table 'excel'"):
        volume.cells(kind="excel")


@pytest.mark.parametrize(
    ("where", "plain"),
    [
        ("theta > 60 deg", "theta > pi / 3"),
        ("90 deg > 2 * phi", "phi < pi / 4"),
        ("r * theta > 2 pc", "r * theta > 2"),  # a length: angles are plain numbers in it
    ],
)
def test_angles_in_conditions_have_units(where, plain):
    grid = vm.SphericalGrid([1, 2, 3], [0, 1, 2, 3], np.linspace(0, 6, 9), unit="pc")
    found, expected = (
        vm.Volume(grid).cells(where=condition)["cell"] for condition in (where, plain)
    )
    np.testing.assert_array_equal(found, expected)
    assert 0 < len(found) < grid.size


@pytest.mark.parametrize("where", ["cos(theta) > 60 deg", "theta > 1 pc", "f > 60 deg"])
def test_what_is_no_angle_is_not_compared_with_one(where):
    grid = vm.SphericalGrid([1, 2, 3], [0, 1, 2, 3], unit="pc")
    with pytest.raises(UnitsError, match="cannot be derived"):
        vm.Volume(grid, f=np.ones(grid.shape)).cells(where=where)


@pytest.mark.parametrize("fields", [3, True])
def test_fields_of_tables_are_listed(fields):
    with pytest.raises(InputError, match="fields must be a list of names"):
        vm.Volume(GRID, a=COUNTED).cells(fields)


def test_a_data_frame():
    pandas = pytest.importorskip("pandas")
    frame = vm.Volume(GRID, a=COUNTED).cells(kind="pandas")
    assert isinstance(frame, pandas.DataFrame)
    assert frame["a"].sum() == COUNTED.sum()


def test_a_slice_draws_itself():
    volume = vm.Volume(GRID, a=COUNTED * u.K)
    found = volume.slice("a", "x", resolution=(3, 10))
    axes = found.plot()
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("y [pc]", "z [pc]")
    (picture,) = axes.images
    assert picture.colorbar.ax.get_ylabel() == "a [K]"
    np.testing.assert_array_equal(picture.get_array(), found.values)
    assert picture.get_extent() == list(found.extent)
    assert picture.get_clim() == (found.values.min(), found.values.max())
    assert picture.origin == "lower"
    assert found.plot(ax=axes, colormap="gray", vmin=1, vmax=2).images[1].get_clim() == (1, 2)
    warm = found.plot(vmin=1000 * u.mK, vmax=2)
    assert warm.images[0].get_clim() == (1, 2)
    with pytest.raises(UnitsError, match="vmax is in kg, expected K"):
        found.plot(vmax=1 * u.kg)


def test_slices_draw_logarithms_and_oblique_planes():
    volume = vm.Volume(GRID, a=COUNTED)
    axes = volume.slice("a + 0", (1, 1, 0), resolution=8).plot(norm="log", vmin=0.5)
    assert axes.get_xlabel() == "(-0.71, 0.71, 0) [pc]"
    assert axes.get_ylabel() == "z [pc]"
    assert axes.images[0].colorbar.ax.get_ylabel() == "a + 0"
    assert axes.images[0].norm(0.5) == 0


@pytest.mark.parametrize(
    ("expression", "options", "message"),
    [
        ("vector(a, a, a)", {}, "three pictures: slice one component, or norm"),
        ("a", {"norm": "sqrt"}, "norm must be 'linear', 'log' or a matplotlib Normalize"),
        ("-a", {"norm": "log"}, "norm='log' needs positive values"),
        ("a", {"colormap": "virdis"}, "unknown colormap 'virdis'"),
    ],
)
def test_slices_that_cannot_be_drawn(expression, options, message):
    found = vm.Volume(GRID, a=COUNTED).slice(expression, resolution=4)
    with pytest.raises((InputError, UnknownNameError), match=message):
        found.plot(**options)
