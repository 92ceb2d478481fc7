"""Bare numbers, described by the file's name or by the user."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

import real_data
import voluminous as vm
from contracts import ReaderContract
from reference import data_directory
from voluminous.io.raw import described_by_name

SHAPE = (5, 4, 3)
# A value names its cell: x fastest in the file.
NUMBERS = np.arange(60).reshape(SHAPE[::-1])
CELLS = NUMBERS.T


def write(path, dtype="<u2", packed=False):
    content = NUMBERS.astype(dtype).tobytes()
    path.write_bytes(gzip.compress(content) if packed else content)
    return path


@pytest.mark.parametrize(
    ("name", "shape", "dtype", "rest"),
    [
        ("csafe_heptane_302x302x302_uint8", (302, 302, 302), "u1", "csafe_heptane"),
        ("cranium_ct_108x256x256_int16le", (108, 256, 256), "<i2", "cranium_ct"),
        ("pig-uint16be-512X512X134", (512, 512, 134), ">u2", "pig"),
        ("4x5x6", (4, 5, 6), None, ""),
        ("print_2x3", None, None, "print_2x3"),
        ("zero_0x4x4_uint8", None, "u1", "zero_0x4x4"),
        ("b_2x3x4x5_uint8", None, "u1", "b_2x3x4x5"),
    ],
)
def test_descriptions_in_names(name, shape, dtype, rest):
    assert described_by_name(name) == (shape, None if dtype is None else np.dtype(dtype), rest)


@pytest.mark.parametrize("packed", [False, True])
def test_shape_and_type_given(tmp_path, packed):
    for dtype in ("u1", "<i2", ">u2", "<f4", ">f8", "<i8"):
        path = write(tmp_path / ("a.raw.gz" if packed else "a.raw"), dtype, packed)
        volume = vm.open(path, shape=SHAPE, dtype=dtype, spacing=(1, 1, 2), unit="mm", name="ct")
        np.testing.assert_array_equal(volume.array("ct"), CELLS)
        assert volume.array("ct").dtype == np.dtype(dtype).newbyteorder("=")
        assert volume.grid.bounds.tolist() == [[0, 5], [0, 4], [0, 6]]
        assert volume.meta["shape_from"] == "the option shape"
        order = "big" if dtype.startswith(">") else "little"
        same = vm.open(path, shape=SHAPE, dtype=dtype.lstrip("<>"), byteorder=order)
        np.testing.assert_array_equal(same.array("a"), CELLS)


def test_axes_and_offset(tmp_path):
    path = tmp_path / "a.raw"
    path.write_bytes(b"header!" + np.ascontiguousarray(CELLS).astype("u1").tobytes())
    volume = vm.open(path, shape=SHAPE, dtype="uint8", axes="xyz", offset=7)
    np.testing.assert_array_equal(volume.array("a"), CELLS)
    with pytest.raises(vm.FileFormatError, match=r"take 60 bytes, but there are 67.*offset=7"):
        vm.open(path, shape=SHAPE, dtype="uint8")


def test_names_suffice(tmp_path):
    numbers = np.arange(64, dtype=">u2").reshape(4, 4, 4)
    (tmp_path / "cube_4x4x4_uint16be.dat").write_bytes(numbers.tobytes())
    volume = vm.open(tmp_path / "cube_4x4x4_uint16be.dat")
    np.testing.assert_array_equal(volume.array("cube"), numbers.T)
    assert volume.meta["shape_from"] == "the file's name"
    path = write(tmp_path / "box_5x4x3_uint16be.raw", ">u2")
    with pytest.raises(vm.InputError, match=r"shape=\(5, 4, 3\) or shape=\(3, 4, 5\)"):
        vm.open(path)  # x first or z first
    np.testing.assert_array_equal(vm.open(path, shape=SHAPE).array("box"), CELLS)
    write(tmp_path / "box.dat", ">u2")
    with pytest.raises(vm.FileFormatError, match="does not know"):
        vm.open(tmp_path / "box.dat")  # any file may be called so
    given = {"format": "raw", "shape": SHAPE, "dtype": ">u2"}
    assert vm.open(tmp_path / "box.dat", **given).fields == ("box",)


def test_errors_say_what_to_give(tmp_path):
    path = write(tmp_path / "a.raw")
    with pytest.raises(vm.InputError, match=r"shape and dtype; give shape=\(nx, ny, nz\).*axes="):
        vm.open(path)
    with pytest.raises(vm.InputError, match="gives their dtype"):
        vm.open(path, shape=SHAPE)
    (tmp_path / "a.mhd").touch()
    with pytest.raises(vm.InputError, match=r"open a\.mhd beside it"):
        vm.open(path)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"shape": (5, 4)}, "shape must be"),
        ({"shape": (5, 4, 0)}, "shape must be"),
        ({"shape": 60}, "shape must be"),
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
def test_wrong_options(tmp_path, options, message):
    with pytest.raises(vm.InputError, match=message):
        vm.open(write(tmp_path / "a.raw"), **{"shape": SHAPE, "dtype": "u2", **options})


def test_packed_files_hold_what_is_announced(tmp_path):
    path = tmp_path / "a_4x4x4_uint8.raw.gz"
    for content, message in (
        (bytes(63), "end after 63 bytes, expected 64"),
        (bytes(65), "holds more than 4 x 4 x 4"),
        (bytes(64 << 20), "holds more than"),
    ):
        path.write_bytes(gzip.compress(content))
        with pytest.raises(vm.FileFormatError, match=message):
            vm.open(path)
    with pytest.raises(vm.errors.MemoryNeededError):
        vm.open(path, shape=(10**5,) * 3, dtype="f8")


class TestRaw(ReaderContract):
    options = {"shape": SHAPE}  # noqa: RUF012

    @pytest.fixture(params=["a_5x4x3_int16.raw", "a_5x4x3_int16.raw.gz"])
    def sample(self, request):
        packed = request.param.endswith(".gz")
        return lambda directory: write(directory / request.param, "<i2", packed)


def test_a_head():
    truth = real_data.load("cranium")
    (path,) = (data_directory() / "data" / "medical").glob("cranium*.raw.gz")
    volume = vm.open(path, shape=(256, 256, 108))  # its name has z first
    np.testing.assert_array_equal(volume.array("cranium_ct"), truth.array("ct"))
