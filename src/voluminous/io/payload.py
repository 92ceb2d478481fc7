"""Raw numbers in a file: memory-mapped, or decompressed to exactly the declared size."""

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

# Magic bytes of compressed files, and the functions that open them.
_PACKED: dict[bytes, Callable[[Path], Any]] = {
    b"\x1f\x8b": gzip.GzipFile,
    b"BZh": bz2.BZ2File,
    b"\xfd7zXZ\x00": lzma.LZMAFile,
}
# Magic bytes of ZIP files, with content or empty.
ZIP = (b"PK\x03\x04", b"PK\x05\x06")
_LARGEST = 2**62


def unpacked(path: Path) -> IO[bytes]:
    """Open a file for reading, with decompression if it is a gzip, bzip2 or xz file."""
    with open(path, "rb") as file:
        start = file.read(8)
    for magic, opened in _PACKED.items():
        if start.startswith(magic):
            stream: IO[bytes] = opened(path)
            return stream
    return open(path, "rb")


def is_packed(head: bytes) -> bool:
    """Return True for the first bytes of a gzip, bzip2 or xz file."""
    return head.startswith(tuple(_PACKED))


def checked_shape(shape: Any, what: str = "the shape") -> tuple[int, ...]:
    """Return a shape as integers after checks."""
    numbers = tuple(int(n) for n in shape)
    if any(n < 1 or float(n) != float(m) for n, m in zip(numbers, shape, strict=True)):
        raise FileFormatError(f"{what} must be positive whole numbers, got {tuple(shape)}")
    if math.prod(numbers) > _LARGEST:
        raise FileFormatError(f"{what} {numbers} is more than any file holds")
    return numbers


def mapped(path: Path, offset: int, shape: Any, dtype: Any) -> np.ndarray:
    """Return a memory-mapped array in C order."""
    shape, dtype = checked_shape(shape), np.dtype(dtype)
    expected = offset + math.prod(shape) * dtype.itemsize
    result = path.stat().st_size
    if offset < 0 or result < expected:
        raise FileFormatError(
            f"{path.name} is cut short: {result} bytes, but {_times(shape)} values of {dtype} from "
            f"byte {offset} on take {expected}"
        )
    return np.memmap(path, dtype=dtype, mode="r", offset=offset, shape=shape)


def read_exactly(file: IO[bytes], shape: Any, dtype: Any, what: str = "the data") -> np.ndarray:
    """Return an array of the next bytes of a stream, such as a compressed file.

    Memory use is bounded by the declared shape, even if the stream contains more.
    """
    shape, dtype = checked_shape(shape), np.dtype(dtype)
    size = math.prod(shape) * dtype.itemsize
    check_memory(size, f"reading {what}", "read a coarser copy, or fewer fields")
    content = file.read(size)
    if len(content) < size:
        raise FileFormatError(
            f"{what} end after {len(content)} bytes, expected {size} for {_times(shape)} values "
            f"of {dtype}"
        )
    return np.asarray(np.frombuffer(content, dtype).reshape(shape))


def inside(directory: Path, name: str) -> Path:
    """Return the path of a file named by another; it must lie in the same directory or below."""
    path = (directory / name).resolve()
    if not path.is_relative_to(directory.resolve()):
        raise FileFormatError(f"it names {name!r}, which is outside of its directory")
    if not path.is_file():
        raise InputError(f"it names {name!r}, but there is no such file in {directory}")
    return path


def _times(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))


def zip_names(path: Path) -> frozenset[str]:
    """Return the names in a ZIP file; empty if it is not a ZIP file or too damaged."""
    try:
        with zipfile.ZipFile(path) as archive:
            return frozenset(archive.namelist())
    except Exception:  # damaged files raise almost any exception, including NotImplementedError
        return frozenset()
