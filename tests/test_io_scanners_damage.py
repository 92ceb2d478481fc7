"""NRRD, NIfTI and MetaImage: damaged files, and such as were made to do harm."""

import bz2
import gzip
import io
import itertools
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import voluminous as vm
from contracts import ReaderContract
from scanner_files import (
    ORIGIN,
    SAGITTAL,
    UPRIGHT,
    VALUES,
    nrrd_text,
    tracemalloc_peak,
    volume_of,
    write_metaimage,
    write_nrrd,
)
from voluminous.io.scanners.stored import Inflated


def gzipped_nifti(path, content):
    path.write_bytes(gzip.compress(content))
    return path


@pytest.fixture
def nifti(tmp_path):
    volume_of(VALUES).save(tmp_path / "sound.nii")
    return (tmp_path / "sound.nii").read_bytes()


def test_streams_that_unpack_to_less_or_to_more(tmp_path, nifti):
    less = gzipped_nifti(tmp_path / "less.nii.gz", nifti[:-2])
    with pytest.raises(vm.FileFormatError, match="end after 238 bytes, expected 240"):
        vm.open(less)
    bomb = gzipped_nifti(tmp_path / "more.nii.gz", nifti + bytes(50_000_000))

    def opened():
        with pytest.warns(UserWarning, match="more than its header tells of"):
            np.testing.assert_array_equal(vm.open(bomb).array("more"), VALUES)

    assert tracemalloc_peak(opened) < 10_000_000


@pytest.mark.parametrize("packing", [bz2.compress, zlib.compress])
def test_packed_data_are_unpacked_no_further_than_needed(tmp_path, packing):
    data = packing(VALUES.tobytes("F") + bytes(50_000_000))
    if packing is zlib.compress:
        path = tmp_path / "a.mha"
        head = "NDims = 3\nDimSize = 4 5 6\nElementType = MET_SHORT\nCompressedData = True\n"
        path.write_bytes(f"{head}ElementDataFile = LOCAL\n".encode() + data)
    else:
        path = tmp_path / "a.nrrd"
        path.write_bytes(nrrd_text(encoding="bzip2").encode() + b"\n" + data)

    def opened():
        with pytest.warns(UserWarning, match="more than its header tells of"):
            np.testing.assert_array_equal(vm.open(path).array("a"), VALUES)

    # bzip2 works in blocks of 900 kB.
    assert tracemalloc_peak(opened) < 10_000_000


@given(data=st.binary(max_size=2000), sizes=st.lists(st.integers(1, 300), min_size=1))
def test_zlib_streams_are_read_piece_by_piece(data, sizes):

    stream = Inflated(io.BytesIO(zlib.compress(data)))
    pieces = []
    for size in itertools.cycle(sizes):
        piece = stream.read(size)
        assert len(piece) <= size
        if not piece:
            break
        pieces.append(piece)
    assert b"".join(pieces) == data


def changed(content, at, dtype, value):
    number = np.array(value, dtype).tobytes()
    return content[:at] + number + content[at + len(number) :]


@pytest.mark.parametrize(
    ("at", "dtype", "value", "told"),
    [
        (42, "<i2", -4, "positive whole numbers"),
        (42, "<i2", 0, "positive whole numbers"),
        (40, "<i2", 1, "must be from 2 to 7"),
        (42, "<i2", 30000, "cut short|end after"),
        (70, "<i2", 32, "datatype 32: expected real"),
        (108, "<f4", -8, "vox_offset"),
        (108, "<f4", np.nan, "vox_offset"),
        (280, "<f4", np.nan, "span space"),
        (0, "<i4", 347, "damaged"),
    ],
)
def test_nifti_heads_that_cannot_be(tmp_path, nifti, at, dtype, value, told):
    path = tmp_path / "bad.nii"
    path.write_bytes(changed(nifti, at, dtype, value))
    with pytest.raises(vm.FileFormatError, match=told):
        vm.open(path)
    with pytest.raises(vm.FileFormatError, match=told):
        vm.open(gzipped_nifti(tmp_path / "bad.nii.gz", path.read_bytes()[:400]))


def test_a_head_without_its_data(tmp_path, nifti):
    pair = changed(nifti, 344, "S4", b"ni1\0")
    (tmp_path / "a.hdr").write_bytes(pair[:348])
    with pytest.raises(vm.FileFormatError, match=r"\.img file, are missing"):
        vm.open(tmp_path / "a.hdr")


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("NRRD0004\n" + "# remark\n" * 1_000_000, "does not end"),
        (nrrd_text(sizes="4 5 -6") + "\n", "positive whole numbers"),
        (nrrd_text(sizes="4 5 99999999") + "\n", "cut short"),
        (nrrd_text(sizes="4000000000 4000000000 4000000000") + "\n", "more than any file holds"),
        (nrrd_text(dimension="4") + "\n", "there are 3 sizes"),
        (nrrd_text(type="block") + "\n", "type must be one of"),
        (nrrd_text(encoding="hex") + "\n", "encoding must be"),
        (nrrd_text(endian="middle") + "\n", "endian"),
        (nrrd_text(kinds="vector domain domain") + "\n", "three axes of space"),
        (nrrd_text(space_directions="(1,0,0) (0,1,0)") + "\n", "3 vectors"),
        (nrrd_text(space_directions="(1,0,0) (0,1) (0,0,1)") + "\n", "must be 3 numbers"),
        (nrrd_text() + "nonsense\n\n", "line 7"),
        (nrrd_text(), "empty line"),
        (nrrd_text(data_file="../other/a.raw"), "outside"),
        (nrrd_text(data_file="/etc/passwd"), "outside"),
        (nrrd_text(data_file="there_is_none.raw"), "no such file"),
        (nrrd_text(data_file="bad.nhdr"), "names itself"),
        (nrrd_text(data_file="s%d%d.raw 1 6 1"), "expected files of data"),
        (nrrd_text(data_file="s%d.raw 1 999999999 1"), "expected files of data"),
        (nrrd_text(data_file="s%999999d.raw 1 6 1"), "expected files of data"),
        (nrrd_text(data_file="LIST\n"), "names no file"),
        (nrrd_text(byte_skip=-7) + "\n", "cannot begin"),
        (nrrd_text(encoding="ascii") + "\n1 2 3 4", "cut short"),
    ],
)
def test_nrrd_heads_that_cannot_be(tmp_path, content, told):
    path = tmp_path / "inner" / "bad.nhdr"
    path.parent.mkdir()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "a.raw").write_bytes(VALUES.tobytes())
    path.write_text(content)
    with pytest.raises(vm.FileFormatError, match=told) as failure:
        vm.open(path)
    assert "bad.nhdr" in str(failure.value)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"ElementDataFile": "bad.mhd"}, "names itself"),
        ({"ElementDataFile": "LIST\nbad.mhd\nbad.mhd"}, "names itself"),
        ({"ElementDataFile": "../a.raw"}, "outside"),
        ({"ElementDataFile": "LIST\n../a.raw"}, "outside"),
        ({"ElementDataFile": "LIST\na.raw\na.raw\na.raw\na.raw\na.raw\na.raw\na.raw"}, "evenly"),
        ({"ElementDataFile": "LIST 1\na.raw"}, "files of slices"),
        ({"DimSize": "4 5"}, "NDims"),
        ({"DimSize": "4 5 0"}, "positive whole numbers"),
        ({"DimSize": "4 5 six"}, "whole numbers"),
        ({"DimSize": "4 5 700000"}, "cut short"),
        ({"ElementType": "MET_NONSENSE"}, "ElementType must be"),
        ({"ElementSpacing": "1 1"}, "must be 3 numbers"),
        ({"ElementSpacing": "1 1 0"}, "span space"),
        ({"ElementNumberOfChannels": "-1"}, "ElementNumberOfChannels"),
        ({"HeaderSize": "-5"}, "cannot begin"),
    ],
)
def test_metaimage_heads_that_cannot_be(tmp_path, changes, told):
    head = {"NDims": "3", "DimSize": "4 5 6", "ElementType": "MET_SHORT"}
    head |= {"ElementDataFile": "a.raw"} | changes
    head["ElementDataFile"] = head.pop("ElementDataFile")  # the last line
    directory = tmp_path / "inner"
    directory.mkdir()
    for place in (tmp_path, directory):
        (place / "a.raw").write_bytes(VALUES.tobytes())
    path = directory / "bad.mhd"
    path.write_text("".join(f"{key} = {value}\n" for key, value in head.items()))
    with pytest.raises(vm.FileFormatError, match=told) as failure:
        vm.open(path)
    assert "bad.mhd" in str(failure.value)


def test_a_larger_file_than_the_head_tells_of_gives_a_warning(tmp_path):
    write_metaimage(tmp_path / "a.mha", VALUES, ORIGIN, UPRIGHT)
    with open(tmp_path / "a.mha", "ab") as file:
        file.write(bytes(7))
    with pytest.warns(UserWarning, match="7 bytes more"):
        vm.open(tmp_path / "a.mha")


class TestNRRD(ReaderContract):
    @pytest.fixture
    def sample(self):
        def write(directory):
            volume_of(VALUES).save(directory / "density.nrrd")
            return directory / "density.nrrd"

        return write


class TestPackedNRRDWithVectors(ReaderContract):
    @pytest.fixture
    def sample(self):
        pytest.importorskip("nrrd")
        steps = np.vstack([np.full(3, np.nan), SAGITTAL])
        kinds = ["vector", "domain", "domain", "domain"]

        def write(directory):
            values = np.stack([VALUES, VALUES + 1, VALUES + 2]).astype(np.float32)
            return write_nrrd(directory / "v.nhdr", values, ORIGIN, steps, kinds=kinds)

        return write

    def victims(self, path):
        # A head that loses a line may still be one.
        return [path.with_suffix(".raw.gz")]


class TestNIfTI(ReaderContract):
    options = {"time": 1}  # noqa: RUF012

    @pytest.fixture(params=["nii", "nii.gz"])
    def sample(self, request):
        nib = pytest.importorskip("nibabel")

        def write(directory):
            values = np.stack([VALUES, VALUES + 1], axis=-1)
            nib.save(nib.Nifti1Image(values, np.eye(4)), directory / f"t1.{request.param}")
            return directory / f"t1.{request.param}"

        return write


class TestMetaImage(ReaderContract):
    @pytest.fixture
    def sample(self):
        return lambda directory: write_metaimage(directory / "a.mha", VALUES, ORIGIN, SAGITTAL)


class TestPackedMetaImage(ReaderContract):
    @pytest.fixture
    def sample(self):
        def write(directory):
            head = "ObjectType = Image\nNDims = 3\nDimSize = 4 5 6\nElementType = MET_SHORT\n"
            (directory / "a.zraw").write_bytes(zlib.compress(VALUES.tobytes("F")))
            (directory / "a.mhd").write_text(
                f"{head}CompressedData = True\nElementDataFile = a.zraw\n"
            )
            return directory / "a.mhd"

        return write

    def victims(self, path):
        return [path.with_suffix(".zraw")]


class TestITK(ReaderContract):
    @pytest.fixture
    def sample(self):
        itk = pytest.importorskip("SimpleITK")

        def write(directory):
            itk.WriteImage(itk.GetImageFromArray(VALUES.T), str(directory / "a.hdf5"))
            return directory / "a.hdf5"

        return write
