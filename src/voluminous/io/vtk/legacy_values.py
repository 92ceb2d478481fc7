"""Lines and values of legacy files: text, and big-endian numbers where a line ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from ...errors import FileFormatError
from ..payload import checked_shape, mapped
from .text import numbers, skip_words

# Types as files spell them. A long is taken to be that of 64-bit machines; VTK writes an id as int.
TYPES = {
    "bit": "u1",
    "char": "i1",
    "signed_char": "i1",
    "unsigned_char": "u1",
    "short": "i2",
    "unsigned_short": "u2",
    "int": "i4",
    "unsigned_int": "u4",
    "long": "i8",
    "unsigned_long": "u8",
    "vtktypeint64": "i8",
    "vtktypeuint64": "u8",
    "vtkidtype": "i4",
    "float": "f4",
    "double": "f8",
}
_LONGEST_LINE = 1 << 16
# Bytes of the length of a text in a binary file, by the first two bits of it.
_LENGTH_BYTES = {3: 1, 2: 2, 1: 4, 0: 8}


@dataclass(frozen=True)
class Stored:
    """Values in a file: where they are.

    Attributes
    ----------
    path : Path
        The file.
    name : str
        What they are, for error messages.
    kind : str
        A key of `TYPES`.
    count : int
        How many.
    start : int
        First byte.
    binary : bool
        False for text.
    """

    path: Path
    name: str
    kind: str
    count: int
    start: int
    binary: bool

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the values in memory."""
        return np.dtype(TYPES[self.kind])

    @property
    def size(self) -> int:
        """Number of bytes, in a binary file."""
        return -(-self.count // 8) if self.kind == "bit" else self.count * self.dtype.itemsize

    def values(self) -> np.ndarray:
        """Return the values."""
        if not self.binary:
            with open(self.path, "rb") as file:
                file.seek(self.start)
                return numbers(file, self.count, self.dtype, f"array {self.name!r}")
        if self.kind == "bit":
            return np.unpackbits(mapped(self.path, self.start, (self.size,), "u1"))[: self.count]
        return mapped(self.path, self.start, (self.count,), self.dtype.newbyteorder(">"))


class Lines:
    """A legacy file, read line by line; values are passed over.

    Parameters
    ----------
    path : Path
        The file.
    file : binary file
        The same, open.
    """

    def __init__(self, path: Path, file: IO[bytes]) -> None:
        self.path, self.file = path, file
        self.binary = False
        self._end = path.stat().st_size

    def line(self) -> str:
        """Return the next line; an empty one at the end too.

        Raises
        ------
        FileFormatError
            If it goes on and on.
        """
        start = self.file.tell()
        line = self.file.readline(_LONGEST_LINE)
        if len(line) == _LONGEST_LINE:
            raise FileFormatError(f"byte {start}: expected a line of text, got {line[:40]!r} …")
        return line.decode("utf-8", "replace").strip()

    def words(self) -> list[str]:
        """Return the words of the next line that has some; none at the end of the file."""
        while self.file.tell() < self._end:
            if words := self.line().split():
                return words
        return []

    def stored(self, name: str, kind: str, count: int) -> Stored:
        """Pass over values, and return where they are.

        Raises
        ------
        FileFormatError
            If the file ends before, or there is no such type.
        """
        start, kind = self.file.tell(), kind.lower()
        if kind not in TYPES:
            raise FileFormatError(
                f"byte {start}: unknown type {kind[:40]!r} of {name!r}; expected one of "
                f"{', '.join(TYPES)}"
            )
        checked_shape((count,), f"byte {start}: the number of values of {name!r}")
        found = Stored(self.path, name, kind, count, start, self.binary)
        if not self.binary:
            skip_words(self.file, count, f"array {name!r}")
        elif start + found.size > self._end:
            raise FileFormatError(
                f"array {name!r}: expected {count} values of {kind} from byte {start} on, "
                f"{found.size} bytes, but only {self._end - start} are left; it is cut short"
            )
        else:
            self.file.seek(start + found.size)
        return found

    def texts(self, count: int) -> list[str]:
        """Return so many texts."""
        one: Callable[[], str] = self._binary_text if self.binary else self.line
        if count > self._end - self.file.tell():
            raise FileFormatError(f"byte {self.file.tell()}: {count} texts in what is left of it")
        return [one() for _ in range(count)]

    def _binary_text(self) -> str:
        start = self.file.read(1)
        size = _LENGTH_BYTES[start[0] >> 6] if start else 1
        length = int.from_bytes(start + self.file.read(size - 1), "big") & (
            (1 << (8 * size - 2)) - 1
        )
        if not start or length > self._end - self.file.tell():
            raise FileFormatError(f"byte {self.file.tell()}: a text is cut short")
        return self.file.read(length).decode("utf-8", "replace")
