"""Is a classic NetCDF file as long as its header says? Libraries read zeros where it is not.

The header is described in the NetCDF Classic Format Specification,
https://docs.unidata.ucar.edu/nug/current/file_format_specifications.html.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from ...errors import FileFormatError

# Bytes of a value by the number of its type.
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8, 7: 1, 8: 2, 9: 4, 10: 8, 11: 8}
_DIMENSIONS, _VARIABLES, _ATTRIBUTES = 10, 11, 12
# Dimensions of a variable; more are damage.
_MOST = 1024


@dataclass
class _Variable:
    name: str
    begin: int
    size: int  # bytes, of one record where it has records
    records: bool


def check_length(path: Path) -> None:
    """Check that all variables lie within the file.

    Raises
    ------
    FileFormatError
        If it is too short, or its header cannot be followed.
    """
    found = path.stat().st_size
    with open(path, "rb") as file:
        header = _Header(file, found)
        records, variables = header.read()
    sizes = [variable.size for variable in variables if variable.records]
    # A lone variable with records is not padded to four bytes.
    step = sum(_padded(size) for size in sizes) if len(sizes) > 1 else sum(sizes)
    for variable in variables:
        repeats = (records - 1) * step if variable.records else 0
        expected = variable.begin + repeats + variable.size
        if expected > found and not (variable.records and records < 1):
            raise FileFormatError(
                f"it is cut short: {found} bytes, but {variable.name!r} ends at byte {expected}"
            )


class _Header:
    """Reads numbers and lists one after the other, never beyond the file's end."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self.file, self.size = file, size
        version = file.read(4)[3]
        self.count = 8 if version == 5 else 4
        self.offset = 4 if version == 1 else 8

    def read(self) -> tuple[int, list[_Variable]]:
        records = self.number(self.count)
        records = 0 if records == 256**self.count - 1 else records
        lengths = [self.dimension() for _ in range(self.list_of(_DIMENSIONS))]
        self.attributes()
        count = self.list_of(_VARIABLES)
        return records, [self.variable(lengths) for _ in range(count)]

    def number(self, size: int) -> int:
        data = self.file.read(size)
        if len(data) < size:
            raise FileFormatError(f"its header is cut short at byte {self.file.tell()}")
        return int.from_bytes(data, "big")

    def skip(self, size: int) -> None:
        if self.file.tell() + size > self.size:
            raise FileFormatError(
                f"{size} bytes from byte {self.file.tell()} on do not fit into its {self.size}"
            )
        self.file.seek(size, 1)

    def list_of(self, kind: int) -> int:
        found, length = self.number(4), self.number(self.count)
        if found not in (0, kind) or (found == 0 and length):
            raise FileFormatError(
                f"expected a list of kind {kind} at byte {self.file.tell()}, got {found}"
            )
        return length

    def name(self) -> str:
        length = self.number(self.count)
        self.skip(0 if length <= self.size else length)
        text = self.file.read(length).decode("utf-8", "replace")
        self.skip(_padded(length) - length)
        return text

    def dimension(self) -> int:
        self.name()
        return self.number(self.count)

    def attributes(self) -> None:
        for _ in range(self.list_of(_ATTRIBUTES)):
            self.name()
            size = self.type_size()
            self.skip(_padded(size * self.number(self.count)))

    def type_size(self) -> int:
        kind = self.number(4)
        if kind not in _SIZES:
            raise FileFormatError(f"unknown type {kind} at byte {self.file.tell()}")
        return _SIZES[kind]

    def variable(self, lengths: list[int]) -> _Variable:
        name, count = self.name(), self.number(self.count)
        if count > _MOST:
            raise FileFormatError(f"{name!r} has {count} dimensions, expected at most {_MOST}")
        numbers = [self.number(self.count) for _ in range(count)]
        if any(number >= len(lengths) for number in numbers):
            raise FileFormatError(f"{name!r} has dimensions that there are not")
        self.attributes()
        size = self.type_size()
        self.skip(self.count)  # its size once more, wrong where it is large
        shape = [lengths[number] for number in numbers]
        records = bool(shape) and shape[0] == 0
        values = math.prod(shape[1:] if records else shape)
        return _Variable(name, self.number(self.offset), values * size, records)


def _padded(size: int) -> int:
    return -(-size // 4) * 4
