"""DICOM: series in any order, their values, and what makes no volume."""

import numpy as np
import pytest

import voluminous as vm
from contracts import ReaderContract
from scanner_files import (
    ORIGIN,
    UPRIGHT,
    VALUES,
    WIDTHS,
    check_places,
    dicom_slice,
    write_dicom,
)


@pytest.fixture
def pydicom():
    return pytest.importorskip("pydicom")


def series(directory, values=VALUES, steps=UPRIGHT, **changes):
    return write_dicom(directory / "series", values, ORIGIN, steps, **changes)


def test_dicom_values_are_rescaled_and_stay_integers(tmp_path, pydicom):
    stored = np.abs(VALUES).astype(np.uint16)
    path = series(
        tmp_path,
        stored,
        BitsStored=12,
        HighBit=11,
        RescaleSlope=1,
        RescaleIntercept=-1024,
        RescaleType="HU",
        SeriesDescription="thorax",
    )
    volume = vm.open(path)
    assert volume.fields == ("ct",)
    assert volume.array("ct").dtype == np.int16
    np.testing.assert_array_equal(volume.array("ct"), stored.astype(int) - 1024)
    told = {"modality": "CT", "series": "thorax", "rescale_type": "HU", "orientation": "LPS"}
    assert volume.meta == told


@pytest.mark.parametrize(
    ("bits", "signed", "slope", "intercept", "dtype"),
    [
        (8, False, 1, 0, np.uint8),
        (16, True, 1, 0, np.int16),
        (16, True, 1, -1024, np.int32),
        (16, False, 1, 0, np.uint16),
        (12, False, 2, -1000, np.int16),
        (16, False, 0.5, 0, np.float32),
    ],
)
def test_dicom_types_hold_all_values(tmp_path, pydicom, bits, signed, slope, intercept, dtype):
    stored = np.dtype(f"{'i' if signed else 'u'}{2 if bits > 8 else 1}")
    ends = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if signed else (0, 2**bits - 1)
    values = np.array(ends, stored).repeat(60).reshape(4, 5, 6)
    path = series(
        tmp_path,
        values,
        BitsStored=bits,
        HighBit=bits - 1,
        RescaleSlope=slope,
        RescaleIntercept=intercept,
    )
    got = vm.open(path).array("ct")
    assert got.dtype == dtype
    np.testing.assert_array_equal(got, values * float(slope) + intercept)


def test_bits_beside_the_value_are_left_out(tmp_path, pydicom, monkeypatch):
    clean = np.abs(VALUES).astype(np.uint16)
    path = series(tmp_path, clean | 0x8000, BitsStored=12, HighBit=11)
    monkeypatch.chdir(path)
    for directory in (path, "."):
        np.testing.assert_array_equal(vm.open(directory).array("ct"), clean)
    negative = np.where(VALUES < 0, VALUES.astype(np.uint16) & 0x0FFF, VALUES.astype(np.uint16))
    path = series(tmp_path, negative, BitsStored=12, HighBit=11, PixelRepresentation=1)
    expected = np.where(VALUES >= 2048, VALUES - 4096, VALUES)
    np.testing.assert_array_equal(vm.open(path).array("ct"), expected)


def test_missing_and_irregular_slices(tmp_path, pydicom):
    path = series(tmp_path)
    (path / "IM06").unlink()  # k = 2
    with pytest.warns(UserWarning, match="behind slice 2 of 5: slices seem to be missing"):
        volume = vm.open(path)
    z = ORIGIN[2] + 2.0 * np.array([0, 1, 3, 4, 5])
    edges = [z[0] - 1, *(z[1:] + z[:-1]) / 2, z[-1] + 1]
    np.testing.assert_allclose(volume.grid.edges[2], edges)
    np.testing.assert_array_equal(volume.array("ct"), np.delete(VALUES, 2, axis=2))


def test_time_steps_at_each_place(tmp_path, pydicom):
    path = series(tmp_path)
    for k in range(6):
        later = dicom_slice(VALUES[:, :, k] + 1, ORIGIN + k * UPRIGHT[2], UPRIGHT)
        later.InstanceNumber = 100 + k
        later.save_as(path / f"later{k}", enforce_file_format=True)
    volume = vm.open(path)
    np.testing.assert_array_equal(volume.array("ct"), VALUES)
    assert volume.meta["times"] == 2
    np.testing.assert_array_equal(vm.open(path, time=1).array("ct"), VALUES + 1)
    (path / "later3").unlink()
    with pytest.raises(vm.FileFormatError, match="as many slices at every place, got 1 to 2"):
        vm.open(path)


def disc(directory, **series):
    """Write an export: its table of contents, and slices in directories below; return the table."""
    from pydicom.fileset import FileSet

    files = FileSet()
    for number, (text, values) in enumerate(series.items(), start=1):
        for k in range(values.shape[2]):
            head = dicom_slice(values[:, :, k], ORIGIN + k * UPRIGHT[2], UPRIGHT, f"1.2.{number}")
            head.PatientID, head.PatientName, head.StudyInstanceUID = "A", "B", "1.2.3"
            head.SeriesNumber, head.SeriesDescription = number, text
            head.InstanceNumber, head.StudyID = k + 1, "C"
            head.StudyDate, head.StudyTime = "20200101", "120000"
            files.add(head)
    files.write(directory)
    return directory / "DICOMDIR"


def test_tables_of_contents(tmp_path, pydicom):
    path = disc(tmp_path, axial=VALUES)
    assert not list(tmp_path.glob("IM*"))  # the slices lie in directories of their own
    for given in (path, tmp_path):
        volume = vm.open(given)
        np.testing.assert_array_equal(volume.array("ct"), VALUES)
        check_places(volume, VALUES, ORIGIN, UPRIGHT)
    for file in [*tmp_path.rglob("IM*")]:
        file.rename(file.with_name(file.name.lower()))
    with pytest.raises(vm.InputError, match="names no image that is there"):
        vm.open(path)


def test_doses_have_offsets_of_frames(tmp_path, pydicom):
    head = dicom_slice(VALUES[:, :, 0].astype(np.uint16), ORIGIN, UPRIGHT)
    stored = np.abs(VALUES).astype(np.uint16)
    head.NumberOfFrames, head.Modality = 6, "RTDOSE"
    head.GridFrameOffsetVector = [0, -2, -4, -6, -8, -10]
    head.DoseGridScaling, head.DoseUnits = "0.001", "GY"
    head.PixelData = stored.transpose(2, 1, 0).tobytes()
    head.save_as(tmp_path / "dose.dcm", enforce_file_format=True)
    volume = vm.open(tmp_path / "dose.dcm")
    assert volume.units["rtdose"] in ("Gy", "J / kg")  # astropy 6 does not know the gray
    down = np.diag(WIDTHS * [1, 1, -1])
    check_places(volume, (stored * 0.001).astype(np.float32), ORIGIN, down)


class TestDICOMSeries(ReaderContract):
    @pytest.fixture
    def sample(self):
        pytest.importorskip("pydicom")
        # Named like what they are: a file that is none of its kind is an error then.
        return lambda directory: write_dicom(directory / "s", VALUES, ORIGIN, UPRIGHT) / "IM03"
