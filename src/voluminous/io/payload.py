"""The plain numbers in a file: mapped where they are, or unpacked to exactly what was announced."""

from __future__ import annotations

import bz2
import gzip
import lzma
import math
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..errors import FileFormatError, InputError
from ..memory import check_memory

# How packed files start, and what opens them.
_PACKED: dict[bytes, Callable[[Path], Any]] = {
    b"\x1f\x8b": gzip.GzipFile,
    b"BZh": bz2.BZ2File,
    b"\xfd7zXZ\x00": lzma.LZMAFile,
}
# How ZIP files start: with a file in them, or empty.
ZIP = (b"PK\x03\x04", b"PK\x05\x06")
_PIECE = 1 << 24
_LARGEST = 2**62


def unpacked(path: Path) -> IO[bytes]:
    """Return a file open for reading, unpacked on the way if gzip, bzip2 or xz packed it."""
    with open(path, "rb") as file:
        start = file.read(8)
    for magic, opened in _PACKED.items():
        if start.startswith(magic):
            stream: IO[bytes] = opened(path)
            return stream
    return open(path, "rb")


def is_packed(head: bytes) -> bool:
    """Return True for the first bytes of a file that gzip, bzip2 or xz packed."""
    return head.startswith(tuple(_PACKED))


def checked_shape(shape: Any, what: str = "the shape") -> tuple[int, ...]:
    """Return a shape as integers."""
    numbers = tuple(int(n) for n in shape)
    if any(n < 1 or float(n) != float(m) for n, m in zip(numbers, shape, strict=True)):
        raise FileFormatError(f"{what} must be positive whole numbers, got {tuple(shape)}")
    if math.prod(numbers) > _LARGEST:
        raise FileFormatError(f"{what} {numbers} is more than any file holds")
    return numbers


def mapped(path: Path, offset: int, shape: Any, dtype: Any) -> np.ndarray:
    """Return an array that stays in the file, in C order."""
    shape, dtype = checked_shape(shape), np.dtype(dtype)
    expected = offset + math.prod(shape) * dtype.itemsize
    found = path.stat().st_size
    if offset < 0 or found < expected:
        raise FileFormatError(
            f"{path.name} is cut short: {found} bytes, but {_times(shape)} values of {dtype} from "
            f"byte {offset} on take {expected}"
        )
    return np.memmap(path, dtype=dtype, mode="r", offset=offset, shape=shape)


def read_exactly(file: IO[bytes], shape: Any, dtype: Any, what: str = "the data") -> np.ndarray:
    """Return an array of the next bytes of a stream, such as a packed file.

    Memory is taken as announced by the shape, however much more the stream would unpack to.
    """
    shape, dtype = checked_shape(shape), np.dtype(dtype)
    size = math.prod(shape) * dtype.itemsize
    check_memory(size, f"reading {what}", "read a coarser copy, or fewer fields")
    pieces = bytearray()
    while len(pieces) < size:  # grows with what is there: a header may promise anything
        piece = file.read(min(_PIECE, size - len(pieces)))
        if not piece:
            raise FileFormatError(
                f"{what} end after {len(pieces)} bytes, expected {size} for {_times(shape)} values "
                f"of {dtype}"
            )
        pieces += piece
    return np.frombuffer(pieces, dtype).reshape(shape)


def inside(directory: Path, name: str) -> Path:
    """Return the path of a file that another names, which must lie in its directory or below."""
    path = (directory / name).resolve()
    if not path.is_relative_to(directory.resolve()):
        raise FileFormatError(f"it names {name!r}, which is outside of its directory")
    if not path.is_file():
        raise InputError(f"it names {name!r}, but there is no such file in {directory}")
    return path


def _times(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))


def zip_names(path: Path) -> frozenset[str]:
    """Return the names in a ZIP file; none if it is no ZIP file, or too damaged to tell."""
    try:
        with zipfile.ZipFile(path) as archive:
            return frozenset(archive.namelist())
    except Exception:  # of damaged ones it raises nearly anything, NotImplementedError too
        return frozenset()
