"""Reader for raw volumes: numbers without a header; the user or the name gives shape and type."""

from __future__ import annotations

import functools
import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError, InputError
from .arrays.layout import axis_order, equal_cells
from .axes import AXES
from .boxes import boxes
from .contract import Contents, ContentsReader, StoredField
from .names import field_name
from .payload import checked_shape, is_packed, read_exactly, stored, unpacked

# Suffixes of raw files with shape and type in their names.
_SUFFIXES = (".raw", ".bin", ".vol", ".dat", ".img")
_PACKED = (".gz", ".bz2", ".xz")
_ORDERS = {"little": "<", "big": ">", "<": "<", ">": ">"}
# Names as in https://klacansky.com/open-scivis-datasets: bonsai_256x256x256_uint8.raw, x first.
_SHAPE = re.compile(r"(?<![\d.])(?<!\d[xX])([1-9]\d*)[xX]([1-9]\d*)[xX]([1-9]\d*)(?!\d|[xX]\d)")
_TYPE = re.compile(
    r"(?<![a-z])(u?int(?:8|16|32|64)|float(?:32|64))_?(le|be)?(?![a-z0-9])", re.IGNORECASE
)


class RawReader(ContentsReader):
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

    def contents(self, path: Path, **options: Any) -> Contents:
        stem = _split(path)[1]
        cells, dtype, source, rest = _described(path, stem, options)
        offset = options.get("offset") or 0
        if not isinstance(offset, (int, np.integer)) or offset < 0:
            raise InputError(f"offset must be a number of bytes, got {offset!r}")
        offset = int(offset)
        if options.get("bounds") is not None and options.get("spacing") is not None:
            raise InputError("give bounds or spacing, not both")
        placing = options if options.get("bounds") is not None else {"spacing": 1.0, **options}
        axes = options.get("axes") or AXES[::-1]
        order, name = axis_order(axes), options.get("name") or field_name(rest or stem)
        shape = tuple(cells[AXES.index(axis)] for axis in axes)
        what = f"{' x '.join(map(str, cells))} values of {dtype} (from {source})"
        with open(path, "rb") as file:
            packed = is_packed(file.read(8))
        expected, size = math.prod(cells) * dtype.itemsize, path.stat().st_size - offset
        if not packed and size != expected:
            hint = (
                f"it is cut short by {expected - size}, or shape or type are others"
                if size < expected
                else f"give offset={size - expected} if the first ones are a header"
            )
            raise FileFormatError(f"{what} take {expected} bytes, but there are {size}: {hint}")

        def unpack() -> np.ndarray:
            with unpacked(path) as stream:
                if offset:
                    read_exactly(stream, (offset,), np.uint8, "the bytes before the data")
                values = read_exactly(stream, shape, dtype)
                if stream.read(1):
                    raise FileFormatError(f"it holds more than {what}; give shape, dtype or offset")
            return np.transpose(values, order)

        there = (path, offset, shape, dtype)
        load = unpack if packed else functools.partial(_turned, *there, order)
        pieces = None if packed else boxes(functools.partial(_part, *there), [shape], order=order)
        return Contents(
            [StoredField(name, field_name(rest or stem), shape, dtype, "", load, pieces)],
            lambda _: equal_cells(cells, placing, options.get("unit")),
            {"shape_from": source},
        )


def _turned(
    path: Path, offset: int, shape: tuple[int, ...], dtype: np.dtype, order: tuple[int, ...]
) -> np.ndarray:
    return np.transpose(stored(path, offset, shape, dtype), order)


def _part(
    path: Path,
    offset: int,
    shape: tuple[int, ...],
    dtype: np.dtype,
    index: tuple[slice, ...],
    level: int,
) -> np.ndarray:
    return stored(path, offset, shape, dtype, index)


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
    inner = path.with_suffix("") if path.suffix.lower() in _PACKED else path
    return inner.suffix.lower(), inner.stem


def _described(
    path: Path, stem: str, options: dict[str, Any]
) -> tuple[tuple[int, ...], np.dtype, str, str]:
    cells, dtype, rest = described_by_name(stem)
    source, shape, order = "the file's name", options.get("shape"), options.get("byteorder")
    if shape is not None:
        source = "the option shape"
        try:
            cells = checked_shape(tuple(shape))
        except (TypeError, ValueError, OverflowError, FileFormatError):
            cells = ()
        if len(cells) != 3:
            raise InputError(f"shape must be (nx, ny, nz), positive whole numbers, got {shape!r}")
    elif cells is not None and cells[0] != cells[2]:
        raise InputError(
            f"its name has {' x '.join(map(str, cells))}, which may be x first or z first; give "
            f"shape={cells} or shape={cells[::-1]}, which is (nx, ny, nz)"
        )
    if (given := options.get("dtype")) is not None:
        try:
            dtype = np.dtype(given)
        except TypeError as error:
            raise InputError(f"dtype must be a type such as 'uint16', got {given!r}") from error
        if dtype.kind not in "fiub":
            raise InputError(f"dtype must be a type of real numbers, got {dtype}")
    if cells is None or dtype is None:
        missing = " and ".join(["shape"] * (cells is None) + ["dtype"] * (dtype is None))
        headers = [path.with_name(stem + end) for end in (".mhd", ".nhdr", ".hdr")]
        beside = next((f"open {h.name} beside it, or " for h in headers if h.is_file()), "")
        raise InputError(
            f"bare numbers, and nothing gives their {missing}; {beside}give shape=(nx, ny, nz), "
            "dtype='uint8' (or 'int16', 'float32' …), and axes='xyz' if z varies fastest"
        )
    if order is not None:
        if order not in _ORDERS:
            raise InputError(f"byteorder must be 'little' or 'big', got {order!r}")
        dtype = dtype.newbyteorder(">" if _ORDERS[order] == ">" else "<")
    return cells, dtype, source, rest
