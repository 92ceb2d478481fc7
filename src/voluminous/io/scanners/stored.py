"""The numbers behind a head: in one file or slabs in several, plain, packed or as text."""

from __future__ import annotations

import bz2
import gzip
import math
import warnings
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from ...errors import FileFormatError
from ..payload import checked_shape, mapped, read_exactly

PLAIN, TEXT, GZIP, BZIP2, ZLIB = "plain", "text", "gzip", "bzip2", "zlib"
AT_THE_END = -1
_PIECE = 1 << 20


@dataclass(frozen=True)
class Stored:
    """Numbers in one file, or in several that hold equally many each.

    Attributes
    ----------
    files : tuple of Path
        In order.
    dtype : dtype
        As in the file, with its byte order.
    count : int
        How many numbers there are in all.
    packing : str
        `PLAIN`, `TEXT` (decimal numbers), `GZIP`, `BZIP2` or `ZLIB`.
    start : int
        Byte of each file at which numbers, or what is packed, begin; `AT_THE_END` if the numbers
        are the last bytes of it.
    skipped : int
        Bytes to leave out after unpacking.
    """

    files: tuple[Path, ...]
    dtype: np.dtype[Any]
    count: int
    packing: str = PLAIN
    start: int = 0
    skipped: int = 0

    def check(self) -> Stored:
        """Look at the sizes of the files, before memory is taken.

        Raises
        ------
        FileFormatError
            If one is too short.
        """
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
        """Return numbers from the `first` on, in C order.

        Raises
        ------
        FileFormatError
            If a stream ends early, or text is no number.
        """
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
