"""Parser for Phantom's native dumps: Fortran records with a tagged header and tagged arrays.

The layout is described in Phantom's documentation (https://phantomsph.readthedocs.io, "Phantom dump
file format"), and by Price et al. (2018, PASA 35, e031).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from ...errors import FileFormatError

# Required numbers in the first record.
_FIRST, _SECOND, _THIRD = 60769, 60878, 690706
# Sizes in bytes of default integers and reals, by the length of the first record.
_SIZES = {20: (4, 4), 24: (4, 8), 36: (8, 4), 40: (8, 8)}
_TAG = 16
_KINDS = 8
_MOST_ARRAYS = 1 << 12


@dataclass(frozen=True)
class DumpArray:
    """An array in the file: offset, type and number of values."""

    offset: int
    dtype: np.dtype
    count: int


@dataclass(frozen=True)
class PhantomDump:
    """The contents of a dump."""

    header: dict[str, np.ndarray]  # all header numbers by tag
    particles: dict[str, DumpArray]
    sinks: dict[str, DumpArray]


def byte_order(head: bytes) -> str | None:
    """Return the byte order of a dump, ``"<"`` or ``">"``; None for any other file."""
    for order in "<>":
        if len(head) >= 12:
            length = int(np.frombuffer(head, f"{order}i4", 1)[0])
            size = _SIZES.get(length, (0, 0))[0]
            if size and np.frombuffer(head, f"{order}i{size}", 1, offset=4)[0] == _FIRST:
                return order
    return None


def read_dump(path: Path) -> PhantomDump:
    """Return the contents of a tagged one-block dump, without particle values."""
    with open(path, "rb") as file:
        records = _Records(file, path.stat().st_size)
        order = byte_order(records.start)
        if order is None:
            raise FileFormatError("expected a dump of Phantom; its first record is another")
        records.order = order
        types = _types(records)
        identity = records.read().decode("latin-1").strip()
        if len(identity) < 2 or identity[1] != "T":
            raise FileFormatError(
                f"it is of the format without tags ({identity[:20]!r}); convert it with a newer "
                "Phantom (phantom2… or moddump)"
            )
        return _blocks(records, types, _header(records, types))


class _Records:
    """Fortran records: a four-byte length precedes and follows each."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self.file, self.size, self.order = file, size, "<"
        self.start = file.read(16)
        file.seek(0)

    def skip(self) -> tuple[int, int]:
        place = self.file.tell()
        length = self._marker(place)
        if length < 0:
            raise FileFormatError(f"the record at byte {place} has parts: more than 2 GiB")
        if place + length + 8 > self.size:
            raise FileFormatError(
                f"it is cut short: {self.size} bytes, but a record of {length} begins at {place}"
            )
        self.file.seek(place + 4 + length)
        if self._marker(place + 4 + length) != length:
            raise FileFormatError(f"the record at byte {place} does not end as it begins")
        return place + 4, length

    def _marker(self, place: int) -> int:
        raw = self.file.read(4)
        if len(raw) < 4:
            raise FileFormatError(f"it is cut short: a record should be at byte {place}")
        return int(np.frombuffer(raw, f"{self.order}i4")[0])

    def read(self) -> bytes:
        place, length = self.skip()
        end = self.file.tell()
        self.file.seek(place)
        content = self.file.read(length)
        self.file.seek(end)
        return content

    def numbers(self, dtype: Any, count: int) -> np.ndarray:
        content = self.read()
        if len(content) != count * np.dtype(dtype).itemsize:
            raise FileFormatError(
                f"expected a record of {count} {dtype} before byte {self.file.tell()}, got "
                f"{len(content)} bytes"
            )
        return np.frombuffer(content, dtype)

    def tags(self, count: int) -> list[str]:
        letters = self.numbers("S1", count * _TAG).tobytes().decode("latin-1")
        return [letters[k * _TAG : (k + 1) * _TAG].strip() for k in range(count)]


def _types(records: _Records) -> list[np.dtype]:
    """Return the number types of the header, in file order."""
    content = records.read()
    integer, real = _SIZES[len(content)]
    order = records.order
    layout = [("a", integer), ("r", real), ("b", integer), ("v", integer), ("c", integer)]
    first = np.frombuffer(
        content, [(n, f"{order}{'f' if n == 'r' else 'i'}{size}") for n, size in layout]
    )[0]
    if (first["a"], first["b"], first["c"]) != (_FIRST, _SECOND, _THIRD):
        raise FileFormatError(
            f"expected {_FIRST}, {_SECOND} and {_THIRD} to begin with, got {first}"
        )
    names = (f"i{integer}", "i1", "i2", "i4", "i8", f"f{real}", "f4", "f8")
    return [np.dtype(f"{order}{name}") for name in names]


def _header(records: _Records, types: list[np.dtype]) -> dict[str, np.ndarray]:
    found: dict[str, list[Any]] = {}
    for dtype in types:
        (count,) = records.numbers(types[0], 1)
        if not 0 <= count <= _MOST_ARRAYS:
            raise FileFormatError(f"the header cannot hold {count} numbers of {dtype}")
        if count:
            tags = records.tags(int(count))
            for tag, value in zip(tags, records.numbers(dtype, int(count)), strict=True):
                found.setdefault(tag, []).append(value)
    return {tag: np.array(values) for tag, values in found.items()}


def _blocks(records: _Records, types: list[np.dtype], header: dict[str, np.ndarray]) -> PhantomDump:
    (groups,) = records.numbers(types[0], 1)
    blocks = int(header.get("nblocks", np.ones(1))[0])
    if blocks != 1:
        raise FileFormatError(
            f"it is in {blocks} blocks, one for each MPI task; write it with a single one"
        )
    if not 1 <= groups <= _KINDS:
        raise FileFormatError(f"expected 1 to {_KINDS} groups of arrays, got {groups}")
    sizes = [_group(records) for _ in range(int(groups))]
    found = [_arrays(records, types, count, numbers) for count, numbers in sizes]
    count = sizes[0][0]
    particles = dict(found[0])
    # Magnetic fields and radiation have separate groups; the second group holds the sinks.
    for (other, _), arrays in zip(sizes[2:], found[2:], strict=True):
        particles |= arrays if other == count else {}
    return PhantomDump(header, particles, found[1] if len(found) > 1 else {})


def _group(records: _Records) -> tuple[int, np.ndarray]:
    """Return the array length of a group, and its number of arrays per type."""
    order = records.order
    (group,) = records.numbers([("count", f"{order}i8"), ("numbers", f"{order}i4", _KINDS)], 1)
    numbers = group["numbers"]
    if group["count"] < 0 or (numbers < 0).any() or numbers.sum() > _MOST_ARRAYS:
        raise FileFormatError(
            f"a group of {group['count']} numbers, in {numbers} arrays, cannot be"
        )
    return int(group["count"]), numbers


def _arrays(
    records: _Records, types: list[np.dtype], count: int, numbers: np.ndarray
) -> dict[str, DumpArray]:
    found: dict[str, DumpArray] = {}
    for dtype, many in zip(types, numbers, strict=True):
        for _ in range(int(many)):
            (tag,) = records.tags(1)
            offset, length = records.skip()
            if length != count * dtype.itemsize:
                raise FileFormatError(f"{tag!r} has {length} bytes, expected {count} of {dtype}")
            found.setdefault(tag, DumpArray(offset, dtype, count))
    return found
