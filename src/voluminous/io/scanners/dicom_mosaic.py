"""Siemens mosaics: all slices of a volume as tiles of one DICOM picture.

Sources: nibabel's notes on the mosaic and on the CSA header; the head's position is that of the
whole picture, about whose centre all slices lie.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ...packages import require

# Where the private header can be, and what announces it.
CSA_TAGS = (0x00290010, 0x00290011, 0x00291010, 0x00291110)
_CREATOR, _ELEMENT, _OTHER = "SIEMENS CSA HEADER", 0x10, "VFRAME"


def is_mosaic(head: Any) -> bool:
    """Return True for the head of a mosaic."""
    return bool({"MOSAIC", _OTHER} & set(head.get("ImageType") or ()))


def describe_slices(head: Any, private: Any) -> None:
    """Change the head of a mosaic to that of a file with a frame per slice.

    Raises
    ------
    FileFormatError
        If the private header, which alone says how many slices there are, is not there.
    """
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
