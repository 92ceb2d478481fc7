"""Raw numbers in a file: as they lie there, or decompressed to exactly the declared size."""

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
from ..files import check_age, check_readable
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
# Bytes of a row that are read sooner than sought over.
_LONG = 1 << 16


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


def stored(path: Path, offset: int, shape: Any, dtype: Any, index: Any = ...) -> np.ndarray:
    """Return an array that lies in a file in C order, or a part of it: slices without a step.

    It is read, not mapped: the system ends a process that looks at pages of a mapped file which
    another program has cut short meanwhile.
    """
    shape, dtype = checked_shape(shape), np.dtype(dtype)
    expected = offset + math.prod(shape) * dtype.itemsize
    result = path.stat().st_size
    if offset < 0 or result < expected:
        raise FileFormatError(
            f"{path.name} is cut short: {result} bytes, but {_times(shape)} values of {dtype} from "
            f"byte {offset} on take {expected}"
        )
    given = index if isinstance(index, tuple) else (slice(None),) * len(shape)
    slices = [slice(i, i + 1) if isinstance(i, int) else i for i in given]
    ends = [s.indices(n)[:2] for s, n in zip(slices, shape, strict=True)]
    part = np.empty([max(b - a, 0) for a, b in ends], dtype)
    cut = [axis for axis, n in enumerate(shape) if part.shape[axis] < n]
    # From the axis `rows` on what is read lies together: rows that are cut are read with what is
    # between them, unless that is long.
    rows = last = cut[-1] if cut else 0
    if rows and math.prod(shape[last:]) * dtype.itemsize <= _LONG:
        rows -= 1
    inner = (slice(None), *(slice(*e) for e in ends[rows + 1 :]))
    sizes = [math.prod(shape[axis + 1 :]) * dtype.itemsize for axis in range(len(shape))]
    run = (*part.shape[rows : rows + 1], *shape[rows + 1 :])
    with open(path, "rb") as file:
        for place in np.ndindex(part.shape[:rows]) if part.size else ():
            first = [a + i for (a, _), i in zip(ends, (*place, 0), strict=False)]
            file.seek(offset + sum(i * n for i, n in zip(first, sizes, strict=False)))
            own = part[place]
            # Rows that are not cut are read to their place.
            values = own if own.shape == run else np.empty(run, dtype)
            if file.readinto(values.reshape(-1).view(np.uint8).data) < values.nbytes:
                raise FileFormatError(f"{path.name} is cut short: it ends at byte {file.tell()}")
            if values is not own:
                own[...] = values[inner]
    check_age(path)
    numbers = tuple(0 if isinstance(i, int) else slice(None) for i in given)
    return np.asarray(part[numbers])


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
    check_readable(path)
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
