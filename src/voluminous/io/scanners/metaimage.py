"""MetaImage (.mhd, .mha): what ITK, elastix and many scanners' exports write.

A header of lines ``key = value``; the last names the file of data (``LOCAL``: they follow).
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
    StoredNumbers,
    data_files,
    header_lines,
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
_MATRIX = ("TransformMatrix", "Rotation", "Orientation")
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
        lines, end, found = header_lines(
            path, lambda line: "=" in line and line.partition("=")[0].strip() == _DATA
        )
        if not found:
            raise FileFormatError(f"expected a line '{_DATA} = …' at the end of its header")
        pairs = (line.partition("=") for line in lines if "=" in line)
        header = {key.strip(): value.strip() for key, _, value in pairs}
        shape = checked_shape(whole_numbers(header.get("DimSize", ""), "DimSize"), "DimSize")
        if len(shape) != _one(header, "NDims", 0) or len(shape) not in (3, 4):
            raise FileFormatError(
                "expected NDims = 3 (or 4 with time) and as many in DimSize, got "
                f"{header.get('NDims')!r} and {shape}"
            )
        code = header.get("ElementType", "").removesuffix("_ARRAY")
        if code not in _TYPES:
            raise FileFormatError(f"ElementType must be one of {', '.join(_TYPES)}, got {code!r}")
        big = _is_true(_first(header, ("BinaryDataByteOrderMSB", "ElementByteOrderMSB")))
        dtype = np.dtype(_TYPES[code]).newbyteorder(">" if big else "<")
        channels = _one(header, "ElementNumberOfChannels", 1)
        if not 1 <= channels <= 1 << 16:
            raise FileFormatError(f"ElementNumberOfChannels must be positive, got {channels}")
        times = math.prod(shape[3:])
        count = math.prod(shape) * channels
        stored = _stored(path, header, end, dtype, count).check()
        step = time_step(time, times)

        def load(number: int) -> np.ndarray:
            block = stored.read(step * (count // times), (*shape[2::-1], channels))
            return block[..., number].transpose()

        vector = VECTOR if channels == 3 and dtype.kind == "f" else ()
        return Voxels(
            shape=shape[:3],
            dtype=dtype.newbyteorder("="),
            placement=_placement(header, len(shape)),
            load=load,
            components=component_names(channels, vector),
            meta=times_meta(times, step),
        )

    def write(self, volume: Volume, path: Path) -> None:
        name, placed = single_field(volume, "a MetaImage"), lattice(volume, "mm")
        values = volume.array(name)
        types = {np.dtype(code): key for key, code in reversed(_TYPES.items())}
        patient = volume.meta.get("orientation") == LPS
        header = {
            "ObjectType": "Image",
            "NDims": "3",
            "BinaryData": "True",
            "BinaryDataByteOrderMSB": "False",
            "CompressedData": "False",
            **({"AnatomicalOrientation": "RAI"} if patient else {}),
            "TransformMatrix": _line(placed.units),
            "Offset": _line(placed.origin),
            "ElementSpacing": _line(placed.widths),
            "DimSize": " ".join(map(str, values.shape)),
            "ElementType": types[np.dtype(np.uint8 if values.dtype == np.bool_ else values.dtype)],
            _DATA: "LOCAL",
        }
        with open(path, "wb") as file:
            file.write("".join(f"{key} = {value}\n" for key, value in header.items()).encode())
            file.writelines(slabs(values))


def _line(numbers: np.ndarray) -> str:
    return " ".join(repr(float(number)) for number in numbers.ravel())


def _first(header: dict[str, str], keys: tuple[str, ...]) -> str:
    return next((header[key] for key in keys if header.get(key)), "")


def _is_true(text: str) -> bool:
    return text[:1].lower() in ("t", "y", "1") if text else False


def _one(header: dict[str, str], key: str, default: int) -> int:
    numbers = whole_numbers(header.get(key) or str(default), key)
    if len(numbers) != 1:
        raise FileFormatError(f"{key} must be one number, got {header[key]!r}")
    return numbers[0]


def _placement(header: dict[str, str], ndims: int) -> Placement:
    def numbers(keys: tuple[str, ...], default: np.ndarray) -> np.ndarray:
        text = _first(header, keys)
        return np.array(real_numbers(text, keys[0], default.size)) if text else default.ravel()

    spacing = numbers(("ElementSpacing", "ElementSize"), np.ones(ndims))
    matrix = numbers(_MATRIX, np.eye(ndims)).reshape(ndims, ndims)
    origin = numbers(("Offset", "Position", "Origin"), np.zeros(ndims))
    unit = header.get("DistanceUnits", "")
    # Three letters describe the axes of the array by the side they come from (ITK) or lead to
    # (MetaIO's manual): the coordinates are a patient's. A matrix says the same without doubt.
    letters = header.get("AnatomicalOrientation", "").upper()
    patient = letters in ("RAI", LPS)
    if _first(header, _MATRIX):
        patient = sorted(letters.translate(_SIDES)) == ["A", "I", "R"]
    steps = matrix[:3, :3] * spacing[:3, None]
    unit = unit if unit in ("um", "mm", "cm") else "mm"
    return Placement(origin[:3], steps, unit, LPS if patient else "")


def _stored(
    path: Path, header: dict[str, str], end: int, dtype: np.dtype[Any], count: int
) -> StoredNumbers:
    packing = ZLIB if _is_true(header.get("CompressedData", "")) else PLAIN
    packing = packing if _is_true(header.get("BinaryData", "True")) else TEXT
    named = header[_DATA]
    if named.upper() == "LOCAL":
        return StoredNumbers((path,), dtype, count, packing, end)
    words = named.split()
    if words and words[0].upper() == "LIST":  # a file for each slice, or slab of them
        if words[1:] not in ([], ["2"], ["2D"], ["3"], ["3D"]):
            raise FileFormatError(f"expected files of slices, got {_DATA} = {named}")
        with open(path, "rb") as file:
            file.seek(end)
            listed = file.read(_LONGEST_LIST).decode("utf-8", "replace").splitlines()
        files = data_files(path, [line.strip() for line in listed if line.strip()])
    else:
        files = data_files(path, named)
    start = _one(header, "HeaderSize", 0)
    start = AT_THE_END if start == -1 and packing == PLAIN else start
    return StoredNumbers(files, dtype, count, packing, start)
