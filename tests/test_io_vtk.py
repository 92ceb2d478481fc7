"""VTK's files against VTK's own writers: values, places, names."""

import itertools

import numpy as np
import pytest

import real_data
import voluminous as vm
from reference import data_directory
from voluminous.io import find_reader

pytest.importorskip("vtkmodules", reason="VTK's own writers make the files")

from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkBitArray, vtkDataArray, vtkStringArray
from vtkmodules.vtkImagingCore import vtkRTAnalyticSource
from vtkmodules.vtkIOLegacy import (
    vtkRectilinearGridWriter,
    vtkStructuredGridWriter,
    vtkStructuredPointsWriter,
)
from vtkmodules.vtkIOParallelXML import vtkXMLPImageDataWriter
from vtkmodules.vtkIOXML import (
    vtkXMLImageDataWriter,
    vtkXMLRectilinearGridWriter,
    vtkXMLStructuredGridWriter,
)

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
    structured,
    write,
    write_image,
)

MODES = {"ascii": (0, False), "binary": (1, False), "raw": (2, False), "base64": (2, True)}
NONE, ZLIB, LZ4, LZMA = range(4)


def encodings():
    """Give all ways in which VTK writes XML: mode, compressor, byte order, type of lengths."""
    for case in itertools.product(MODES, (NONE, ZLIB, LZ4, LZMA), (0, 1), (32, 64)):
        if case[0] != "ascii" or case[1:] == (NONE, 1, 32):
            yield case


def encoded(mode, compressor, order, head):
    """Return the settings of a writer; lengths of blocks make several of each array."""
    if compressor == LZ4:
        pytest.importorskip("lz4", reason="the package that unpacks LZ4")
    return {
        "DataMode": MODES[mode][0],
        "EncodeAppendedData": MODES[mode][1],
        "CompressorType": compressor,
        "ByteOrder": order,
        "HeaderType": head,
        "BlockSize": 64,
    }


@pytest.mark.parametrize("case", list(encodings()), ids=str)
@pytest.mark.parametrize("kind", ["vti", "vtr"])
def test_all_encodings_of_xml(tmp_path, case, kind):
    data, writer = (
        (image(), None) if kind == "vti" else (rectilinear(), vtkXMLRectilinearGridWriter())
    )
    values = {name: random_values(name) for name in ("u1", "i2", "f4", "f8")}
    values["v"] = random_values("f4", (*POINTS, 3))
    for name, array in values.items():
        add(data, name, array)
    path = tmp_path / f"a.{kind}"
    settings = encoded(*case)
    write_image(data, path, **settings) if writer is None else write(writer, data, path, **settings)
    volume = vm.open(path)
    assert volume.fields == ("u1", "i2", "f4", "f8", "v_x", "v_y", "v_z")
    for name in ("u1", "i2", "f4", "f8"):
        assert volume.array(name).dtype == values[name].dtype
        # As text VTK writes as many digits as the type holds.
        np.testing.assert_array_equal(volume.array(name), values[name])
    for k, name in enumerate(("v_x", "v_y", "v_z")):
        np.testing.assert_array_equal(volume.array(name), values["v"][..., k])
    if kind == "vtr":
        np.testing.assert_array_equal(
            point_centers(volume).reshape(*POINTS, 3)[:, 0, 0, 0][1:-1], middle(LINES[0])
        )


def middle(line):
    """Return the centres of inner cells whose walls are midway between points."""
    walls = (np.array(line)[1:] + np.array(line)[:-1]) / 2
    return (walls[1:] + walls[:-1]) / 2


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("version", [42, 51])
@pytest.mark.parametrize(
    ("make", "writer"),
    [
        (image, vtkStructuredPointsWriter),
        (rectilinear, vtkRectilinearGridWriter),
        (structured, vtkStructuredGridWriter),
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


def test_structured_grids_in_xml(tmp_path):
    data, values = structured(), random_values("f4")
    add(data, "f", values)
    path = write(vtkXMLStructuredGridWriter(), data, tmp_path / "a.vts")
    np.testing.assert_array_equal(vm.open(path).array("f"), values)
    np.testing.assert_array_equal(vm.open(path).grid.edges[0], [-0.5, 0.5, 2, 3.25, 3.75])


# Places


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


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_directions_along_axes_are_undone(tmp_path, order):
    for signs in itertools.product((1, -1), repeat=3):
        data = image(origin=(1, 2, 3), spacing=(1, 2, 4), low=(2, 0, 1))
        matrix = np.zeros((3, 3))
        matrix[range(3), order] = signs
        data.SetDirectionMatrix(*matrix.ravel())
        add(data, "f", random_values("f4"))
        add(data, "c", random_values("f4", CELLS), cells=True)
        path = write_image(data, tmp_path / "a.vti")
        volume = vm.open(path, "f")
        there = {
            tuple(np.round(data.GetPoint(n), 9)): random_values("f4").T.reshape(-1)[n]
            for n in range(data.GetNumberOfPoints())
        }
        values = volume.array("f").reshape(-1)
        for place, value in zip(point_centers(volume), values, strict=True):
            assert there[tuple(np.round(place, 9))] == value
        np.testing.assert_allclose(vm.open(path, "c").grid.bounds.ravel(), data.GetBounds())


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


def test_axes_that_run_down_are_turned(tmp_path):
    lines = (LINES[0][::-1], LINES[1], LINES[2][::-1])
    data, values = rectilinear(lines), random_values("f4")
    add(data, "f", values)
    volume = vm.open(write(vtkXMLRectilinearGridWriter(), data, tmp_path / "a.vtr"))
    np.testing.assert_array_equal(volume.array("f"), values[::-1, :, ::-1])


@pytest.mark.parametrize("at", ["p", "c"])
def test_a_single_layer_is_a_layer_of_cells(tmp_path, at):
    data = image((4, 1, 3), spacing=(1, 3, 1))
    values = random_values("f4", (4, 1, 3) if at == "p" else (3, 1, 2))
    add(data, "f", values, cells=at == "c")
    volume = vm.open(write_image(data, tmp_path / "a.vti"))
    np.testing.assert_array_equal(volume.array("f"), values)
    assert volume.grid.bounds[1].tolist() == [-1.5, 1.5]
    data = rectilinear(([0, 1, 2, 3], [7], [0, 1, 2]))
    add(data, "f", values, cells=at == "c")
    volume = vm.open(write(vtkXMLRectilinearGridWriter(), data, tmp_path / "a.vtr"))
    assert volume.grid.bounds[1].tolist() == [6.5, 7.5]


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
    path.write_text(
        f'<VTKFile type="P{kind}"><P{kind} WholeExtent="0 8 0 6 0 5" GhostLevel="0" '
        f'Origin="1 2 3"><PPointData Scalars="f"/>{listed}</P{kind}></VTKFile>'
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


def test_pieces_by_the_parallel_writer(tmp_path):
    source, whole = vtkRTAnalyticSource(), vtkRTAnalyticSource()
    for one in (source, whole):
        one.SetWholeExtent(-5, 3, 0, 6, 2, 7)
    writer = vtkXMLPImageDataWriter()
    writer.SetInputConnection(source.GetOutputPort())
    writer.SetFileName(str(tmp_path / "a.pvti"))
    writer.SetNumberOfPieces(4)
    writer.SetEndPiece(3)
    assert writer.Write()
    whole.Update()
    volume = vm.open(tmp_path / "a.pvti")
    expected = vtk_to_numpy(whole.GetOutput().GetPointData().GetScalars()).reshape(6, 7, 9)
    np.testing.assert_array_equal(volume.array("RTData"), expected.T)
    assert volume.grid.bounds.tolist() == [[-5.5, 3.5], [-0.5, 6.5], [1.5, 7.5]]
    piece = next(tmp_path.glob("a*_1.vti"))
    assert vm.open(piece).grid.size < volume.grid.size


def test_several_pieces_in_one_file(tmp_path):
    data, values = image((9, 7, 6)), random_values("f4", (9, 7, 6))
    add(data, "f", values)
    path = write_image(data, tmp_path / "a.vti", NumberOfPieces=3)
    assert path.read_bytes().count(b"<Piece") == 3
    np.testing.assert_array_equal(vm.open(path).array("f"), values)


# Names, and what else is told


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


def test_names_of_components(tmp_path):
    data = image()
    vector = add(data, "gas velocity", random_values("f4", (*POINTS, 3)))
    labelled = add(data, "stress", random_values("f4", (*POINTS, 2)))
    for array, labels in ((vector, "XYZ"), (labelled, ("xx", "x y"))):
        for k, label in enumerate(labels):
            array.SetComponentName(k, label)
    add(data, "pair", random_values("f4", (*POINTS, 2)))
    add(data, "c", random_values("u1", (*POINTS, 4)))
    for path in (
        write_image(data, tmp_path / "a.vti"),
        write(vtkStructuredPointsWriter(), data, tmp_path / "a.vtk"),
    ):
        volume = vm.open(path)
        assert volume.fields == (
            *(f"gas_velocity_{end}" for end in "xyz"),
            *("stress_xx", "stress_x_y", "pair_0", "pair_1"),
            *("c_red", "c_green", "c_blue", "c_alpha"),
        )
        assert vm.open(path, "gas_velocity").fields == volume.fields[:3]
        assert vm.open(path, {"v": "point/gas velocity/y"}).fields == ("v",)
        np.testing.assert_array_equal(
            vm.open(path, "c_blue").array("c_blue"), random_values("u1", (*POINTS, 4))[..., 2]
        )


@pytest.mark.parametrize("binary", [False, True])
def test_units_time_and_texts(tmp_path, binary):
    data = image()
    array = add(data, "T", random_values("f4"))
    array.GetInformation().Set(vtkDataArray.UNITS_LABEL(), "km/s")
    data.GetPointData().SetActiveScalars("T")
    for name, values in (("TimeValue", [2.5]), ("cycle", [7]), ("box", [1, 2, 3])):
        told = numpy_to_vtk(np.array(values), deep=True)
        told.SetName(name)
        data.GetFieldData().AddArray(told)
    text = vtkStringArray()
    text.SetName("code name")
    text.InsertNextValue("MHD 3")
    text.InsertNextValue("x" * 100)
    data.GetFieldData().AddArray(text)
    bits = vtkBitArray()
    bits.SetName("bits")
    for n in range(np.prod(POINTS)):
        bits.InsertNextValue(n % 3 == 0)
    legacy = write(
        vtkStructuredPointsWriter(), with_array(data, bits), tmp_path / "a.vtk", FileType=1 + binary
    )
    expected = (np.arange(np.prod(POINTS)) % 3 == 0).reshape(POINTS[::-1]).T
    np.testing.assert_array_equal(vm.open(legacy).array("bits"), expected)
    data.GetPointData().RemoveArray("bits")
    for path in (write_image(data, tmp_path / "a.vti", DataMode=binary), legacy):
        volume = vm.open(path)
        assert volume.units["T"] == "km / s"
        assert find_reader(path).info(path)[0].unit == "km / s"
        assert volume.meta == {
            "time": 2.5,
            "cycle": 7,
            "box": [1, 2, 3],
            "code name": "MHD 3\n" + "x" * 100,
        }


def with_array(data, array):
    data.GetPointData().AddArray(array)
    return data


def test_hidden_points_are_missing_values(tmp_path):
    data, values = image(), random_values("f4")
    add(data, "f", values)
    add(data, "i", random_values("i2"))
    ghosts = np.zeros(POINTS, np.uint8)
    ghosts[1, 2, 3], ghosts[0, 0, 0] = 2, 1  # hidden; only a duplicate
    add(data, "vtkGhostType", ghosts)
    volume = vm.open(write_image(data, tmp_path / "a.vti"))
    assert volume.fields == ("f", "i")
    np.testing.assert_array_equal(volume.array("f"), np.where(ghosts == 2, np.nan, values))
    np.testing.assert_array_equal(volume.array("i"), random_values("i2"))


# What people and codes write themselves


def test_a_legacy_file_written_by_hand(tmp_path):
    path = tmp_path / "a.vtk"
    path.write_text(
        "# vtk DataFile Version 2.0\nPRIMITIVE vars at time= 1.5e-1, level= 0\nASCII\n"
        "dataset structured_points\n dimensions 2 1 2\nASPECT_RATIO 1 2 3\norigin 0 0 0\n\n"
        "POINT_DATA 4\nSCALARS density float\nLOOKUP_TABLE default\n1 2\n3\n 4\n"
        "COLOR_SCALARS tint 2\n0 1 0 1 0 1 0 1\n"
        "LOOKUP_TABLE mine 1\n0 0 0 1\nNORMALS n double\n" + "0 0 1 " * 4 + "\n"
        "TEXTURE_COORDINATES uv 2 float\n" + "0 1 " * 4 + "\n"
        "TENSORS t float\n" + "1 2 3 4 5 6 7 8 9\n" * 4 + "FIELD more 1\nextra%20one 1 4 int\n"
        "5 6 7 8"
    )
    volume = vm.open(path)
    assert volume.fields[:4] == ("density", "tint_0", "tint_1", "n_x")
    assert volume.array("density")[:, 0, :].tolist() == [[1, 3], [2, 4]]
    assert volume.array("extra_one")[:, 0, :].tolist() == [[5, 7], [6, 8]]
    assert volume.array("t_8").tolist() == np.full((2, 1, 2), 9).tolist()
    assert volume.grid.bounds.tolist() == [[-0.5, 1.5], [-1, 1], [-1.5, 4.5]]
    assert volume.meta["time"] == 0.15


BODIES = {
    "words on one line": "DATASET STRUCTURED_POINTS DIMENSIONS 2 2 2 ORIGIN 1 2 3 SPACING 1 2 4\n",
    "blank lines": "\n\nDATASET STRUCTURED_POINTS\n\nDIMENSIONS\n2 2\n\n2\nORIGIN 1\n2 3\n\n"
    "SPACING 1 2 4\n\n",
    "rectilinear": "DATASET RECTILINEAR_GRID DIMENSIONS 2 2 2\nX_COORDINATES 2 float 1\n2\n"
    "Y_COORDINATES\n2 float\n2 4 Z_COORDINATES 2 float\n\n3 7\n",
}


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("binary", [False, True])
def test_legacy_files_are_words_not_lines(tmp_path, body, binary):
    if binary and body == "rectilinear":
        pytest.skip("its coordinates are text")
    text = "# vtk DataFile Version 3.0\na title\n" + ("BINARY" if binary else "ASCII") + "\n"
    text += BODIES[body]

    def put(values, kind):
        data = np.array(values, ">f4" if kind == "float" else ">i4")
        if binary:
            return data.tobytes() + b"\n"
        return " ".join(map(str, data.tolist())).replace(" ", "\n", 2).encode() + b"\n\n"

    eight = list(range(1, 9))
    path = tmp_path / "a.vtk"
    path.write_bytes(
        text.encode()
        + b"POINT_DATA\n8 SCALARS rho float\nLOOKUP_TABLE default\n"
        + put(eight, "float")
        + b"\nFIELD more 2\nt 1 8 float\n"
        + put(eight[::-1], "float")
        + b"n 1 8 int\n"
        + put(eight, "int")
        + b"CELL_DATA 1\nSCALARS c float 1\nLOOKUP_TABLE default\n"
        + put([42], "float")
    )
    volume = vm.open(path)
    assert volume.fields == ("rho", "t", "n")
    for name, values in (("rho", eight), ("t", eight[::-1]), ("n", eight)):
        np.testing.assert_array_equal(volume.array(name).T.ravel(), values)
    assert volume.grid.bounds.tolist() == [[0.5, 2.5], [1, 5], [1, 9]]
    cells = vm.open(path, "c")
    assert cells.array("c").item() == 42
    assert cells.grid.bounds.tolist() == [[1, 2], [2, 4], [3, 7]]


# Real data


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
