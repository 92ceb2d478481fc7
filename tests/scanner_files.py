"""The same voxels in the formats of scanners, each written by a library of its own.

Voxels are ``values[i, j, k]`` with centres ``origin + i steps[0] + j steps[1] + k steps[2]`` in
mm, in the patient coordinates LPS. The writers use nothing of the package.
"""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np

import voluminous as vm

RNG = np.random.default_rng(3)
VALUES = RNG.integers(-1000, 3000, (4, 5, 6)).astype(np.int16)
ORIGIN, WIDTHS = np.array([-10.0, 20.0, 30.0]), np.array([0.5, 0.75, 2.0])
UPRIGHT = np.diag(WIDTHS)
# A sagittal scan: columns run to the back, rows to the feet, slices to the right.
SAGITTAL = np.array([[0, 0.5, 0], [0, 0, -0.75], [-2.0, 0, 0]])
DTYPES = [np.uint8, np.int16, np.uint16, np.int32, np.float32, np.float64]
TO_RAS = np.diag([-1.0, -1.0, 1.0])


def write_nifti(path: Path, values, origin, steps, *, qform: bool = False) -> Path:
    """By nibabel, whose affine is RAS."""
    import nibabel

    affine = np.eye(4)
    affine[:3, :3] = TO_RAS @ np.transpose(steps)
    affine[:3, 3] = TO_RAS @ origin
    kind = nibabel.Nifti1Pair if path.suffix in (".hdr", ".img") else nibabel.Nifti1Image
    image = kind(values, affine, dtype=values.dtype)
    image.set_sform(None if qform else affine, code=0 if qform else 1)
    image.set_qform(affine if qform else None, code=1 if qform else 0)
    image.header.set_xyzt_units("mm")
    nibabel.save(image, path)
    return path


def write_nrrd(path: Path, values, origin, steps, *, space="left-posterior-superior", **fields):
    """By pynrrd, in any of the patient's spaces."""
    import nrrd

    turn = {"left-posterior-superior": np.eye(3), "right-anterior-superior": TO_RAS}[space]
    header = {
        "space": space,
        "space directions": np.asarray(steps) @ turn,
        "space origin": turn @ origin,
        **fields,
    }
    nrrd.write(str(path), values, header, detached_header=path.suffix == ".nhdr")
    return path


def nrrd_text(**fields) -> str:
    """Return the head of an NRRD file with `VALUES`, without the empty line behind it."""
    lines = {"type": "short", "dimension": "3", "sizes": "4 5 6", "encoding": "raw"}
    lines |= {"endian": "little", **{name.replace("_", " "): v for name, v in fields.items()}}
    return "".join(["NRRD0004\n", *(f"{name}: {value}\n" for name, value in lines.items())])


def write_metaimage(path: Path, values, origin, steps) -> Path:
    """As the format is described: directions of the axes one after the other."""
    widths = np.linalg.norm(steps, axis=1)
    codes = {"uint8": "MET_UCHAR", "int16": "MET_SHORT", "float32": "MET_FLOAT"}
    lines = {
        "ObjectType": "Image",
        "NDims": "3",
        "BinaryData": "True",
        "BinaryDataByteOrderMSB": "True",
        "AnatomicalOrientation": "RAI",
        "TransformMatrix": _words(steps / widths[:, None]),
        "Offset": _words(origin),
        "ElementSpacing": _words(widths),
        "DimSize": " ".join(map(str, values.shape)),
        "ElementType": codes[values.dtype.name],
        "ElementDataFile": "LOCAL",
    }
    text = "".join(f"{key} = {value}\n" for key, value in lines.items())
    path.write_bytes(text.encode() + values.astype(values.dtype.newbyteorder(">")).tobytes("F"))
    return path


def write_dicom(directory: Path, values, origin, steps, **changes) -> Path:
    """One file per slice by pydicom, named and numbered in an order that means nothing."""
    directory.mkdir(exist_ok=True)
    origin, steps = np.asarray(origin), np.asarray(steps)
    for k in range(values.shape[2]):
        head = dicom_slice(values[:, :, k], origin + k * steps[2], steps)
        head.InstanceNumber = 5 * k % 7
        for keyword, value in changes.items():
            setattr(head, keyword, value)
        head.save_as(directory / f"IM{3 * k % 11:02d}", enforce_file_format=True)
    return directory


def dicom_slice(values, origin, steps, series: str = "1.2.3.4"):
    """Return a CT slice ``values[i, j]`` as a data set."""
    head = _data_set("1.2.840.10008.5.1.4.1.1.2", series)
    head.Modality = "CT"
    widths = np.linalg.norm(steps, axis=1)
    head.ImagePositionPatient = [_decimal(x) for x in origin]
    units = np.asarray(steps) / widths[:, None]
    head.ImageOrientationPatient = [_decimal(x) for x in (*units[0], *units[1])]
    head.PixelSpacing = [_decimal(widths[1]), _decimal(widths[0])]
    head.SliceThickness = _decimal(widths[2])
    _set_pixels(head, np.asarray(values).T)
    return head


def dicom_frames(values, origin, steps):
    """Return an enhanced CT of many frames, the last slice first, as a data set."""
    from pydicom.dataset import Dataset

    head = _data_set("1.2.840.10008.5.1.4.1.1.2.1", "1.2.3.5")
    head.Modality = "CT"
    widths = np.linalg.norm(steps, axis=1)
    units = np.asarray(steps) / widths[:, None]
    shared = Dataset()
    shared.PixelMeasuresSequence = [Dataset()]
    shared.PixelMeasuresSequence[0].PixelSpacing = [_decimal(widths[1]), _decimal(widths[0])]
    shared.PlaneOrientationSequence = [Dataset()]
    shared.PlaneOrientationSequence[0].ImageOrientationPatient = [
        _decimal(x) for x in (*units[0], *units[1])
    ]
    head.SharedFunctionalGroupsSequence = [shared]
    frames = []
    for k in reversed(range(values.shape[2])):
        frame = Dataset()
        frame.PlanePositionSequence = [Dataset()]
        position = np.asarray(origin) + k * np.asarray(steps[2])
        frame.PlanePositionSequence[0].ImagePositionPatient = [_decimal(x) for x in position]
        frames.append(frame)
    head.PerFrameFunctionalGroupsSequence = frames
    head.NumberOfFrames = values.shape[2]
    _set_pixels(head, values.transpose(2, 1, 0)[::-1])
    return head


def _data_set(kind: str, series: str):
    from pydicom.dataset import Dataset, FileMetaDataset
    from pydicom.uid import ExplicitVRLittleEndian, generate_uid

    head = Dataset()
    head.file_meta = FileMetaDataset()
    head.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    head.SOPClassUID = head.file_meta.MediaStorageSOPClassUID = kind
    head.SOPInstanceUID = head.file_meta.MediaStorageSOPInstanceUID = generate_uid()
    head.SeriesInstanceUID = series
    return head


def _set_pixels(head, pixels) -> None:
    head.Rows, head.Columns = pixels.shape[-2:]
    head.SamplesPerPixel, head.PhotometricInterpretation = 1, "MONOCHROME2"
    head.BitsAllocated = head.BitsStored = 8 * pixels.dtype.itemsize
    head.HighBit = head.BitsStored - 1
    head.PixelRepresentation = int(pixels.dtype.kind == "i")
    head.PixelData = np.ascontiguousarray(pixels).tobytes()
    head["PixelData"].VR = "OW"


def _words(numbers) -> str:
    return " ".join(repr(float(x)) for x in np.ravel(numbers))


def _decimal(x) -> str:
    return f"{float(x):.10g}"


def centers(grid):
    return [(edges[1:] + edges[:-1]) / 2 for edges in grid.edges]


def check_places(volume, values, origin, steps, name=None):
    """Look for every voxel where it should be, one by one."""
    lines = centers(volume.grid)
    got = volume.array(name or volume.fields[0])
    for index in np.ndindex(values.shape):
        place = origin + np.array(index) @ steps
        cell = tuple(int(np.argmin(abs(c - x))) for c, x in zip(lines, place, strict=True))
        np.testing.assert_allclose([c[n] for c, n in zip(lines, cell, strict=True)], place, 1e-6)
        assert got[cell] == values[index]


def volume_of(values, widths=WIDTHS, origin=ORIGIN, unit="mm"):
    edges = [
        o + w * (np.arange(n + 1) - 0.5)
        for o, w, n in zip(origin, widths, values.shape, strict=True)
    ]
    return vm.Volume(vm.CartesianGrid(*edges, unit=unit), density=values)


def tracemalloc_peak(action):
    tracemalloc.start()
    try:
        action()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
