"""Reader for raw volumes: numbers without a header; the user or the name gives shape and type."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..deferred import Deferred
from ..errors import FileFormatError, InputError
from .arrays.layout import AXES, axis_order, equal_cells
from .contract import FieldChoice, FieldInfo, Reader
from .names import chosen_fields, field_name
from .payload import checked_shape, is_packed, mapped, read_exactly, unpacked

if TYPE_CHECKING:
    from ..volume import Volume

# Suffixes of raw files with shape and type in their names.
_SUFFIXES = (".raw", ".bin", ".vol", ".dat", ".img")
_PACKED = (".gz", ".bz2", ".xz")
_ORDERS = {"little": "<", "big": ">", "<": "<", ">": ">"}
# Names as in https://klacansky.com/open-scivis-datasets: bonsai_256x256x256_uint8.raw, x first.
_SHAPE = re.compile(r"(?<![\d.])(?<!\d[xX])([1-9]\d*)[xX]([1-9]\d*)[xX]([1-9]\d*)(?!\d|[xX]\d)")
_TYPE = re.compile(
    r"(?<![a-z])(u?int(?:8|16|32|64)|float(?:32|64))_?(le|be)?(?![a-z0-9])", re.IGNORECASE
)


@dataclass(frozen=True)
class RawNumbers:
    """The numbers in a file: offset, type and order."""

    path: Path
    name: str
    cells: tuple[int, ...]  # along x, y and z
    dtype: np.dtype  # including the byte order
    axes: str  # from the slowest to the fastest
    offset: int  # bytes before the first value
    packed: bool  # by gzip, bzip2 or xz
    source: str  # source of the shape, for messages

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array in the file."""
        return tuple(self.cells[AXES.index(axis)] for axis in self.axes)

    def values(self) -> np.ndarray:
        """Return the values as [ix, iy, iz]."""
        if not self.packed:
            return mapped(self.path, self.offset, self.shape, self.dtype).transpose(self._order)
        with unpacked(self.path) as stream:
            if self.offset:
                read_exactly(stream, (self.offset,), np.uint8, "the bytes before the data")
            values = read_exactly(stream, self.shape, self.dtype)
            if stream.read(1):
                raise FileFormatError(
                    f"it holds more than {_times(self.cells)} values of {self.dtype} (from "
                    f"{self.source}); give shape, dtype or offset"
                )
        return values.transpose(self._order)

    @property
    def _order(self) -> tuple[int, ...]:
        return axis_order(self.axes)

    def check_size(self) -> None:
        found = self.path.stat().st_size - self.offset
        expected = math.prod(self.cells) * self.dtype.itemsize
        if found == expected:
            return
        hint = (
            f"it is cut short by {expected - found}, or shape or type are others"
            if found < expected
            else f"give offset={found - expected} if the first ones are a header"
        )
        raise FileFormatError(
            f"{_times(self.cells)} values of {self.dtype} (from {self.source}) take {expected} "
            f"bytes, but there are {found}: {hint}"
        )


class RawReader(Reader):
    """Numbers without a header, compressed or not; x varies fastest unless `axes` is given."""

    name = "raw"
    description = "a raw file of numbers"
    suffixes = (".raw",)
    options = {  # noqa: RUF012 - as in Reader
        "shape": "number of cells (nx, ny, nz)",
        "dtype": "type of a value: 'uint8', 'int16', 'float32', '>u2' …",
        "byteorder": "'little' (default) or 'big'",
        "offset": "bytes before the first value",
        "axes": "what the axes are, from the slowest to the fastest: 'zyx' (default), 'xyz' …",
        "bounds": "(low, high) or ((x0, x1), (y0, y1), (z0, z1))",
        "spacing": "cell width, or one per axis (1)",
        "unit": "unit of length",
        "name": "name of the field; by default that of the file",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        suffix, stem = _split(path)
        shape, dtype, _ = described_by_name(stem)
        named = shape is not None and dtype is not None
        return bool(head) and (suffix == ".raw" or (suffix in _SUFFIXES and named))

    def read(self, path: Path, fields: FieldChoice = None, **options: Any) -> Volume:
        from ..volume import Volume

        numbers = _numbers(path, options)
        if options.get("bounds") is not None and options.get("spacing") is not None:
            raise InputError("give bounds or spacing, not both")
        given = options if options.get("bounds") is not None else {"spacing": 1.0, **options}
        volume = Volume(equal_cells(numbers.cells, given, options.get("unit")))
        stays = not numbers.packed and numbers.axes == AXES and numbers.dtype.isnative
        for name in chosen_fields({numbers.name: options.get("name") or numbers.name}, fields):
            volume[name] = Deferred(numbers.values, numbers.dtype, mapped=stays)
        volume.meta["shape_from"] = numbers.source
        return volume

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        numbers = _numbers(path, options)
        name = options.get("name") or numbers.name
        return (FieldInfo(name, numbers.name, numbers.shape, str(numbers.dtype)),)


def described_by_name(stem: str) -> tuple[tuple[int, ...] | None, np.dtype | None, str]:
    """Return shape and type given by a file's name (None if absent), and the rest of the name.

    Examples
    --------
    >>> described_by_name("foot_256x256x128_uint16be")
    ((256, 256, 128), dtype('>u2'), 'foot')
    """
    shape, kind = _SHAPE.search(stem), _TYPE.search(stem)
    rest = stem
    for match in (kind, shape):
        rest = rest.replace(match[0], "") if match else rest
    cells = tuple(int(n) for n in shape.groups()) if shape else None
    dtype = None
    if kind:
        big = (kind[2] or "").lower() == "be"
        dtype = np.dtype(kind[1].lower()).newbyteorder(">" if big else "<")
    return cells, dtype, re.sub(r"[_\-. ]+$|(?<=[_\-. ])[_\-. ]+", "", rest)


def _split(path: Path) -> tuple[str, str]:
    """Return suffix and stem of a file name, ignoring the suffix of a compressor."""
    inner = path.with_suffix("") if path.suffix.lower() in _PACKED else path
    return inner.suffix.lower(), inner.stem


def _numbers(path: Path, options: Mapping[str, Any]) -> RawNumbers:
    stem = _split(path)[1]
    shape, dtype, rest = described_by_name(stem)
    source = "the file's name"
    if options.get("shape") is not None:
        shape, source = _given_shape(options["shape"]), "the option shape"
    elif shape is not None and shape[0] != shape[2]:
        raise InputError(
            f"its name has {_times(shape)}, which may be x first or z first; give shape={shape} or "
            f"shape={shape[::-1]}, which is (nx, ny, nz)"
        )
    if options.get("dtype") is not None:
        dtype = _given_dtype(options["dtype"])
    offset = options.get("offset") or 0
    if not isinstance(offset, (int, np.integer)) or offset < 0:
        raise InputError(f"offset must be a number of bytes, got {offset!r}")
    if shape is None or dtype is None:
        raise InputError(_missing(path, shape is None, dtype is None))
    order = options.get("byteorder")
    if order is not None:
        if order not in _ORDERS:
            raise InputError(f"byteorder must be 'little' or 'big', got {order!r}")
        dtype = dtype.newbyteorder(">" if _ORDERS[order] == ">" else "<")
    with open(path, "rb") as file:
        packed = is_packed(file.read(8))
    axes = options.get("axes") or AXES[::-1]
    axis_order(axes)  # raises an error if they are not x, y and z
    name = field_name(rest or stem)
    numbers = RawNumbers(path, name, shape, dtype, axes, int(offset), packed, source)
    if not packed:
        numbers.check_size()
    return numbers


def _missing(path: Path, shape: bool, dtype: bool) -> str:
    what = " and ".join(n for n, lacks in (("shape", shape), ("dtype", dtype)) if lacks)
    headers = [path.with_name(_split(path)[1] + end) for end in (".mhd", ".nhdr", ".hdr")]
    beside = next(
        (f"open {header.name} beside it, or " for header in headers if header.is_file()), ""
    )
    return (
        f"bare numbers, and nothing gives their {what}; {beside}give shape=(nx, ny, nz), "
        "dtype='uint8' (or 'int16', 'float32' …), and axes='xyz' if z varies fastest"
    )


def _given_shape(shape: Any) -> tuple[int, ...]:
    try:
        numbers = checked_shape(tuple(shape))
    except (TypeError, ValueError, OverflowError, FileFormatError):
        numbers = ()
    if len(numbers) != 3:
        raise InputError(f"shape must be (nx, ny, nz), positive whole numbers, got {shape!r}")
    return numbers


def _given_dtype(dtype: Any) -> np.dtype:
    try:
        found = np.dtype(dtype)
    except TypeError as error:
        raise InputError(f"dtype must be a type such as 'uint16', got {dtype!r}") from error
    if found.kind not in "fiub":
        raise InputError(f"dtype must be a type of real numbers, got {found}")
    return found


def _times(cells: tuple[int, ...]) -> str:
    return " x ".join(map(str, cells))
