"""MetaImage (.mhd, .mha): what ITK, elastix and many scanners' exports write.

A header of lines ``key = value``; the last names the file of data (``LOCAL``: they follow).
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...errors import FileFormatError
from ..guard import by_library
from ..payload import checked_shape
from .placement import LPS, Placement, lattice, single_field, slabs
from .stored import StoredNumbers, data_files, header_lines
from .voxels import TIMED, VECTOR, VoxelReader, Voxels, component_names, time_step, times_meta

if TYPE_CHECKING:
    from ...volume import Volume

_FIRST_KEY = re.compile(rb"\s*(ObjectType\s*=\s*Image|NDims\s*=|Comment\s*=)")
_NEEDED_KEY = re.compile(rb"^\s*NDims\s*=", re.MULTILINE)
_DATA = "ElementDataFile"
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
    options = TIMED
    writes = True

    def matches(self, path: Path, head: bytes) -> bool:
        return bool(_FIRST_KEY.match(head) and _NEEDED_KEY.search(head))

    def voxels(self, path: Path, *, time: int = 0) -> Voxels:
        lines, end = header_lines(path, lambda line: line.partition("=")[0].strip() == _DATA)
        pairs = (line.partition("=") for line in lines)
        header = {key.strip(): value.strip() for key, _, value in pairs}
        if not header.get(_DATA):
            raise FileFormatError(f"expected a line '{_DATA} = …' at the end of its header")
        with by_library("its header"):
            shape = checked_shape(_numbers(header, "DimSize", dtype=int), "DimSize")
            ndims, skipped = int(header.get("NDims", 0)), int(header.get("HeaderSize", 0))
            channels = int(header.get("ElementNumberOfChannels", 1))
            if len(shape) != ndims or ndims not in (3, 4) or channels < 1:
                raise FileFormatError(
                    f"expected NDims = 3 (or 4 with time) and as many sizes, got {ndims}, {shape}"
                )
            placement = _placement(header, ndims)
        code = header.get("ElementType", "").removesuffix("_ARRAY")
        if code not in _TYPES:
            raise FileFormatError(f"ElementType must be one of {', '.join(_TYPES)}, got {code!r}")
        big = any(
            _is_true(header, key) for key in ("BinaryDataByteOrderMSB", "ElementByteOrderMSB")
        )
        dtype = np.dtype(_TYPES[code]).newbyteorder(">" if big else "<")
        times, count = math.prod(shape[3:]), math.prod(shape) * channels
        is_binary = _is_true(header, "BinaryData", "True")
        packing = ("zlib" if _is_true(header, "CompressedData") else "") if is_binary else "text"
        files = _files(path, header[_DATA], len(lines))
        if files == (path,):
            skipped = end
        stored = StoredNumbers(files, dtype, count, skipped, packing)
        stored.check()
        step = time_step(time, times)

        def load(number: int) -> np.ndarray:
            block = stored.read(step * (count // times), (*shape[2::-1], channels))
            return np.asarray(block[..., number].transpose())

        vector = VECTOR if channels == 3 and dtype.kind == "f" else ()
        return Voxels(
            shape=shape[:3],
            dtype=dtype.newbyteorder("="),
            placement=placement,
            load=load,
            components=component_names(channels, vector),
            meta=times_meta(times, step),
        )

    def write(self, volume: Volume, path: Path) -> None:
        values = volume.array(single_field(volume, "a MetaImage"))
        origin, steps = lattice(volume, "mm")
        widths = np.linalg.norm(steps, axis=1)
        types = {np.dtype(code): key for key, code in reversed(_TYPES.items())}
        patient = "orientation" in volume.meta
        header = {
            "ObjectType": "Image",
            "NDims": "3",
            "BinaryData": "True",
            "BinaryDataByteOrderMSB": "False",
            "CompressedData": "False",
            **({"AnatomicalOrientation": "RAI"} if patient else {}),
            "TransformMatrix": _line(steps / widths[:, None]),
            "Offset": _line(origin),
            "ElementSpacing": _line(widths),
            "DimSize": " ".join(map(str, values.shape)),
            "ElementType": types[np.dtype(np.uint8 if values.dtype == np.bool_ else values.dtype)],
            _DATA: "LOCAL",
        }
        with open(path, "wb") as file:
            file.write("".join(f"{key} = {value}\n" for key, value in header.items()).encode())
            file.writelines(slabs(values))


def _line(numbers: np.ndarray) -> str:
    return " ".join(repr(float(number)) for number in numbers.ravel())


def _is_true(header: dict[str, str], key: str, default: str = "") -> bool:
    return header.get(key, default)[:1].lower() in ("t", "y", "1")


def _numbers(header: dict[str, str], *keys: str, dtype: type = float) -> np.ndarray | None:
    """Return the numbers under the first of several names; None if there are none."""
    text = next((header[key] for key in keys if header.get(key)), None)
    return None if text is None else np.array(text.split()).astype(dtype)


def _placement(header: dict[str, str], ndims: int) -> Placement:
    spacing = _numbers(header, "ElementSpacing", "ElementSize")
    matrix = _numbers(header, "TransformMatrix", "Rotation", "Orientation")
    origin = _numbers(header, "Offset", "Position", "Origin")
    unit = header.get("DistanceUnits", "")
    # Three letters describe the axes of the array by the side they come from (ITK) or lead to
    # (MetaIO's manual): the coordinates are a patient's. A matrix says the same without doubt.
    letters = header.get("AnatomicalOrientation", "").upper()
    patient = letters in ("RAI", LPS)
    if matrix is not None:
        patient = sorted(letters.translate(_SIDES)) == ["A", "I", "R"]
    turn = np.eye(ndims) if matrix is None else matrix.reshape(ndims, ndims)
    steps = turn * (np.ones(ndims) if spacing is None else spacing.reshape(ndims))[:, None]
    first = np.zeros(ndims) if origin is None else origin.reshape(ndims)
    unit = unit if unit in ("um", "mm", "cm") else "mm"
    return Placement(first[:3], steps[:3, :3], unit, LPS if patient else "")


def _files(path: Path, named: str, above: int) -> tuple[Path, ...]:
    if named.upper() == "LOCAL":
        return (path,)
    if named.split()[0].upper() == "LIST":  # a file for each slice, or slab of them
        return data_files(path, named, header_lines(path, lambda _: False)[0][above:])
    return data_files(path, named)
