"""MetaImage (.mhd, .mha): what ITK, elastix and many scanners' exports write.

A head of lines ``key = value``, the last of which names the file of data (``LOCAL``: they follow).
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError
from ..payload import checked_shape
from .placement import LPS, Placement, lattice, single_field, slabs
from .stored import (
    AT_THE_END,
    PLAIN,
    TEXT,
    ZLIB,
    Stored,
    data_files,
    head_lines,
    named_files,
    real_numbers,
    whole_numbers,
)
from .voxels import VECTOR, VoxelReader, Voxels, component_names, time_step, times_meta

if TYPE_CHECKING:
    from ...volume import Volume

_FIRST_KEY = re.compile(rb"\s*(ObjectType\s*=\s*Image|NDims\s*=|Comment\s*=)")
_NEEDED_KEY = re.compile(rb"^\s*NDims\s*=", re.MULTILINE)
_DATA = "ElementDataFile"
_LONGEST_LIST = 4 << 20
# One thing has had several names.
_OFFSET = ("Offset", "Position", "Origin")
_MATRIX = ("TransformMatrix", "Rotation", "Orientation")
_SPACING = ("ElementSpacing", "ElementSize")
_BIG = ("BinaryDataByteOrderMSB", "ElementByteOrderMSB")
_TYPES = {
    "MET_CHAR": "i1",
    "MET_UCHAR": "u1",
    "MET_SHORT": "i2",
    "MET_USHORT": "u2",
    "MET_INT": "i4",
    "MET_UINT": "u4",
    "MET_LONG": "i4",
    "MET_ULONG": "u4",
    "MET_LONG_LONG": "i8",
    "MET_ULONG_LONG": "u8",
    "MET_FLOAT": "f4",
    "MET_DOUBLE": "f8",
}
# Either end of an axis by one of them.
_SIDES = str.maketrans("LPS", "RAI")
_UNITS = {"um": "um", "mm": "mm", "cm": "cm"}


class MetaImageReader(VoxelReader):
    """A MetaImage of three dimensions, or of four: a time series."""

    name = "metaimage"
    description = "a MetaImage (.mhd, .mha)"
    suffixes = (".mhd", ".mha")
    options = {  # noqa: RUF012 - as in Reader
        **VoxelReader.options,
        "time": "number of the time step, from 0, of a file with four dimensions",
    }
    writes = True

    def matches(self, path: Path, head: bytes) -> bool:
        return bool(_FIRST_KEY.match(head) and _NEEDED_KEY.search(head))

    def voxels(self, path: Path, *, time: int = 0) -> Voxels:
        lines, end, found = head_lines(path, lambda line: "=" in line and _key(line) == _DATA)
        if not found:
            raise FileFormatError(f"expected a line '{_DATA} = …' at the end of its head")
        head = dict(_pair(line) for line in lines if "=" in line)
        shape = _shape(head)
        dtype, channels = _dtype(head), _one(head, "ElementNumberOfChannels", 1)
        if not 1 <= channels <= 1 << 16:
            raise FileFormatError(f"ElementNumberOfChannels must be positive, got {channels}")
        times = math.prod(shape[3:])
        count = math.prod(shape) * channels
        stored = _stored(path, head, end, dtype, count).check()
        step = time_step(time, times) * (count // times)
        block = (*shape[2::-1], channels)

        def load(number: int) -> np.ndarray:
            return stored.read(step, block)[..., number].transpose()

        vector = VECTOR if channels == 3 and dtype.kind == "f" else ()
        return Voxels(
            shape=shape[:3],
            dtype=dtype.newbyteorder("="),
            placement=_placement(head, len(shape)),
            load=load,
            components=component_names(channels, vector),
            meta=times_meta(times, time % times),
        )

    def write(self, volume: Volume, path: Path) -> None:
        name = single_field(volume, "a MetaImage")
        placed = lattice(volume, "mm")
        values = volume.array(name)
        types = {np.dtype(code): key for key, code in reversed(_TYPES.items())}
        stored = np.dtype(np.uint8) if values.dtype == np.bool_ else values.dtype
        head = {
            "ObjectType": "Image",
            "NDims": "3",
            "BinaryData": "True",
            "BinaryDataByteOrderMSB": "False",
            "CompressedData": "False",
            **({"AnatomicalOrientation": "RAI"} if volume.meta.get("orientation") == LPS else {}),
            "TransformMatrix": _line(placed.units),
            "Offset": _line(placed.origin),
            "ElementSpacing": _line(placed.widths),
            "DimSize": " ".join(map(str, values.shape)),
            "ElementType": types[stored],
            _DATA: "LOCAL",
        }
        with open(path, "wb") as file:
            file.write("".join(f"{key} = {value}\n" for key, value in head.items()).encode())
            for slab in slabs(values):
                file.write(slab)


def _key(line: str) -> str:
    return line.partition("=")[0].strip()


def _pair(line: str) -> tuple[str, str]:
    key, _, value = line.partition("=")
    return key.strip(), value.strip()


def _line(numbers: np.ndarray) -> str:
    return " ".join(repr(float(number)) for number in numbers.ravel())


def _first(head: dict[str, str], keys: tuple[str, ...]) -> str:
    return next((head[key] for key in keys if head.get(key)), "")


def _is_true(text: str) -> bool:
    return text[:1].lower() in ("t", "y", "1") if text else False


def _one(head: dict[str, str], key: str, default: int) -> int:
    numbers = whole_numbers(head.get(key) or str(default), key)
    if len(numbers) != 1:
        raise FileFormatError(f"{key} must be one number, got {head[key]!r}")
    return numbers[0]


def _shape(head: dict[str, str]) -> tuple[int, ...]:
    shape = checked_shape(whole_numbers(head.get("DimSize", ""), "DimSize"), "DimSize")
    if len(shape) != _one(head, "NDims", 0) or len(shape) not in (3, 4):
        raise FileFormatError(
            f"expected NDims = 3 (or 4 with time) and as many in DimSize, got "
            f"{head.get('NDims')!r} and {shape}"
        )
    return shape


def _dtype(head: dict[str, str]) -> np.dtype[Any]:
    code = head.get("ElementType", "").removesuffix("_ARRAY")
    if code not in _TYPES:
        raise FileFormatError(f"ElementType must be one of {', '.join(_TYPES)}, got {code!r}")
    big = _is_true(_first(head, _BIG))
    return np.dtype(_TYPES[code]).newbyteorder(">" if big else "<")


def _placement(head: dict[str, str], ndims: int) -> Placement:
    def numbers(keys: tuple[str, ...], default: np.ndarray) -> np.ndarray:
        text = _first(head, keys)
        return np.array(real_numbers(text, keys[0], default.size)) if text else default.ravel()

    spacing = numbers(_SPACING, np.ones(ndims))
    matrix = numbers(_MATRIX, np.eye(ndims)).reshape(ndims, ndims)
    origin = numbers(_OFFSET, np.zeros(ndims))
    unit = _UNITS.get(head.get("DistanceUnits", ""), "mm")
    steps = matrix[:3, :3] * spacing[:3, None]
    return Placement(origin[:3], steps, unit, LPS if _is_anatomical(head) else "")


def _is_anatomical(head: dict[str, str]) -> bool:
    """Return True if the coordinates are a patient's: they are LPS then, as ITK's always are.

    The three letters describe the axes of the array by the side they come from (ITK) or lead to
    (MetaIO's manual); where there is a matrix it says the same without doubt.
    """
    letters = head.get("AnatomicalOrientation", "").upper()
    if _first(head, _MATRIX):
        return sorted(letters.translate(_SIDES)) == ["A", "I", "R"]
    return letters in ("RAI", LPS)


def _stored(path: Path, head: dict[str, str], end: int, dtype: np.dtype[Any], count: int) -> Stored:
    packing = ZLIB if _is_true(head.get("CompressedData", "")) else PLAIN
    packing = packing if _is_true(head.get("BinaryData", "True")) else TEXT
    if head[_DATA].upper() == "LOCAL":
        return Stored((path,), dtype, count, packing, end)
    start = _one(head, "HeaderSize", 0)
    start = AT_THE_END if start == -1 and packing == PLAIN else start
    return Stored(_files(path, head[_DATA], end), dtype, count, packing, start)


def _files(path: Path, named: str, end: int) -> tuple[Path, ...]:
    """Return the file of data, or a file for each slice: listed, or numbered by a pattern."""
    words = named.split()
    if not words or words[0].upper() != "LIST":
        return data_files(path, named)
    _check_slices(words[1:])
    with open(path, "rb") as file:
        file.seek(end)
        listed = file.read(_LONGEST_LIST + 1)
    if len(listed) > _LONGEST_LIST:
        raise FileFormatError(f"its list of files does not end within {_LONGEST_LIST} bytes")
    lines = listed.decode("utf-8", "replace").splitlines()
    return named_files(path, [line.strip() for line in lines if line.strip()])


def _check_slices(words: list[str]) -> None:
    # Without a number the files hold slices; whole slabs of them are read the same way.
    if words not in ([], ["2"], ["2D"], ["3"], ["3D"]):
        raise FileFormatError(f"expected files of slices, got {_DATA} = LIST {' '.join(words)}")
