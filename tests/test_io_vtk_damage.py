"""Damaged and hostile files of VTK: our errors only, in little time and memory."""

import base64
import zlib

import numpy as np
import pytest

import voluminous as vm
from contracts import ReaderContract
from voluminous.io import find_reader

pytest.importorskip("vtkmodules", reason="VTK's own writers make the files")

from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkPolyData
from vtkmodules.vtkIOLegacy import vtkPolyDataWriter, vtkStructuredPointsWriter
from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLRectilinearGridWriter

from vtk_files import CELLS, add, image, random_values, rectilinear, write, write_image


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


class TestImageDataAppendedAsTheyAre(ReaderContract):
    @pytest.fixture
    def sample(self):
        return lambda folder: trimmed(
            write_image(sample(image()), folder / "a.vti", CompressorType=0, EncodeAppendedData=0)
        )


class TestImageDataPacked(ReaderContract):
    @pytest.fixture
    def sample(self):
        return lambda folder: trimmed(
            write_image(sample(image()), folder / "a.vti", DataMode=1, BlockSize=64)
        )


class TestImageDataAsText(ReaderContract):
    @pytest.fixture
    def sample(self):
        return lambda folder: trimmed(write_image(sample(image()), folder / "a.vti", DataMode=0))


class TestRectilinearGrid(ReaderContract):
    @pytest.fixture
    def sample(self):
        return lambda folder: trimmed(
            write(
                vtkXMLRectilinearGridWriter(),
                sample(rectilinear()),
                folder / "a.vtr",
                EncodeAppendedData=1,
            )
        )


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
            path.write_text(
                f'<VTKFile type="PImageData"><PImageData>{listed}</PImageData></VTKFile>'
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
BINARY = 'type="Float32" format="binary"'
APPENDED = 'type="Float32" format="appended" offset="0"'
ZLIB = 'compressor="vtkZLibDataCompressor"'


def coded(*parts):
    return "".join(base64.b64encode(np.asarray(part).tobytes()).decode() for part in parts)


def packed(values, sizes=None):
    """Return one block, announced as `sizes` or as it is."""
    block = zlib.compress(values)
    head = np.array(sizes or [1, len(values), 0, len(block)], np.uint32)
    return base64.b64encode(head.tobytes()).decode() + base64.b64encode(block).decode()


EIGHT = np.ones(8, "<f4").tobytes()
BAD = {
    "few numbers": (one_array(text="1 2 3"), "expected 8 numbers"),
    "fewer than room": (one_array(text="1 2 3 4 5 6 777777"), "expected 8 numbers, got 7"),
    "no number": (one_array(text="1 2 3 4 five 6 7 8"), "expected numbers of type float32"),
    "many digits": (one_array(text="1 2 3 4 5 6 7 " + "9" * 5000), "expected numbers, got"),
    "type": (one_array('type="Flaot32"'), "expected type to be one of Int8.*got 'Flaot32'"),
    "components": (one_array(TEXT + ' NumberOfComponents="0"'), "expected 1 to 4096 components"),
    "a billion components": (
        one_array(TEXT + ' NumberOfComponents="1000000000"'),
        "more than a file|expected 1 to 4096 components",
    ),
    "extent": (one_array(extent="0 1 0 1 0"), "Extent to be 6 whole numbers"),
    "empty": (one_array(extent="0 -1 0 1 0 1"), "expected a piece with points"),
    "overflow": (one_array(extent="0 4000000000 " * 3), "more than any file holds"),
    "infinite": (one_array(extent="0 inf 0 1 0 1"), "Extent to be 6 whole numbers"),
    "huge": (one_array(extent="0 99999 0 9999 0 9999"), "more than a file of this size holds"),
    "long": (one_array(extent="0 1000000000000 0 0 0 0"), "more than a file of this size holds"),
    "not base64": (one_array(BINARY, "!!!!" * 20), "expected base64 text"),
    "length": (one_array(BINARY, coded([np.uint32(4)], np.ones(8))), "4 bytes are announced"),
    "few bytes": (one_array(BINARY, coded([np.uint32(32)])), "expected 32 bytes, but only 8"),
    "compressor": (
        one_array(BINARY, packed(EIGHT), top='compressor="zip"'),
        "unknown compressor 'zip'",
    ),
    "bomb": (
        one_array(BINARY, packed(bytes(10_000_000), [1, 32, 0, 9725]), top=ZLIB),
        "block 0 holds more than the 32 bytes",
    ),
    "many blocks": (
        one_array(BINARY, packed(EIGHT, [1 << 31, 32, 0, 9]), top=ZLIB),
        "2147483648 compressed blocks",
    ),
    "small block": (one_array(BINARY, packed(EIGHT[:4], [1, 32, 0, 12]), top=ZLIB), "fewer than"),
    "packed sizes": (one_array(BINARY, packed(EIGHT, [1, 32, 0, 1 << 30]), top=ZLIB), "more than"),
    "damaged": (
        one_array(BINARY, coded(np.uint32([1, 32, 0, 12])) + "A" * 16, top=ZLIB),
        "block 0 is damaged",
    ),
    "no appended": (one_array(APPENDED), "is appended, but there is no <AppendedData>"),
    "offset": (
        one_array(
            APPENDED.replace('"0"', '"-9"'),
            after='<AppendedData encoding="raw">_    </AppendedData>',
        ),
        "its offset is negative",
    ),
    "far offset": (
        one_array(
            APPENDED.replace('"0"', '"99999"'),
            after='<AppendedData encoding="raw">_    </AppendedData>',
        ),
        "cut short before its values",
    ),
    "no underscore": (
        one_array(APPENDED, after="<AppendedData>xyz</AppendedData>"),
        "expected '_' and values",
    ),
    "entities": (
        '<!DOCTYPE a [<!ENTITY b "bbbb"><!ENTITY c "&b;&b;">]>' + one_array(text="&c;"),
        "declares a document type",
    ),
    "nested": ("<VTKFile>" + "<a>" * 100_000, "more than 32 elements in each other"),
    "a tag that goes on": ('<VTKFile a="' + "x" * 5_000_000, "a tag of more than"),
    "not finite": (
        one_array().replace("<ImageData", '<ImageData Origin="0 nan 0"'),
        "Origin to be 3 finite numbers",
    ),
    "no spacing": (one_array().replace("<ImageData", '<ImageData Spacing="0 1 1"'), "span space"),
    "no direction": (
        one_array().replace("<ImageData", '<ImageData Direction="1 0 0 1 0 0 0 0 1"'),
        "span space",
    ),
    "no data": ('<VTKFile type="ImageData"></VTKFile>', "expected <ImageData> in <VTKFile>"),
    "no piece": ('<VTKFile type="ImageData"><ImageData/></VTKFile>', "expected a piece"),
    "no lines": (
        one_array().replace("ImageData", "RectilinearGrid"),
        "expected 3 arrays of coordinates, got 0",
    ),
}


@pytest.mark.parametrize("what", BAD)
def test_what_is_wrong_is_told(tmp_path, what):
    path = tmp_path / "a.vti"
    path.write_text(BAD[what][0])
    # What exactly is wrong VTK says in its own words.
    with pytest.raises(vm.FileFormatError) as failure:
        vm.open(path, format="vti")
    assert str(failure.value).startswith(str(path))
    assert len(str(failure.value)) < 1000


def test_what_is_right_is_read(tmp_path):
    # The same files, if nothing is wrong with them.
    path = tmp_path / "a.vti"
    for content in (
        one_array(),
        one_array(BINARY, coded(np.uint32([32])) + coded(np.frombuffer(EIGHT, "f4"))),
        one_array(BINARY, packed(EIGHT), top=ZLIB),
    ):
        path.write_text(content)
        assert vm.open(path).array("a").shape == (2, 2, 2)


LEGACY = "# vtk DataFile Version 3.0\nt\nASCII\nDATASET STRUCTURED_POINTS\n"
BOX = LEGACY + "DIMENSIONS 2 1 1\n"
BAD_LEGACY = {
    "way": ("# vtk DataFile Version 3.0\nt\nTEXT\n", "expected ASCII or BINARY, got 'TEXT'"),
    "no dataset": ("# vtk DataFile Version 3.0\nt\nASCII\nPOINTS 3\n", "line 4: expected DATASET"),
    "no dimensions": (LEGACY + "POINT_DATA 2\n", "expected DIMENSIONS before data"),
    "no whole number": (LEGACY + "DIMENSIONS 2 b 1\n", "DIMENSIONS.*invalid literal"),
    "negative": (LEGACY + "DIMENSIONS 2 -1 1\n", "must be positive whole numbers"),
    "overflow": (LEGACY + "DIMENSIONS 4000000000 4000000000 4\n", "more than any file holds"),
    "two": (LEGACY + "DIMENSIONS 4 4\n", "expected three DIMENSIONS"),
    "count": (BOX + "POINT_DATA 3\n", "expected POINT_DATA 2"),
    "keyword": (BOX + "POINT_DATA 2\nSCALAR a float\n", "'SCALAR' is no keyword"),
    "table": (BOX + "POINT_DATA 2\nSCALARS a float\n1 2\n", "expected LOOKUP_TABLE"),
    "type": (BOX + "POINT_DATA 2\nVECTORS a flaot\n1 2 3\n", "unknown type 'flaot'"),
    "too few": (BOX + "POINT_DATA 2\nVECTORS a float\n1 2 3\n", "expected 6 numbers"),
    "place": (BOX + "VECTORS a float\n1 2 3 4 5 6\n", "expected POINT_DATA or CELL_DATA before"),
    "word": (BOX + "POINT_DATA 2\nFIELD f 2\na 1 2 int\n1 2\n", "expected 2 arrays"),
    "tuples": (BOX + "POINT_DATA 2\nFIELD f 1\na 1 3 int\n1 2 3\n", "3 tuples, expected one"),
    "many": (BOX + "FIELD f 1\na 1000000 1000000 int\n1 2 3\n", "expected 1000000000000 numbers"),
    "no data": (BOX, "there are none"),
    "spacing": (BOX + "SPACING 1 nan 1\n", "expected three finite numbers as SPACING"),
    "long line": (BOX + "x" * 100_000, "expected a line of text"),
    "lines": (
        LEGACY.replace("STRUCTURED_POINTS", "RECTILINEAR_GRID")
        + "DIMENSIONS 2 1 1\nX_COORDINATES 3 float\n1 2 3\n",
        "expected 2 X_COORDINATES",
    ),
    "line": (
        LEGACY.replace("STRUCTURED_POINTS", "RECTILINEAR_GRID")
        + "DIMENSIONS 2 1 1\nX_COORDINATES 2 float\n1 1\nY_COORDINATES 1 float\n1\n"
        + "Z_COORDINATES 1 float\n1\nPOINT_DATA 2\nSCALARS a int\nLOOKUP_TABLE default\n1 2\n",
        "x coordinates that increase, or decrease",
    ),
}


@pytest.mark.parametrize("what", BAD_LEGACY)
def test_what_is_wrong_with_legacy_files(tmp_path, what):
    path = tmp_path / "a.vtk"
    path.write_text(BAD_LEGACY[what][0])
    with pytest.raises(vm.InputError) as failure:
        vm.open(path)
    assert str(failure.value).startswith(str(path))


def test_binary_legacy_files_that_promise_too_much(tmp_path):
    path = tmp_path / "a.vtk"
    path.write_text(
        "# vtk DataFile Version 3.0\nt\nBINARY\nDATASET STRUCTURED_POINTS\n"
        "DIMENSIONS 1000000 1000 1000\nPOINT_DATA 1000000000000\nVECTORS v double\n"
    )
    with pytest.raises(vm.FileFormatError, match=r"more than a file of \d+ bytes holds"):
        vm.open(path)


@pytest.mark.parametrize(
    ("source", "error", "expected"),
    [
        ("../b.vti", vm.FileFormatError, "outside of its directory"),
        ("c.vti", vm.InputError, "no such file"),
        ("a.pvti", vm.FileFormatError, "a piece of a.pvti: expected a VTK file with ImageData"),
        ("", vm.InputError, "no such file"),
    ],
)
def test_pieces_elsewhere(tmp_path, source, error, expected):
    folder = tmp_path / "folder"
    folder.mkdir()
    (tmp_path / "b.vti").write_text(one_array())
    path = folder / "a.pvti"
    path.write_text(
        '<VTKFile type="PImageData"><PImageData><Piece Extent="0 1 0 1 0 1" '
        f'Source="{source}"/></PImageData></VTKFile>'
    )
    with pytest.raises(error, match=expected):
        vm.open(path)


def test_pieces_that_leave_gaps(tmp_path):
    pieces = {"a.vti": "0 1 0 1 0 1", "b.vti": "2 3 0 1 0 1", "c.vti": "0 1 0 1 0 1"}
    for name, extent in pieces.items():
        (tmp_path / name).write_text(one_array(extent=extent))

    def together(*names):
        path = tmp_path / "all.pvti"
        listed = "".join(f'<Piece Extent="{pieces[n]}" Source="{n}"/>' for n in names)
        path.write_text(f'<VTKFile type="PImageData"><PImageData>{listed}</PImageData></VTKFile>')
        return path

    # Points are next to each other, there is none between.
    assert vm.open(together("a.vti", "b.vti")).grid.shape == (4, 2, 2)
    pieces["b.vti"] = "4 5 0 1 0 1"
    (tmp_path / "b.vti").write_text(one_array(extent=pieces["b.vti"]))
    with pytest.raises(vm.FileFormatError, match="have 16 points, expected at least 24"):
        vm.open(together("a.vti", "b.vti"))
    with pytest.raises(vm.FileFormatError, match="8 of 24 values are in none"):
        vm.open(together("a.vti", "b.vti", "c.vti"))


def test_other_data_of_vtk_are_refused_with_advice(tmp_path):
    points, data = vtkPoints(), vtkPolyData()
    points.InsertNextPoint(1, 2, 3)
    data.SetPoints(points)
    xml = write(vtkXMLPolyDataWriter(), data, tmp_path / "a.vtp")
    legacy = write(vtkPolyDataWriter(), data, tmp_path / "a.vtk")
    for path in (xml, legacy):
        with pytest.raises(vm.InputError, match=r"; give resolution=64"):
            vm.open(path)


@pytest.mark.parametrize(
    "content",
    [
        b"<svg/>",
        b"<?xml version='1.0'?><html>",
        b"<",
        b"<!-- <VTKFile> --><a/>",
        b"# vtk",
        b"<??>" * 900,
    ],
)
def test_other_files_are_left_to_others(tmp_path, content):
    for reader in (vm.io.registry.VTKXMLReader(), vm.io.registry.VTKReader()):
        assert not reader.matches(tmp_path / "a.vti", content)


def test_a_comment_may_come_first(tmp_path):
    path = tmp_path / "a.vti"
    path.write_text("<?xml version='1.0'?>\n<!-- by hand -->\n" + one_array())
    assert find_reader(path).name == "vti"
