"""Unformatted files of Fortran: records, with their length in bytes in front and behind."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError
from .opened import OpenedFile

_MARK = 4
# The first record holds one or two whole numbers: that tells the byte order.
_FIRST = (4, 8, 16)


class RecordFile(OpenedFile):
    """An unformatted file, read from its beginning; of either byte order.

    Whole numbers in grids have four bytes, those in files with data eight.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._size = os.fstat(self._file.fileno()).st_size
        first = self._file.read(_MARK)
        self._file.seek(0)
        self._order = ">" if int.from_bytes(first, "big") in _FIRST else "<"
        self._whole, self._left = "i4", b""

    def format(self, precision: bool) -> int:
        """Return the format number; in files with data the length of records follows."""
        self._whole = "i8" if precision else "i4"
        number, *_ = self.integers(1 + precision, "the format number")
        return number

    def integers(self, count: int, what: str) -> list[int]:
        """Return whole numbers from one or several records."""
        found: list[int] = self._read(count, self._whole, what).tolist()
        return found

    def reals(self, count: int, what: str) -> NDArray[np.float64]:
        """Return double-precision numbers from one or several records."""
        return self._read(count, "f8", what).astype(np.float64)

    def _read(self, count: int, kind: str, what: str) -> NDArray[np.generic]:
        dtype = np.dtype(self._order + kind)
        needed = count * dtype.itemsize
        while len(self._left) < needed:
            self._left += self._record(what)
        found, self._left = self._left[:needed], self._left[needed:]
        return np.frombuffer(found, dtype)

    def _record(self, what: str) -> bytes:
        place = self._file.tell()
        length = self._mark()
        if length is None or length > self._size - place - 2 * _MARK:
            raise FileFormatError(f"byte {place}: {what}: expected a record, but the file ends")
        if length < 0:
            raise FileFormatError(
                f"byte {place}: {what}: a record of {length} bytes; those of 2 GiB and more, which "
                "are split, cannot be read"
            )
        content = self._file.read(length)
        if self._mark() != length:
            raise FileFormatError(f"byte {place}: {what}: a record does not end with its length")
        return content

    def _mark(self) -> int | None:
        mark = self._file.read(_MARK)
        if len(mark) < _MARK:
            return None
        return int(np.frombuffer(mark, self._order + "i4")[0])

    def flags(self, what: str) -> NDArray[np.uint8]:
        """Return all that is left: one record per whole number that is 0 or 1."""
        self._check_boundary(what)
        place = self._file.tell()
        record = np.dtype([(name, f"{self._order}i4") for name in ("before", "flag", "after")])
        content = self._file.read()
        if len(content) % record.itemsize:
            raise FileFormatError(f"{what}: the file ends within a record")
        rows = np.frombuffer(content, record)
        marked = (rows["before"] == _MARK) & (rows["after"] == _MARK)
        wrong = ~marked | (rows["flag"] < 0) | (rows["flag"] > 1)
        if wrong.any():
            at = place + int(np.argmax(wrong)) * record.itemsize
            raise FileFormatError(f"byte {at}: {what}: expected a record with 0 or 1")
        return rows["flag"].astype(np.uint8)

    def _check_boundary(self, what: str) -> None:
        if self._left:
            raise FileFormatError(f"byte {self._file.tell()}: {what}: a record is too long")

    def end(self) -> None:
        """Check that nothing is left."""
        self._check_boundary("the end")
        if self._file.tell() != self._size:
            raise FileFormatError(f"byte {self._file.tell()}: expected nothing more")

    def planes(self, count: int, size: int) -> RecordPlanes:
        """Return what is left: `count` planes of `size` numbers, each beginning a record."""
        self._check_boundary("the data")
        offset = self._file.tell()
        length = self._mark()
        dtype = np.dtype(self._order + "f8")
        if length is None or length < dtype.itemsize or length % dtype.itemsize:
            raise FileFormatError(
                f"byte {offset}: expected a record of numbers of 8 bytes, got one of {length} bytes"
            )
        planes = RecordPlanes(self.path, offset, size, length // dtype.itemsize, dtype)
        expected = offset + count * planes.records * (length + 2 * _MARK)
        if expected != self._size:
            told = "it is cut short: " if self._size < expected else ""
            raise FileFormatError(
                f"{told}{count} times {size} numbers in records of {length} bytes make {expected} "
                f"bytes, but it has {self._size}"
            )
        return planes


class RecordPlanes:
    """Planes of numbers in records of one length, of which the last in a plane may be filled up."""

    mapped = False

    def __init__(
        self, path: Path, offset: int, size: int, per_record: int, dtype: np.dtype[np.float64]
    ) -> None:
        self.path, self.offset, self.size, self.dtype = path, offset, size, dtype
        self.per_record, self.records = per_record, -(-size // per_record)

    def plane(self, index: int) -> NDArray[np.float64]:
        """Return the numbers of a plane."""
        mark = self.dtype.str[0] + "i4"
        record = np.dtype(
            [("before", mark), ("data", self.dtype, (self.per_record,)), ("after", mark)]
        )
        offset = self.offset + index * self.records * record.itemsize
        rows = np.memmap(self.path, record, "r", offset, (self.records,))
        length = self.per_record * self.dtype.itemsize
        if (rows["before"] != length).any() or (rows["after"] != length).any():
            raise FileFormatError(f"records of {length} bytes are expected from byte {offset} on")
        found: NDArray[np.float64] = rows["data"].reshape(-1)[: self.size]
        return found
