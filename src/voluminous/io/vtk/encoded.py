"""The values of one array in an XML file of VTK: where they are, and how they are written."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from ...errors import FileFormatError
from ...memory import check_memory
from ..guard import placed
from ..payload import mapped, read_exactly
from .base64_text import Base64Text
from .blocks import MOST_PACKED, Stream, unpack
from .text import numbers

# Text looked at to count numbers in it: more is data, not a remark.
_REMARK = 1 << 16
# Bytes at a file's end in which its last tag must be.
_TAIL = 1024


@dataclass(frozen=True)
class Encoding:
    """What holds for all arrays of a file.

    Attributes
    ----------
    path : Path
        The file.
    order : str
        Byte order, as NumPy writes it.
    head : str
        Type of the numbers that precede values.
    compressor : str
        VTK's name of it; empty for none.
    appended : int
        First byte of the appended data; -1 if there is none.
    raw : bool
        True if appended data are plain bytes, False for base64.
    """

    path: Path
    order: str
    head: str
    compressor: str
    appended: int
    raw: bool

    @property
    def head_type(self) -> np.dtype[Any]:
        """Type of the numbers that precede values, in this file's byte order."""
        return np.dtype(self.head).newbyteorder(self.order)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Encoded:
    """One array in a file.

    Attributes
    ----------
    name : str
        Where it is, for error messages.
    encoding : Encoding
        The file's.
    format : str
        ``"ascii"``, ``"binary"`` or ``"appended"``.
    dtype : dtype
        Type of the values.
    start, end : int
        Bytes of the text between which they are; appended ones end anywhere.
    """

    name: str
    encoding: Encoding
    format: str
    dtype: np.dtype[Any]
    start: int
    end: int

    def check(self, count: int) -> None:
        """Refuse more values than a file of this size can hold, before memory is taken.

        Raises
        ------
        FileFormatError
            Says which array it is.
        """
        size = count * self.dtype.itemsize if self.format != "ascii" else 2 * count - 1
        most = self.encoding.path.stat().st_size
        if self.encoding.compressor and self.format != "ascii":
            most *= MOST_PACKED
        if size > most:
            raise FileFormatError(
                f"array {self.name!r}: {count} values of {self.dtype} are announced, more than a "
                "file of this size holds; it is cut short or damaged"
            )

    def values(self, count: int) -> np.ndarray:
        """Return so many values.

        Raises
        ------
        FileFormatError
            If there are fewer or more; says which array it is.
        """
        with placed(f"array {self.name!r}"):
            return self._values(count)

    def _values(self, count: int) -> np.ndarray:
        if self.format == "ascii":
            with open(self.encoding.path, "rb") as file:
                file.seek(self.start)
                return numbers(file, count, self.dtype, "its text", self.end)
        dtype = self.dtype.newbyteorder(self.encoding.order)  # type: ignore[arg-type]
        if self.format == "appended" and self.encoding.raw and not self.encoding.compressor:
            return self._mapped(count, dtype)
        with self._stream() as (stream, room):
            if self.encoding.compressor:
                return self._unpacked(stream, room, count, dtype)
            _check_size(stream.read(self.encoding.head_type.itemsize), self.encoding, count, dtype)
            _check_room(count * dtype.itemsize, room)
            return read_exactly(stream, (count,), dtype, "its values")  # type: ignore[arg-type]

    def size(self) -> int:
        """Return the number of values that the file announces; of long texts, some large one."""
        if self.format == "ascii":
            with open(self.encoding.path, "rb") as file:
                file.seek(self.start)
                return len(file.read(min(self.end - self.start, _REMARK)).split())
        kind = self.encoding.head_type
        count = 3 if self.encoding.compressor else 1
        with self._stream() as (stream, _):
            head = stream.read(count * kind.itemsize)
        sizes = [int(n) for n in np.frombuffer(head, kind)]
        if self.encoding.compressor:
            blocks, block, last = sizes
            sizes = [blocks * block - (block - last if last else 0)]
        return sizes[0] // self.dtype.itemsize

    def _mapped(self, count: int, dtype: np.dtype[Any]) -> np.ndarray:
        """Return values that are in the file as they are in memory."""
        with open(self.encoding.path, "rb") as file:
            file.seek(self.start)
            head = file.read(self.encoding.head_type.itemsize)
        _check_size(head, self.encoding, count, dtype)
        return mapped(self.encoding.path, self.start + len(head), (count,), dtype)

    def _unpacked(self, stream: Stream, room: int, count: int, dtype: np.dtype[Any]) -> np.ndarray:
        size = count * dtype.itemsize
        check_memory(size, "unpacking it", "read a coarser copy, or fewer fields")
        head, name = self.encoding.head_type, self.encoding.compressor
        return np.frombuffer(unpack(stream, room, size, head, name), dtype)

    @contextmanager
    def _stream(self) -> Iterator[tuple[Stream, int]]:
        """Give the bytes from the start on, and how many there are at most."""
        with open(self.encoding.path, "rb") as file:
            last = self.end if self.format == "binary" else file.seek(0, 2)
            file.seek(self.start)
            room = max(last - self.start, 0)
            if self.format == "appended" and self.encoding.raw:
                yield file, room
            else:
                yield Base64Text(file, self.end if self.format == "binary" else None), room


def appended_start(file: IO[bytes], element: int) -> int:
    """Return the first byte of the appended data: that behind the underscore.

    Parameters
    ----------
    file : binary file
        The whole file.
    element : int
        Byte at which ``<AppendedData`` begins.
    """
    file.seek(element)
    begin = file.read(4096)
    mark = begin.find(b"_", begin.find(b">") + 1)
    if mark < 0 or begin[begin.find(b">") + 1 : mark].strip():
        raise FileFormatError(f"byte {element}: expected '_' and values in <AppendedData>")
    file.seek(max(file.seek(0, 2) - _TAIL, 0))
    if b"</VTKFile" not in file.read():
        raise FileFormatError("it is cut short: expected </VTKFile> at its end")
    return element + mark + 1


def _check_size(head: bytes, encoding: Encoding, count: int, dtype: np.dtype[Any]) -> None:
    """Check the number of bytes that precedes values which are not compressed."""
    kind = encoding.head_type
    if len(head) < kind.itemsize:
        raise FileFormatError("cut short before its values")
    size = int(np.frombuffer(head, kind)[0])
    if size != count * dtype.itemsize:
        raise FileFormatError(
            f"{size} bytes are announced, expected {count * dtype.itemsize} for {count} values of "
            f"{dtype}"
        )


def _check_room(size: int, room: int) -> None:
    if size > room:
        raise FileFormatError(f"expected {size} bytes, but only {room} are left: it is cut short")
