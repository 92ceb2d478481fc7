"""openPMD meshes: values where the standard puts them, whatever the order and the series."""

from __future__ import annotations

import itertools

import h5py
import numpy as np
import pytest

import voluminous as vm
from contracts import ReaderContract
from voluminous.io import find_reader

SHAPE = {"x": 3, "y": 4, "z": 5}
SPACING = {"x": 0.5, "y": 0.25, "z": 2.0}
OFFSET = {"x": -1.0, "y": 3.0, "z": 10.0}
VOLT_PER_METRE = [1.0, 1, -3, -1, 0, 0, 0]


def linear(x, y, z):
    """A field that tells apart every place and every order of axes, in SI."""
    return x + 10 * y + 100 * z


def place(file, at="/data/100/", meshes="fields/", version="1.1.0", **more):
    """Write what the root and an iteration have; return the group of meshes."""
    file.attrs.update(openPMD=np.bytes_(version), basePath=np.bytes_("/data/%T/"))
    file.attrs["meshesPath"] = np.bytes_(meshes)
    file.attrs.update(openPMDextension=np.uint32(0), **more)
    base = file.require_group(at)
    base.attrs.update(time=2.0, dt=1.0, timeUnitSI=1e-15)
    return base.require_group(meshes)


def describe(record, labels, order="C", unit=1e-6, dimension=VOLT_PER_METRE, **more):
    record.attrs.update(geometry=np.bytes_("cartesian"), dataOrder=np.bytes_(order))
    record.attrs.update(gridSpacing=[SPACING[a] for a in labels], gridUnitSI=unit)
    record.attrs.update(gridGlobalOffset=[OFFSET[a] for a in labels], timeOffset=0.0)
    record.attrs.update(unitDimension=dimension, axisLabels=[a.encode() for a in labels])
    record.attrs.update(more)


def values_of(labels, order, position, unit_si=1.0):
    """The array of h5py for `linear` of lengths in units of the simulation."""
    ticks = {
        a: OFFSET[a] + (np.arange(SHAPE[a]) + p) * SPACING[a]
        for a, p in zip(labels, position, strict=True)
    }
    axes = labels if order == "C" else labels[::-1]
    grids = np.meshgrid(*(ticks[a] for a in axes), indexing="ij")
    return linear(**dict(zip(axes, grids, strict=True))) / unit_si


def vector(group, name="E", labels="zyx", order="C", positions=None, unit_si=4.0, **more):
    record = group.create_group(name)
    describe(record, labels, order, **more)
    for part in "xyz":
        position = (positions or {}).get(part, (0.5, 0.5, 0.5))
        record[part] = values_of(labels, order, position, unit_si)
        record[part].attrs.update(unitSI=unit_si, position=position)


def expected(grid, scale=1.0):
    return linear(*np.meshgrid(*(c / scale for c in centres(grid)), indexing="ij"))


def centres(grid):
    return [(e[1:] + e[:-1]) / 2 for e in grid.edges]


class TestContract(ReaderContract):
    @pytest.fixture
    def sample(self):
        def write(directory):
            with h5py.File(directory / "small.h5", "w") as file:
                vector(place(file))
            return directory / "small.h5"

        return write

    def reader(self, path):
        reader = find_reader(path)
        assert reader.name == "openpmd"
        return reader


@pytest.mark.parametrize("order", "CF")
@pytest.mark.parametrize("labels", [*map("".join, itertools.permutations("xyz"))])
@pytest.mark.parametrize("position", [(0.5, 0.5, 0.5), (0.0, 0.0, 0.0), (0.0, 0.5, 0.25)])
def test_values_are_where_the_standard_puts_them(tmp_path, labels, order, position):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        vector(place(file), "E", labels, order, dict.fromkeys("xyz", position))
    volume = vm.open(tmp_path / "a.h5")
    assert volume.fields == ("E_x", "E_y", "E_z")
    assert volume.grid.shape == (3, 4, 5)
    assert str(volume.unit) == "um"
    assert set(volume.units.values()) == {"V / m"}
    np.testing.assert_allclose(volume.array("E_y"), expected(volume.grid), rtol=1e-12)
    at = dict(zip(labels, position, strict=True))
    assert volume.grid.bounds[0, 0] == pytest.approx(OFFSET["x"] + (at["x"] - 0.5) * SPACING["x"])
    assert volume.meta["iteration"] == 100
    assert volume.meta["time"] == pytest.approx(2e-15)


@pytest.mark.parametrize("meshes", ["fields", "fields/", "/meshes/", "deep/meshes/"])
def test_a_series_in_groups(tmp_path, meshes):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for number in (5, 20, 100):
            vector(place(file, f"/data/{number}/", meshes.strip("/")), unit_si=float(number))
        file.attrs["meshesPath"] = meshes
    volume = vm.open(tmp_path / "a.h5")
    assert volume.meta["iteration"] == 100
    assert volume.meta["iterations"] == [5, 20, 100]
    earlier = vm.open(tmp_path / "a.h5", "E", iteration=20)
    assert earlier.meta["iteration"] == 20
    with pytest.raises(vm.errors.UnknownNameError, match=r"iteration '21'.*20"):
        vm.open(tmp_path / "a.h5", iteration=21)


@pytest.mark.parametrize("order", "CF")
def test_scalars_constants_and_numbers_as_they_are(tmp_path, order):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        group = place(file)
        vector(group, "B", "xyz", order)
        del group["B/y"]
        item = group["B"].create_group("y")
        item.attrs.update(value=2.0, shape=[3, 4, 5], unitSI=3.0, position=[0.5] * 3)
        group["rho"] = values_of("xyz", order, (0.5,) * 3).astype("f4")
        describe(group["rho"], "xyz", order, dimension=[-3.0, 0, 1, 1, 0, 0, 0])
        group["rho"].attrs.update(unitSI=1.0, position=[0.5] * 3)
        item = group.create_group("T")
        describe(item, "xyz", order, dimension=[0.0] * 7)
        item.attrs.update(value=7, shape=[3, 4, 5], unitSI=1.0, position=[0.5] * 3)
    volume = vm.open(tmp_path / "a.h5")
    assert set(volume.fields) == {"B_x", "B_y", "B_z", "rho", "T"}
    assert (volume.array("B_y") == 6).all()
    assert (volume.array("T") == 7).all()
    assert volume.units["rho"] == "C / m3"
    assert volume.units["T"] == ""
    assert volume.array("rho").dtype == np.float32
    np.testing.assert_allclose(volume.array("rho"), expected(volume.grid), rtol=1e-6)


def modes(group, name="E", labels="rz", order="C", sign="+", geometry="thetaMode"):
    """Fields of modes 0 to 2; Σ of them at (R, phi, z) is `around`."""
    r, z = 0.5 * (np.arange(3) + 0.5), 2.0 * (np.arange(5) + 0.5) - 1
    record = group.create_group(name)
    record.attrs.update(geometry=geometry, geometryParameters=f"m=3;imag={sign}")
    record.attrs.update(dataOrder=order, axisLabels=[a.encode() for a in labels])
    told = {"r": (0.5, 0.0), "z": (2.0, -1.0)}
    record.attrs.update(gridSpacing=[told[a][0] for a in labels], gridUnitSI=1.0)
    record.attrs.update(gridGlobalOffset=[told[a][1] for a in labels])
    record.attrs.update(unitDimension=VOLT_PER_METRE)
    parts = [1, 2, 3, 4, 5] if sign == "+" else [1, 2, -3, 4, -5]
    values = np.array(parts)[:, None, None] * (r[:, None] + 10 * z)
    axes = labels if order == "C" else labels[::-1]
    for part in "rtz":
        record[part] = values if axes == "rz" else values.transpose(0, 2, 1)
        record[part].attrs.update(unitSI=1.0, position=[0.5, 0.5])


def around(R, phi, z):
    waves = 1 + 2 * np.cos(phi) + 3 * np.sin(phi) + 4 * np.cos(2 * phi) + 5 * np.sin(2 * phi)
    return (R + 10 * z) * waves


@pytest.mark.parametrize(("labels", "order"), [("rz", "C"), ("zr", "C"), ("rz", "F"), ("zr", "F")])
@pytest.mark.parametrize("sign", "+-")
def test_modes_around_an_axis(tmp_path, labels, order, sign):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        modes(place(file), "E", labels, order, sign)
    volume = vm.open(tmp_path / "a.h5", "E")
    assert volume.fields == ("E_R", "E_phi", "E_z")
    assert isinstance(volume.grid, vm.CylindricalGrid)
    assert volume.grid.shape == (3, 64, 5)
    np.testing.assert_allclose(volume.grid.edges[0], [0, 0.5, 1.0, 1.5])
    np.testing.assert_allclose(volume.grid.edges[2], [-1, 1, 3, 5, 7, 9])
    points = np.meshgrid(*centres(volume.grid), indexing="ij")
    np.testing.assert_allclose(volume.array("E_R"), around(*points), atol=1e-10)
    few = vm.open(tmp_path / "a.h5", "E/z", azimuths=8)
    assert few.grid.shape == (3, 8, 5)
    with pytest.raises(vm.InputError, match="azimuths"):
        vm.open(tmp_path / "a.h5", "E/z", azimuths=4)


@pytest.mark.parametrize("encoding", ["group_based", "file_based", "variable_based"])
@pytest.mark.parametrize("order", "CF")
def test_files_of_the_standards_own_library(tmp_path, encoding, order):
    io = pytest.importorskip("openpmd_api")
    name = "s_%T.h5" if encoding == "file_based" else "s.h5"
    series = io.Series(str(tmp_path / name), io.Access.create)
    series.iteration_encoding = getattr(io.Iteration_Encoding, encoding)
    steps = (3,) if encoding == "variable_based" else (3, 12)
    for step in steps:
        iteration = series.iterations[step]
        iteration.time, iteration.time_unit_SI = 1.5, 1e-15
        mesh = iteration.meshes["E"]
        labels = "zyx" if order == "C" else "xyz"
        mesh.axis_labels, mesh.data_order = list(labels), order
        mesh.grid_spacing = [SPACING[a] for a in labels]
        mesh.grid_global_offset = [OFFSET[a] for a in labels]
        mesh.grid_unit_SI = 1e-6
        mesh.unit_dimension = {io.Unit_Dimension.L: 1, io.Unit_Dimension.M: 1}
        values = np.ascontiguousarray(values_of(labels, order, (0.0, 0.5, 0.5)))
        for part in "xy":
            component = mesh[part]
            component.reset_dataset(io.Dataset(values.dtype, values.shape))
            component.position, component.unit_SI = [0.0, 0.5, 0.5], 2.0
            if part == "x":
                component[()] = values
            else:
                component.make_constant(4.0)
        iteration.close()
    series.close()
    path = tmp_path / ("s_12.h5" if encoding == "file_based" else "s.h5")
    volume = vm.open(path)
    assert volume.meta["iteration"] in steps[-1:] or encoding == "variable_based"
    np.testing.assert_allclose(volume.array("E_x"), 2 * expected(volume.grid), rtol=1e-12)
    assert (volume.array("E_y") == 8).all()
    assert volume.units["E_x"] == "kg m"
