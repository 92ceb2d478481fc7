"""DICOM: series in any order, their values, and what makes no volume."""

import contextlib
import gzip
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest

import voluminous as vm
from contracts import ReaderContract
from scanner_files import (
    ORIGIN,
    SAGITTAL,
    UPRIGHT,
    VALUES,
    WIDTHS,
    centers,
    check_places,
    dicom_frames,
    dicom_slice,
    tracemalloc_peak,
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


def test_bits_beside_the_value_are_left_out(tmp_path, pydicom):
    clean = np.abs(VALUES).astype(np.uint16)
    path = series(tmp_path, clean | 0x8000, BitsStored=12, HighBit=11)
    np.testing.assert_array_equal(vm.open(path).array("ct"), clean)
    negative = np.where(VALUES < 0, VALUES.astype(np.uint16) & 0x0FFF, VALUES.astype(np.uint16))
    path = series(tmp_path, negative, BitsStored=12, HighBit=11, PixelRepresentation=1)
    expected = np.where(VALUES >= 2048, VALUES - 4096, VALUES)
    np.testing.assert_array_equal(vm.open(path).array("ct"), expected)


def test_slopes_may_differ_from_slice_to_slice(tmp_path, pydicom):
    path = series(tmp_path, Modality="PT", Units="BQML")
    for k, file in enumerate(sorted(path.iterdir())):
        head = pydicom.dcmread(file)
        head.RescaleSlope, head.RescaleIntercept = 0.5 + k, 0
        head.save_as(file)
    slopes = {file.name: 0.5 + k for k, file in enumerate(sorted(path.iterdir()))}
    volume = vm.open(path)
    for k in range(6):
        factor = slopes[f"IM{3 * k % 11:02d}"]
        np.testing.assert_array_equal(volume.array("pt")[:, :, k], factor * VALUES[:, :, k])
    assert volume.units["pt"] == "Bq / ml"


def test_missing_and_irregular_slices(tmp_path, pydicom):
    path = series(tmp_path)
    (path / "IM06").unlink()  # k = 2
    with pytest.warns(UserWarning, match="behind slice 2 of 5: slices seem to be missing"):
        volume = vm.open(path)
    z = ORIGIN[2] + 2.0 * np.array([0, 1, 3, 4, 5])
    edges = [z[0] - 1, *(z[1:] + z[:-1]) / 2, z[-1] + 1]
    np.testing.assert_allclose(volume.grid.edges[2], edges)
    np.testing.assert_array_equal(volume.array("ct"), np.delete(VALUES, 2, axis=2))


def test_positions_that_were_rounded_are_equally_spaced(tmp_path, pydicom):
    path = tmp_path / "series"
    path.mkdir()
    for k in range(6):
        place = ORIGIN + np.array([0, 0, round(k * 1.25, 1)])
        dicom_slice(VALUES[:, :, k], place, UPRIGHT).save_as(
            path / f"{k}", enforce_file_format=True
        )
    # A tenth in 1.25 is more than rounding may do; a hundredth is not.
    with pytest.warns(UserWarning, match="apart"):
        assert not vm.open(path).grid.is_uniform
    for k in range(6):
        head = pydicom.dcmread(path / f"{k}")
        head.ImagePositionPatient = [-10, 20, f"{30 + k * 1.255:.2f}"]
        head.save_as(path / f"{k}")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert vm.open(path).grid.is_uniform


def test_several_series_are_listed(tmp_path, pydicom):
    path = series(tmp_path, SeriesNumber=3, SeriesDescription="axial")
    other = dicom_slice(VALUES[:, :, 0], ORIGIN, UPRIGHT, series="1.2.9")
    other.SeriesNumber, other.SeriesDescription = 1, "scout"
    other.save_as(path / "scout.dcm", enforce_file_format=True)
    with pytest.raises(vm.InputError, match="series='3': 'axial', CT, 6 files") as failure:
        vm.open(path)
    assert "series='1': 'scout', CT, 1 files, 1.2.9" in str(failure.value)
    for chosen in (3, "3", "axial", "1.2.3.4"):
        np.testing.assert_array_equal(vm.open(path, series=chosen).array("ct"), VALUES)
    np.testing.assert_array_equal(vm.open(path / "IM03").array("ct"), VALUES)
    with pytest.raises(vm.InputError, match="0 series 7"):
        vm.open(path, series=7)
    with pytest.raises(vm.InputError, match="directory only"):
        vm.open(path / "IM03", series=3)


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


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"Columns": 3, "PixelData": bytes(30)}, "IM03 has Columns 3, but IM00 has 4"),
        ({"ImageOrientationPatient": [0, 1, 0, 0, 0, 1]}, "not parallel"),
        ({"ImageOrientationPatient": [0, 1, 0, 0, 1, 1]}, "unit vectors"),
        ({"PixelData": bytes(20)}, "IM03"),
    ],
)
def test_slices_that_make_no_volume(tmp_path, pydicom, changes, told):
    path = series(tmp_path)
    head = pydicom.dcmread(path / "IM03")
    for keyword, value in changes.items():
        setattr(head, keyword, value)
    head.save_as(path / "IM03")
    with pytest.raises(vm.FileFormatError, match=told):
        vm.open(path)


def test_colors_are_refused(tmp_path, pydicom):
    path = series(tmp_path)
    for file in path.iterdir():
        head = pydicom.dcmread(file)
        head.SamplesPerPixel = 3
        head.save_as(file)
    with pytest.raises(vm.FileFormatError, match="coloured"):
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
    with pytest.raises(vm.InputError, match="no such file"):
        vm.open(path)


def test_several_series_in_a_table_of_contents(tmp_path, pydicom):
    path = disc(tmp_path, axial=VALUES, late=VALUES + 1)
    with pytest.raises(vm.InputError, match=r"several series; choose(.|\n)*series='2': 'late', CT"):
        vm.open(path)
    for chosen in (2, "late"):
        np.testing.assert_array_equal(vm.open(path, series=chosen).array("ct"), VALUES + 1)


def test_tables_of_contents_in_other_letters(tmp_path, pydicom):
    path = disc(tmp_path, axial=VALUES)
    for file in sorted(tmp_path.rglob("*"), key=lambda f: -len(f.parts)):
        if file != path:
            file.rename(file.with_name(file.name.lower()))
    np.testing.assert_array_equal(vm.open(path).array("ct"), VALUES)


@pytest.mark.parametrize(
    ("names", "told"),
    [(["..", "x"], "outside of its directory"), (["GONE"], "no such file"), (None, "of 0 images")],
)
def test_tables_of_contents_that_lead_nowhere(tmp_path, pydicom, names, told):
    path = disc(tmp_path, axial=VALUES)
    head = pydicom.dcmread(path)
    for record in head.DirectoryRecordSequence:
        if "ReferencedFileID" in record:
            record.ReferencedFileID = names
    head.save_as(path)
    with pytest.raises(vm.InputError, match=told):
        vm.open(path)


def test_packed_pixels(tmp_path, pydicom):
    path = series(tmp_path)
    for file in path.iterdir():
        head = pydicom.dcmread(file)
        head.compress(pydicom.uid.RLELossless)
        head.save_as(file)
    np.testing.assert_array_equal(vm.open(path).array("ct"), VALUES)


def test_a_missing_decoder_is_named(tmp_path, pydicom, monkeypatch):
    path = series(tmp_path)
    for file in path.iterdir():
        head = pydicom.dcmread(file)
        head.file_meta.TransferSyntaxUID = pydicom.uid.HTJ2KLossless
        head.PixelData = pydicom.encaps.encapsulate([bytes(100)])
        head["PixelData"].is_undefined_length = True
        head.save_as(file)
    decoder = pydicom.pixels.get_decoder(pydicom.uid.HTJ2KLossless)
    monkeypatch.setattr(decoder, "_available", {})
    with pytest.raises(vm.errors.MissingPackageError, match=r"High-Throughput.*pylibjpeg"):
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


def test_slices_without_a_place_go_by_their_numbers(tmp_path, pydicom):
    path = series(tmp_path)
    for k in range(6):
        head = pydicom.dcmread(path / f"IM{3 * k % 11:02d}")
        del head.ImagePositionPatient
        head.InstanceNumber = k
        head.save_as(path / f"IM{3 * k % 11:02d}")
    volume = vm.open(path)
    np.testing.assert_array_equal(volume.array("ct"), VALUES)
    assert "orientation" not in volume.meta
    np.testing.assert_array_equal(volume.grid.bounds[:, 0], -WIDTHS / 2)


@pytest.mark.parametrize("kind", ["implicit", "explicit", "big"])
@pytest.mark.parametrize("preamble", [True, False])
def test_files_without_group_2(tmp_path, pydicom, kind, preamble):
    path = series(tmp_path)
    for file in path.iterdir():
        head = pydicom.dcmread(file)
        for keyword in ("StudyDate", "InstitutionName", "ReferencedImageSequence"):
            setattr(head, keyword, [] if "Seq" in keyword else None)
        if kind == "big":
            head.PixelData = np.frombuffer(head.PixelData, "<i2").astype(">i2").tobytes()
        bare = pydicom.Dataset()
        bare.update(head)
        with open(file, "wb") as stream:
            stream.write(bytes(128) + b"DICM" if preamble else b"")
            implicit, little = kind == "implicit", kind != "big"
            pydicom.dcmwrite(stream, bare, implicit_vr=implicit, little_endian=little)
    for opened in (path, path / "IM03"):
        volume = vm.open(opened)
        assert volume.meta["orientation"] == "LPS"
        check_places(volume, VALUES, ORIGIN, UPRIGHT)


def csa_header(**tags):
    """Return Siemens's private header, of the second kind."""
    parts = [b"SV10\4\3\2\1", struct.pack("<2I", len(tags), 77)]
    for name, values in tags.items():
        vr = b"IS" if isinstance(values[0], int) else b"FD"
        parts.append(struct.pack("<64si4s3i", name.encode(), len(values), vr, 6, len(values), 77))
        for value in values:
            text = str(value).encode() + b"\0"
            parts += [struct.pack("<4i", len(text), len(text), 77, len(text))]
            parts += [text.ljust(-(-len(text) // 4) * 4, b"\0")]
    return b"".join(parts)


def write_mosaic(path, values, origin, steps, sign=1.0):
    """Tiles of a picture, the first slice at `origin`; row by row, empty ones at the end."""
    columns, rows, count = values.shape
    side = int(np.ceil(np.sqrt(count)))
    picture = np.zeros((side * rows, side * columns), values.dtype)
    for k in range(count):
        down, across = divmod(k, side)
        tile = (slice(down * rows, (down + 1) * rows), slice(across * columns, None))
        picture[tile][:, :columns] = values[:, :, k].T
    steps = np.asarray(steps)
    # The position in the head is that of a single slice as large as the mosaic.
    moved = (side - 1) * (columns * steps[0] + rows * steps[1]) / 2
    head = dicom_slice(picture.T, origin - moved, steps)
    head.ImageType = ["ORIGINAL", "PRIMARY", "M", "MOSAIC"]
    head.SpacingBetweenSlices = float(np.linalg.norm(steps[2]))
    normal = (steps[2] / np.linalg.norm(steps[2])).tolist()
    block = head.private_block(0x0029, "SIEMENS CSA HEADER", create=True)
    tags = {"NumberOfImagesInMosaic": [count], "SliceNormalVector": normal}
    block.add_new(0x10, "OB", csa_header(Echo=[1], **tags))
    head.save_as(path, enforce_file_format=True)
    return path


@pytest.mark.parametrize("steps", [UPRIGHT, SAGITTAL, UPRIGHT * [1, 1, -1]])
def test_mosaics_are_taken_apart(tmp_path, pydicom, steps):
    pytest.importorskip("nibabel")
    path = write_mosaic(tmp_path / "epi.dcm", VALUES, ORIGIN, steps)
    check_places(vm.open(path), VALUES, ORIGIN, steps)
    check_places(vm.open(tmp_path), VALUES, ORIGIN, steps)


def test_a_real_mosaic_is_where_nibabel_says(tmp_path, pydicom):
    wrappers = pytest.importorskip("nibabel.nicom.dicomwrappers")
    sample = Path(wrappers.__file__).parent / "tests" / "data" / "siemens_dwi_0.dcm.gz"
    if not sample.is_file():
        pytest.skip("nibabel was installed without its samples")
    path = tmp_path / "dwi.dcm"
    path.write_bytes(gzip.decompress(sample.read_bytes()))
    head = pydicom.dcmread(path)
    head.PixelData = np.random.default_rng(1).bytes(len(head.PixelData))  # they are all zero
    head.save_as(path)
    image, volume = wrappers.wrapper_from_file(path), vm.open(path)
    values, got = image.get_data(), volume.array("mr")
    middle, direction = volume.grid.bounds.mean(axis=1), np.array(volume.meta["direction"])
    for index in np.random.default_rng(0).integers(values.shape, size=(100, 3)):
        place = (image.affine @ [*index, 1])[:3]
        inside = middle + np.linalg.solve(direction, place - middle)
        cell = tuple(
            int(np.searchsorted(edges, x)) - 1
            for edges, x in zip(volume.grid.edges, inside, strict=True)
        )
        assert got[cell] == values[tuple(index)]
        found = [c[n] for c, n in zip(centers(volume.grid), cell, strict=True)]
        np.testing.assert_allclose(found, inside, atol=0.05)


def test_mosaics_of_several_times(tmp_path, pydicom):
    pytest.importorskip("nibabel")
    for time in range(3):
        path = write_mosaic(tmp_path / f"epi{time}.dcm", VALUES + time, ORIGIN, UPRIGHT)
        head = pydicom.dcmread(path)
        head.InstanceNumber = time + 1
        head.save_as(path)
    volume = vm.open(tmp_path, time=2)
    assert volume.meta["times"] == 3
    check_places(volume, VALUES + 2, ORIGIN, UPRIGHT)


def test_mosaics_without_their_private_header_are_refused(tmp_path, pydicom):
    pytest.importorskip("nibabel")
    path = write_mosaic(tmp_path / "epi.dcm", VALUES, ORIGIN, UPRIGHT)
    head = pydicom.dcmread(path)
    head.remove_private_tags()
    head.save_as(path)
    with pytest.raises(vm.FileFormatError, match=r"Siemens mosaic without.*dcm2niix"):
        vm.open(path)


def test_a_bad_mosaic_harms_no_other_series_of_its_directory(tmp_path, pydicom):
    pytest.importorskip("nibabel")
    path = write_mosaic(tmp_path / "epi.dcm", VALUES, ORIGIN, UPRIGHT)
    head = pydicom.dcmread(path)
    head.SeriesInstanceUID = "1.2.3"
    head.remove_private_tags()
    head.save_as(path)
    other = tmp_path / "other.dcm"
    dicom_slice(VALUES[:, :, 0], ORIGIN, UPRIGHT).save_as(other, enforce_file_format=True)
    assert vm.open(other).grid.shape == (*VALUES.shape[:2], 1)
    with pytest.raises(vm.FileFormatError, match=r"Siemens mosaic without") as caught:
        vm.open(path)
    assert str(caught.value).count(str(path)) == 1


def test_mosaics_of_other_makers_and_films_are_refused(tmp_path, pydicom):
    head = dicom_slice(VALUES[:, :, 0], ORIGIN, UPRIGHT)
    head.ImageType = ["ORIGINAL", "PRIMARY", "M", "VFRAME"]
    head.save_as(tmp_path / "epi.dcm", enforce_file_format=True)
    with pytest.raises(vm.FileFormatError, match="United Imaging"):
        vm.open(tmp_path / "epi.dcm")
    del head.ImageType
    head.NumberOfFrames, head.FrameTime = 6, 40
    head.FrameIncrementPointer = 0x00181063
    head.PixelData = VALUES.transpose(2, 1, 0).tobytes()
    head.save_as(tmp_path / "heart.dcm", enforce_file_format=True)
    with pytest.raises(vm.FileFormatError, match="film, no volume"):
        vm.open(tmp_path / "heart.dcm")


def test_animals_on_four_legs_have_other_axes(tmp_path):
    volume = vm.open(series(tmp_path, AnatomicalOrientationType="QUADRUPED"))
    assert "orientation" not in volume.meta


def test_a_directory_without_slices_is_not_ours(tmp_path):
    (tmp_path / "notes.txt").write_text("nothing")
    with pytest.raises(vm.FileFormatError, match="no reader knows"):
        vm.open(tmp_path)


@pytest.mark.parametrize("claim", [b"\xff\xff\xff\x7f", b"\xfe\xff\xff\xff"])
def test_lengths_in_dicom_that_cannot_be(tmp_path, pydicom, claim):
    frames = dicom_frames(VALUES, ORIGIN, UPRIGHT)
    path = tmp_path / "frames.dcm"
    frames.save_as(path, enforce_file_format=True)
    content = path.read_bytes()
    at = content.index(b"\xe0\x7f\x10\x00OW") + 8
    path.write_bytes(content[:at] + claim + content[at + 4 :])

    def opened():
        # All pixels are there, whatever the length says: to read them is right too.
        with contextlib.suppress(vm.FileFormatError):
            np.testing.assert_array_equal(vm.open(path).array("ct"), VALUES)

    assert tracemalloc_peak(opened) < 10_000_000


@pytest.mark.parametrize(("keyword", "value"), [("Rows", 60000), ("NumberOfFrames", 90000)])
def test_sizes_in_dicom_are_compared_with_the_file(tmp_path, pydicom, keyword, value):
    head = dicom_slice(VALUES[:, :, 0], ORIGIN, UPRIGHT)
    setattr(head, keyword, value)
    head.save_as(tmp_path / "a.dcm", enforce_file_format=True)
    with pytest.raises(vm.FileFormatError, match="cut short"):
        vm.open(tmp_path / "a.dcm")


def test_deflated_dicom_is_refused(tmp_path, pydicom):
    head = dicom_slice(VALUES[:, :, 0], ORIGIN, UPRIGHT)
    head.file_meta.TransferSyntaxUID = pydicom.uid.DeflatedExplicitVRLittleEndian
    head.save_as(tmp_path / "a.dcm", enforce_file_format=True)
    with pytest.raises(vm.FileFormatError, match="deflated"):
        vm.open(tmp_path / "a.dcm")


class TestDICOMSeries(ReaderContract):
    @pytest.fixture
    def sample(self):
        pytest.importorskip("pydicom")
        # Named like what they are: a file that is none of its kind is an error then.
        return lambda directory: write_dicom(directory / "s", VALUES, ORIGIN, UPRIGHT) / "IM03"


class TestDICOMFrames(ReaderContract):
    @pytest.fixture
    def sample(self):
        pytest.importorskip("pydicom")

        def write(directory):
            frames = dicom_frames(VALUES, ORIGIN, UPRIGHT)
            frames.save_as(directory / "frames.dcm", enforce_file_format=True)
            return directory / "frames.dcm"

        return write


class TestTableOfContents(ReaderContract):
    @pytest.fixture
    def sample(self):
        pytest.importorskip("pydicom")
        return lambda directory: disc(directory, axial=VALUES)
