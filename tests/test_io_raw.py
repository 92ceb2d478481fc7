"""Bare numbers: what they are is told by names, by files beside them, or by the user."""

from __future__ import annotations

import gzip
import json
import plistlib
import shutil

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import real_data
import voluminous as vm
from contracts import ReaderContract
from reference import data_directory
from voluminous.io.raw.order import is_turned
from voluminous.io.raw.told import told_by_name

SHAPE = (5, 4, 3)
# A value tells its cell: x fastest in the file.
NUMBERS = np.arange(60).reshape(SHAPE[::-1])
CELLS = NUMBERS.T


def write(path, dtype="<u2", packed=False):
    content = NUMBERS.astype(dtype).tobytes()
    path.write_bytes(gzip.compress(content) if packed else content)
    return path


@pytest.mark.parametrize(
    ("name", "shape", "dtype", "rest"),
    [
        ("bonsai_256x256x256_uint8", (256, 256, 256), "u1", "bonsai"),
        ("csafe_heptane_302x302x302_uint8", (302, 302, 302), "u1", "csafe_heptane"),
        ("magnetic_reconnection_512x512x512_float32", (512,) * 3, "<f4", "magnetic_reconnection"),
        ("cranium_ct_108x256x256_int16le", (108, 256, 256), "<i2", "cranium_ct"),
        ("pig-uint16be-512X512X134", (512, 512, 134), ">u2", "pig"),
        ("a_10x20x30_f64", (10, 20, 30), "<f8", "a"),
        ("4x5x6", (4, 5, 6), None, ""),
        ("scan_double", None, "<f8", "scan"),
        ("short_pipe_4x4x4", (4, 4, 4), None, "short_pipe"),
        ("print_2x3", None, None, "print_2x3"),
        ("zero_0x4x4_uint8", None, "u1", "zero"),
        ("b_2x3x4x5_uint8", None, "u1", "b_2x3x4x5"),
    ],
)
def test_what_names_tell(name, shape, dtype, rest):
    told, left = told_by_name(name)
    assert told.shape == shape
    assert told.dtype == (None if dtype is None else np.dtype(dtype))
    assert left == rest


@given(st.text(st.characters(max_codepoint=127), max_size=40))
def test_any_name_can_be_asked(name):
    told_by_name(name)


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("dtype", ["u1", "<i2", ">u2", "<f4", ">f8", "<i8"])
def test_shape_and_type_given(tmp_path, dtype, packed):
    path = write(tmp_path / ("a.raw.gz" if packed else "a.raw"), dtype, packed)
    volume = vm.open(path, shape=SHAPE, dtype=dtype, spacing=(1, 1, 2), unit="mm", name="ct")
    np.testing.assert_array_equal(volume.array("ct"), CELLS)
    assert volume.array("ct").dtype == np.dtype(dtype).newbyteorder("=")
    assert volume.grid.bounds.tolist() == [[0, 5], [0, 4], [0, 6]]
    assert volume.meta["shape_from"] == "the option shape"
    order = "big" if dtype.startswith(">") else "little"
    plain = dtype.lstrip("<>")
    same = vm.open(path, shape=SHAPE, dtype=plain, byteorder=order)
    np.testing.assert_array_equal(same.array("a"), CELLS)


def test_axes_and_offset(tmp_path):
    path = tmp_path / "a.raw"
    path.write_bytes(b"header!" + np.ascontiguousarray(CELLS).astype("u1").tobytes())
    volume = vm.open(path, shape=SHAPE, dtype="uint8", axes="xyz", offset=7)
    np.testing.assert_array_equal(volume.array("a"), CELLS)
    with pytest.raises(vm.FileFormatError, match=r"take 60 bytes, but there are 67.*offset=7"):
        vm.open(path, shape=SHAPE, dtype="uint8")


def test_a_cube_needs_no_more_than_its_name(tmp_path):
    numbers = np.arange(64, dtype=">u2").reshape(4, 4, 4)
    (tmp_path / "cube_4x4x4_uint16be.dat").write_bytes(numbers.tobytes())
    volume = vm.open(tmp_path / "cube_4x4x4_uint16be.dat")
    np.testing.assert_array_equal(volume.array("cube"), numbers.T)
    assert volume.meta["shape_from"] == "the file's name"
    (tmp_path / "cube.dat").write_bytes(numbers.tobytes())
    with pytest.raises(vm.FileFormatError, match="does not know"):
        vm.open(tmp_path / "cube.dat")  # any file may be called so
    given = {"format": "raw", "shape": (4, 4, 4), "dtype": ">u2"}
    assert vm.open(tmp_path / "cube.dat", **given).fields == ("cube",)


# The order of a shape


def smooth(shape, seed):
    """Return a field that changes slowly: a few waves in random directions."""
    rng = np.random.default_rng(seed)
    axes = np.meshgrid(*[np.arange(n) for n in shape], indexing="ij")
    waves = rng.normal(size=(3, 3)) * 0.3
    return sum(np.sin(sum(k * a for k, a in zip(w, axes, strict=True))) for w in waves)


@pytest.mark.parametrize("noise", [0.0, 0.5])
@pytest.mark.parametrize("seed", range(5))
def test_neighbours_tell_the_order(seed, noise):
    shape = (30, 20, 16)
    field = smooth(shape, seed) + noise * np.random.default_rng(seed).normal(size=shape)
    flat = field.T.reshape(-1)  # x fastest
    assert not is_turned(flat, shape)[0]
    assert is_turned(flat, shape[::-1])[0]


@pytest.mark.parametrize("values", [np.zeros(60), np.full(60, np.nan), np.arange(3.0)])
def test_what_does_not_tell_is_read_as_listed(values):
    turned, why = is_turned(values, SHAPE)
    assert not turned
    assert "nx x ny x nz" in why


@pytest.mark.parametrize("packed", [False, True])
def test_a_name_that_lists_z_first(tmp_path, packed):
    field = smooth((30, 20, 16), 1).astype("<f4")
    content = field.T.tobytes()
    for name in ("a_30x20x16_float32.raw", "a_16x20x30_float32.raw"):
        path = tmp_path / (name + ".gz" * packed)
        path.write_bytes(gzip.compress(content) if packed else content)
        volume = vm.open(path)
        np.testing.assert_array_equal(volume.array("a"), field)
        assert "neighbouring values differ by" in volume.meta["shape_from"]


# Files beside


def test_open_scivis(tmp_path):
    path = write(tmp_path / "a_3x4x5_uint16.raw")  # the wrong way round: the description counts
    told = {"name": "A", "type": "uint16", "size": SHAPE, "spacing": [1, 2, 3]}
    (tmp_path / "a_3x4x5_uint16.json").write_text(json.dumps(told))
    volume = vm.open(path)
    np.testing.assert_array_equal(volume.array("a"), CELLS)
    assert volume.grid.bounds.tolist() == [[0, 5], [0, 8], [0, 9]]
    assert volume.meta["shape_from"] == "a_3x4x5_uint16.json"
    assert vm.open(path, shape=(3, 4, 5)).grid.shape == (3, 4, 5)  # the user counts most


def vtkjs(**changes):
    data = {"dataType": "Uint16Array", "ref": {"encode": "BigEndian"}}
    return {
        "vtkClass": "vtkImageData",
        "origin": [10, 0, 0],
        "spacing": [2, 1, 1],
        "extent": [1, 5, 0, 3, 0, 2],
        "pointData": {"arrays": [{"data": data}]},
        **changes,
    }


def test_vtkjs(tmp_path):
    path = write(tmp_path / "a.raw", ">u2")
    (tmp_path / "a.index.json").write_text(json.dumps(vtkjs()))
    volume = vm.open(path)
    np.testing.assert_array_equal(volume.array("a"), CELLS)
    # Points are the centres of cells: the first of this extent is at 10 + 1 · 2.
    assert volume.grid.bounds.tolist() == [[11, 21], [-0.5, 3.5], [-0.5, 2.5]]


def test_the_axes_of_vtkjs_are_undone_if_they_can_be(tmp_path):
    path = write(tmp_path / "a.raw", ">u2")
    # Column by column: the first axis runs along y, the second against x.
    turned = vtkjs(direction=[0, 1, 0, -1, 0, 0, 0, 0, 1])
    (tmp_path / "a.index.json").write_text(json.dumps(turned))
    volume = vm.open(path)
    assert "direction" not in volume.meta
    np.testing.assert_array_equal(volume.array("a"), CELLS.transpose(1, 0, 2)[::-1])
    # Point (1, 0, 0) is at (10, 0, 0) + 2 (0, 1, 0), and the second axis goes down to x = 7.
    assert volume.grid.bounds.tolist() == [[6.5, 10.5], [1, 11], [-0.5, 2.5]]


@pytest.mark.parametrize("suffix", [".vti", ".nrrd", ".mha", ".h5"])
def test_oblique_numbers_are_turned_alike_in_all_formats(tmp_path, suffix):
    path = write(tmp_path / "a.raw", ">u2")
    angle = np.radians(30)
    matrix = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    turned = vtkjs(direction=matrix.T.reshape(-1).tolist())
    (tmp_path / "a.index.json").write_text(json.dumps(turned))
    volume = vm.open(path)
    np.testing.assert_allclose(volume.meta["direction"], matrix)
    # The middle point of the array is the centre of the turned cells.
    middle = [10, 0, 0] + matrix @ [3 * 2, 1.5, 1]
    np.testing.assert_allclose(volume.grid.bounds.mean(axis=1), middle)
    vm.io.save(volume, tmp_path / f"b{suffix}")
    again = vm.open(tmp_path / f"b{suffix}")
    np.testing.assert_allclose(again.meta["direction"], matrix, atol=1e-12)
    np.testing.assert_allclose(again.grid.bounds, volume.grid.bounds)
    np.testing.assert_array_equal(again.array(again.fields[0]), volume.array("a"))


@pytest.mark.parametrize("name", ["a.json", "a.index.json", "a.plist"])
def test_what_describes_numbers_opens_them(tmp_path, name):
    told = {
        "a.json": json.dumps({"type": ">u2", "size": SHAPE}).encode(),
        "a.index.json": json.dumps(vtkjs()).encode(),
        "a.plist": plistlib.dumps(
            {"matrix": {"shape": SHAPE[::-1], "dtype": "uint16"}, "spacing": [1, 1, 2]}
        ),
    }
    (tmp_path / name).write_bytes(told[name])
    with pytest.raises(vm.InputError, match=r"no file beside it with them: expected a\.raw"):
        vm.open(tmp_path / name)
    path = write(tmp_path / "a_5x4x3.raw.gz", "<u2" if name == "a.plist" else ">u2", packed=True)
    assert vm.open(tmp_path / name).fields == ("a",)
    np.testing.assert_array_equal(vm.open(tmp_path / name).array("a"), vm.open(path).array("a"))
    write(tmp_path / "a.raw")
    with pytest.raises(vm.InputError, match=r"open a\.raw, a_5x4x3\.raw\.gz"):
        vm.open(tmp_path / name)


def test_other_descriptions_are_none_of_ours(tmp_path):
    write(tmp_path / "a.raw")
    for name, text in {"a.json": '{"some": "notes"}', "a.plist": "<plist", "b.json": "{"}.items():
        (tmp_path / name).write_text(text)
        with pytest.raises(vm.FileFormatError, match="does not know"):
            vm.open(tmp_path / name)


def test_invesalius(tmp_path):
    path = write(tmp_path / "a.raw", "<i2")
    told = {"matrix": {"shape": SHAPE[::-1], "dtype": "int16"}, "spacing": [0.5, 0.5, 2.0]}
    (tmp_path / "a.plist").write_bytes(plistlib.dumps(told))
    volume = vm.open(path)
    np.testing.assert_array_equal(volume.array("a"), CELLS)
    np.testing.assert_allclose(volume.grid.bounds, [[0, 2.5], [0, 2], [0, 6]])
    assert str(volume.unit) == "mm"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.json", "{"),
        ("a.json", '{"type": "uint16", "size": [1, 2]}'),
        ("a.json", '{"type": "string", "size": [5, 4, 3]}'),
        ("a.json", '{"type": "uint16", "size": [5, 4, -3]}'),
        ("a.json", json.dumps(vtkjs(spacing=[1, 2]))),
        ("a.json", json.dumps(vtkjs(pointData={}))),
        ("a.plist", "<plist"),
        ("a.plist", "<?xml version='1.0'?><plist><dict><key>matrix</key></dict></plist>"),
    ],
)
def test_descriptions_that_cannot_be_used(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    with pytest.raises(vm.FileFormatError, match=rf"{name} beside it is not as expected.*shape="):
        vm.open(write(tmp_path / "a.raw"))


def test_a_description_that_does_not_fit(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps({"type": "uint8", "size": SHAPE}))
    with pytest.raises(vm.FileFormatError, match=r"5 x 4 x 3 values of uint8 \(from a\.json\)"):
        vm.open(write(tmp_path / "a.raw"))
    (tmp_path / "a.json").write_text(json.dumps({"some": "notes"}))  # not about this file
    with pytest.raises(vm.InputError, match="nothing tells"):
        vm.open(tmp_path / "a.raw")


# What is wrong


def test_what_to_give_is_said(tmp_path):
    (tmp_path / "a.raw").write_bytes(bytes(64**3))
    expected = r"shape and dtype; give shape=.*64 x 64 x 64 of uint8, or 32 x 32 x 32 of float64"
    with pytest.raises(vm.InputError, match=expected):
        vm.open(tmp_path / "a.raw")
    with pytest.raises(vm.InputError, match=r"tells their dtype.*could be uint8"):
        vm.open(tmp_path / "a.raw", shape=(64, 64, 64))
    with pytest.raises(vm.InputError, match=r"could be no cube of any type"):
        vm.open(write(tmp_path / "b.raw"))
    (tmp_path / "b.mhd").touch()
    with pytest.raises(vm.InputError, match=r"open b\.mhd beside it"):
        vm.open(tmp_path / "b.raw")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"shape": (5, 4)}, "shape must be"),
        ({"shape": (5, 4, 0)}, "shape must be"),
        ({"shape": 60}, "shape must be"),
        ({"shape": (2**40,) * 3}, "shape must be"),
        ({"shape": (2**20,) * 3}, "cut short by"),
        ({"dtype": "uint17"}, "dtype must be a type such as"),
        ({"dtype": "complex64"}, "dtype must be a type of real numbers"),
        ({"byteorder": "middle"}, "byteorder must be 'little' or 'big'"),
        ({"offset": -1}, "offset must be a number of bytes"),
        ({"axes": "abc"}, "axes must be x, y and z"),
        ({"bounds": (0, 1), "spacing": 1}, "bounds or spacing, not both"),
        ({"spacing": 0}, "spacing must be a positive number"),
    ],
)
def test_options_that_cannot_be(tmp_path, options, message):
    with pytest.raises(vm.InputError, match=message):
        vm.open(write(tmp_path / "a.raw"), **{"shape": SHAPE, "dtype": "u2", **options})


@pytest.mark.parametrize("change", [-1, 1])
def test_packed_files_hold_what_is_announced(tmp_path, change):
    content = NUMBERS.astype("u1").tobytes()
    content = content[:-1] if change < 0 else content + b"."
    (tmp_path / "a_5x4x3_uint8.raw.gz").write_bytes(gzip.compress(content))
    message = "end after 59 bytes, expected 60" if change < 0 else "holds more than 5 x 4 x 3"
    with pytest.raises(vm.FileFormatError, match=message):
        vm.open(tmp_path / "a_5x4x3_uint8.raw.gz", shape=SHAPE)


def test_packed_bombs_unpack_to_what_was_announced(tmp_path):
    (tmp_path / "a_4x4x4_uint8.raw.gz").write_bytes(gzip.compress(bytes(64 << 20)))
    with pytest.raises(vm.FileFormatError, match="holds more than"):
        vm.open(tmp_path / "a_4x4x4_uint8.raw.gz")
    (tmp_path / "b.raw.gz").write_bytes(gzip.compress(bytes(64)))
    with pytest.raises(vm.MemoryNeededError):
        vm.open(tmp_path / "b.raw.gz", shape=(10**5,) * 3, dtype="f8")


class TestRaw(ReaderContract):
    @pytest.fixture(params=["a_5x4x3_int16.raw", "a_5x4x3_int16.raw.gz"])
    def sample(self, request):
        packed = request.param.endswith(".gz")
        return lambda directory: write(directory / request.param, "<i2", packed)


class TestDescription(ReaderContract):
    @pytest.fixture
    def sample(self):
        def write_both(directory):
            write(directory / "a.raw", ">u2")
            (directory / "a.index.json").write_text(json.dumps(vtkjs()))
            return directory / "a.index.json"

        return write_both


# Real data


@pytest.mark.parametrize("name", ["cranium", "headsq"])
@pytest.mark.parametrize("described", [True, False], ids=["beside", "by name"])
def test_heads(tmp_path, name, described):
    truth = real_data.load(name)
    directory = data_directory() / "data" / "medical"
    (path,) = directory.glob(f"{name}*.raw.gz")
    if not described:  # the order of the shape is told by the values
        path = shutil.copy(path, tmp_path)
    volume = vm.open(path)
    (field,) = volume.fields
    assert volume.array(field).dtype == np.int16
    np.testing.assert_array_equal(volume.array(field), truth.array("ct"))
    if described and name == "cranium":
        # The description has 0.95703 mm where PROVENANCE.md rounds to 0.957.
        np.testing.assert_allclose(volume.grid.bounds, truth.grid.bounds, rtol=1e-4)
        assert volume.unit == truth.unit
