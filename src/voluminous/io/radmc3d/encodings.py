"""Readers and writers for RADMC-3D's three file encodings: text, binary and Fortran records.

Integers and reals come in the same order in all three. A file is read sequentially; `planes` then
returns the cell values, which are read on first use.
"""

from __future__ import annotations

import os
import re
import warnings
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError
from ..payload import mapped

if TYPE_CHECKING:
    from typing_extensions import Self

Reals = NDArray[np.float64]
_REALS = {4: "f4", 8: "f8"}
# The byte order is the one in which the format number is small.
_LARGEST_FORMAT = 1 << 16
_CUT = "it is cut short: "


class EncodedFile:
    """An input file, opened and closed by a `with` block."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path.open("rb")
        self._size = os.fstat(self._file.fileno()).st_size

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()

    def format(self, precision: bool) -> int:
        """Return the format number; in files of cell values the precision follows it."""
        raise NotImplementedError

    def integers(self, count: int, what: str) -> list[int]:
        """Read `count` integers."""
        raise NotImplementedError

    def reals(self, count: int, what: str) -> Reals:
        """Read `count` double-precision numbers."""
        raise NotImplementedError

    def flags(self, what: str) -> NDArray[np.uint8]:
        """Read the rest of the file as numbers that are 0 or 1."""
        raise NotImplementedError

    def end(self) -> None:
        """Check that the file is read to its end."""
        raise NotImplementedError

    def width(self, cells: int) -> int:
        """Return the number of values per cell in the rest of the file; 0 if it is ambiguous."""
        return 0

    def planes(self, count: int, size: int) -> ValuePlanes:
        """Return the rest of the file as `count` planes of `size` numbers."""
        raise NotImplementedError


class ValuePlanes:
    """Cell values as consecutive planes."""

    dtype: np.dtype = np.dtype(np.float64)
    mapped = False  # values are not read yet

    def plane(self, index: int) -> np.ndarray:
        raise NotImplementedError


# Text

_WHOLE = re.compile(rb"[+-]?\d{1,18}")
# Fortran omits the letter E before an exponent of three digits: 1.0-100.
_NUMBER = re.compile(rb"([+-]?(?:\d+\.?\d*|\.\d+))(?:[eEdDqQ]?([+-]\d+)|[eEdDqQ](\d+))?")
_WORDS = re.compile(rb"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)
_LETTERS = bytes.maketrans(b"dDqQ", b"eeee")
_LONGEST_LINE = 1 << 26
_BLOCK = 1 << 22
_SHOWN = 32
# Number of values at the end of a file that show the number format, if they have this length.
_LAST, _FIXED = 9, 8


def number(token: bytes) -> float:
    """Return a number in Fortran notation; raise ValueError for any other text."""
    found = _NUMBER.fullmatch(token)
    if found is None:
        if _WORDS.fullmatch(token):
            return float(token)
        raise ValueError(f"expected a number, got {_shown(token)}")
    digits, signed, unsigned = found.groups()
    return float(digits + b"e" + (signed or unsigned or b"0"))


def _shown(token: bytes) -> str:
    text = token[:_SHOWN].decode("ascii", "backslashreplace")
    return repr(text) + (" …" if len(token) > _SHOWN else "")


class TextFile(EncodedFile):
    """A text file read as by Fortran: each read starts on a new line and skips the rest of it."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._line = 0

    def format(self, precision: bool) -> int:
        return self.integers(1, "the format number")[0]

    def integers(self, count: int, what: str) -> list[int]:
        tokens: list[bytes] = []
        while len(tokens) < count:
            tokens += self._tokens(what, f"{count} whole number{'s' * (count > 1)}")
            for token in tokens[:count]:
                if not _WHOLE.fullmatch(token):
                    raise self._error(what, f"expected a whole number, got {_shown(token)}")
        return [int(token) for token in tokens[:count]]

    def reals(self, count: int, what: str) -> Reals:
        values: list[float] = []
        while len(values) < count:
            tokens = self._tokens(what, f"{count} numbers, after {len(values)}")
            try:
                values += map(number, tokens)
            except ValueError as error:
                raise self._error(what, str(error)) from None
        if len(values) > count:
            raise self._error(what, f"expected {count} numbers, found {len(values)}")
        return np.array(values)

    def _tokens(self, what: str, expected: str) -> list[bytes]:
        while line := self._file.readline(_LONGEST_LINE):
            self._line += 1
            if tokens := line.split():
                return tokens
        raise self._error(what, f"expected {expected}, but the file ends")

    def _error(self, what: str, message: str) -> FileFormatError:
        return FileFormatError(f"line {self._line}: {what}: {message}")

    def flags(self, what: str) -> NDArray[np.uint8]:
        text = np.frombuffer(self._file.read(), np.uint8)
        digit = text > 32
        wrong = digit & ((text < 48) | (text > 49))
        wrong[1:] |= digit[1:] & digit[:-1]
        if wrong.any():
            self._line += 1 + int(np.count_nonzero(text[: int(np.argmax(wrong))] == 10))
            raise self._error(what, "expected 0 or 1, one per line")
        return text[digit] - np.uint8(48)

    def end(self) -> None:
        while line := self._file.readline(_LONGEST_LINE):
            self._line += 1
            if tokens := line.split():
                raise self._error("the end", f"expected nothing more, got {_shown(tokens[0])}")

    def width(self, cells: int) -> int:
        place = self._file.tell()
        tokens = self._file.readline(_LONGEST_LINE).split()
        self._file.seek(place)
        return len(tokens)

    def planes(self, count: int, size: int) -> TextPlanes:
        left = self._size - self._file.tell()
        if left < 2 * count * size - 1:  # one digit and one space per flag
            raise FileFormatError(
                f"{_CUT}{count * size} numbers are promised, but only {left} characters are left"
            )
        return TextPlanes(self.path, self._file.tell(), self._line, count * size)


class TextPlanes(ValuePlanes):
    """The numbers in the rest of a text file, as one plane."""

    def __init__(self, path: Path, offset: int, line: int, size: int) -> None:
        self.path, self.offset, self.line, self.size = path, offset, line, size

    def plane(self, index: int) -> Reals:
        values, found, line, text = np.empty(self.size), 0, self.line + 1, b""
        with self.path.open("rb") as file:
            file.seek(self.offset)
            while block := file.read(_BLOCK):
                block = text + block
                cut = max(block.rfind(space) for space in (b"\n", b" ", b"\t")) + 1
                block, text = block[:cut], block[cut:]
                found = self._put(values, found, block, line)
                line += block.count(b"\n")
        self._check_end(text)
        found = self._put(values, found, text, line)
        if found != self.size:
            short = _CUT if found < self.size else ""
            raise FileFormatError(f"{short}expected {self.size} numbers, found {found}")
        return values

    def _put(self, values: Reals, first: int, text: bytes, line: int) -> int:
        read = _numbers(text, line)
        if first < self.size:
            values[first : first + len(read)] = read[: self.size - first]
        return first + len(read)

    def _check_end(self, last: bytes) -> None:
        """Refuse a file truncated within a number: no final newline, and a shorter last number."""
        with self.path.open("rb") as file:
            file.seek(max(self.path.stat().st_size - 2048, self.offset))
            numbers = [token.lstrip(b"+-") for token in file.read().split()[1:]][-_LAST:]
        if not last or len(numbers) < _LAST:
            return
        *others, length = map(len, numbers)
        if len(set(others)) == 1 and length < others[0] and others[0] >= _FIXED:
            raise FileFormatError(f"{_CUT}it ends within a number, {_shown(last)}")


def _numbers(text: bytes, line: int) -> Reals:
    """Return the numbers in a text that begins at line `line` of the file."""
    if not text or text.isspace():
        return np.empty(0)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # older NumPy warns if the text is not a number
            return np.fromstring(text.translate(_LETTERS).decode("ascii"), sep=" ")
    except (ValueError, DeprecationWarning):
        values: list[float] = []
        for k, row in enumerate(text.split(b"\n")):
            try:
                values += map(number, row.split())
            except ValueError as error:
                raise FileFormatError(f"line {line + k}: {error}") from None
        return np.array(values)


# Binary


class BinaryFile(EncodedFile):
    """A binary file of either byte order: integers of eight bytes, then reals of four or eight."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._order, self._precision = "<", 8

    def format(self, precision: bool) -> int:
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
        found: list[int] = self._read(count, "i8", what).tolist()
        return found

    def reals(self, count: int, what: str) -> Reals:
        return self._read(count, "f8", what).astype(np.float64)

    def _read(self, count: int, kind: str, what: str) -> np.ndarray:
        dtype = np.dtype(self._order + kind)
        left = self._size - self._file.tell()
        if left < count * dtype.itemsize:
            raise FileFormatError(
                f"byte {self._file.tell()}: {what}: expected {count} numbers of {dtype.itemsize} "
                f"bytes, but only {left} bytes are left"
            )
        return np.frombuffer(self._file.read(count * dtype.itemsize), dtype)

    def flags(self, what: str) -> NDArray[np.uint8]:
        place = self._file.tell()
        flags = np.frombuffer(self._file.read(), np.uint8)
        if (wrong := flags > 1).any():
            at = int(np.argmax(wrong))
            raise FileFormatError(f"byte {place + at}: {what}: expected 0 or 1, got {flags[at]}")
        return flags

    def end(self) -> None:
        if self._file.tell() != self._size:
            raise FileFormatError(f"byte {self._file.tell()}: expected nothing more")

    def width(self, cells: int) -> int:
        return (self._size - self._file.tell()) // (cells * self._precision)

    def planes(self, count: int, size: int) -> BinaryPlanes:
        dtype = np.dtype(self._order + _REALS[self._precision])
        offset = self._file.tell()
        expected = offset + count * size * dtype.itemsize
        if self._size != expected:
            raise FileFormatError(
                f"{_CUT if self._size < expected else ''}{count * size} numbers of "
                f"{dtype.itemsize} bytes from byte {offset} on make {expected} bytes, but it has "
                f"{self._size}"
            )
        return BinaryPlanes(self.path, offset, size, dtype)


class BinaryPlanes(ValuePlanes):
    """ValuePlanes read from a binary file on use."""

    mapped = True

    def __init__(self, path: Path, offset: int, size: int, dtype: np.dtype) -> None:
        self.path, self.offset, self.size, self.dtype = path, offset, size, dtype

    def plane(self, index: int) -> np.ndarray:
        offset = self.offset + index * self.size * self.dtype.itemsize
        return mapped(self.path, offset, (self.size,), self.dtype)


# Fortran records: a four-byte length (in bytes) precedes and follows each record

_MARK = 4
# The first record holds one or two integers: its length shows the byte order.
_FIRST = (4, 8, 16)


class RecordFile(EncodedFile):
    """An unformatted Fortran file of either byte order.

    Integers have four bytes in grid files and eight in files of cell values.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        first = self._file.read(_MARK)
        self._file.seek(0)
        self._order = ">" if int.from_bytes(first, "big") in _FIRST else "<"
        self._whole, self._left = "i4", b""

    def format(self, precision: bool) -> int:
        self._whole = "i8" if precision else "i4"
        number, *_ = self.integers(1 + precision, "the format number")
        return number

    def integers(self, count: int, what: str) -> list[int]:
        found: list[int] = self._read(count, self._whole, what).tolist()
        return found

    def reals(self, count: int, what: str) -> Reals:
        return self._read(count, "f8", what).astype(np.float64)

    def _read(self, count: int, kind: str, what: str) -> np.ndarray:
        """Read numbers that span one or more records."""
        dtype = np.dtype(self._order + kind)
        needed = count * dtype.itemsize
        while len(self._left) < needed:
            self._left += self._record(what)
        found, self._left = self._left[:needed], self._left[needed:]
        return np.frombuffer(found, dtype)

    def _record(self, what: str) -> bytes:
        place = self._file.tell()
        length = self._mark()
        if not 0 <= length <= self._size - place - 2 * _MARK:
            raise FileFormatError(f"byte {place}: {what}: expected a record, but the file ends")
        content = self._file.read(length)
        if self._mark() != length:
            raise FileFormatError(f"byte {place}: {what}: a record does not end with its length")
        return content

    def _mark(self) -> int:
        mark = self._file.read(_MARK)
        return int(np.frombuffer(mark, self._order + "i4")[0]) if len(mark) == _MARK else -1

    def flags(self, what: str) -> NDArray[np.uint8]:
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
        self._check_boundary("the end")
        if self._file.tell() != self._size:
            raise FileFormatError(f"byte {self._file.tell()}: expected nothing more")

    def planes(self, count: int, size: int) -> RecordPlanes:
        self._check_boundary("the data")
        offset = self._file.tell()
        length = self._mark()
        dtype = np.dtype(self._order + "f8")
        if length < dtype.itemsize or length % dtype.itemsize:
            raise FileFormatError(
                f"byte {offset}: expected a record of numbers of 8 bytes, got one of {length} bytes"
            )
        planes = RecordPlanes(self.path, offset, size, length // dtype.itemsize, dtype)
        expected = offset + count * planes.records * (length + 2 * _MARK)
        if expected != self._size:
            raise FileFormatError(
                f"{_CUT if self._size < expected else ''}{count} times {size} numbers in records "
                f"of {length} bytes make {expected} bytes, but it has {self._size}"
            )
        return planes


class RecordPlanes(ValuePlanes):
    """ValuePlanes in records of equal length; the last record of a plane may be padded."""

    def __init__(
        self, path: Path, offset: int, size: int, per_record: int, dtype: np.dtype
    ) -> None:
        self.path, self.offset, self.size, self.dtype = path, offset, size, dtype
        self.per_record, self.records = per_record, -(-size // per_record)

    def plane(self, index: int) -> Reals:
        mark = self.dtype.str[0] + "i4"
        record = np.dtype(
            [("before", mark), ("data", self.dtype, (self.per_record,)), ("after", mark)]
        )
        offset = self.offset + index * self.records * record.itemsize
        rows = np.memmap(self.path, record, "r", offset, (self.records,))
        length = self.per_record * self.dtype.itemsize
        if (rows["before"] != length).any() or (rows["after"] != length).any():
            raise FileFormatError(f"records of {length} bytes are expected from byte {offset} on")
        found: Reals = rows["data"].reshape(-1)[: self.size]
        return found


# Writing

# This many digits reproduce every double exactly.
_REAL = "%.16e"
# Number of values converted to text or bytes at a time.
_PIECE = 1 << 16


class TextOut:
    """Writes a text file: one line per call or per cell."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def format(self, number: int, single: bool | None = None) -> None:
        """Write the format number."""
        self.integers(number)

    def integers(self, *numbers: int) -> None:
        self._file.write((" ".join(map(str, numbers)) + "\n").encode())

    def rows(self, columns: list[np.ndarray]) -> None:
        """Write columns side by side."""
        line = " ".join([_REAL] * len(columns)) + "\n"
        for first in range(0, len(columns[0]), _PIECE):
            piece = np.stack([c[first : first + _PIECE] for c in columns], axis=1)
            self._file.write((line * len(piece) % tuple(piece.ravel().tolist())).encode())

    def flags(self, flags: NDArray[np.uint8]) -> None:
        lines = np.full((len(flags), 2), ord("\n"), np.uint8)
        lines[:, 0] = ord("0") + flags
        self._file.write(lines.tobytes())


class BinaryOut(TextOut):
    """Writes a binary file."""

    _real = "<f8"

    def format(self, number: int, single: bool | None = None) -> None:
        """Write the format number, and the precision in data files (`single` is not None)."""
        self.integers(number)
        if single is not None:
            self._real = "<f4" if single else "<f8"
            self.integers(4 if single else 8)

    def integers(self, *numbers: int) -> None:
        self._file.write(np.array(numbers, "<i8").tobytes())

    def rows(self, columns: list[np.ndarray]) -> None:
        for first in range(0, len(columns[0]), _PIECE):
            piece = np.stack([c[first : first + _PIECE] for c in columns], axis=1)
            self._file.write(piece.astype(self._real).tobytes())

    def flags(self, flags: NDArray[np.uint8]) -> None:
        self._file.write(flags.tobytes())
