"""What is written for VTK is what VTK reads; objects of VTK and PyVista become volumes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

import voluminous as vm

pytest.importorskip("vtkmodules", reason="VTK's own readers judge the files")

from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkDataArray
from vtkmodules.vtkIOXML import vtkXMLImageDataReader, vtkXMLRectilinearGridReader

from vtk_files import (
    CELLS,
    LINES,
    POINTS,
    TYPES,
    random_values,
)

READERS = {".vti": vtkXMLImageDataReader, ".vtr": vtkXMLRectilinearGridReader}


def read(path):
    """Return what VTK's own reader makes of a file."""
    reader = READERS[path.suffix]()
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


@st.composite
def volumes(draw, even):
    shape = draw(array_shapes(min_dims=3, max_dims=3, max_side=4))
    widths = st.floats(0.01, 10.0)
    if even:
        limits = [(a, a + n * draw(widths)) for n, a in zip(shape, (0.0, -3.0, 50.0), strict=True)]
        grid = vm.CartesianGrid.uniform(shape, limits, unit=draw(st.sampled_from([None, "kpc"])))
    else:
        edges = [np.cumsum(draw(arrays(float, n + 1, elements=widths))) for n in shape]
        grid = vm.CartesianGrid(*edges)
    volume = vm.Volume(grid)
    for name in draw(st.lists(st.sampled_from("abcd"), unique=True, min_size=1)):
        volume[name] = draw(arrays(draw(st.sampled_from(TYPES)), shape))
        volume.set_unit(name, draw(st.sampled_from(["", "g / cm3", "K"])))
    return volume


@pytest.mark.parametrize("suffix", [".vti", ".vtr"])
def test_what_is_written_vtk_reads_and_so_do_we(tmp_path_factory, suffix):
    path = tmp_path_factory.mktemp("vtk") / f"a{suffix}"

    @settings(deadline=None, max_examples=50)
    @given(volumes(even=suffix == ".vti"))
    def run(volume):
        volume.save(path)
        theirs, ours = read(path), vm.open(path)
        np.testing.assert_allclose(theirs.GetBounds(), volume.grid.bounds.ravel(), rtol=1e-13)
        assert ours.fields == volume.fields
        assert ours.unit == volume.unit
        assert ours.units == volume.units
        for mine, edges in zip(ours.grid.edges, volume.grid.edges, strict=True):
            np.testing.assert_allclose(mine, edges, rtol=1e-13, atol=1e-13)
        for name in volume.fields:
            array = theirs.GetCellData().GetArray(name)
            values = vtk_to_numpy(array).reshape(volume.grid.shape[::-1]).T
            np.testing.assert_array_equal(values, volume.array(name))
            np.testing.assert_array_equal(ours.array(name), volume.array(name))
            assert ours.array(name).dtype == volume.array(name).dtype
            unit = array.GetInformation().Get(vtkDataArray.UNITS_LABEL())
            assert (unit or "").strip() == volume.units[name]

    run()


def test_vectors_truths_and_remarks(tmp_path):
    volume = vm.models.sphere(4)
    rng = np.random.default_rng(1)
    for axis in "xyz":
        volume[f"wind_{axis}"] = rng.random(volume.grid.shape, dtype=np.float32)
        volume[f"mixed_{axis}"] = rng.random(volume.grid.shape).astype(
            "f4" if axis == "x" else "f8"
        )
    volume["truth"] = volume.array("inside") > 0.5
    volume.meta |= {"time": 2.5, "object": "a & b", "list": [1], "flag": True}
    path = tmp_path / "a.vti"
    volume.save(path)
    theirs, ours = read(path), vm.open(path)
    wind = theirs.GetCellData().GetArray("wind")
    assert wind.GetNumberOfComponents() == 3
    np.testing.assert_array_equal(
        vtk_to_numpy(wind)[:, 1].reshape(4, 4, 4).T, volume.array("wind_y")
    )
    assert theirs.GetFieldData().GetArray("TimeValue").GetValue(0) == 2.5
    assert theirs.GetFieldData().GetAbstractArray("object").GetValue(0) == "a & b"
    assert theirs.GetCellData().GetArray("mixed_x").GetNumberOfComponents() == 1
    assert set(ours.fields) == set(volume.fields)
    assert ours.meta == {"time": 2.5, "object": "a & b"}
    assert ours.array("truth").dtype == np.uint8
    np.testing.assert_array_equal(ours.array("truth"), volume.array("truth"))


def test_objects_of_pyvista():
    pv = pytest.importorskip("pyvista")
    mesh = pv.ImageData(dimensions=POINTS, spacing=(1, 2, 3), origin=(1, 1, 1))
    mesh["rho"] = random_values("f4").T.ravel()
    mesh.cell_data["c"] = random_values("f4", CELLS).T.ravel()
    mesh.field_data["TimeValue"] = [4.0]
    volume = vm.Volume.from_pyvista(mesh, "rho")
    np.testing.assert_array_equal(volume.array("rho"), random_values("f4"))
    assert volume.meta == {"time": 4.0}
    grid = pv.RectilinearGrid(*LINES)
    grid["rho"] = random_values("f4").T.ravel()
    np.testing.assert_array_equal(vm.Volume.from_pyvista(grid).array("rho"), random_values("f4"))
    with pytest.raises(vm.InputError, match=r"got UnstructuredGrid.*give resolution=64"):
        vm.Volume.from_pyvista(grid.cast_to_unstructured_grid())
    # The advice helps.
    volume = vm.Volume.from_pyvista(grid.cast_to_unstructured_grid(), resolution=8)
    assert volume.fields == ("rho",)
    assert volume.grid.shape == (7, 6, 8)
    assert np.isfinite(volume.array("rho")).all()
