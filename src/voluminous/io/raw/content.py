"""Where in a raw file the numbers are, and what they are: all that is told, put together."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError, InputError
from ..arrays.layout import AXES, axis_order
from ..names import field_name
from ..payload import is_packed, mapped, read_exactly, unpacked
from .order import is_turned
from .sidecar import header_beside, told_beside
from .told import Told, told_by_name, told_by_options
from .unknown import what_to_give

PACKED = (".gz", ".bz2", ".xz")
# Values at the beginning of a packed file by which the order of its axes is told.
_SAMPLE = 1 << 24
_ORDERS: dict[str, Any] = {"little": "<", "big": ">", "<": "<", ">": ">"}


@dataclass(frozen=True)
class Content:
    """The numbers in a file.

    Attributes
    ----------
    cells : tuple of three int
        Along x, y and z.
    dtype : dtype
        With the order of bytes.
    axes : str
        What the axes are, from the slowest to the fastest.
    offset : int
        Bytes before the first value.
    packed : bool
        True if gzip, bzip2 or xz packed the file.
    told : Told
        What else is known.
    """

    path: Path
    place: str
    cells: tuple[int, int, int]
    dtype: np.dtype[Any]
    axes: str
    offset: int
    packed: bool
    told: Told

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array in the file."""
        return tuple(self.cells[AXES.index(axis)] for axis in self.axes)

    @property
    def mapped(self) -> bool:
        """True if the values can stay in the file."""
        return not self.packed and self.axes == AXES and self.dtype.isnative

    def values(self) -> np.ndarray:
        """Return the values as [ix, iy, iz].

        Raises
        ------
        FileFormatError
            If there are more, or fewer.
        """
        found = self._unpacked() if self.packed else self._flat().reshape(self.shape)
        return found.transpose(axis_order(self.axes))

    def sample(self) -> np.ndarray:
        """Return all values in the order of the file, or many of the first."""
        if not self.packed:
            return self._flat()
        with unpacked(self.path) as stream:
            self._skip(stream)
            return read_exactly(stream, (min(math.prod(self.cells), _SAMPLE),), self.dtype)

    def _flat(self) -> np.ndarray:
        return mapped(self.path, self.offset, (math.prod(self.cells),), self.dtype)

    def _unpacked(self) -> np.ndarray:
        with unpacked(self.path) as stream:
            self._skip(stream)
            values = read_exactly(stream, self.shape, self.dtype)
            if stream.read(1):
                raise FileFormatError(
                    f"it holds more than {_times(self.cells)} values of {self.dtype} (from "
                    f"{self.told.source}); give shape, dtype or offset"
                )
        return values

    def _skip(self, stream: Any) -> None:
        if self.offset:
            read_exactly(stream, (self.offset,), np.uint8, "the bytes before the data")


def split(path: Path) -> tuple[str, str]:
    """Return suffix and stem of a name, without the suffix of a packer."""
    inner = path.with_suffix("") if path.suffix.lower() in PACKED else path
    return inner.suffix.lower(), inner.stem


def stems_of(path: Path) -> tuple[str, ...]:
    """Return the names, without ending, that the description of a file may have."""
    stem = split(path)[1]
    return tuple(dict.fromkeys((stem, told_by_name(stem)[1])))


def content_of(path: Path, options: Mapping[str, Any]) -> Content:
    """Return what is in a file: what the user tells goes before a file beside it, and its name.

    Raises
    ------
    InputError
        If shape or type are not known; says what to give.
    FileFormatError
        If what is told does not fit the file's size.
    """
    by_name, rest = told_by_name(split(path)[1])
    stems = stems_of(path)
    told = told_by_options(options).over(told_beside(path, stems).over(by_name))
    offset = _offset(options.get("offset"))
    with open(path, "rb") as file:
        packed = is_packed(file.read(8))
    if told.shape is None or told.dtype is None:
        size = None if packed else path.stat().st_size - offset
        raise InputError(what_to_give(told, size, header_beside(path, stems)))
    dtype = _ordered(told.dtype, options.get("byteorder"))
    axes = options.get("axes") or AXES[::-1]
    axis_order(axes)
    place = field_name(rest or stems[0])
    content = Content(path, place, told.shape, dtype, axes, offset, packed, told)
    if not packed:
        _check_size(content)
    return _turned(content) if told.turnable and options.get("axes") is None else content


def _turned(content: Content) -> Content:
    """Return the content with its shape in the order that the values speak for."""
    turned, why = is_turned(content.sample(), content.cells)
    told = replace(content.told, source=f"{content.told.source}, {why}")
    nx, ny, nz = content.cells
    return replace(content, told=told, cells=(nz, ny, nx) if turned else (nx, ny, nz))


def _check_size(content: Content) -> None:
    found = content.path.stat().st_size - content.offset
    expected = math.prod(content.cells) * content.dtype.itemsize
    if found == expected:
        return
    hint = (
        f"it is cut short by {expected - found}, or shape or type are others"
        if found < expected
        else f"give offset={found - expected} if the first ones are a header"
    )
    raise FileFormatError(
        f"{_times(content.cells)} values of {content.dtype} (from {content.told.source}) take "
        f"{expected} bytes, but there are {found}: {hint}"
    )


def _times(cells: tuple[int, ...]) -> str:
    return " x ".join(map(str, cells))


def _offset(offset: Any) -> int:
    if offset is None:
        return 0
    if not isinstance(offset, (int, np.integer)) or offset < 0:
        raise InputError(f"offset must be a number of bytes, got {offset!r}")
    return int(offset)


def _ordered(dtype: np.dtype[Any], order: Any) -> np.dtype[Any]:
    if order is None:
        return dtype
    if order not in _ORDERS:
        raise InputError(f"byteorder must be 'little' or 'big', got {order!r}")
    return dtype.newbyteorder(_ORDERS[order])
