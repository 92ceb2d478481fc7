"""Parser for Phantom's native dumps: Fortran records with a tagged header and tagged arrays.

The layout is described in Phantom's documentation (https://phantomsph.readthedocs.io, "Phantom dump
file format"), and by Price et al. (2018, PASA 35, e031).
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...errors import FileFormatError
from ..contract import StoredField
from ..payload import stored

# Required numbers in the first record.
_FIRST, _SECOND, _THIRD = 60769, 60878, 690706
# Sizes in bytes of default integers and reals, by the length of the first record.
_SIZES = {20: (4, 4), 24: (4, 8), 36: (8, 4), 40: (8, 8)}
_TAG = 16
_KINDS = 8
_MOST_ARRAYS = 1 << 12

Columns = dict[str, StoredField]


class PhantomDump(NamedTuple):
    """The contents of a dump, by tag."""

    header: dict[str, np.ndarray]
    particles: Columns
    sinks: Columns


def byte_order(head: bytes) -> str | None:
    """Return the byte order of a dump, ``"<"`` or ``">"``; None for any other file."""
    for order in "<>":
        if len(head) >= 12:
            length = int(np.frombuffer(head, f"{order}i4", 1)[0])
            size = _SIZES.get(length, (0, 0))[0]
            if size and np.frombuffer(head, f"{order}i{size}", 1, offset=4)[0] == _FIRST:
                return order
    return None


class _Records:
    """Fortran records of a file: a four-byte length precedes and follows each."""

    def __init__(self, path: Path) -> None:
        self.path, self.size, self.place = path, path.stat().st_size, 0
        with path.open("rb") as file:
            order = byte_order(file.read(16))
        if order is None:
            raise FileFormatError("expected a dump of Phantom; its first record is another")
        self.order = order

    def read(self) -> np.ndarray:
        """Return the bytes of the next record."""
        first, length = self.next()
        return _values(self.path, first, length, np.dtype(np.uint8))

    def next(self) -> tuple[int, int]:
        """Return where the next record begins, and its length."""
        first, length = self.place + 4, self._mark(self.place)
        if length < 0:
            raise FileFormatError(f"the record at byte {self.place} has parts: more than 2 GiB")
        if self._mark(first + length) != length:
            raise FileFormatError(f"the record at byte {self.place} does not end as it begins")
        self.place = first + length + 4
        return first, length

    def _mark(self, place: int) -> int:
        if place + 4 > self.size:
            raise FileFormatError(
                f"it is cut short: {self.size} bytes, but a record of length should be at "
                f"byte {place}"
            )
        return int(_values(self.path, place, 1, np.dtype(f"{self.order}i4"))[0])

    def numbers(self, dtype: Any, count: int) -> np.ndarray:
        return _values(self.path, self.begin(np.dtype(dtype), count), count, np.dtype(dtype))

    def begin(self, dtype: np.dtype, count: int, what: str = "") -> int:
        """Return where the next record begins, which is so many numbers."""
        first, length = self.next()
        if length != count * dtype.itemsize:
            raise FileFormatError(
                f"expected a record {what}of {count} {dtype} before byte {self.place}, got "
                f"{length} bytes"
            )
        return first

    def tags(self, count: int) -> list[str]:
        letters = self.numbers(f"S{_TAG}", count).tolist()
        return [tag.decode("latin-1").strip() for tag in letters]


def _values(path: Path, first: int, count: int, dtype: np.dtype) -> np.ndarray:
    return stored(path, first, (count,), dtype) if count else np.empty(0, dtype)


def read_dump(path: Path) -> PhantomDump:
    """Return the contents of a tagged one-block dump."""
    records = _Records(path)
    types = _types(records)
    identity = records.read().tobytes().decode("latin-1").strip()
    if len(identity) < 2 or identity[1] != "T":
        raise FileFormatError(
            f"it is of the format without tags ({identity[:20]!r}); convert it with a newer "
            "Phantom (phantom2… or moddump)"
        )
    numbers: dict[str, list[Any]] = {}
    for dtype in types:
        (count,) = records.numbers(types[0], 1).tolist()
        if not 0 <= count <= _MOST_ARRAYS:
            raise FileFormatError(f"the header cannot hold {count} numbers of {dtype}")
        if count:
            tags = records.tags(count)
            for tag, value in zip(tags, records.numbers(dtype, count), strict=True):
                numbers.setdefault(tag, []).append(value)
    header = {tag: np.array(values) for tag, values in numbers.items()}
    (groups,) = records.numbers(types[0], 1).tolist()
    if (blocks := int(header.get("nblocks", np.ones(1))[0])) != 1:
        raise FileFormatError(
            f"it is in {blocks} blocks, one for each MPI task; write it with a single one"
        )
    if not 1 <= groups <= _KINDS:
        raise FileFormatError(f"expected 1 to {_KINDS} groups of arrays, got {groups}")
    sizes = [_group(records) for _ in range(groups)]
    arrays = [_arrays(records, types, count, many) for count, many in sizes]
    particles = arrays[0]
    # Magnetic fields and radiation have separate groups; the second group holds the sinks.
    for (count, _), more in zip(sizes[2:], arrays[2:], strict=True):
        particles = particles | more if count == sizes[0][0] else particles
    return PhantomDump(header, particles, arrays[1] if groups > 1 else {})


def _types(records: _Records) -> list[np.dtype]:
    content, order = records.read(), records.order
    integer, real = _SIZES[len(content)]
    i, r = f"{order}i{integer}", f"{order}f{real}"
    first = content.view([("a", i), ("r", r), ("b", i), ("version", i), ("c", i)])[0]
    if (first["a"], first["b"], first["c"]) != (_FIRST, _SECOND, _THIRD):
        raise FileFormatError(
            f"expected {_FIRST}, {_SECOND} and {_THIRD} to begin with, got {first}"
        )
    return [np.dtype(t) for t in (i, "i1", *(f"{order}{n}" for n in ("i2", "i4", "i8")), r)] + [
        np.dtype(f"{order}{n}") for n in ("f4", "f8")
    ]


def _group(records: _Records) -> tuple[int, list[int]]:
    order = records.order
    (group,) = records.numbers([("count", f"{order}i8"), ("numbers", f"{order}i4", _KINDS)], 1)
    count, numbers = int(group["count"]), group["numbers"].tolist()
    if count < 0 or min(numbers) < 0 or sum(numbers) > _MOST_ARRAYS:
        raise FileFormatError(f"a group of {count} numbers, in {numbers} arrays, cannot be")
    return count, numbers


def _arrays(records: _Records, types: list[np.dtype], count: int, numbers: list[int]) -> Columns:
    arrays: Columns = {}
    for dtype, many in zip(types, numbers, strict=True):
        for _ in range(many):
            (tag,) = records.tags(1)
            first = records.begin(dtype, count, f"{tag!r} ")
            load = functools.partial(_values, records.path, first, count, dtype)
            kind = dtype.newbyteorder("=")
            arrays.setdefault(tag, StoredField(tag, tag, (count,), kind, "", load))
    return arrays
