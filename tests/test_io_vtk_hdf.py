"""Image data in HDF5 files of VTK, by its own writer."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from contracts import ReaderContract
from voluminous.io import find_reader

pytest.importorskip("vtkmodules.vtkIOHDF", reason="VTK's own writer makes the files")

from vtkmodules.vtkIOHDF import vtkHDFWriter

from vtk_files import CELLS, POINTS, add, image, random_values, write


def sample(path, **place):
    data = image(**place)
    add(data, "f", random_values("f4"))
    add(data, "v", random_values("f8", (*POINTS, 3)))
    add(data, "c", random_values("i2", CELLS), cells=True)
    data.GetPointData().SetActiveScalars("f")
    return write(vtkHDFWriter(), data, path)


def test_places_and_values(tmp_path):
    path = sample(tmp_path / "a.vtkhdf", origin=(10, 20, 30), spacing=(1, 2, 3), low=(1, 0, 0))
    volume = vm.open(path)
    assert find_reader(path).name == "vtkhdf"
    assert volume.fields == ("f", "v_x", "v_y", "v_z")
    np.testing.assert_array_equal(volume.array("f"), random_values("f4"))
    vectors = random_values("f8", (*POINTS, 3))
    np.testing.assert_array_equal(volume.array("v_y"), vectors[..., 1])
    # Points are the centres of cells; the first one has the index (1, 0, 0).
    assert volume.grid.bounds.tolist() == [[10.5, 14.5], [19, 25], [28.5, 43.5]]
    cells = vm.open(path, "c", unit="pc")
    np.testing.assert_array_equal(cells.array("c"), random_values("i2", CELLS))
    assert cells.grid.bounds.tolist() == [[11, 14], [20, 24], [30, 42]]
    assert str(cells.unit) == "pc"


class TestVTKHDF(ReaderContract):
    @pytest.fixture
    def sample(self):
        return lambda folder: sample(folder / "a.vtkhdf")
