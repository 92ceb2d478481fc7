"""Files of VTK that name others: blocks side by side, patches of several levels, series."""

from __future__ import annotations

import numpy as np
import pytest

import voluminous as vm
from contracts import ReaderContract

pv = pytest.importorskip("pyvista")

SHAPE, SPACING = (4, 3, 2), (1.0, 1.0, 2.0)
SLOPES = [1.0, 10.0, 100.0]


def block(low, first=0.0, shape=SHAPE, spacing=SPACING, name="c"):
    """Return image data whose lowest corner is `low`."""
    image = pv.ImageData(dimensions=np.add(shape, 1), spacing=spacing, origin=low)
    # Linear in the place: what lies elsewhere is seen.
    image.cell_data[name] = first + image.cell_centers().points @ SLOPES
    return image


def saved(path, **blocks):
    pv.MultiBlock(blocks).save(path)
    return path


@pytest.mark.parametrize("field", ["c", "p"])
def test_blocks_that_fill_a_box_are_joined(tmp_path, field):
    images = {"b": block((4, 0, 0)), "a": block((0, 0, 0))}
    for image in images.values():
        image.point_data["p"] = image.points @ SLOPES
    volume = vm.open(saved(tmp_path / "a.vtm", **images), field)
    assert isinstance(volume.grid, vm.CartesianGrid)
    assert volume.grid.shape == ((8, 3, 2) if field == "c" else (9, 4, 3))
    centers = [(e[1:] + e[:-1]) / 2 for e in volume.grid.edges]
    x, y, z = np.meshgrid(*centers, indexing="ij")
    np.testing.assert_allclose(volume.array(field), x + 10 * y + 100 * z)


@pytest.mark.parametrize(
    "others",
    [
        {"gap": block((8, 0, 0))},
        {"corner": block((4, 3, 0))},
        {"finer": block((1, 1, 0), shape=(4, 2, 4), spacing=(0.5, 0.5, 1.0))},
    ],
)
def test_other_blocks_are_patches(tmp_path, others):
    path = saved(tmp_path / "a.vtm", first=block((0, 0, 0)), **others)
    volume = vm.open(path)
    assert isinstance(volume.grid, vm.PatchGrid)
    parts = volume.grid.unpack(volume.array("c"))
    for part, image in zip(parts, [block((0, 0, 0)), *others.values()], strict=True):
        values = np.asarray(image.cell_data["c"]).reshape(part.shape[::-1]).T
        seen = np.isfinite(part)
        np.testing.assert_array_equal(part[seen], values[seen])
        assert seen.any()


def test_levels_of_patches(tmp_path):
    model = pytest.importorskip("vtkmodules.vtkCommonDataModel")
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkIOXML import vtkXMLUniformGridAMRWriter

    made = model.vtkOverlappingAMR()
    made.Initialize([1, 1])
    made.SetOrigin([0, 0, 0])
    numbers = [np.arange(64.0), 1000 + np.arange(64.0)]
    for level, (origin, width) in enumerate([((0, 0, 0), 1.0), ((1, 1, 1), 0.5)]):
        grid = model.vtkUniformGrid()
        grid.SetOrigin(origin)
        grid.SetSpacing([width] * 3)
        grid.SetDimensions(5, 5, 5)
        values = numpy_to_vtk(numbers[level], deep=True)
        values.SetName("rho")
        grid.GetCellData().AddArray(values)
        made.SetSpacing(level, [width] * 3)
        box = model.vtkAMRBox(origin, [5] * 3, [width] * 3, [0, 0, 0], 9)
        made.SetAMRBox(level, 0, box)
        made.SetDataSet(level, 0, grid)
    made.SetRefinementRatio(0, 2)
    writer = vtkXMLUniformGridAMRWriter()
    writer.SetInputData(made)
    writer.SetFileName(str(tmp_path / "a.vthb"))
    assert writer.Write()
    volume = vm.open(tmp_path / "a.vthb")
    assert volume.grid.cells_per_level == (56, 64)
    coarse, fine = volume.grid.unpack(volume.array("rho"))
    np.testing.assert_array_equal(fine.T.reshape(-1), numbers[1])
    inner = np.zeros((4, 4, 4), bool)
    inner[1:3, 1:3, 1:3] = True
    np.testing.assert_array_equal(np.isnan(coarse), inner)


def test_what_is_no_regular_grid_is_left_out_or_named(tmp_path):
    path = saved(tmp_path / "a.vtm", ball=pv.Sphere(), box=pv.MultiBlock({"in": block((0, 0, 0))}))
    with pytest.warns(UserWarning, match=r"left out:\n  ball \(.*a_0\.vtp\)"):
        volume = vm.open(path)
    assert volume.grid.shape == SHAPE
    with pytest.raises(vm.InputError, match=r"holds PolyData, not a regular grid; give"):
        vm.open(saved(tmp_path / "b.vtm", ball=pv.Sphere()))
    with pytest.raises(vm.InputError, match=r"none of its blocks(.|\n)*  ball \((.|\n)*  cube \("):
        vm.open(saved(tmp_path / "c.vtm", ball=pv.Sphere(), cube=pv.Cube()))


class TestBlocks(ReaderContract):
    @pytest.fixture(params=["joined", "patches"])
    def sample(self, request):
        low = (4, 0, 0) if request.param == "joined" else (9, 0, 0)

        def make(folder):
            path = saved(folder / "a.vtm", a=block((0, 0, 0)), b=block(low))
            # Cut short within the last line break, it is as good.
            for file in self.victims(path):
                file.write_bytes(file.read_bytes().rstrip())
            return path

        return make

    def victims(self, path):
        return [path, *path.parent.glob("a/*.vti")]
