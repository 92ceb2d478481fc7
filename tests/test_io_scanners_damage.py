"""NRRD, NIfTI and MetaImage: damaged files, and such as were made to do harm."""

import gzip

import numpy as np
import pytest

import voluminous as vm
from contracts import ReaderContract
from scanner_files import (
    ORIGIN,
    SAGITTAL,
    VALUES,
    nrrd_text,
    tracemalloc_peak,
    volume_of,
    write_metaimage,
)


def gzipped_nifti(path, content):
    path.write_bytes(gzip.compress(content))
    return path


@pytest.fixture
def nifti(tmp_path):
    volume_of(VALUES).save(tmp_path / "sound.nii")
    return (tmp_path / "sound.nii").read_bytes()


def test_streams_that_unpack_to_less_or_to_more(tmp_path, nifti):
    less = gzipped_nifti(tmp_path / "less.nii.gz", nifti[:-2])
    with pytest.raises(vm.FileFormatError, match="Expected 240 bytes, got 238"):
        vm.open(less)
    bomb = gzipped_nifti(tmp_path / "more.nii.gz", nifti + bytes(50_000_000))

    def opened():
        np.testing.assert_array_equal(vm.open(bomb).array("more"), VALUES)

    assert tracemalloc_peak(opened) < 10_000_000


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (nrrd_text(sizes="4 5 -6") + "\n", "positive whole numbers"),
        (nrrd_text(sizes="4000000000 4000000000 4000000000") + "\n", "more than any file holds"),
        (nrrd_text(dimension="4") + "\n", "there are 3 sizes"),
        (nrrd_text(), "empty line"),
        (nrrd_text(data_file="../other/a.raw"), "outside"),
        (nrrd_text(data_file="there_is_none.raw"), "no such file"),
        (nrrd_text(data_file="bad.nhdr"), "names itself"),
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
        ({"ElementDataFile": "../a.raw"}, "outside"),
        ({"ElementDataFile": "LIST\na.raw\na.raw\na.raw\na.raw\na.raw\na.raw\na.raw"}, "evenly"),
        ({"DimSize": "4 5"}, "NDims"),
        ({"DimSize": "4 5 700000"}, "cut short"),
        ({"ElementSpacing": "1 1 0"}, "span space"),
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


class TestNRRD(ReaderContract):
    @pytest.fixture
    def sample(self):
        def write(directory):
            volume_of(VALUES).save(directory / "density.nrrd")
            return directory / "density.nrrd"

        return write


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
