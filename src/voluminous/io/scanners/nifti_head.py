"""The head of NIfTI-1 and NIfTI-2: binary, in either byte order, perhaps packed by gzip."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ..payload import checked_shape, unpacked
from .placement import Placement

# Where magic words are, and the number of bytes that each version's head says it has.
_FIRST, _SECOND = 348, 540
_MAGICS = ((344, b"n+1\0"), (344, b"ni1\0"), (4, b"n+2\0\r\n\x1a\n"), (4, b"ni2\0\r\n\x1a\n"))
_FIRST_FIELDS = {
    "sizeof_hdr": ("i4", 0),
    "dim": ("8i2", 40),
    "intent_code": ("i2", 68),
    "datatype": ("i2", 70),
    "bitpix": ("i2", 72),
    "pixdim": ("8f4", 76),
    "vox_offset": ("f4", 108),
    "scl_slope": ("f4", 112),
    "scl_inter": ("f4", 116),
    "xyzt_units": ("u1", 123),
    "qform_code": ("i2", 252),
    "sform_code": ("i2", 254),
    "quaternion": ("3f4", 256),
    "qoffset": ("3f4", 268),
    "srow": ("(3,4)f4", 280),
    "magic": ("S4", 344),
}
_SECOND_FIELDS = {
    "sizeof_hdr": ("i4", 0),
    "magic": ("S8", 4),
    "datatype": ("i2", 12),
    "dim": ("8i8", 16),
    "pixdim": ("8f8", 104),
    "vox_offset": ("i8", 168),
    "scl_slope": ("f8", 176),
    "scl_inter": ("f8", 184),
    "qform_code": ("i4", 344),
    "sform_code": ("i4", 348),
    "quaternion": ("3f8", 352),
    "qoffset": ("3f8", 376),
    "srow": ("(3,4)f8", 400),
    "xyzt_units": ("i4", 500),
    "intent_code": ("i4", 504),
}
_UNITS = {1: "m", 2: "mm", 3: "um"}


def _structure(fields: dict[str, tuple[str, int]], size: int) -> np.dtype[Any]:
    formats, offsets = zip(*fields.values(), strict=True)
    return np.dtype(
        {"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": size}
    )


FIRST = _structure(_FIRST_FIELDS, _FIRST)
SECOND = _structure(_SECOND_FIELDS, _SECOND)


def is_head(start: bytes) -> bool:
    """Return True for the first bytes of a NIfTI head."""
    return any(start[at : at + len(word)] == word for at, word in _MAGICS)


def read_head(path: Path) -> np.ndarray:
    """Return the head as a NumPy record, in the file's byte order.

    Raises
    ------
    FileFormatError
        If it does not say how long it is.
    """
    with unpacked(path) as file:
        start = file.read(_SECOND)
    for structure in (FIRST, SECOND):
        for ordered in (structure.newbyteorder("<"), structure.newbyteorder(">")):
            if len(start) >= ordered.itemsize and is_head(start):
                head = np.frombuffer(start, ordered, count=1)[0]
                if head["sizeof_hdr"] == ordered.itemsize:
                    return head
    raise FileFormatError(
        f"expected the head of NIfTI-1 ({_FIRST} bytes) or NIfTI-2 ({_SECOND} bytes), but it is "
        "damaged or cut short"
    )


def sizes_of(head: Any) -> tuple[tuple[int, ...], int, int]:
    """Return the shape, and how many time steps and components there are.

    Raises
    ------
    FileFormatError
        If a size is not positive, or there are more dimensions.
    """
    count, *dim = (int(n) for n in head["dim"])
    if not 2 <= count <= 7:
        raise FileFormatError(f"dim[0] must be from 2 to 7, got {count}")
    sizes = checked_shape(dim[:count], "dim") + (1,) * (7 - count)
    if math.prod(sizes[5:]) > 1:
        raise FileFormatError(f"expected x, y, z, time and components at most, got dim {sizes}")
    return sizes[:3], sizes[3], sizes[4]


def placement_of(head: Any) -> Placement:
    """Return where the voxels are: by the sform, else the qform, else their widths alone.

    Source: nifti1.h, methods 3, 2 and 1 for coordinates; they are RAS.
    """
    widths = np.array(head["pixdim"][1:4], float)
    unit = _UNITS.get(int(head["xyzt_units"]) & 7, "mm")
    if head["sform_code"] > 0:
        affine = np.array(head["srow"], float)
        return Placement(affine[:, 3], affine[:, :3].T, unit, "RAS")
    if head["qform_code"] > 0:
        turned = _rotation(np.array(head["quaternion"], float))
        handed = np.array([1.0, 1.0, -1.0 if head["pixdim"][0] < 0 else 1.0])
        steps = (turned * (widths * handed)).T
        return Placement(np.array(head["qoffset"], float), steps, unit, "RAS")
    return Placement(np.zeros(3), np.diag(widths), unit)


def _rotation(vector: np.ndarray) -> np.ndarray:
    """Return the matrix of a unit quaternion, of which the real part (not negative) is left out."""
    squared = float(vector @ vector)
    if squared > 1:  # by rounding, else it is damaged, and only turned
        vector, squared = vector / math.sqrt(squared), 1.0
    a, (b, c, d) = math.sqrt(1 - squared), vector
    return np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - b * b - c * c],
        ]
    )
