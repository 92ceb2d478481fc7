"""Text headers and their data: in one or several files, plain, compressed or as text."""

from __future__ import annotations

import bz2
import gzip
import math
import re
import warnings
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from ...errors import FileFormatError, InputError
from ..payload import checked_shape, inside, mapped, read_exactly

PLAIN, TEXT, GZIP, BZIP2, ZLIB = "plain", "text", "gzip", "bzip2", "zlib"
AT_THE_END = -1
_PIECE = 1 << 20
# No header that a program wrote is longer; one with a name of a file per slice can be long.
_LONGEST = 4 << 20
# The one number that a pattern such as slice%03d.raw leaves open.
_NUMBER = re.compile(r"%(0?)(\d{0,2})[di]")
_MOST_FILES = 100_000


def unpacked_start(head: bytes, size: int) -> bytes:
    """Return the first bytes of a file, decompressed if it is gzipped."""
    if not head.startswith(b"\x1f\x8b"):
        return head
    try:
        return zlib.decompressobj(wbits=31).decompress(head, size)
    except zlib.error:
        return b""


def header_lines(path: Path, is_last: Callable[[str], bool]) -> tuple[list[str], int, bool]:
    """Return the lines of a header, the byte behind it, and whether there is a last line."""
    lines, size = [], 0
    with open(path, "rb") as file:
        while line := file.readline(_LONGEST):
            size += len(line)
            if size > _LONGEST:
                raise FileFormatError(f"its header does not end within {_LONGEST} bytes")
            lines.append(line.decode("utf-8", "replace").strip())
            if is_last(lines[-1]):
                return lines, size, True
    return lines, size, False


def data_files(header: Path, named: str | Sequence[str]) -> tuple[Path, ...]:
    """Return the files of data beside a header: one, several, or ``slice%03d.raw 1 20 1``."""
    names = [named] if isinstance(named, str) else list(named)
    pattern, *numbers = named.split() or [""] if isinstance(named, str) else [""]
    if len(numbers) >= 3 and "%" in pattern:
        first, last, step = whole_numbers(" ".join(numbers[:3]), "numbers of files")
        count = range(first, last + (1 if step > 0 else -1), step) if step else range(0)
        found = _NUMBER.search(pattern)
        if len(_NUMBER.findall(pattern)) != 1 or not 0 < len(count) <= _MOST_FILES or not found:
            raise FileFormatError(
                f"expected files of data such as 'slice%03d.raw 1 20 1', got {named!r}"
            )
        start, end = pattern[: found.start()], pattern[found.end() :]
        names = [f"{start}{number:{found[1]}{found[2]}d}{end}" for number in count]
    try:
        files = tuple(inside(header.parent, name) for name in names)
    except FileFormatError:
        raise
    except (InputError, OSError) as error:
        raise FileFormatError(str(error)) from error
    if not files:
        raise FileFormatError("it names no file of data")
    if header.resolve() in files:
        raise FileFormatError("it names itself as the file of data")
    return files


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


@dataclass(frozen=True)
class StoredNumbers:
    """Numbers in one file, or in several that hold equally many each."""

    files: tuple[Path, ...]
    dtype: np.dtype[Any]  # as in the file, with its byte order
    count: int  # in all files
    packing: str = PLAIN  # or `TEXT` (decimal numbers), `GZIP`, `BZIP2`, `ZLIB`
    # Byte of each file at which numbers, or what is packed, begin; or `AT_THE_END` of it.
    start: int = 0
    skipped: int = 0  # bytes to leave out after unpacking

    @property
    def each(self) -> int:
        """Numbers in each file."""
        return self.count // len(self.files)

    def check(self) -> StoredNumbers:
        """Check the sizes of the files, before memory is taken."""
        if self.start < AT_THE_END or self.skipped < 0:
            raise FileFormatError(f"the data cannot begin at byte {min(self.start, self.skipped)}")
        if self.count % len(self.files):
            raise FileFormatError(
                f"{self.count} values cannot be spread evenly over {len(self.files)} files"
            )
        for file in self.files:
            found = file.stat().st_size - max(self.start, 0)
            size = self.each * self.dtype.itemsize
            # A number as text takes a digit and a space; packed data may take any size.
            least = {PLAIN: self.skipped + size, TEXT: 2 * self.each - 1}.get(self.packing, 1)
            if found < least:
                raise FileFormatError(
                    f"{file.name} is cut short: {max(found, 0)} bytes of data, but {self.each} "
                    f"values of {self.dtype} take {least}"
                )
            if self.packing == PLAIN and self.start != AT_THE_END and found > least:
                _warn_of_more(file, f"{found - least} bytes ")
        return self

    def read(self, first: int, shape: tuple[int, ...]) -> np.ndarray:
        """Return numbers from the `first` on, in C order."""
        last, each = first + math.prod(checked_shape(shape)), self.each
        parts = [
            self._part(file, max(first - k * each, 0), min(last - k * each, each))
            for k, file in enumerate(self.files)
            if k * each < last and first < (k + 1) * each
        ]
        return (parts[0] if len(parts) == 1 else np.concatenate(parts)).reshape(shape)

    def _part(self, path: Path, low: int, high: int) -> np.ndarray:
        before = self.skipped + low * self.dtype.itemsize
        if self.packing == PLAIN:
            start = self.start
            if start == AT_THE_END:
                start = path.stat().st_size - self.each * self.dtype.itemsize - self.skipped
            return mapped(path, start + before, (high - low,), self.dtype)
        with open(path, "rb") as file:
            file.seek(self.start)
            if self.packing == TEXT:
                words = file.read().split()
                if len(words) < self.each:
                    raise FileFormatError(
                        f"{path.name} holds {len(words)} numbers, expected {self.each}"
                    )
                return np.array(words[low:high]).astype(self.dtype)
            stream = _OPENED[self.packing](file)
            while before > 0:
                piece = stream.read(min(before, _PIECE))
                if not piece:
                    raise FileFormatError(
                        f"the packed data end {before} bytes before those asked for"
                    )
                before -= len(piece)
            values = read_exactly(stream, (high - low,), self.dtype, f"the data of {path.name}")
            # The checksum is at the end of the stream.
            if high == self.each and stream.read(1):
                _warn_of_more(path)
            return values


class Inflated:
    """A stream that zlib packed, read as a file: never more is unpacked than is asked for."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._stream = zlib.decompressobj(wbits=47)  # zlib's own header, or that of gzip

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


_OPENED: dict[str, Callable[[IO[bytes]], Any]] = {
    GZIP: lambda file: gzip.GzipFile(fileobj=file),
    BZIP2: bz2.BZ2File,
    ZLIB: Inflated,
}


def _warn_of_more(path: Path, size: str = "") -> None:
    warnings.warn(
        f"{path.name} holds {size}more than its header says; the rest is not read. If "
        "the picture looks wrong, the sizes in the header are",
        stacklevel=2,
    )
