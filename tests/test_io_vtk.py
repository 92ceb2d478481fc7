"""VTK's files against VTK's own writers: values, places, names."""

import numpy as np
import pytest

import real_data
import voluminous as vm
from reference import data_directory

pytest.importorskip("vtkmodules", reason="VTK's own writers make the files")

from vtkmodules.vtkIOHDF import vtkHDFWriter
from vtkmodules.vtkIOLegacy import (
    vtkRectilinearGridWriter,
    vtkStructuredPointsWriter,
)
from vtkmodules.vtkIOXML import (
    vtkXMLImageDataWriter,
    vtkXMLRectilinearGridWriter,
)

from contracts import ReaderContract
from voluminous.io import find_reader
from vtk_files import (
    CELLS,
    LINES,
    POINTS,
    TYPES,
    add,
    image,
    point_centers,
    random_values,
    rectilinear,
    write,
    write_image,
)


@pytest.mark.parametrize(
    "settings",
    [
        {"DataMode": 0},
        {"DataMode": 1, "CompressorType": 1, "ByteOrder": 0, "BlockSize": 64},
        {"DataMode": 2, "CompressorType": 0, "EncodeAppendedData": False, "HeaderType": 64},
        {"DataMode": 2, "CompressorType": 3, "EncodeAppendedData": True},
    ],
    ids=str,
)
@pytest.mark.parametrize("kind", ["vti", "vtr"])
def test_encodings_of_xml(tmp_path, settings, kind):
    data, writer = (
        (image(), vtkXMLImageDataWriter())
        if kind == "vti"
        else (rectilinear(), vtkXMLRectilinearGridWriter())
    )
    values = {name: random_values(name) for name in ("u1", "i2", "f4", "f8")}
    for name, array in values.items():
        add(data, name, array)
    volume = vm.open(write(writer, data, tmp_path / f"a.{kind}", **settings))
    assert volume.fields == tuple(values)
    for name, array in values.items():
        assert volume.array(name).dtype == array.dtype
        # As text VTK writes as many digits as the type holds.
        np.testing.assert_array_equal(volume.array(name), array)


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("version", [42, 51])
@pytest.mark.parametrize(
    ("make", "writer"),
    [
        (image, vtkStructuredPointsWriter),
        (rectilinear, vtkRectilinearGridWriter),
    ],
)
def test_legacy_files_of_all_types(tmp_path, make, writer, version, binary):
    data, path = make(), tmp_path / "a.vtk"
    values = {name: random_values(name) for name in TYPES}
    for name, array in values.items():
        add(data, name, array)
    add(data, "in cells", random_values("f4", CELLS), cells=True)
    data.GetPointData().SetActiveScalars("i2")
    add(data, "v", random_values("f8", (*POINTS, 3)))
    data.GetPointData().SetActiveVectors("v")
    write(writer(), data, path, FileType=2 if binary else 1, FileVersion=version)
    volume = vm.open(path)
    assert set(volume.fields) == {*TYPES, "v_x", "v_y", "v_z"}
    for name in TYPES:
        assert volume.array(name).dtype == values[name].dtype
        # As text VTK writes numbers with 6 or 11 digits here.
        rounding = 0 if binary or name[0] != "f" else 1e-5
        np.testing.assert_allclose(volume.array(name), values[name], rtol=rounding, atol=0)
    cells = vm.open(path, "in_cells")
    np.testing.assert_allclose(cells.array("in_cells"), random_values("f4", CELLS), rtol=1e-5)
    if make is not image:
        np.testing.assert_array_equal(cells.grid.edges[2], LINES[2])


def test_points_are_centres_of_cells_and_cells_are_cells(tmp_path):
    data = image(origin=(1, 2, 3), spacing=(0.5, 2, 1), low=(10, 0, -4))
    add(data, "p", random_values("f4"))
    add(data, "c", random_values("f8", CELLS), cells=True)
    path = write_image(data, tmp_path / "a.vti")
    points, cells = vm.open(path, "p", unit="kpc"), vm.open(path, "c")
    expected = [data.GetPoint(n) for n in range(data.GetNumberOfPoints())]
    centers = point_centers(points).reshape(*POINTS, 3).transpose(2, 1, 0, 3).reshape(-1, 3)
    np.testing.assert_allclose(centers, expected, rtol=1e-14)
    np.testing.assert_allclose(cells.grid.bounds.ravel(), data.GetBounds(), rtol=1e-14)
    assert cells.grid.shape == CELLS
    assert cells.grid.is_uniform
    assert points.grid.is_uniform
    assert str(points.unit) == "kpc"
    np.testing.assert_array_equal(cells.array("c"), random_values("f8", CELLS))


def test_oblique_data_keep_their_own_axes_and_say_so(tmp_path):
    angle = np.deg2rad(20)
    turned = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    data = image(origin=(1, 2, 3), spacing=(1, 2, 4))
    data.SetDirectionMatrix(*turned.ravel())
    add(data, "f", random_values("f4"))
    add(data, "v", random_values("f4", (*POINTS, 3)))
    volume = vm.open(write_image(data, tmp_path / "a.vti"))
    # Components in space are none along the data's own axes.
    assert volume.fields == ("f", "v_0", "v_1", "v_2")
    np.testing.assert_array_equal(volume.array("f"), random_values("f4"))
    middle = volume.grid.bounds.mean(axis=1)
    true = middle + (point_centers(volume) - middle) @ np.array(volume.meta["direction"]).T
    expected = [data.GetPoint(n) for n in range(data.GetNumberOfPoints())]
    true = true.reshape(*POINTS, 3).transpose(2, 1, 0, 3).reshape(-1, 3)
    np.testing.assert_allclose(true, expected, atol=1e-12)
    again = tmp_path / "b.vti"
    volume.save(again)
    np.testing.assert_allclose(vm.open(again).meta["direction"], volume.meta["direction"])
    np.testing.assert_allclose(vm.open(again).grid.bounds, volume.grid.bounds)


@pytest.mark.parametrize("kind", ["ImageData", "RectilinearGrid"])
def test_files_in_pieces(tmp_path, kind):
    points = (9, 7, 6)
    values, cells = random_values("f4", points), random_values("i2", (8, 6, 5))
    # Points where pieces meet are in both; the third has a layer of cells of the second, too.
    boxes = [((0, 0, 0), (9, 4, 6)), ((0, 3, 0), (5, 4, 6)), ((3, 3, 0), (6, 4, 6))]
    listed = ""
    for number, (low, size) in enumerate(boxes):
        box = tuple(slice(a, a + n) for a, n in zip(low, size, strict=True))
        inner = tuple(slice(a, a + n - 1) for a, n in zip(low, size, strict=True))
        extent = " ".join(f"{a} {a + n - 1}" for a, n in zip(low, size, strict=True))
        if kind == "ImageData":
            data, writer = image(size, low=low), vtkXMLImageDataWriter()
        else:
            data = rectilinear(
                [np.arange(n, dtype=float)[s] ** 2 for n, s in zip(points, box, strict=True)]
            )
            data.SetExtent(*map(int, extent.split()))
            writer = vtkXMLRectilinearGridWriter()
        add(data, "f", values[box])
        add(data, "c", cells[inner], cells=True)
        write(writer, data, tmp_path / f"piece {number}", CompressorType=number % 2)
        listed += f'<Piece Extent="{extent}" Source="piece {number}"/>'
    path = tmp_path / "all.pvti"
    lines = "".join(f'<PDataArray type="Float64" Name="{axis}"/>' for axis in "xyz")
    path.write_text(
        f'<VTKFile type="P{kind}"><P{kind} WholeExtent="0 8 0 6 0 5" GhostLevel="0" '
        'Origin="1 2 3" Spacing="1 1 1">'
        '<PPointData Scalars="f"><PDataArray type="Float32" Name="f"/></PPointData>'
        '<PCellData><PDataArray type="Int16" Name="c"/></PCellData>'
        f"<PCoordinates>{lines}</PCoordinates>{listed}</P{kind}></VTKFile>"
    )
    volume = vm.open(path)
    assert volume.fields == ("f",)
    np.testing.assert_array_equal(volume.array("f"), values)
    np.testing.assert_array_equal(vm.open(path, "c").array("c"), cells)
    low, high = vm.open(path, "c").grid.bounds.T
    whole = ([1, 2, 3], [9, 8, 8]) if kind == "ImageData" else ([0, 0, 0], [64, 36, 25])
    np.testing.assert_allclose((low, high), whole)
    # One file of it alone is what is in that one.
    assert vm.open(tmp_path / "piece 1", "f").grid.shape == (5, 4, 6)


def test_which_arrays_are_fields_if_nobody_says(tmp_path):
    data = image()
    for name in ("a", "b"):
        add(data, name, random_values("f4"))
    add(data, "a", random_values("f8", CELLS), cells=True)
    add(data, "vtkOriginalPointIds", random_values("i4"))
    path = write_image(data, tmp_path / "a.vti")
    assert vm.open(path).fields == ("a", "b")
    assert vm.open(path, "a").array("a").dtype == np.float32
    data.GetCellData().SetActiveScalars("a")
    path = write_image(data, tmp_path / "a.vti")
    assert vm.open(path).fields == ("a",)
    assert vm.open(path).grid.shape == CELLS
    assert vm.open(path, "point/a").grid.shape == POINTS
    assert vm.open(path, {"x1": "point/a", "x2": "b"}).fields == ("x1", "x2")
    with pytest.raises(vm.InputError, match=r"fields of one kind \(cells: a; points: b\)"):
        vm.open(path, ["a", "b"])
    assert vm.open(path, "vtkOriginalPointIds").fields == ("vtkOriginalPointIds",)


@pytest.mark.parametrize(
    ("name", "path", "fields"),
    [
        ("hydrogen", "classic_small/hydrogen.vti", {}),
        (
            "carotid",
            "vector_fields/carotid.vtk",
            {"speed": "scalars", **{f"velocity_{a}": f"vectors_{a}" for a in "xyz"}},
        ),
    ],
)
def test_real_files(name, path, fields):
    expected = real_data.load(name)
    volume = vm.open(data_directory() / "data" / path, fields or None)
    assert volume.fields == expected.fields
    for field in volume.fields:
        np.testing.assert_array_equal(volume.array(field), expected.array(field))


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


def hdf_sample(path, **place):
    data = image(**place)
    add(data, "f", random_values("f4"))
    add(data, "v", random_values("f8", (*POINTS, 3)))
    add(data, "c", random_values("i2", CELLS), cells=True)
    data.GetPointData().SetActiveScalars("f")
    return write(vtkHDFWriter(), data, path)


def test_hdf5_places_and_values(tmp_path):
    path = hdf_sample(tmp_path / "a.vtkhdf", origin=(10, 20, 30), spacing=(1, 2, 3), low=(1, 0, 0))
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
        return lambda folder: hdf_sample(folder / "a.vtkhdf")


@pytest.mark.parametrize("wrong", ['NumberOfComponents="1000000000"', 'offset="-9"', ""])
def test_what_vtk_would_crash_on_is_refused(tmp_path, wrong):
    path, extent = tmp_path / "a.vti", "0 1 0 1 0 1"
    array = f'<DataArray Name="a" type="Float32" format="ascii" {wrong}>1 2 3</DataArray>'
    path.write_text(
        f'<VTKFile type="ImageData"><ImageData WholeExtent="{extent}"><Piece Extent="{extent}">'
        f"<PointData>{array}</PointData></Piece></ImageData></VTKFile>"
    )
    with pytest.raises(vm.FileFormatError, match=r"a\.vti"):
        vm.open(path)


def with_odd_number(way, word):
    """Return text of VTK in which one of the values at points is a word."""
    values = [f"{k}.5" for k in range(64)]
    values[10] = word
    others = " ".join(f"{k}.25" for k in range(64))
    if way == "xml":
        arrays = "".join(
            f'<DataArray type="Float64" Name="{name}" format="ascii">{text}</DataArray>'
            for name, text in (("a", " ".join(values)), ("b", others))
        )
        return (
            '<VTKFile type="ImageData" version="0.1"><ImageData WholeExtent="0 3 0 3 0 3" '
            'Origin="0 0 0" Spacing="1 1 1"><Piece Extent="0 3 0 3 0 3"><PointData>'
            f"{arrays}</PointData></Piece></ImageData></VTKFile>"
        )
    head = "# vtk DataFile Version 3.0\nt\nASCII\nDATASET "
    if way == "coordinates":
        lines = f"0 {word} 2 3", "0 1 2 3", "0 1 2 3"
        named = zip("XYZ", lines, strict=True)
        head += "RECTILINEAR_GRID\nDIMENSIONS 4 4 4\n"
        head += "".join(f"{axis}_COORDINATES 4 float\n{line}\n" for axis, line in named)
        values[10] = "10.5"
    else:
        head += "STRUCTURED_POINTS\nDIMENSIONS 4 4 4\nORIGIN 0 0 0\nSPACING 1 1 1\n"
    cells = "CELL_DATA 27\nSCALARS c double\nLOOKUP_TABLE default\n" + "1 " * 27 + "\n"
    if way == "scalars":
        start = "SCALARS a double\nLOOKUP_TABLE default\n"
        points = f"{start}{' '.join(values)}\nVECTORS b%20c double\n" + "1 2 3 " * 64
    else:
        points = f"FIELD f 2\na 1 64 double\n{' '.join(values)}\nb%20c 1 64 double\n{others}"
    return f"{head}POINT_DATA 64\n{points}\n{cells}"


@pytest.mark.parametrize("word", ["1.0-300", "-.5+100", "1.0D-300", "****", "1,5", "1.#QNAN"])
@pytest.mark.parametrize("way", ["scalars", "field", "coordinates", "xml"])
def test_numbers_that_vtk_does_not_read_are_refused(tmp_path, way, word):
    """VTK takes 1.0-300 for two numbers, and stops over what is left, in silence."""
    path = tmp_path / ("a.vti" if way == "xml" else "a.vtk")
    path.write_text(with_odd_number(way, word))
    with pytest.raises(vm.FileFormatError) as failure:
        vm.open(path)
    if word in ("1.0-300", "-.5+100"):
        assert f"{word} is no number" in str(failure.value)
    if way == "field":
        assert "did not read its arrays a, b c" in str(failure.value)


@pytest.mark.parametrize("word", ["nan", "NaN", "inf", ".5", "5.", "1e-300", "-1E+5"])
@pytest.mark.parametrize("way", ["scalars", "field", "xml"])
def test_all_spellings_of_numbers_are_read(tmp_path, way, word):
    path = tmp_path / ("a.vti" if way == "xml" else "a.vtk")
    path.write_text(with_odd_number(way, word))
    values = vm.open(path, "a").array("a").ravel("F")
    expected = 0.5 + np.arange(64)
    expected[10] = float(word)
    np.testing.assert_array_equal(values, expected)


def test_binary_arrays_that_vtk_loses_are_named(tmp_path):
    """A FIELD of which one array is shorter than announced ends VTK's reading without a word."""
    head = b"# vtk DataFile Version 3.0\nt\nBINARY\nDATASET STRUCTURED_POINTS\nDIMENSIONS 4 4 4\n"
    head += b"ORIGIN 0 0 0\nSPACING 1 1 1\nPOINT_DATA 64\nFIELD f 2\n"
    array = np.ones(64, ">f8").tobytes() + b"\n"
    whole = head + b"a 1 64 double\n" + array + b"b 1 64 double\n" + array
    path = tmp_path / "a.vtk"
    path.write_bytes(whole)
    assert vm.open(path).fields == ("a", "b")
    path.write_bytes(whole.replace(b"a 1 64 double\n", b"a 1 62 double\n"))
    with pytest.raises(vm.FileFormatError):
        vm.open(path)
