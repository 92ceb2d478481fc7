"""Numbers written as text."""

from __future__ import annotations

from collections.abc import Iterator
from typing import IO, Any

import numpy as np

from ...errors import FileFormatError
from ...memory import check_memory

_PIECE = 1 << 20
# No number takes more characters.
_LONGEST = 1024


def numbers(
    file: IO[bytes], count: int, dtype: Any, what: str, end: int | None = None
) -> np.ndarray:
    """Return the next numbers in a file.

    Parameters
    ----------
    file : binary file
        At the first of them; is left behind the last.
    count : int
        How many.
    dtype : dtype
        Their type.
    what : str
        What they are, for error messages.
    end : int, optional
        Byte at which they must end.

    Raises
    ------
    FileFormatError
        If there are fewer, or one is no number of that type.
    """
    dtype = np.dtype(dtype)
    check_room(file, count, end, what)
    check_memory(count * dtype.itemsize, f"reading {what}", "read a coarser copy")
    # Python's numbers: they tell what is none, and integers do not overflow silently.
    kind: Any = float if dtype.kind == "f" else int
    found, out = 0, np.empty(count, dtype)
    for words in _words(file, count, end):
        try:
            with np.errstate(over="ignore"):  # infinite in single precision
                out[found : found + len(words)] = np.fromiter(map(kind, words), dtype, len(words))
        except (ValueError, OverflowError) as error:
            raise FileFormatError(f"{what}: expected numbers of type {dtype} ({error})") from error
        found += len(words)
    _check_found(found, count, what)
    return out


def skip_words(file: IO[bytes], count: int, what: str) -> None:
    """Go behind the next words of a file.

    Raises
    ------
    FileFormatError
        If there are fewer.
    """
    check_room(file, count, None, what)
    _check_found(sum(len(words) for words in _words(file, count, None)), count, what)


def check_room(file: IO[bytes], count: int, end: int | None, what: str) -> None:
    """Refuse to look for more words than there can be up to `end`, or to the file's end.

    Raises
    ------
    FileFormatError
        Before memory is taken.
    """
    here = file.tell()
    last = file.seek(0, 2) if end is None else end
    file.seek(here)
    if 2 * count - 1 > last - here:  # a digit and a space each
        raise FileFormatError(
            f"{what}: expected {count} numbers from byte {here} on, but only "
            f"{max(last - here, 0)} bytes are left; the file is cut short"
        )


def _check_found(found: int, count: int, what: str) -> None:
    if found < count:
        raise FileFormatError(f"{what}: expected {count} numbers, got {found}; it is cut short")


def _words(file: IO[bytes], count: int, end: int | None) -> Iterator[list[bytes]]:
    """Give so many words, a piece of the file at a time."""
    rest = b""
    while count > 0:
        here = file.tell()
        piece = file.read(_PIECE if end is None else min(_PIECE, max(end - here, 0)))
        text = rest + piece
        words = text.split(None, count)
        rest = b""
        if len(words) > count:  # what follows is left in the file
            file.seek(here + len(piece) - len(words.pop()))
        elif piece and words and not text[-1:].isspace():
            rest = words.pop()  # it may go on in the next piece
        if max(map(len, words), default=len(rest)) > _LONGEST:
            raise FileFormatError(
                f"expected numbers, got {max(words, default=rest, key=len)[:20]!r}…"
            )
        count -= len(words)
        yield words
        if not piece:
            return
