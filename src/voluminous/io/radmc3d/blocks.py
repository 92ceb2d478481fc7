"""All numbers in a text file, block by block, with as many threads as there are processors.

The file is gone through twice: first the numbers in each block are counted, so that what was
promised can be compared with what is there before memory is taken, and so that every block knows
where its numbers go. Apart from the result, memory is taken for a few blocks only.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError
from .decimals import PADDING, decimals
from .fortran import number

# Calls for so many characters last long compared with their overhead.
_BLOCK = 1 << 20
# The largest double has 309 digits.
_LONGEST = 512
_SPACE = 32
_MOST_THREADS = 8
_LARGE = 1 << 24
Result = TypeVar("Result")


class NumbersInText:
    """The numbers in a text file from a byte on.

    Parameters
    ----------
    path : Path
    offset : int
        A place after white space, or the beginning of the file.

    Attributes
    ----------
    count : int
        How many there are.
    """

    def __init__(self, path: Path, offset: int = 0) -> None:
        self.path, self.offset = path, offset
        self.size = path.stat().st_size
        counts = list(self._map(self._count, range(-(-(self.size - offset) // _BLOCK))))
        self._first = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
        self.count = int(self._first[-1])

    def read(self, first: int, count: int) -> NDArray[np.float64]:
        """Return some consecutive numbers.

        Raises
        ------
        FileFormatError
            If something is no number; names the line.
        """
        values = np.empty(count)
        begin = int(np.searchsorted(self._first, first, "right")) - 1
        end = int(np.searchsorted(self._first, first + count, "left"))

        def fill(block: int) -> None:
            start = int(self._first[block]) - first
            found = self._values(block)
            low, high = max(start, 0), min(start + len(found), count)
            values[low:high] = found[low - start : high - start]

        _keep_freed_memory()
        for _ in self._map(fill, range(begin, end)):
            pass
        return values

    def _map(self, work: Callable[[int], Result], blocks: range) -> Iterator[Result]:
        threads = min(os.cpu_count() or 1, _MOST_THREADS, len(blocks))
        if threads <= 1:
            yield from map(work, blocks)
            return
        with ThreadPoolExecutor(threads) as pool:
            yield from pool.map(work, blocks)

    def _text(self, block: int, beyond: int) -> tuple[bytes, int]:
        """Return the characters of a block, one before and some beyond; and the block's length."""
        start = self.offset + block * _BLOCK
        length = min(_BLOCK, self.size - start)
        with open(self.path, "rb") as file:
            file.seek(max(start - 1, 0))
            text = file.read(length + beyond + (start > 0))
        return (text if start > 0 else b" " + text), length

    def _count(self, block: int) -> int:
        text, _ = self._text(block, 0)
        blank = np.frombuffer(text, np.uint8) <= _SPACE
        return int(np.count_nonzero(blank[:-1] & ~blank[1:]))

    def _values(self, block: int) -> NDArray[np.float64]:
        text, length = self._text(block, _LONGEST)
        padded = np.full(len(text) + PADDING, _SPACE, np.uint8)
        padded[: len(text)] = np.frombuffer(text, np.uint8)
        self._cut(padded, length, block)
        values, unsure, starts, ends = decimals(padded)
        known: dict[bytes, float] = {}
        for k in np.flatnonzero(unsure).tolist():
            token = padded[starts[k] : ends[k]].tobytes()
            if token not in known:
                known[token] = self._number(token, block, int(starts[k]))
            values[k] = known[token]
        return values

    def _cut(self, padded: NDArray[np.uint8], length: int, block: int) -> None:
        blank = padded <= _SPACE
        begin = 0 if blank[0] else int(np.argmax(blank))
        end = length + (1 if blank[length] else int(np.argmax(blank[length:])))
        if begin <= length and end - length >= _LONGEST:
            self._number(padded[length:end].tobytes(), block, length)
        padded[: min(begin, length + 1)] = padded[end if begin <= length else 0 :] = _SPACE

    def _number(self, token: bytes, block: int, start: int) -> float:
        try:
            return number(token)
        except ValueError as error:
            place = self.offset + block * _BLOCK - 1 + start
            raise FileFormatError(f"line {_line(self.path, place)}: {error}") from None


def _keep_freed_memory() -> None:
    """Make temporary arrays cheap, which halves the time of reading (glibc; no effect elsewhere).

    The C library gives freed memory back to the system from 128 KiB on, and has to take it again
    page by page. Having freed one large block, it keeps up to twice as much from then on.
    """
    np.empty(_LARGE, np.uint8)


def _line(path: Path, place: int) -> int:
    lines = 1
    with open(path, "rb") as file:
        while place > 0 and (piece := file.read(min(place, _BLOCK))):
            lines += piece.count(b"\n")
            place -= len(piece)
    return lines
