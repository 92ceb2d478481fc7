"""DICOM files, opened by pydicom: only the elements in use; Siemens mosaics taken apart."""

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

# Where the private header can be, and what announces it.
CSA_TAGS = (0x00290010, 0x00290011, 0x00291010, 0x00291110)
_CREATOR, _ELEMENT, _OTHER = "SIEMENS CSA HEADER", 0x10, "VFRAME"


def is_mosaic(head: Any) -> bool:
    """Return True for the head of a mosaic."""
    return bool({"MOSAIC", _OTHER} & set(head.get("ImageType") or ()))


def describe_slices(head: Any, private: Any) -> None:
    """Change the head of a mosaic to that of a file with a frame per slice."""
    if _OTHER in head.ImageType:
        raise FileFormatError(
            "mosaics of United Imaging (VFRAME) are not read; convert them with 'dcm2niix'"
        )
    csareader = require("nibabel.nicom.csareader", "medical", "reading Siemens mosaics")
    try:
        csa = csareader.read(private.private_block(0x0029, _CREATOR)[_ELEMENT].value)
        count = int(csareader.get_n_mosaic(csa))
        normal = np.array(csareader.get_slice_normal(csa), float)
        first, axes, spacing = (
            np.array(head[name].value, float)
            for name in ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing")
        )
    except (KeyError, TypeError) as error:
        raise FileFormatError(
            "it is a Siemens mosaic without the private header (0029,1010) that says how many "
            "slices it has, or without a position; convert the original file with 'dcm2niix'"
        ) from error
    side = math.ceil(math.sqrt(count)) if count > 0 else 0
    if not side or head.Rows % side or head.Columns % side:
        raise FileFormatError(f"{head.Columns} x {head.Rows} pixels are no mosaic of {count}")
    along, down = axes.reshape(2, 3)
    moved = (head.Columns - head.Columns // side) / 2 * spacing[1] * along
    moved += (head.Rows - head.Rows // side) / 2 * spacing[0] * down
    step = float(head.get("SpacingBetweenSlices") or head.get("SliceThickness") or 1.0)
    step *= 1.0 if np.cross(along, down) @ normal > 0 else -1.0
    head.Rows, head.Columns, head.NumberOfFrames = head.Rows // side, head.Columns // side, count
    head.ImagePositionPatient = (first + moved).tolist()
    head.GridFrameOffsetVector = (step * np.arange(count)).tolist()


def tiles(picture: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return the tiles of a picture, (slices, *shape): row by row."""
    rows, columns = shape
    across, down = picture.shape[-1] // columns, picture.shape[-2] // rows
    parts = picture.reshape(down, rows, across, columns)
    return parts.swapaxes(1, 2).reshape(-1, rows, columns)


PREAMBLE, MAGIC = 128, b"DICM"
# Bytes that tell whether a file without a preamble is DICOM; the groups that come first; kinds of
# values (VR) whose length takes four bytes.
_START, _FIRST_GROUPS, _LONG = (
    1024,
    (2, 8),
    (b"OB", b"OW", b"OF", b"SQ", b"UN", b"UT", b"UC", b"UR"),
)
# All that is looked at: parsing the rest of a head takes most of the time.
_KEYWORDS = (
    "AnatomicalOrientationType",
    "BitsAllocated",
    "BitsStored",
    "Columns",
    "DoseGridScaling",
    "DoseUnits",
    "FrameIncrementPointer",
    "GridFrameOffsetVector",
    "HighBit",
    "ImageType",
    "ImageOrientationPatient",
    "ImagePositionPatient",
    "InstanceNumber",
    "Modality",
    "NumberOfFrames",
    "PerFrameFunctionalGroupsSequence",
    "PhotometricInterpretation",
    "PixelRepresentation",
    "PixelSpacing",
    "RescaleIntercept",
    "RescaleSlope",
    "RescaleType",
    "Rows",
    "SamplesPerPixel",
    "SeriesDescription",
    "SeriesInstanceUID",
    "SeriesNumber",
    "SharedFunctionalGroupsSequence",
    "SliceThickness",
    "SpacingBetweenSlices",
    "Units",
)
_PIXELS = ("PixelData", "FloatPixelData", "DoubleFloatPixelData", "PlanarConfiguration")
# Native pixels, which need no decoder: implicit and explicit, little and big endian.
_NATIVE = ("1.2.840.10008.1.2", "1.2.840.10008.1.2.1", "1.2.840.10008.1.2.2")
_DEFLATED = "1.2.840.10008.1.2.1.99"


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep pydicom from telling what is unusual in a head: what matters is checked by others."""
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
    return head[PREAMBLE:].startswith(MAGIC) or any(_is_bare(head, order) for order in "<>")


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


def read_head(path: Path) -> Any:
    """Return the head of a file as a pydicom data set."""
    return _read(path, _KEYWORDS, stop_before_pixels=True)


def take_apart(path: Path, head: Any) -> None:
    """Make the head of a Siemens mosaic, and of nothing else, one of a file with many frames."""
    if is_mosaic(head):
        private = _read(path, CSA_TAGS, stop_before_pixels=True)
        with by_library("nibabel"):
            describe_slices(head, private)


def read_whole(path: Path) -> Any:
    """Return a file with its pixels, as they are in it."""
    return _read(path, (*_KEYWORDS, *_PIXELS), stop_before_pixels=False)


def read_parts(path: Path, *keywords: str) -> Any:
    """Return those elements of a file, which are otherwise passed over."""
    return _read(path, keywords, stop_before_pixels=True)


def is_native(head: Any) -> bool:
    """Return True if the pixels lie in the file as they are."""
    return str(head.file_meta.get("TransferSyntaxUID", _NATIVE[0])) in _NATIVE


def check_size(path: Path, head: Any, frames: int) -> None:
    """Check that a file is long enough for its frames."""
    # Of packed frames it is known that each has a head.
    bits = head.Rows * head.Columns * head.BitsAllocated if is_native(head) else 64
    found, least = path.stat().st_size, frames * bits // 8
    if found < least:
        raise FileFormatError(
            f"{path.name} is cut short: {found} bytes, but {frames} frames of {head.Columns} x "
            f"{head.Rows} pixels of {head.BitsAllocated} bits take {least} at least"
        )


def _read(path: Path, keywords: tuple[str | int, ...], **options: Any) -> Any:
    pydicom = require("pydicom", "medical", "reading DICOM")
    with reading(path, "a DICOM file"), by_library("pydicom"), _bounded(path) as file:
        bare = not file[PREAMBLE:].startswith(MAGIC) and starts_dicom(file[:_START])
        head = pydicom.dcmread(file, specific_tags=list(keywords), force=bare, **options)
        if "TransferSyntaxUID" not in head.file_meta:
            head.file_meta.TransferSyntaxUID = _NATIVE[_encoding(head)]
        if str(head.file_meta.get("TransferSyntaxUID", "")) == _DEFLATED:
            raise FileFormatError("deflated DICOM is not read; convert it with 'dcmconv +te'")
    return head


def _encoding(head: Any) -> int:
    """Return which of the native encodings a head without group 2 is in, as pydicom has seen."""
    implicit, little = head.original_encoding
    return 0 if implicit else 1 if little else 2


@contextlib.contextmanager
def _bounded(path: Path) -> Iterator[Any]:
    """Open a file so that lengths it claims take no memory beyond what there is."""
    with open(path, "rb") as file:
        if not path.stat().st_size:
            raise FileFormatError("the file is empty")
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
            yield mapped
