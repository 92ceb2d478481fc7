"""Text and binary files as RADMC-3D reads them: the counterparts of `TextFile`, `BinaryFile`."""

from __future__ import annotations

from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

# So many digits bring every double back.
_REAL = "%.16e"
# Values turned into text, or into bytes, at once.
_PIECE = 1 << 16


class TextOut:
    """A text file that is being written, a line for each call or each cell."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def format(self, number: int, single: bool | None = None) -> None:
        """Write the format number; of files with data the precision is not told."""
        self.integers(number)

    def integers(self, *numbers: int) -> None:
        """Write whole numbers on a line."""
        self._file.write((" ".join(map(str, numbers)) + "\n").encode())

    def rows(self, columns: list[NDArray[Any]]) -> None:
        """Write the values of columns side by side."""
        line = " ".join([_REAL] * len(columns)) + "\n"
        for first in range(0, len(columns[0]), _PIECE):
            piece = np.stack([c[first : first + _PIECE] for c in columns], axis=1)
            self._file.write((line * len(piece) % tuple(piece.ravel().tolist())).encode())

    def flags(self, flags: NDArray[np.uint8]) -> None:
        """Write numbers of one digit."""
        lines = np.full((len(flags), 2), ord("\n"), np.uint8)
        lines[:, 0] = ord("0") + flags
        self._file.write(lines.tobytes())


class BinaryOut:
    """A binary file that is being written."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file, self._real = file, "<f8"

    def format(self, number: int, single: bool | None = None) -> None:
        """Write the format number; of files with data (`single` is not None) also the precision."""
        self.integers(number)
        if single is not None:
            self._real = "<f4" if single else "<f8"
            self.integers(4 if single else 8)

    def integers(self, *numbers: int) -> None:
        """Write whole numbers."""
        self._file.write(np.array(numbers, "<i8").tobytes())

    def rows(self, columns: list[NDArray[Any]]) -> None:
        """Write the values of columns side by side."""
        for first in range(0, len(columns[0]), _PIECE):
            piece = np.stack([c[first : first + _PIECE] for c in columns], axis=1)
            self._file.write(piece.astype(self._real).tobytes())

    def flags(self, flags: NDArray[np.uint8]) -> None:
        """Write bytes."""
        self._file.write(flags.tobytes())
