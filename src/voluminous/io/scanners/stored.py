"""Text headers that name the files of their data, and the numbers in these files."""

from __future__ import annotations

import math
import re
import zlib
from bz2 import BZ2Decompressor
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...files import check_age
from ...memory import check_memory
from ..payload import inside, stored

# No header that a program wrote is longer; one with a file name per slice can be long.
_LONGEST = 4 << 20
# Files with a number in their names, the first number, the last, and the step (NRRD: and the
# dimension of each file, which follows from the number of files).
_NUMBERED = re.compile(r"([^%]*%0?\d?\d?[diu][^%]*?)\s+(-?\d+)\s+(-?\d+)\s+(-?\d+)(?:\s+\d+)?")


def header_lines(path: Path, is_last: Callable[[str], bool]) -> tuple[list[str], int]:
    """Return the lines of a header, up to its last, and the offset behind it."""
    lines, size = [], 0
    with open(path, "rb") as file:
        while size <= _LONGEST and (line := file.readline(_LONGEST)):
            size += len(line)
            lines.append(line.decode("utf-8", "replace").strip())
            if is_last(lines[-1]):
                break
    return lines, size


def data_files(header: Path, named: str, listed: Sequence[str] = ()) -> tuple[Path, ...]:
    """Return the data files of a header: one, ``slice%03d.raw 1 20 1``, or those listed."""
    names: Iterable[str] = [name.strip() for name in listed if name.strip()] or [named]
    if not listed and (numbered := _NUMBERED.fullmatch(named.strip())):
        first, last, step = map(int, numbered.groups()[1:])
        count = range(first, last + (1 if step > 0 else -1), step or 1)
        names = (numbered[1] % number for number in count)  # the first that is not there ends it
    try:
        files = tuple(inside(header.parent, name) for name in names)
    except (InputError, OSError) as error:
        raise FileFormatError(str(error)) from error
    if not files:
        raise FileFormatError(f"{named!r} are no files")
    if header.resolve() in files:
        raise FileFormatError("it names itself as the file of data")
    return files


@dataclass(frozen=True)
class StoredNumbers:
    """Numbers in one file, or in several with the same number in each."""

    files: tuple[Path, ...]
    dtype: np.dtype[Any]  # as in the file, with its byte order
    count: int  # in all files
    # Offset of the numbers, or of the packed numbers, in each file; -1: they are its end.
    start: int = 0
    packing: str = ""  # or "text" (decimal numbers), "zlib" (also gzip), "bz2"
    skipped: int = 0  # bytes before the numbers that were packed with them

    def check(self) -> None:
        """Check the lengths of files that are not packed."""
        each = self.count // len(self.files)
        if each * len(self.files) != self.count:
            raise FileFormatError(
                f"{self.count} values cannot be spread evenly over {len(self.files)} files"
            )
        for file in () if self.packing else self.files:
            self._part(file, 0, each)

    def read(self, first: int, shape: tuple[int, ...]) -> np.ndarray:
        """Return numbers from the index `first` on, in C order."""
        last, each = first + math.prod(shape), self.count // len(self.files)
        parts = [
            self._part(file, max(first - k * each, 0), min(last - k * each, each))
            for k, file in enumerate(self.files)
            if k * each < last and first < (k + 1) * each
        ]
        return (parts[0] if len(parts) == 1 else np.concatenate(parts)).reshape(shape)

    def _part(self, path: Path, low: int, high: int) -> np.ndarray:
        width, each = self.dtype.itemsize, self.count // len(self.files)
        if not self.packing:
            start = path.stat().st_size - each * width if self.start == -1 else self.start
            return stored(path, start + low * width, (high - low,), self.dtype)
        with open(path, "rb") as file:
            file.seek(self.start)
            content = file.read()
        check_age(path)
        if self.packing == "text":
            values = np.array(content.split()[low:high]).astype(self.dtype)
        else:  # never unpacks more than is needed
            size = self.skipped + high * width
            check_memory(size, f"unpacking {path.name}", "read a coarser copy")
            stream: Any = zlib.decompressobj(47) if self.packing == "zlib" else BZ2Decompressor()
            plain = stream.decompress(content, size)[self.skipped :]
            rest = getattr(stream, "unconsumed_tail", b"")
            # Behind the last value there is a checksum.
            if high == each and not stream.eof and (stream.decompress(rest, 1) or not stream.eof):
                raise FileFormatError(f"{path.name} is cut short, or has more than {each} values")
            values = np.frombuffer(plain[: len(plain) // width * width], self.dtype)[low:]
        if len(values) < high - low:
            raise FileFormatError(f"{path.name} is cut short: it has no {high} values")
        return values
