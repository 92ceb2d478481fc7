"""Heads: lines of text, the files that they name, and what libraries raise over damaged ones."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ...errors import FileFormatError, InputError, VoluminousError
from ..payload import inside

# No head that a program wrote is longer; one with a name of a file per slice can be long.
_LONGEST = 4 << 20
# The one number that a pattern such as slice%03d.raw leaves open.
_NUMBER = re.compile(r"%(0?)(\d{0,2})[di]")
_MOST_FILES = 100_000
_GZIP_MAGIC = b"\x1f\x8b"


@contextmanager
def by_library(name: str) -> Iterator[None]:
    """Blame the file for whatever a library raises while it reads: sound ones it can read.

    Raises
    ------
    FileFormatError
        In place of any error that is not ours.
    """
    try:
        yield
    except (VoluminousError, MemoryError, ImportError):
        raise
    except NameError:  # a fault of a program, whatever is in the file
        raise
    except (FileNotFoundError, PermissionError) as error:
        raise FileFormatError(f"a file cannot be opened ({error})") from error
    except Exception as error:
        raise FileFormatError(
            f"it is damaged, cut short or of another kind: {name} says {type(error).__name__}: "
            f"{str(error)[:400]}"
        ) from error


def unpacked_start(head: bytes, size: int) -> bytes:
    """Return the first bytes of a file as they are when unpacked, if gzip packed it."""
    if not head.startswith(_GZIP_MAGIC):
        return head
    try:
        return zlib.decompressobj(wbits=31).decompress(head, size)
    except zlib.error:
        return b""


def head_lines(path: Path, is_last: Callable[[str], bool]) -> tuple[list[str], int, bool]:
    """Return the lines of a head, the byte behind it, and whether its last line was found.

    Raises
    ------
    FileFormatError
        If there is no end of it.
    """
    lines, size = [], 0
    with open(path, "rb") as file:
        while line := file.readline(_LONGEST):
            size += len(line)
            if size > _LONGEST:
                raise FileFormatError(f"its head does not end within {_LONGEST} bytes")
            lines.append(line.decode("utf-8", "replace").strip())
            if is_last(lines[-1]):
                return lines, size, True
    return lines, size, False


def named_files(header: Path, names: list[str]) -> tuple[Path, ...]:
    """Return the files that a head names, which lie beside it or below.

    Raises
    ------
    FileFormatError
        If one is elsewhere, is not there, or is the head itself.
    """
    try:
        found = tuple(inside(header.parent, name) for name in names)
    except FileFormatError:
        raise
    except (InputError, OSError) as error:
        raise FileFormatError(str(error)) from error
    if not found:
        raise FileFormatError("it names no file of data")
    if header.resolve() in found:
        raise FileFormatError("it names itself as the file of data")
    return found


def data_files(header: Path, named: str) -> tuple[Path, ...]:
    """Return the file of data that a head names, or those of ``slice%03d.raw 1 20 1``.

    Raises
    ------
    FileFormatError
        As `named_files`; or if the pattern stands for no file, or for too many.
    """
    pattern, *numbers = named.split() or [""]
    if len(numbers) < 3 or "%" not in pattern:
        return named_files(header, [named])
    first, last, step = whole_numbers(" ".join(numbers[:3]), "numbers of files")
    count = range(first, last + (1 if step > 0 else -1), step) if step else range(0)
    if len(_NUMBER.findall(pattern)) != 1 or not 0 < len(count) <= _MOST_FILES:
        raise FileFormatError(
            f"expected a pattern such as 'slice%03d.raw 1 20 1' for files of data, got {named!r}"
        )
    return named_files(header, [_filled(pattern, number) for number in count])


def _filled(pattern: str, number: int) -> str:
    found = _NUMBER.search(pattern)
    assert found is not None
    return f"{pattern[: found.start()]}{number:{found[1]}{found[2]}d}{pattern[found.end() :]}"


def whole_numbers(text: str, what: str) -> tuple[int, ...]:
    """Return the whole numbers in a line.

    Raises
    ------
    FileFormatError
        If it is anything else.
    """
    try:
        return tuple(int(word) for word in text.split())
    except ValueError:
        raise FileFormatError(f"{what} must be whole numbers, got {text[:80]!r}") from None


def real_numbers(text: str, what: str, count: int | None = None) -> list[float]:
    """Return the numbers in a line, and check how many there are.

    Raises
    ------
    FileFormatError
        If it is anything else.
    """
    try:
        found = [float(word) for word in text.split()]
    except ValueError:
        raise FileFormatError(f"{what} must be numbers, got {text[:80]!r}") from None
    if count is not None and len(found) != count:
        raise FileFormatError(f"{what} must be {count} numbers, got {text[:80]!r}")
    return found
