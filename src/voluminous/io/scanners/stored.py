"""Text headers, and the numbers behind them: in one file or several, plain, packed or as text."""

from __future__ import annotations

import bz2
import gzip
import math
import re
import warnings
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from ...errors import FileFormatError, InputError
from ..payload import checked_shape, inside, mapped, read_exactly

PLAIN, TEXT, GZIP, BZIP2, ZLIB = "plain", "text", "gzip", "bzip2", "zlib"
AT_THE_END = -1
_PIECE = 1 << 20


@dataclass(frozen=True)
class Stored:
    """Numbers in one file, or in several that hold equally many each."""

    files: tuple[Path, ...]  # in order
    dtype: np.dtype[Any]  # as in the file, with its byte order
    count: int  # how many numbers there are in all
    packing: str = PLAIN  # `PLAIN`, `TEXT` (decimal numbers), `GZIP`, `BZIP2` or `ZLIB`
    # byte of each file at which numbers, or what is packed, begin; `AT_THE_END` if the numbers
    # are the last bytes of it
    start: int = 0
    skipped: int = 0  # bytes to leave out after unpacking

    def check(self) -> Stored:
        """Look at the sizes of the files, before memory is taken."""
        if self.start < AT_THE_END or self.skipped < 0:
            raise FileFormatError(f"the data cannot begin at byte {min(self.start, self.skipped)}")
        each, rest = divmod(self.count, len(self.files))
        if rest:
            raise FileFormatError(
                f"{self.count} values cannot be spread evenly over {len(self.files)} files"
            )
        for file in self.files:
            self._check_size(file, each)
        return self

    def _check_size(self, file: Path, each: int) -> None:
        found = file.stat().st_size - max(self.start, 0)
        size = each * self.dtype.itemsize
        # A digit and a space for each number; of what is packed nothing is known.
        least = {PLAIN: self.skipped + size, TEXT: 2 * each - 1}.get(self.packing, 1)
        if found < least:
            raise FileFormatError(
                f"{file.name} is cut short: {max(found, 0)} bytes of data, but {each} values of "
                f"{self.dtype} take {least}"
            )
        if self.packing == PLAIN and self.start != AT_THE_END and found > least:
            _warn_of_more(file, found - least)

    def read(self, first: int, shape: tuple[int, ...]) -> np.ndarray:
        """Return numbers from the `first` on, in C order."""
        each = self.count // len(self.files)
        last = first + math.prod(checked_shape(shape))
        parts = [
            self._part(file, max(first - k * each, 0), min(last - k * each, each))
            for k, file in enumerate(self.files)
            if k * each < last and first < (k + 1) * each
        ]
        return (parts[0] if len(parts) == 1 else np.concatenate(parts)).reshape(shape)

    def _part(self, file: Path, low: int, high: int) -> np.ndarray:
        if self.packing == TEXT:
            return self._words(file)[low:high]
        if self.packing == PLAIN:
            offset = self._byte(file) + low * self.dtype.itemsize
            return mapped(file, offset, (high - low,), self.dtype)
        return self._unpacked(file, low, high)

    def _byte(self, file: Path) -> int:
        if self.start != AT_THE_END:
            return self.start + self.skipped
        return file.stat().st_size - self.count // len(self.files) * self.dtype.itemsize

    def _unpacked(self, path: Path, low: int, high: int) -> np.ndarray:
        with open(path, "rb") as file:
            file.seek(self.start)
            stream = _OPENED[self.packing](file)
            _skip(stream, self.skipped + low * self.dtype.itemsize)
            values = read_exactly(stream, (high - low,), self.dtype, f"the data of {path.name}")
            # The end of a stream is where its checksum is.
            if high == self.count // len(self.files) and stream.read(1):
                _warn_of_more(path)
        return values

    def _words(self, path: Path) -> np.ndarray:
        with open(path, "rb") as file:
            file.seek(self.start)
            words = file.read().split()
        each = self.count // len(self.files)
        if len(words) < each:
            raise FileFormatError(f"{path.name} holds {len(words)} numbers, expected {each}")
        return np.array(words[:each]).astype(self.dtype)


class Inflated:
    """A stream that zlib packed, read as a file: never more is unpacked than is asked for."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._stream = zlib.decompressobj(wbits=47)  # zlib's own head, or that of gzip

    def read(self, size: int) -> bytes:
        """Return the next bytes, at most so many; none at the end."""
        while not self._stream.eof:
            packed = self._stream.unconsumed_tail or self._file.read(_PIECE)
            plain = self._stream.decompress(packed, size)
            if plain:
                return plain
            if not packed:
                raise FileFormatError("the packed data are cut short")
        return b""


def _gunzipped(file: IO[bytes]) -> Any:
    return gzip.GzipFile(fileobj=file)


_OPENED: dict[str, Any] = {GZIP: _gunzipped, BZIP2: bz2.BZ2File, ZLIB: Inflated}


def _skip(stream: Any, size: int) -> None:
    while size > 0:
        piece = stream.read(min(size, _PIECE))
        if not piece:
            raise FileFormatError(f"the packed data end {size} bytes before those asked for")
        size -= len(piece)


def _warn_of_more(path: Path, size: int | None = None) -> None:
    warnings.warn(
        f"{path.name} holds {'' if size is None else f'{size} bytes '}more than its head tells of; "
        "what is left over is not read. If the picture looks wrong, the sizes in the head are",
        stacklevel=2,
    )


# No head that a program wrote is longer; one with a name of a file per slice can be long.
_LONGEST = 4 << 20
# The one number that a pattern such as slice%03d.raw leaves open.
_NUMBER = re.compile(r"%(0?)(\d{0,2})[di]")
_MOST_FILES = 100_000
_GZIP_MAGIC = b"\x1f\x8b"


def unpacked_start(head: bytes, size: int) -> bytes:
    """Return the first bytes of a file as they are when unpacked, if gzip packed it."""
    if not head.startswith(_GZIP_MAGIC):
        return head
    try:
        return zlib.decompressobj(wbits=31).decompress(head, size)
    except zlib.error:
        return b""


def head_lines(path: Path, is_last: Callable[[str], bool]) -> tuple[list[str], int, bool]:
    """Return the lines of a head, the byte behind it, and whether its last line was found."""
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
    """Return the files that a head names, which lie beside it or below."""
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
    """Return the file of data that a head names, or those of ``slice%03d.raw 1 20 1``."""
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
    """Return the whole numbers in a line."""
    try:
        return tuple(int(word) for word in text.split())
    except ValueError:
        raise FileFormatError(f"{what} must be whole numbers, got {text[:80]!r}") from None


def real_numbers(text: str, what: str, count: int | None = None) -> list[float]:
    """Return the numbers in a line, and check how many there are."""
    try:
        found = [float(word) for word in text.split()]
    except ValueError:
        raise FileFormatError(f"{what} must be numbers, got {text[:80]!r}") from None
    if count is not None and len(found) != count:
        raise FileFormatError(f"{what} must be {count} numbers, got {text[:80]!r}")
    return found
