"""Is an OpenVDB file all there? Asked before its library, which a file cut short leads astray."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import IO

from ..errors import FileFormatError

MAGIC = b" BDV\0\0\0\0"
# File versions whose head is as below (openvdb/version.h): since grids may share voxels.
_KNOWN = range(216, 300)
_UUID = 36
_MOST = 1 << 16


def check_whole(path: Path) -> None:
    """Follow the places that the file tells of its grids.

    Raises
    ------
    FileFormatError
        If one is outside of the file.
    """
    size = path.stat().st_size
    with open(path, "rb") as file:
        _take(file, len(MAGIC))
        version = _number(file)
        _take(file, 8)  # version of the library
        if version not in _KNOWN or _take(file, 1) == b"\0":  # a stream tells no places
            return
        _take(file, _UUID)
        for _ in range(_count(file, "remarks")):
            for _ in range(3):  # name, type, value
                _text(file)
        for number in range(_count(file, "grids")):
            for _ in range(3):  # name, type, grid that it shares voxels with
                _text(file)
            _, _, end = struct.unpack("<3q", _take(file, 24))
            if not file.tell() <= end <= size:
                raise FileFormatError(
                    f"grid {number} ends at byte {end}, but the file has {size} bytes: it is cut "
                    "short or damaged"
                )
            file.seek(end)


def _count(file: IO[bytes], what: str) -> int:
    count = _number(file)
    if count > _MOST:
        raise FileFormatError(f"byte {file.tell()}: {count} {what} are announced")
    return count


def _number(file: IO[bytes]) -> int:
    return int.from_bytes(_take(file, 4), "little")


def _text(file: IO[bytes]) -> None:
    length = _number(file)
    if length > _MOST:
        raise FileFormatError(f"byte {file.tell()}: a name of {length} bytes is announced")
    _take(file, length)


def _take(file: IO[bytes], size: int) -> bytes:
    data = file.read(size)
    if len(data) < size:
        raise FileFormatError(f"cut short in its head, at byte {file.tell()}")
    return data
