"""Text files as Fortran reads them: each reading starts on a new line, and skips its rest."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError
from .blocks import NumbersInText
from .fortran import number, shown
from .opened import OpenedFile

_WHOLE = re.compile(rb"[+-]?\d{1,18}")
_LONGEST_LINE = 1 << 26
# How many of the last numbers of a file tell how they are written, if they are as long as this.
_LAST, _FIXED = 9, 8
_TAIL = 2048


def _check_end(path: Path) -> None:
    """Refuse a file that ends within its last number, as far as that can be told.

    If the numbers before have one length and the last, which no line ends, is shorter, the file
    was cut there: its value would be wrong.
    """
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - _TAIL, 0))
        tail = file.read()
    numbers = [token.lstrip(b"+-") for token in tail.split()[1:]][-_LAST:]
    if len(numbers) < _LAST or tail[-1:].isspace():
        return
    *others, last = map(len, numbers)
    if len(set(others)) == 1 and last < others[0] and others[0] >= _FIXED:
        raise FileFormatError(f"it is cut short: it ends within a number, {shown(numbers[-1])}")


class TextFile(OpenedFile):
    """A text file, read from its beginning.

    What is read is told in `what`, for error messages, all of which name the line.
    """

    def __init__(self, path: Path) -> None:
        _check_end(path)
        super().__init__(path)
        self._line = 0

    def format(self, precision: bool) -> int:
        """Return the format number that all files begin with."""
        return self.integers(1, "the format number")[0]

    def integers(self, count: int, what: str) -> list[int]:
        """Return whole numbers; what is behind them in the line is left out, such as a remark."""
        tokens: list[bytes] = []
        while len(tokens) < count:
            tokens += self._tokens(what, f"{count} whole number{'s' * (count > 1)}")
            for token in tokens[:count]:
                if not _WHOLE.fullmatch(token):
                    raise self._error(what, f"expected a whole number, got {shown(token)}")
        return [int(token) for token in tokens[:count]]

    def reals(self, count: int, what: str) -> NDArray[np.float64]:
        """Return numbers, which end where a line ends."""
        values: list[float] = []
        while len(values) < count:
            try:
                tokens = self._tokens(what, f"{count} numbers, after {len(values)}")
                values += map(number, tokens)
            except ValueError as error:
                if isinstance(error, FileFormatError):
                    raise
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

    def _error(self, what: str, told: str) -> FileFormatError:
        return FileFormatError(f"line {self._line}: {what}: {told}")

    def flags(self, what: str) -> NDArray[np.uint8]:
        """Return all that is left: single digits, 0 or 1."""
        text = np.frombuffer(self._file.read(), np.uint8)
        digit = text > 32
        joined = digit[1:] & digit[:-1]
        if joined.any():
            self._line += 1 + int(np.count_nonzero(text[: int(np.argmax(joined))] == 10))
            raise self._error(what, "expected 0 or 1, one per line, got more than one character")
        flags = text[digit] - np.uint8(ord("0"))
        if (wrong := flags > 1).any():
            place = int(np.flatnonzero(digit)[np.argmax(wrong)])
            self._line += 1 + int(np.count_nonzero(text[:place] == 10))
            raise self._error(what, f"expected 0 or 1, got {chr(text[place])!r}")
        return flags

    def end(self) -> None:
        """Check that nothing is left."""
        while line := self._file.readline(_LONGEST_LINE):
            self._line += 1
            if tokens := line.split():
                raise self._error("the end", f"expected nothing more, got {shown(tokens[0])}")

    def width(self, cells: int) -> int:
        """Return how many numbers are on the next line."""
        place = self._file.tell()
        tokens = self._file.readline(_LONGEST_LINE).split()
        self._file.seek(place)
        return len(tokens)

    def planes(self, count: int, size: int) -> TextPlanes:
        """Return what is left: `count` planes of `size` numbers."""
        return TextPlanes(self.path, self._file.tell(), count, size)


class TextPlanes:
    """Planes of numbers in a text file, one after the other."""

    dtype = np.dtype(np.float64)
    mapped = False

    def __init__(self, path: Path, offset: int, count: int, size: int) -> None:
        self.path, self.offset, self.count, self.size = path, offset, count, size
        # A digit and a space each.
        least, found = 2 * count * size - 1, path.stat().st_size - offset
        if found < least:
            raise FileFormatError(
                f"it is cut short: {count * size} numbers are promised, but only {found} "
                "characters are left"
            )
        self._numbers: NumbersInText | None = None

    def plane(self, index: int) -> NDArray[np.float64]:
        """Return the numbers of a plane.

        Raises
        ------
        FileFormatError
            If there are more or fewer than promised, or something is no number.
        """
        if self._numbers is None:
            self._numbers = NumbersInText(self.path, self.offset)
        found, expected = self._numbers.count, self.count * self.size
        if found != expected:
            short = "it is cut short: " if found < expected else ""
            raise FileFormatError(f"{short}expected {expected} numbers, found {found}")
        return self._numbers.read(index * self.size, self.size)
