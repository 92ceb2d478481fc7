"""Readers and writers of Fortran's three encodings, as RADMC-3D has them: text, binary, records.

Integers and reals come in the same order in all three. A file is read sequentially; `data` then
returns the cell values, which are read on first use.
"""

from __future__ import annotations

import functools
import re
import warnings
from codecs import BOM_UTF8
from collections.abc import Callable
from contextlib import suppress
from itertools import takewhile
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import FileFormatError
from ..files import check_age
from .payload import stored

if TYPE_CHECKING:
    from typing_extensions import Self

Reals = NDArray[np.float64]
Flags = NDArray[np.uint8]
CUT = "it is cut short: "
# What begins a comment, in a line of its own or behind numbers.
COMMENTS = (b"#", b"!", b";")
# The byte order is the one in which the format number is small.
_LARGEST_FORMAT = 1 << 16


class CellData(NamedTuple):
    """Cell values as consecutive planes."""

    plane: Callable[..., np.ndarray]
    dtype: np.dtype = np.dtype(np.float64)
    in_parts: bool = False  # `plane` takes slices, of a part of one


class BinaryFile:
    """A binary file of either byte order: integers of eight bytes, then reals of four or eight.

    It is opened and closed by a `with` block.
    """

    order, whole, real = "<", "i8", "f8"

    def __init__(self, path: Path) -> None:
        self.path, self.size = path, path.stat().st_size
        self.file = path.open("rb")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()

    def format(self, precision: bool) -> int:
        """Return the format number; in files of cell values the precision follows it."""
        (number,) = self.integers(1, "the format number")
        if not 0 <= number < _LARGEST_FORMAT:
            self.order, number = ">", int(np.array(number, "<i8").byteswap())
        if precision:
            (size,) = self.integers(1, "the precision")
            if size not in (4, 8):
                raise FileFormatError(f"the precision must be 4 or 8 bytes per number, got {size}")
            self.real = f"f{size}"
        return number

    def integers(self, count: int, what: str) -> list[int]:
        """Read `count` integers."""
        numbers: list[int] = self.numbers(count, self.whole, what).tolist()
        return numbers

    def reals(self, count: int, what: str) -> Reals:
        """Read `count` double-precision numbers."""
        return self.numbers(count, "f8", what).astype(np.float64)

    def numbers(self, count: int, kind: str, what: str) -> np.ndarray:
        dtype = np.dtype(self.order + kind)
        return np.frombuffer(self.content(count * dtype.itemsize, what), dtype)

    def content(self, size: int, what: str) -> bytes:
        place = self.file.tell()
        if self.size - place < size:
            raise FileFormatError(
                f"{CUT}byte {place}: {what}: expected {size} bytes, but only {self.size - place} "
                "are left"
            )
        return self.file.read(size)

    def flags(self, what: str) -> Flags:
        """Read the rest of the file as numbers that are 0 or 1."""
        return _checked_flags(np.frombuffer(self.file.read(), np.uint8), what)

    def end(self) -> None:
        """Check that the file is read to its end."""
        if self.file.tell() != self.size:
            raise FileFormatError(f"byte {self.file.tell()}: expected nothing more")

    def width(self, cells: int) -> int:
        """Return the number of values per cell in the rest of the file."""
        return (self.size - self.file.tell()) // (cells * int(self.real[1]))

    def data(self, count: int, size: int) -> CellData:
        """Return the rest of the file as `count` planes of `size` numbers."""
        dtype, offset, path = np.dtype(self.order + self.real), self.file.tell(), self.path
        self.check_size(
            offset + count * size * dtype.itemsize,
            f"{count * size} numbers of {dtype.itemsize} bytes",
        )
        return CellData(functools.partial(_plane, path, offset, size, dtype), dtype, True)

    def check_size(self, expected: int, what: str) -> None:
        if self.size != expected:
            short = CUT if self.size < expected else ""
            raise FileFormatError(
                f"{short}{what} from byte {self.file.tell()} on make {expected} bytes, but it has "
                f"{self.size}"
            )


def _plane(
    path: Path, offset: int, size: int, dtype: np.dtype, k: int, index: Any = ...
) -> np.ndarray:
    return stored(path, offset + k * size * dtype.itemsize, (size,), dtype, index)


def _checked_flags(flags: np.ndarray, what: str) -> Flags:
    wrong = (flags != 0) & (flags != 1)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise FileFormatError(f"{what}: expected 0 or 1, but flag {at + 1} is {flags[at]}")
    return flags.astype(np.uint8)


# Fortran records: a four-byte length (in bytes) precedes and follows each record

_MARK = 4
# The first record holds one or two integers: its length shows the byte order.
_FIRST = (4, 8, 16)


class RecordFile(BinaryFile):
    """An unformatted Fortran file of either byte order.

    Integers have four bytes in grid files and eight in files of cell values.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.order = ">" if int.from_bytes(self.file.peek(_MARK)[:_MARK], "big") in _FIRST else "<"
        self.left = b""

    def format(self, precision: bool) -> int:
        self.whole = "i8" if precision else "i4"
        return self.integers(1 + precision, "the format number")[0]

    def content(self, size: int, what: str) -> bytes:
        """Read bytes that span one or more records."""
        while len(self.left) < size:
            (length,) = np.frombuffer(super().content(_MARK, what), self.order + "u4").tolist()
            record = super().content(length + _MARK, what)
            if int(np.frombuffer(record[length:], self.order + "u4")[0]) != length:
                raise FileFormatError(f"{what}: a record does not end with its length")
            self.left += record[:length]
        content, self.left = self.left[:size], self.left[size:]
        return content

    def flags(self, what: str) -> Flags:
        content = self.file.read()
        if self.left or len(content) % (3 * _MARK):
            raise FileFormatError(f"{what}: the file ends within a record")
        before, flags, after = np.frombuffer(content, self.order + "i4").reshape(-1, 3).T
        if (before != _MARK).any() or (after != _MARK).any():
            raise FileFormatError(f"{what}: expected records of one number")
        return _checked_flags(flags, what)

    def data(self, count: int, size: int) -> CellData:
        """Return planes in records of equal length; the last one of a plane may be padded."""
        offset, path, dtype = self.file.tell(), self.path, np.dtype(self.order + "f8")
        (length,) = np.frombuffer(super().content(_MARK, "the data"), self.order + "u4").tolist()
        if self.left or length < dtype.itemsize or length % dtype.itemsize:
            raise FileFormatError(
                f"byte {offset}: expected a record of numbers of 8 bytes, got one of {length} bytes"
            )
        mark, values = self.order + "u4", (dtype, (length // dtype.itemsize,))
        record = np.dtype([("before", mark), ("values", *values), ("after", mark)])
        records = -(-size * dtype.itemsize // length)
        self.check_size(
            offset + count * records * record.itemsize,
            f"{count} times {size} numbers in records of {length} bytes",
        )

        def plane(k: int) -> np.ndarray:
            start = offset + k * records * record.itemsize
            rows = stored(path, start, (records,), record)
            if (rows["before"] != length).any() or (rows["after"] != length).any():
                raise FileFormatError(f"expected records of {length} bytes from byte {start} on")
            return rows["values"].reshape(-1)[:size]

        return CellData(plane, dtype)


# Text

_WHOLE = re.compile(rb"[+-]?\d{1,18}")
_LETTERS = bytes.maketrans(b"dDqQ", b"eeee")
# Fortran omits the letter E before an exponent of three digits: 1.0-100.
_NO_LETTER = re.compile(rb"([\d.])([+-]\d)")
_LONGEST_LINE = 1 << 26
_BLOCK = 1 << 22
_SHOWN = 32
# Number of values at the end of a file that show the number format, if they have this length.
_LAST, _FIXED = 9, 8


class TextFile(BinaryFile):
    """A text file read as by Fortran: each read starts on a new line and skips the rest of it."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.line = 0
        if self.file.peek(len(BOM_UTF8)).startswith(BOM_UTF8):
            self.file.seek(len(BOM_UTF8))

    def format(self, precision: bool) -> int:
        return self.integers(1, "the format number")[0]

    def integers(self, count: int, what: str) -> list[int]:
        tokens: list[bytes] = []
        while len(tokens) < count:
            tokens += self.tokens(f"{what}: expected {count} whole number{'s' * (count > 1)}")
            for token in tokens[:count]:
                if not _WHOLE.fullmatch(token):
                    raise FileFormatError(
                        f"line {self.line}: {what}: expected a whole number, got {_shown(token)}"
                    )
        return [int(token) for token in tokens[:count]]

    def reals(self, count: int, what: str) -> Reals:
        values = np.empty(0)
        while len(values) < count:
            tokens = self.tokens(f"{what}: expected {count} numbers, after {len(values)}")
            row = b" ".join(before_comment(tokens))
            values = np.append(values, fortran_numbers(row, self.line))
        if len(values) > count:
            raise FileFormatError(
                f"line {self.line}: {what}: expected {count} numbers, found {len(values)}"
            )
        return values

    def tokens(self, expected: str) -> list[bytes]:
        while line := self.file.readline(_LONGEST_LINE):
            self.line += 1
            if tokens := line.split():
                return tokens
        raise FileFormatError(f"line {self.line}: {expected}, but the file ends")

    def comment(self) -> None:
        """Skip a line of comment, which may be empty, or a marked one behind empty lines."""
        self.line += 1
        if self.file.readline(_LONGEST_LINE).strip():
            return
        place, line = self.file.tell(), self.line
        if not self.tokens("what follows a comment")[0].startswith((*COMMENTS, b"--")):
            self.file.seek(place)
            self.line = line

    def flags(self, what: str) -> Flags:
        text = np.frombuffer(self.file.read(), np.uint8)
        digit = text > 32
        wrong = digit & ((text < 48) | (text > 49))
        wrong[1:] |= digit[1:] & digit[:-1]
        if wrong.any():
            line = self.line + 1 + np.count_nonzero(text[: int(np.argmax(wrong))] == 10)
            raise FileFormatError(f"line {line}: {what}: expected 0 or 1, one per line")
        flags: Flags = text[digit] - np.uint8(48)
        return flags

    def end(self) -> None:
        while line := self.file.readline(_LONGEST_LINE):
            self.line += 1
            if tokens := line.split():
                raise FileFormatError(
                    f"line {self.line}: the end: expected nothing more, got {_shown(tokens[0])}"
                )

    def width(self, cells: int) -> int:
        place = self.file.tell()
        tokens = self.file.readline(_LONGEST_LINE).split()
        self.file.seek(place)
        return len(tokens)

    def data(self, count: int, size: int) -> CellData:
        """Return the numbers in the rest of the file as one plane."""
        size, offset, line = count * size, self.file.tell(), self.line + 1
        if self.size - offset < 2 * size - 1:  # one digit and one space per number
            raise FileFormatError(
                f"{CUT}{size} numbers are promised, but only {self.size - offset} characters are "
                "left"
            )
        return CellData(lambda _: _values(self.path, offset, line, size))


def _values(path: Path, offset: int, line: int, size: int) -> Reals:
    values, count, end = np.empty(size), 0, b""
    with path.open("rb") as file:
        file.seek(offset)
        while block := file.read(_BLOCK) + file.readline():
            numbers = fortran_numbers(block, line)
            values[count : count + len(numbers)] = numbers[: max(size - count, 0)]
            count, line, end = count + len(numbers), line + block.count(b"\n"), block[-2048:]
    check_age(path)
    if not end.endswith(b"\n"):  # the last number may be cut
        *others, last = [len(t.lstrip(b"+-")) for t in end.split()[-_LAST:]]
        if len(others) == _LAST - 1 and {*others} == {max(others)} and last < max(others) >= _FIXED:
            raise FileFormatError(f"{CUT}it ends within a number, {_shown(end.split()[-1])}")
    if count != size:
        short = CUT if count < size else ""
        raise FileFormatError(f"{short}expected {size} numbers, found {count}")
    return values


def before_comment(tokens: list[bytes]) -> list[bytes]:
    """Return the words of a line before a comment: Fortran reads as many as it needs."""
    return list(takewhile(lambda token: not token.startswith(COMMENTS), tokens))


def fortran_numbers(text: bytes, line: int) -> Reals:
    """Return the numbers in a text that begins at line `line` of the file."""
    if not text.strip():
        return np.empty(0)
    text = text.translate(_LETTERS)
    for pattern in (None, _NO_LETTER):
        numbers = pattern.sub(rb"\1e\2", text) if pattern else text
        with warnings.catch_warnings(), suppress(ValueError, DeprecationWarning):
            warnings.simplefilter("error")  # older NumPy warns if the text is not a number
            return np.fromstring(numbers.decode("ascii"), sep=" ")
    tokens = text.split()
    if len(tokens) > 1:  # find the wrong one
        for k, row in enumerate(text.split(b"\n")):
            for token in row.split():
                fortran_numbers(token, line + k)
    raise FileFormatError(f"line {line}: expected a number, got {_shown(tokens[0])}")


def _shown(token: bytes) -> str:
    text = token[:_SHOWN].decode("ascii", "backslashreplace")
    return repr(text) + (" …" if len(token) > _SHOWN else "")


# Writing

# This many digits reproduce every double exactly.
_REAL = "%.16e"
# Number of values converted to text or bytes at a time.
_PIECE = 1 << 16


class TextOut:
    """Writes a text file: one line per call or per cell."""

    def __init__(self, file: IO[bytes]) -> None:
        self.file = file

    def format(self, number: int, single: bool | None = None) -> None:
        """Write the format number, and the precision in data files (`single` is not None)."""
        self.integers(number)

    def integers(self, *numbers: int) -> None:
        self.file.write((" ".join(map(str, numbers)) + "\n").encode())

    def rows(self, *columns: np.ndarray) -> None:
        """Write columns side by side."""
        for first in range(0, len(columns[0]), _PIECE):
            self.row(np.stack([c[first : first + _PIECE] for c in columns], axis=1))

    def row(self, piece: np.ndarray) -> None:
        line = " ".join([_REAL] * piece.shape[1]) + "\n"
        self.file.write((line * len(piece) % tuple(piece.ravel().tolist())).encode())

    def flags(self, flags: Flags) -> None:
        lines = np.full((len(flags), 2), ord("\n"), np.uint8)
        lines[:, 0] = ord("0") + flags
        self.file.write(lines.tobytes())


class BinaryOut(TextOut):
    """Writes a binary file."""

    real = "<f8"

    def format(self, number: int, single: bool | None = None) -> None:
        self.integers(number)
        if single is not None:
            self.real = "<f4" if single else "<f8"
            self.integers(4 if single else 8)

    def integers(self, *numbers: int) -> None:
        self.file.write(np.array(numbers, "<i8").tobytes())

    def row(self, piece: np.ndarray) -> None:
        self.file.write(piece.astype(self.real).tobytes())

    def flags(self, flags: Flags) -> None:
        self.file.write(flags.tobytes())
