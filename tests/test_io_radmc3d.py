"""Models of RADMC-3D, written by hand and by its own rules: grids, fields and damage."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import voluminous as vm
from radmc3d_directory import Binary, in_file_order, path_of, put_field, put_grid
from radmc3d_models import (
    ENCODINGS,
    EVEN,
    FLAGS,
    LAYERS,
    PHI,
    PI,
    THETA,
    TREE,
    R,
    X,
    layered,
    regular,
    same,
    spherical,
    tree,
    values,
)
from voluminous.io.registry import open_lazily

# What is in the files comes out, to the last bit


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_regular(tmp_path, encoding):
    volume = vm.open(regular(tmp_path, encoding))
    assert volume.fields == ("gas_density", *(f"gas_velocity_{a}" for a in "xyz"))
    assert volume.units["gas_density"] == "g / cm3"
    assert volume.units["gas_velocity_x"] == "cm / s"
    assert str(volume.unit) == "cm"
    for found, expected in zip(volume.grid.edges, X, strict=True):
        same(found, expected)
    same(in_file_order(volume.array("gas_density")), values(240))
    for axis, expected in zip("xyz", values((3, 240), 1), strict=True):
        same(in_file_order(volume.array(f"gas_velocity_{axis}")), expected)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_octree(tmp_path, encoding):
    volume = vm.open(tree(tmp_path, encoding))
    assert volume.fields == ("dust_density_1", "dust_density_2", "dust_temperature")
    np.testing.assert_array_equal(volume.grid.refined, FLAGS)
    for found, expected in zip(volume.grid.base_edges, TREE, strict=True):
        same(found, expected)
    for k, expected in enumerate(values((2, FLAGS.count(0))), start=1):
        same(volume.array(f"dust_density_{k}"), expected)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_layers(tmp_path, encoding):
    volume = vm.open(layered(tmp_path, encoding))
    grid = vm.PatchGrid.from_layers(*EVEN, LAYERS, unit="cm")
    assert volume.grid.describe() == grid.describe()
    np.testing.assert_array_equal(volume.grid.corners(), grid.corners())
    # The cells that finer layers cover are in the file, and are not in the volume.
    parts = np.split(values(464), np.cumsum([192, 144, 64]))
    shapes = [(4, 6, 8), (4, 6, 6), (4, 4, 4), (2, 2, 16)]
    patches = [p.reshape(s[::-1]).transpose(2, 1, 0) for p, s in zip(parts, shapes, strict=True)]
    same(volume.array("gas_temperature"), vm.Volume(grid, a=patches).array("a"))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_spherical(tmp_path, encoding):
    volume = vm.open(spherical(tmp_path, encoding))
    assert volume.fields[0] == "gas_velocity_r"
    assert not volume.grid.mirror
    for found, expected in zip(volume.grid.edges, (R, THETA, PHI), strict=True):
        same(found, expected)
    for axis, expected in zip(("r", "theta", "phi"), values((3, 1200), 1), strict=True):
        same(in_file_order(volume.array(f"gas_velocity_{axis}")), expected)


def test_a_byte_order_mark_is_no_number(tmp_path):
    """Editors on Windows put one before a text."""
    regular(tmp_path, "text")
    expected = {name: vm.open(tmp_path).array(name) for name in vm.open(tmp_path).fields}
    for path in tmp_path.glob("*.inp"):
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    volume = vm.open(tmp_path / "amr_grid.inp")
    assert set(volume.fields) == set(expected)
    for name, values_of in expected.items():
        np.testing.assert_array_equal(volume.array(name), values_of)


def test_single_precision_and_the_other_byte_order(tmp_path):
    regular(tmp_path, "binary", single=True)
    density = vm.open(tmp_path).array("gas_density")
    same(in_file_order(density), values(240).astype(np.float32))
    for stem, columns in (("gas_density", [values(240)]), ("gas_velocity", values((3, 240)))):
        swapped = Binary(">")
        swapped.head(1, False, False)
        swapped.integers(240)
        swapped.data(np.stack(columns, axis=1))
        path_of(tmp_path, stem, "binary").write_bytes(swapped.content)
    same(in_file_order(vm.open(tmp_path).array("gas_density")), values(240))


# Which grid is meant


def spherical_grid(directory, theta, phi=(0, 2 * PI), active=(1, 1, 0), **options):
    walls = [R, np.array(theta, float), np.array(phi, float)]
    put_grid(directory, walls, coordinates=100, active=active, **options)
    cells = int(np.prod([len(w) - 1 for w in walls]))
    if not options:
        put_field(directory, "gas_density", values(cells))
        return vm.open(directory).grid
    return None


def test_theta_that_ends_at_the_midplane_is_mirrored(tmp_path):
    assert spherical_grid(tmp_path, [0.5, 1.0, PI / 2]).mirror
    assert spherical_grid(tmp_path, [0.5, 1.0, 1.57079]).mirror  # six digits will do
    with pytest.warns(UserWarning, match="near the midplane"):
        assert not spherical_grid(tmp_path, [0.5, 1.0, 1.5701]).mirror
    assert not spherical_grid(tmp_path, [0.5, 1.0, PI / 2, 2.0]).mirror


def test_dimensions_that_are_not_there(tmp_path):
    grid = spherical_grid(tmp_path, [0, 1], [0, 1], active=(1, 0, 0))
    assert grid.shape == (12, 1, 1)
    np.testing.assert_array_equal(grid.edges[1], [0, PI])
    np.testing.assert_array_equal(grid.edges[2], [0, 2 * PI])
    for active in ((0, 1, 0), (1, 0, 1)):
        put_grid(tmp_path, [[1, 2], [0, 1], [0, 1]], coordinates=100, active=active)
        put_field(tmp_path, "gas_density", [1.0])
        with pytest.raises(vm.FileFormatError, match="must be active"):
            vm.open(tmp_path)


def test_angles_are_where_they_are_meant_to_be(tmp_path):
    theta = [1e-6, 0.8, 1.570797, 2.4, 3.14159]
    grid = spherical_grid(tmp_path, theta, [0.001, 3.0, 6.28], active=(1, 1, 1))
    np.testing.assert_array_equal(grid.edges[1], [0, 0.8, PI / 2, 2.4, PI])
    np.testing.assert_array_equal(grid.edges[2], [0, 3.0, 2 * PI])
    wedge = spherical_grid(tmp_path, theta, [0.5, 3.0, 6.0], active=(1, 1, 1))
    np.testing.assert_array_equal(wedge.edges[2], [0.5, 3.0, 6.0])


def evenly(directory, flags):
    """Write a spherical octree over two dimensions, its leaves numbered; return the volume."""
    walls = [np.array([1.0, 2.0, 3.0]), np.array([0.3, PI / 2]), np.array([0, 2 * PI])]
    put_grid(directory, walls, coordinates=100, active=(1, 1, 0), flags=flags)
    put_field(directory, "gas_density", np.arange(float(flags.count(0))))
    return vm.open(directory)


def test_spherical_octrees_split_the_dimensions_that_are_there(tmp_path):
    volume = evenly(tmp_path, [1, 0, 1, 0, 0, 0, 0, 0, 0, 0])
    grid = volume.grid
    assert grid.mirror
    assert grid.size == 8
    # r first, then theta.
    r, theta, _ = grid.native_centers()
    middle = 0.5 * (0.3 + PI / 2)
    assert r[0] == 1.25
    assert theta[0] < middle
    np.testing.assert_allclose(r[1:5], [1.625, 1.875, 1.625, 1.875])
    assert theta[1] == theta[2] < theta[3] == theta[4] < middle
    assert theta[5] > middle
    assert (r[7], theta[7]) == (2.5, middle)
    np.testing.assert_array_equal(volume.array("gas_density"), np.arange(8))


def test_trees_that_are_not_split_along_all_axes(tmp_path):
    walls = [np.array([0.0, 8.0]), np.arange(3.0), np.arange(3.0)]
    flags = [0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0]
    put_grid(tmp_path, walls, active=(0, 1, 1), flags=flags)
    put_field(tmp_path, "gas_density", np.arange(10.0))
    volume = vm.open(tmp_path)
    assert volume.grid.size == 10
    points = [[4, 0.5, 0.5], [1, 1.125, 0.125], [7, 1.375, 0.125], [4, 1.375, 0.375]]
    points += [[4, 1.75, 0.25], [4, 1.25, 0.75], [4, 1.75, 0.75], [4, 0.5, 1.5], [4, 1.5, 1.5]]
    found = volume.array("gas_density")[volume.grid.locate(np.array(points))]
    np.testing.assert_array_equal(found, [0, 1, 2, 4, 5, 6, 7, 8, 9])


def test_lengths_in_another_unit(tmp_path):
    (other := tmp_path / "other").mkdir()
    volume = vm.open(regular(tmp_path), unit="au")
    assert str(volume.unit) == "AU"
    np.testing.assert_allclose(volume.grid.edges[0], X[0] / 1.495978707e13, rtol=1e-15)
    np.testing.assert_array_equal(vm.open(spherical(other), unit="au").grid.edges[1], THETA)
    for unit in ("s", "no such unit", 3):
        with pytest.raises(vm.UnitsError):
            vm.open(tmp_path, unit=unit)


# Which files are fields


def test_a_path_in_the_directory(tmp_path):
    regular(tmp_path)
    assert len(vm.open(tmp_path / "amr_grid.inp").fields) == 4
    assert vm.open(tmp_path / "gas_density.inp").fields == ("gas_density",)
    assert vm.open(tmp_path / "gas_density.inp", "gas_velocity_x").fields == ("gas_velocity_x",)
    assert vm.open(tmp_path, "gas_velocity").fields == tuple(f"gas_velocity_{a}" for a in "xyz")
    (tmp_path / "wavelength_micron.inp").write_text("2\n0.1\n1000\n")
    assert len(vm.open(tmp_path).fields) == 4
    with pytest.raises(vm.FileFormatError, match="no values on the grid"):
        vm.open(tmp_path / "wavelength_micron.inp")


def test_any_file_with_values_on_the_grid_is_a_field(tmp_path):
    put_grid(tmp_path, X)
    put_field(tmp_path, "tracer", values(240))
    put_field(tmp_path, "b-field", *values((3, 240)), encoding="binary")
    put_field(tmp_path, "of_another_grid", values(241))
    volume = vm.open(tmp_path)
    assert volume.fields == ("b_field_x", "b_field_y", "b_field_z", "tracer")
    same(in_file_order(volume.array("b_field_y")), values((3, 240))[1])


def test_results_of_radmc3d(tmp_path):
    put_grid(tmp_path, X)
    levels = values((240, 2))
    lines = "".join(f"{a:.16e} {b:.16e}\n" for a, b in levels)
    (tmp_path / "levelpop_co.dat").write_text(f"1\n240\n2\n1 3\n{lines}")
    means = values((2, 240), 1)
    lines = "".join(f"{v:.16e}\n" for v in means.ravel())
    (tmp_path / "mean_intensity.out").write_text(f"2\n240\n2\n1e11 3e11\n{lines}")
    volume = vm.open(tmp_path)
    same(in_file_order(volume.array("levelpop_co_3")), levels[:, 1].copy())
    same(in_file_order(volume.array("mean_intensity_2")), means[1])
    assert volume.units["levelpop_co_1"] == "1 / cm3"


def test_of_several_forms_the_binary_one_is_read(tmp_path):
    regular(tmp_path)
    put_field(tmp_path, "gas_density", values(240, 9), encoding="binary")
    with pytest.warns(UserWarning, match=r"gas_density.binp is read, and gas_density.inp"):
        volume = vm.open(tmp_path)
    same(in_file_order(volume.array("gas_density")), values(240, 9))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        volume = vm.open(tmp_path / "gas_density.inp")  # it is said which
    same(in_file_order(volume.array("gas_density")), values(240))


def test_a_bad_file_is_told_when_it_is_wanted(tmp_path):
    regular(tmp_path)
    put_field(tmp_path, "gas_temperature", values(100))
    with pytest.raises(vm.FileFormatError, match=r"gas_temperature.inp: .*100 cells.*240.*fields="):
        vm.open(tmp_path)
    assert vm.open(tmp_path, "gas_density").fields == ("gas_density",)
    with pytest.raises(vm.FileFormatError, match="100 cells"):
        vm.open(tmp_path, "gas_temperature")


def test_a_vector_in_text_is_read_once(tmp_path):
    volume = open_lazily(regular(tmp_path))
    assert volume.waiting == volume.fields
    volume.array("gas_velocity_x")
    (tmp_path / "gas_velocity.inp").unlink()
    for axis, expected in zip("xyz", values((3, 240), 1), strict=True):
        same(in_file_order(volume.array(f"gas_velocity_{axis}")), expected)


def test_spherical_layers_are_a_tree_of_the_same_cells(tmp_path):
    walls = [R, np.linspace(0.3, PI / 2, 7), np.array([0, 2 * PI])]
    layers = [[0, 1, 1, 1, 2, 3, 9], [1, 3, 5, 1, 2, 1, 1], [0, 11, 6, 1, 2, 1, 1]]
    put_grid(tmp_path, walls, coordinates=100, active=(1, 1, 0), layers=layers)
    put_field(tmp_path, "gas_density", np.arange(float(72 + 24 + 8 + 8)))
    volume, found = vm.open(tmp_path), {}
    r, theta, _ = volume.grid.native_centers()
    place = [np.interp(x, w, np.arange(len(w))) for x, w in zip((r, theta), walls[:2], strict=True)]
    boxes = [(0, 0, 0, 12), (1, 0, 0, 4), (2, 4, 8, 4), (1, 20, 10, 4)]  # level, first cell, count
    for value, level, i, j in zip(
        volume.array("gas_density"), volume.grid.levels, *place, strict=True
    ):
        first = 0
        for own, low_r, low_theta, count in boxes:
            rows = {0: 6, 1: 6 if low_r == 0 else 2, 2: 2}[own]
            if first <= value < first + count * rows:
                k, m = divmod(int(value) - first, count)
                assert (level, int(i * 2**own), int(j * 2**own)) == (own, low_r + m, low_theta + k)
                found[value] = True
            first += count * rows
    assert len(found) == volume.grid.size == 72 - 6 - 2 + 24 - 2 + 8 + 8
