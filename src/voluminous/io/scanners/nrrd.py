"""NRRD (.nrrd, .nhdr): what 3D Slicer and Teem write."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError
from ..unit_texts import known_unit
from .heads import data_files, named_files, whole_numbers
from .nrrd_head import MAGIC, SHORT, Axes, Head, axes_of, placement_of, read_head
from .placement import LPS
from .stored import AT_THE_END, BZIP2, GZIP, PLAIN, TEXT, Stored
from .voxels import COLORS, VECTOR, VoxelReader, Voxels, components, time_step
from .written import lattice, single_field, slabs

if TYPE_CHECKING:
    from ...volume import Volume

_SIGNED = {
    "i1": ("signed char", "int8", "int8_t"),
    "i2": ("short", "short int", "signed short", "signed short int", "int16", "int16_t"),
    "i4": ("int", "signed int", "int32", "int32_t"),
    "i8": ("longlong", "long long", "long long int", "signed long long", "int64", "int64_t"),
    "u1": ("uchar", "unsigned char", "uint8", "uint8_t"),
    "u2": ("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"),
    "u4": ("uint", "unsigned int", "uint32", "uint32_t"),
    "u8": ("ulonglong", "unsigned long long", "unsigned long long int", "uint64", "uint64_t"),
    "f4": ("float",),
    "f8": ("double",),
}
_TYPES = {name: code for code, names in _SIGNED.items() for name in names}
_PACKINGS = {
    "raw": PLAIN,
    "txt": TEXT,
    "text": TEXT,
    "ascii": TEXT,
    "gz": GZIP,
    "gzip": GZIP,
    "bz2": BZIP2,
    "bzip2": BZIP2,
}
_ENDINGS = {
    **dict.fromkeys(("vector", "3-vector", "covariant-vector", "3-gradient", "3-normal"), VECTOR),
    **dict.fromkeys(("rgb-color", "rgba-color", "3-color", "4-color"), COLORS),
}
_LONGEST_LINE = 1 << 16
_IDENTITY = "(1,0,0)(0,1,0)(0,0,1)"


class NRRDReader(VoxelReader):
    """An NRRD of three axes of space, and perhaps one of components or of time."""

    name = "nrrd"
    description = "an NRRD file (.nrrd, .nhdr)"
    suffixes = (".nrrd", ".nhdr")
    options = {  # noqa: RUF012 - as in Reader
        **VoxelReader.options,
        "time": "number of the time step, from 0, of a file with an axis of time",
    }
    writes = True

    def matches(self, path: Path, head: bytes) -> bool:
        return head.startswith(MAGIC)

    def voxels(self, path: Path, *, time: int | None = None) -> Voxels:
        head = read_head(path)
        sizes, axes, dtype = head.sizes, axes_of(head, time is not None), _dtype(head)
        stored = _stored(path, head, dtype).check()
        others = 1 if axes.other is None else sizes[axes.other]
        timed = axes.kind == "time"
        step = time_step(0 if time is None else time, others if timed else 1)

        def load(number: int) -> np.ndarray:
            return _component(stored, sizes, axes.other, step if timed else number)

        return Voxels(
            shape=tuple(sizes[axis] for axis in axes.space),
            dtype=dtype.newbyteorder("="),
            placement=placement_of(head, axes),
            load=load,
            components=("",) if timed else _components(head, axes, others, dtype),
            unit=known_unit(head.get("sampleunits").strip('"')),
            meta={"times": others, "time_step": step} if timed else {},
        )

    def write(self, volume: Volume, path: Path) -> None:
        name = single_field(volume, "an NRRD file")
        values = volume.array(name)
        with open(path, "wb") as file:
            for line in _head_of(volume, name, values):
                file.write(f"{line}\n".encode())
            file.write(b"\n")
            for slab in slabs(values):
                file.write(slab)


def _component(
    stored: Stored, sizes: tuple[int, ...], other: int | None, number: int
) -> np.ndarray:
    """Return the array of one component, axes as in the file, the fastest first."""
    if other is None or other == len(sizes) - 1:
        block = sizes[:3]
        return stored.read(number * int(np.prod(block, dtype=object)), block[::-1]).transpose()
    return stored.read(0, sizes[::-1]).transpose()[(slice(None),) * other + (number,)]


def _components(head: Head, axes: Axes, count: int, dtype: np.dtype[Any]) -> tuple[str, ...]:
    if axes.other is None or count == 1:
        return ("",)
    frame = head.get("measurementframe").replace(" ", "")
    endings = _ENDINGS.get(axes.kind, ())
    if axes.kind == SHORT and count >= len(VECTOR):
        endings = COLORS if dtype == np.uint8 else VECTOR[:count]
    # In a frame of their own, x, y and z would be others.
    return components(count, () if endings == VECTOR and frame not in ("", _IDENTITY) else endings)


def _dtype(head: Head) -> np.dtype[Any]:
    code = _TYPES.get(head.get("type").lower())
    if code is None:
        raise FileFormatError(f"type must be one of {', '.join(_TYPES)}, got {head.get('type')!r}")
    dtype = np.dtype(code)
    endian = head.get("endian").lower()
    if endian not in ("little", "big") and dtype.itemsize > 1 and _packing(head) != TEXT:
        raise FileFormatError(f"endian must be little or big, got {endian!r}")
    return dtype.newbyteorder(">" if endian == "big" else "<")


def _packing(head: Head) -> str:
    encoding = head.get("encoding").lower()
    if encoding not in _PACKINGS:
        raise FileFormatError(f"encoding must be raw, ascii, gzip or bzip2, got {encoding!r}")
    return _PACKINGS[encoding]


def _stored(path: Path, head: Head, dtype: np.dtype[Any]) -> Stored:
    files = _files(path, head)
    count, packing = int(np.prod(head.sizes, dtype=object)), _packing(head)
    start = 0 if files else head.end
    if not files and not head.closed:
        raise FileFormatError("expected an empty line between its head and the data, or data file:")
    files = files or (path,)
    (lines,) = whole_numbers(head.get("lineskip") or "0", "line skip")[:1]
    (skipped,) = whole_numbers(head.get("byteskip") or "0", "byte skip")[:1]
    if lines:
        start = _behind_lines(files, start, lines)
    if skipped == -1 and packing == PLAIN:
        return Stored(files, dtype, count, packing, AT_THE_END)
    return Stored(files, dtype, count, packing, start, skipped)


def _files(path: Path, head: Head) -> tuple[Path, ...]:
    """Return the files of data: named, listed or numbered; none if the data follow the head."""
    named = head.get("datafile")
    if named.split()[:1] == ["LIST"]:
        return named_files(path, list(head.rest))
    return data_files(path, named) if named else ()


def _behind_lines(files: tuple[Path, ...], start: int, lines: int) -> int:
    if len(files) > 1 or lines < 0:
        raise FileFormatError("line skip is known of one file of data only")
    with open(files[0], "rb") as file:
        file.seek(start)
        for _ in range(lines):
            if not file.readline(_LONGEST_LINE):
                raise FileFormatError(f"{files[0].name} ends within the {lines} lines to skip")
        return file.tell()


def _head_of(volume: Volume, name: str, values: np.ndarray) -> list[str]:
    """Return the lines of a head; as a patient's space if the volume is in one."""
    placed, unit = lattice(volume), volume.grid.describe()["unit"]
    dtype = np.dtype(np.uint8) if values.dtype == np.bool_ else values.dtype
    patient = volume.meta.get("orientation") == LPS
    lines = [
        "NRRD0005",
        f"type: {_SIGNED[dtype.str[1:]][-1]}",
        "dimension: 3",
        "space: left-posterior-superior" if patient else "space dimension: 3",
        "sizes: " + " ".join(map(str, values.shape)),
        "space directions: " + " ".join(_vector(step) for step in placed.steps),
        "kinds: domain domain domain",
        "endian: little",
        "encoding: raw",
        f"space origin: {_vector(placed.origin)}",
    ]
    lines += [f'space units: "{unit}" "{unit}" "{unit}"'] if unit else []
    return lines + ([f"sample units: {volume.units[name]}"] if volume.units[name] else [])


def _vector(numbers: np.ndarray) -> str:
    return "(" + ",".join(repr(float(number)) for number in numbers) + ")"
