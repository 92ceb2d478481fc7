"""DICOM files, opened by pydicom: only the elements in use; Siemens mosaics taken apart.

Sources on mosaics: nibabel's notes on the mosaic and on the CSA header; the header's position is
that of the whole picture, about whose centre all slices lie.
"""

from __future__ import annotations

import contextlib
import logging
import math
import mmap
import struct
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ...packages import require
from ..guard import by_library, reading

_PREAMBLE, _MAGIC, _START = 128, b"DICM", 1024
# Groups that come first, and kinds of values (VR) whose length takes four bytes.
_FIRST_GROUPS = (2, 8)
_LONG = (b"OB", b"OW", b"OF", b"SQ", b"UN", b"UT", b"UC", b"UR")
# All that is in use: parsing the rest of a header takes most of the time.
_KEYWORDS = (
    *("AnatomicalOrientationType", "BitsAllocated", "BitsStored", "Columns", "DoseGridScaling"),
    *("DoseUnits", "FrameIncrementPointer", "GridFrameOffsetVector", "HighBit", "ImageType"),
    *("ImageOrientationPatient", "ImagePositionPatient", "InstanceNumber", "Modality"),
    *("NumberOfFrames", "PerFrameFunctionalGroupsSequence", "PhotometricInterpretation"),
    *("PixelRepresentation", "PixelSpacing", "RescaleIntercept", "RescaleSlope", "RescaleType"),
    *("Rows", "SamplesPerPixel", "SeriesDescription", "SeriesInstanceUID", "SeriesNumber"),
    *("SharedFunctionalGroupsSequence", "SliceThickness", "SpacingBetweenSlices", "Units"),
)
_PIXELS = ("PixelData", "FloatPixelData", "DoubleFloatPixelData", "PlanarConfiguration")
# Native pixels, which need no decoder: implicit and explicit, little and big endian.
_NATIVE = ("1.2.840.10008.1.2", "1.2.840.10008.1.2.1", "1.2.840.10008.1.2.2")
_DEFLATED = "1.2.840.10008.1.2.1.99"
# Where the private header of a mosaic can be, and what announces it.
_CSA_TAGS = (0x00290010, 0x00290011, 0x00291010, 0x00291110)
_CREATOR, _ELEMENT, _OTHER_MOSAIC = "SIEMENS CSA HEADER", 0x10, "VFRAME"


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Silence what pydicom says of unusual headers: what matters is checked by others."""
    logger = logging.getLogger("pydicom")
    before, logger.disabled = logger.disabled, True
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.disabled = before


def is_dicom(path: Path) -> bool:
    """Return True for a file that starts as DICOM files do."""
    try:
        with open(path, "rb") as file:
            return starts_dicom(file.read(_START))
    except OSError:
        return False


def starts_dicom(head: bytes) -> bool:
    """Return True for the first bytes of a DICOM file, with its preamble or without.

    Without, there have to be two elements of low groups in their order.
    """
    return head[_PREAMBLE:].startswith(_MAGIC) or any(_is_bare(head, order) for order in "<>")


def _is_bare(head: bytes, order: str) -> bool:
    at, last, found = 0, (0, 0), 0
    while found < 3 and at + 12 <= len(head):
        tag = struct.unpack_from(f"{order}2H", head, at)
        kind = head[at + 4 : at + 6]
        explicit = kind.isalpha() and kind.isupper()
        long = explicit and kind in _LONG
        where = (8 if long else 6 if explicit else 4) + at
        (size,) = struct.unpack_from(order + ("H" if explicit and not long else "I"), head, where)
        if tag[0] not in _FIRST_GROUPS[: None if found else 2] or tag <= last:
            return False
        at, last, found = at + (12 if long else 8) + size, tag, found + 1
    return found > 1


def read_header(path: Path, *keywords: str | int) -> Any:
    """Return the header of a file as a pydicom data set; or those elements of it."""
    return _read(path, keywords or _KEYWORDS, stop_before_pixels=True)


def read_whole(path: Path) -> Any:
    """Return a file with its pixels, as they are in it."""
    return _read(path, (*_KEYWORDS, *_PIXELS), stop_before_pixels=False)


def is_native(header: Any) -> bool:
    """Return True if the pixels lie in the file as they are."""
    return str(header.file_meta.get("TransferSyntaxUID", _NATIVE[0])) in _NATIVE


def check_size(path: Path, header: Any, frames: int) -> None:
    """Check that a file is long enough for its frames."""
    # Packed frames have a header each.
    bits = header.Rows * header.Columns * header.BitsAllocated if is_native(header) else 64
    found, least = path.stat().st_size, frames * bits // 8
    if found < least:
        raise FileFormatError(
            f"{path.name} is cut short: {found} bytes, but {frames} frames of {header.Columns} x "
            f"{header.Rows} pixels of {header.BitsAllocated} bits take {least} at least"
        )


def _read(path: Path, keywords: tuple[str | int, ...], **options: Any) -> Any:
    pydicom = require("pydicom", "medical", "reading DICOM")
    with reading(path, "a DICOM file"), by_library("pydicom"), open(path, "rb") as opened:
        if not path.stat().st_size:
            raise FileFormatError("the file is empty")
        # Of a file that is mapped, lengths it claims take no memory beyond what there is.
        with mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as file:
            bare = not file[_PREAMBLE:].startswith(_MAGIC) and starts_dicom(file[:_START])
            header = pydicom.dcmread(file, specific_tags=list(keywords), force=bare, **options)
        if "TransferSyntaxUID" not in header.file_meta:  # no group 2: as pydicom has seen
            implicit, little = header.original_encoding
            header.file_meta.TransferSyntaxUID = _NATIVE[0 if implicit else 1 if little else 2]
        if str(header.file_meta.get("TransferSyntaxUID", "")) == _DEFLATED:
            raise FileFormatError("deflated DICOM is not read; convert it with 'dcmconv +te'")
    return header


def is_mosaic(header: Any) -> bool:
    """Return True for the header of a mosaic: all slices of a volume as tiles of one picture."""
    return bool({"MOSAIC", _OTHER_MOSAIC} & set(header.get("ImageType") or ()))


def take_apart(path: Path, header: Any) -> None:
    """Make the header of a Siemens mosaic, and of nothing else, one of a frame per slice."""
    if not is_mosaic(header):
        return
    if _OTHER_MOSAIC in header.ImageType:
        raise FileFormatError(
            "mosaics of United Imaging (VFRAME) are not read; convert them with 'dcm2niix'"
        )
    private = read_header(path, *_CSA_TAGS)
    csareader = require("nibabel.nicom.csareader", "medical", "reading Siemens mosaics")
    try:
        with by_library("nibabel"):
            csa = csareader.read(private.private_block(0x0029, _CREATOR)[_ELEMENT].value)
            count = int(csareader.get_n_mosaic(csa))
            normal = np.array(csareader.get_slice_normal(csa), float)
        first, axes, spacing = (
            np.array(header[name].value, float)
            for name in ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing")
        )
    except (FileFormatError, KeyError, TypeError) as error:
        raise FileFormatError(
            "it is a Siemens mosaic without the private header (0029,1010) that says how many "
            "slices it has, or without a position; convert the original file with 'dcm2niix'"
        ) from error
    side = math.ceil(math.sqrt(count)) if count > 0 else 0
    if not side or header.Rows % side or header.Columns % side:
        raise FileFormatError(f"{header.Columns} x {header.Rows} pixels are no mosaic of {count}")
    rows, columns = header.Rows // side, header.Columns // side
    along, down = axes.reshape(2, 3)
    moved = (header.Columns - columns) / 2 * spacing[1] * along
    moved += (header.Rows - rows) / 2 * spacing[0] * down
    step = float(header.get("SpacingBetweenSlices") or header.get("SliceThickness") or 1.0)
    step *= 1.0 if np.cross(along, down) @ normal > 0 else -1.0
    header.Rows, header.Columns, header.NumberOfFrames = rows, columns, count
    header.ImagePositionPatient = (first + moved).tolist()
    header.GridFrameOffsetVector = (step * np.arange(count)).tolist()


def tiles(picture: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return the tiles of a picture, (slices, *shape): row by row."""
    rows, columns = shape
    across, down = picture.shape[-1] // columns, picture.shape[-2] // rows
    parts = picture.reshape(down, rows, across, columns)
    return parts.swapaxes(1, 2).reshape(-1, rows, columns)
