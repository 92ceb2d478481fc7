"""Text headers that name the files of their data, and the numbers in these files."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...files import check_age
from ..payload import inside, stored

# No header that a program wrote is longer; one with a file name per slice can be long.
_LONGEST = 4 << 20


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
    """Return the data files of a header: one, or those listed."""
    names = [name.strip() for name in listed if name.strip()] or [named]
    try:
        files = tuple(inside(header.parent, name) for name in names)
    except (InputError, OSError) as error:
        raise FileFormatError(str(error)) from error
    if header.resolve() in files:
        raise FileFormatError("it names itself as the file of data")
    return files


@dataclass(frozen=True)
class StoredNumbers:
    """Numbers in one file, or in several with the same number in each."""

    files: tuple[Path, ...]
    dtype: np.dtype[Any]  # as in the file, with its byte order
    count: int  # in all files
    start: int = 0  # offset of the numbers, or of the packed numbers, in each file
    packing: str = ""  # or "text" (decimal numbers), or "zlib"

    def read(self, first: int, shape: tuple[int, ...]) -> np.ndarray:
        """Return numbers from the index `first` on, in C order."""
        last, each = first + math.prod(shape), self.count // len(self.files)
        if each * len(self.files) != self.count:
            raise FileFormatError(
                f"{self.count} values cannot be spread evenly over {len(self.files)} files"
            )
        parts = [
            self._part(file, max(first - k * each, 0), min(last - k * each, each))
            for k, file in enumerate(self.files)
            if k * each < last and first < (k + 1) * each
        ]
        return (parts[0] if len(parts) == 1 else np.concatenate(parts)).reshape(shape)

    def _part(self, path: Path, low: int, high: int) -> np.ndarray:
        width = self.dtype.itemsize
        if not self.packing:
            return stored(path, self.start + low * width, (high - low,), self.dtype)
        with open(path, "rb") as file:
            file.seek(self.start)
            content = file.read()
        check_age(path)
        if self.packing == "text":
            values = np.array(content.split()[low:high]).astype(self.dtype)
        else:  # never unpacks more than is needed
            plain = zlib.decompressobj(wbits=47).decompress(content, high * width)
            values = np.frombuffer(plain[: len(plain) // width * width], self.dtype)[low:]
        if len(values) < high - low:
            raise FileFormatError(f"{path.name} is cut short: it has no {high} values")
        return values
