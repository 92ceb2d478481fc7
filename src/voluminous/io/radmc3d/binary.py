"""Binary files: whole numbers of eight bytes, then numbers of four or eight."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError
from ..payload import mapped
from .opened import OpenedFile

_REALS = {4: "f4", 8: "f8"}
# The byte order in which the format number is small is the right one.
_LARGEST_FORMAT = 1 << 16


class BinaryFile(OpenedFile):
    """A binary file, read from its beginning; of either byte order."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._order, self._precision = "<", 8

    def format(self, precision: bool) -> int:
        """Return the format number; in files with data the precision follows."""
        (number,) = self.integers(1, "the format number")
        if not 0 <= number < _LARGEST_FORMAT:
            swapped = int(np.array(number, "<i8").byteswap())
            if 0 <= swapped < _LARGEST_FORMAT:
                self._order, number = ">", swapped
        if precision:
            (self._precision,) = self.integers(1, "the precision")
            if self._precision not in _REALS:
                raise FileFormatError(
                    f"the precision must be 4 or 8 bytes per number, got {self._precision}"
                )
        return number

    def integers(self, count: int, what: str) -> list[int]:
        """Return whole numbers."""
        found: list[int] = self._read(count, "i8", what).tolist()
        return found

    def reals(self, count: int, what: str) -> NDArray[np.float64]:
        """Return double-precision numbers."""
        return self._read(count, "f8", what).astype(np.float64)

    def _read(self, count: int, kind: str, what: str) -> NDArray[np.generic]:
        dtype = np.dtype(self._order + kind)
        left = os.fstat(self._file.fileno()).st_size - self._file.tell()
        if left < count * dtype.itemsize:
            raise FileFormatError(
                f"byte {self._file.tell()}: {what}: expected {count} numbers of {dtype.itemsize} "
                f"bytes, but only {left} bytes are left"
            )
        return np.frombuffer(self._file.read(count * dtype.itemsize), dtype)

    def flags(self, what: str) -> NDArray[np.uint8]:
        """Return all that is left: bytes that are 0 or 1."""
        place = self._file.tell()
        flags = np.frombuffer(self._file.read(), np.uint8)
        if (wrong := flags > 1).any():
            at = int(np.argmax(wrong))
            raise FileFormatError(f"byte {place + at}: {what}: expected 0 or 1, got {flags[at]}")
        return flags

    def end(self) -> None:
        """Check that nothing is left."""
        if rest := self._file.read(1):
            raise FileFormatError(
                f"byte {self._file.tell() - 1}: expected nothing more, got {rest!r}"
            )

    def width(self, cells: int) -> int:
        """Return how many numbers are left per cell."""
        left = self.path.stat().st_size - self._file.tell()
        return left // (cells * self._precision)

    def planes(self, count: int, size: int) -> BinaryPlanes:
        """Return what is left: `count` planes of `size` numbers."""
        dtype = np.dtype(self._order + _REALS[self._precision])
        found, offset = self.path.stat().st_size, self._file.tell()
        expected = offset + count * size * dtype.itemsize
        if found != expected:
            told = "it is cut short: " if found < expected else ""
            raise FileFormatError(
                f"{told}{count * size} numbers of {dtype.itemsize} bytes from byte {offset} on "
                f"make {expected} bytes, but it has {found}"
            )
        return BinaryPlanes(self.path, offset, size, dtype)


class BinaryPlanes:
    """Planes of numbers in a binary file, one after the other; they stay in the file."""

    mapped = True

    def __init__(self, path: Path, offset: int, size: int, dtype: np.dtype[np.generic]) -> None:
        self.path, self.offset, self.size, self.dtype = path, offset, size, dtype

    def plane(self, index: int) -> NDArray[np.generic]:
        """Return the numbers of a plane."""
        offset = self.offset + index * self.size * self.dtype.itemsize
        return mapped(self.path, offset, (self.size,), self.dtype)
