"""Damaged and hostile files of VTK: our errors only, in little time and memory."""

import numpy as np
import pytest

import voluminous as vm
from contracts import ReaderContract

pytest.importorskip("vtkmodules", reason="VTK's own writers make the files")

from vtkmodules.vtkIOLegacy import vtkStructuredPointsWriter

from vtk_files import CELLS, add, image, random_values, write, write_image


def sample(data):
    """Fill a data set with an array of each kind."""
    add(data, "f", random_values("f4"))
    add(data, "v", random_values("f8", (*data.GetDimensions(), 3)))
    add(data, "i", random_values("u1"))
    add(data, "c", random_values("f4", CELLS), cells=True)
    return data


def trimmed(path):
    """Leave out the last line's end: without it a file is whole, too."""
    path.write_bytes(path.read_bytes().rstrip(b"\n"))
    return path


class TestLegacy(ReaderContract):
    @pytest.fixture(params=[1, 2], ids=["text", "binary"])
    def sample(self, request):
        def make(folder):
            data = sample(image())
            # The last number has one digit: of a longer one the rest would be a number, too.
            add(data, "last", np.full((4, 3, 5), 7, "i4"))
            path = folder / "a.vtk"
            write(vtkStructuredPointsWriter(), data, path, FileType=request.param)
            path.write_bytes(path.read_bytes().rstrip())
            return path

        return make


class TestPieces(ReaderContract):
    @pytest.fixture
    def sample(self):
        def make(folder):
            listed = ""
            for number, low in enumerate((0, 3)):
                write_image(sample(image(low=(low, 0, 0))), folder / f"{number}.vti")
                trimmed(folder / f"{number}.vti")
                listed += f'<Piece Extent="{low} {low + 3} 0 2 0 4" Source="{number}.vti"/>'
            path = folder / "a.pvti"
            arrays = '<PPointData><PDataArray type="Float32" Name="f"/></PPointData>'
            path.write_text(
                '<VTKFile type="PImageData"><PImageData WholeExtent="0 6 0 2 0 4" GhostLevel="0" '
                f'Origin="0 0 0" Spacing="1 1 1">{arrays}{listed}</PImageData></VTKFile>'
            )
            return path

        return make

    def victims(self, path):
        return [path, *path.parent.glob("*.vti")]


# One thing wrong each


def one_array(attributes="", text="1 2 3 4 5 6 7 8", extent="0 1 0 1 0 1", top="", after=""):
    return (
        f'<VTKFile type="ImageData" {top}><ImageData WholeExtent="{extent}"><Piece '
        f'Extent="{extent}"><PointData><DataArray Name="a" {attributes or TEXT}>{text}'
        f"</DataArray></PointData></Piece></ImageData>{after}</VTKFile>"
    )


TEXT = 'type="Float32" format="ascii"'
BAD = {
    "few numbers": one_array(text="1 2 3"),
    "no number": one_array(text="1 2 3 4 five 6 7 8"),
    "a billion components": one_array(TEXT + ' NumberOfComponents="1000000000"'),
    "extent": one_array(extent="0 1 0 1 0"),
    "overflow": one_array(extent="0 4000000000 " * 3),
    "no appended": one_array('type="Float32" format="appended" offset="-9"'),
    "no spacing": one_array().replace("<ImageData", '<ImageData Spacing="0 1 1"'),
    "no data": '<VTKFile type="ImageData"></VTKFile>',
    "no piece": '<VTKFile type="ImageData"><ImageData/></VTKFile>',
}


@pytest.mark.parametrize("what", BAD)
def test_what_is_wrong_is_told(tmp_path, what):
    path = tmp_path / "a.vti"
    path.write_text(BAD[what])
    # What exactly is wrong VTK says in its own words.
    with pytest.raises(vm.FileFormatError) as failure:
        vm.open(path, format="vti")
    assert str(failure.value).startswith(str(path))
    assert len(str(failure.value)) < 1000


def test_binary_legacy_files_that_promise_too_much(tmp_path):
    path = tmp_path / "a.vtk"
    path.write_text(
        "# vtk DataFile Version 3.0\nt\nBINARY\nDATASET STRUCTURED_POINTS\n"
        "DIMENSIONS 1000000 1000 1000\nPOINT_DATA 1000000000000\nVECTORS v double\n"
    )
    with pytest.raises(vm.FileFormatError, match=r"more than a file of \d+ bytes holds"):
        vm.open(path)
