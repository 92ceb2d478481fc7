"""The head of an NRRD file: ``field: value``, and what its axes are."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError
from ..payload import checked_shape
from ..unit_texts import known_unit
from .placement import LPS, Placement, conversion, lattice, length_unit, single_field, slabs
from .stored import (
    AT_THE_END,
    BZIP2,
    GZIP,
    PLAIN,
    TEXT,
    Stored,
    data_files,
    head_lines,
    named_files,
    real_numbers,
    whole_numbers,
)
from .voxels import COLORS, VECTOR, VoxelReader, Voxels, component_names, time_step

if TYPE_CHECKING:
    from ...volume import Volume


MAGIC = b"NRRD000"
_SPACES = {
    "right-anterior-superior": "RAS",
    "ras": "RAS",
    "left-anterior-superior": "LAS",
    "las": "LAS",
    "left-posterior-superior": LPS,
    "lps": LPS,
}
# The kind of a short axis of which nothing is told: components, by all experience.
SHORT = "short"
_SHORTEST, _SHORT = 1, 4
# Kinds of an axis along which one goes through space.
_SPATIAL = ("domain", "space", "none", "???", "")
_VECTOR_OR_NONE = re.compile(r"\(([^()]*)\)|(none)", re.IGNORECASE)
# Spaces such as right-anterior-superior-time, or RAST.
_TIMED = re.compile(r"-time$|(?<=s)t$")
_QUOTED = re.compile(r'"([^"]*)"')


@dataclass(frozen=True)
class Head:
    """The fields of a head, and where it ends."""

    fields: dict[str, str]  # by name, in lower case without spaces: ``"spacedirections"``
    rest: tuple[str, ...]  # the lines behind ``data file: LIST``
    end: int  # the byte behind it
    closed: bool  # true if an empty line closes it: data can follow

    def get(self, name: str) -> str:
        """Return a field's text; the empty string if it is not there."""
        return self.fields.get(name, "")

    @property
    def sizes(self) -> tuple[int, ...]:
        """Sizes of the axes, the fastest first."""
        sizes = checked_shape(whole_numbers(self.get("sizes"), "sizes"), "sizes")
        if whole_numbers(self.get("dimension"), "dimension") != (len(sizes),):
            raise FileFormatError(
                f"dimension is {self.get('dimension')!r}, but there are {len(sizes)} sizes"
            )
        return sizes

    def words(self, name: str, count: int) -> list[str]:
        """Return one word per axis; empty ones if the field is not there."""
        text = self.get(name)
        found = _QUOTED.findall(text) if '"' in text else text.split()
        if text and len(found) != count:
            raise FileFormatError(f"{name} must be {count} words, got {text[:80]!r}")
        return found or [""] * count


def read_head(path: Path) -> Head:
    """Return the head of a file."""
    lines, end, closed = head_lines(path, lambda line: not line)
    fields: dict[str, str] = {}
    for number, line in enumerate(lines[1:], start=2):
        name, colon, value = line.partition(":")
        if not line or line.startswith("#") or value.startswith("="):  # key:=value is a remark
            continue
        if not colon:
            raise FileFormatError(f"expected 'field: value' in line {number}, got {line[:80]!r}")
        name = name.replace(" ", "").lower()
        fields[name] = value.strip()
        if name == "datafile" and value.split()[:1] == ["LIST"]:
            return Head(fields, tuple(text for text in lines[number:] if text), end, closed)
    return Head(fields, (), end, closed)


@dataclass(frozen=True)
class Axes:
    """Which axes are space: `space`, three of them; and `other`, a fourth, or None."""

    space: tuple[int, ...]
    other: int | None
    kind: str


def axes_of(head: Head, timed: bool = False) -> Axes:
    """Return which axes are space."""
    count = len(head.sizes)
    kinds = [kind.lower() for kind in head.words("kinds", count)]
    spacings, lows = head.words("spacings", count), head.words("axismins", count)
    directions = _directions(head, count)
    space = tuple(
        axis
        for axis in range(count)
        if kinds[axis] in _SPATIAL
        and (spacings[axis].lower() != "nan" or lows[axis].lower() not in ("", "nan"))
        and (directions is None or directions[axis] is not None)
    )
    if len(space) == 4:
        return _of_four(head.sizes, space, timed)
    others = [axis for axis in range(count) if axis not in space]
    if len(space) != 3 or len(others) > 1:
        raise FileFormatError(
            f"expected three axes of space and at most one other, got sizes {head.sizes} with "
            f"kinds {head.get('kinds') or '(none)'!r}; a line such as 'kinds: vector domain domain "
            "domain' tells what they are"
        )
    kind = kinds[others[0]] if others else ""
    # An axis along no direction, and yet a domain, is what four-dimensional spaces have: time.
    timed = kind in _SPATIAL[:2] and _dimensions(head) == 4
    return Axes(space, others[0] if others else None, "time" if timed else kind)


def _of_four(sizes: tuple[int, ...], space: tuple[int, ...], timed: bool) -> Axes:
    """Return which of four axes is not space, by their sizes if the user does not say."""
    if len(sizes) > 4:
        raise FileFormatError(f"expected three axes of space and at most one other, got {sizes}")
    if timed:
        return Axes(space[:3], 3, "time")
    for axis in (0, 3):
        rest = tuple(k for k in space if k != axis)
        single = sizes[axis] == _SHORTEST
        if single or (sizes[axis] <= _SHORT < min(sizes[k] for k in rest)):
            return Axes(rest, axis, SHORT)
    raise InputError(
        f"it has four axes, of sizes {sizes}, and does not tell what they are. If the last is "
        f"time, choose one of its {sizes[3]} steps with time=0; else add a line to its head such "
        "as 'kinds: vector domain domain domain'"
    )


def placement_of(head: Head, axes: Axes) -> Placement:
    """Return where the voxels are."""
    directions = _directions(head, len(head.sizes))
    space = _SPACES.get(_TIMED.sub("", head.get("space").lower()), "")
    if directions is None:
        return _along_axes(head, axes, space)
    dimensions = _dimensions(head)
    origin = np.zeros(3)
    if head.get("spaceorigin"):
        told = _vector(head.get("spaceorigin").strip("()"), "space origin", dimensions)
        origin = told[:3]
    units = [length_unit(unit) for unit in head.words("spaceunits", dimensions)[:3]]
    factors = np.array([conversion(unit, units[0]) for unit in units])
    steps = np.array([directions[axis] for axis in axes.space])
    # Patients are measured in mm.
    return Placement(origin * factors, steps * factors, units[0] or (space and "mm"), space)


def _along_axes(head: Head, axes: Axes, space: str) -> Placement:
    """Return the placement by a spacing, and the lowest and highest position, of each axis."""
    count, places = len(head.sizes), list(axes.space)

    def along(name: str) -> np.ndarray:
        words = head.words(name, count)
        return np.array([real_numbers(words[k] or "nan", name, 1)[0] for k in places])

    sizes = np.array(head.sizes)[places]
    spacing, low, high = along("spacings"), along("axismins"), along("axismaxs")
    centers = head.words("centers" if head.get("centers") else "centerings", count)
    # Positions are those of the outer walls of cells, by Teem's default too, or of nodes.
    at_nodes = np.array([centers[k].lower() == "node" for k in places])
    steps = sizes - at_nodes
    spans = np.where(steps > 0, (high - low) / np.maximum(steps, 1), np.nan)
    spacing = np.where(np.isfinite(spacing), spacing, np.where(np.isfinite(spans), spans, 1.0))
    low = np.where(np.isfinite(low), low, high - steps * spacing)
    origin = np.where(np.isfinite(low), low + np.where(at_nodes, 0.0, 0.5) * spacing, 0.0)
    units = [length_unit(head.words("units", count)[k]) for k in places]
    factors = np.array([conversion(unit, units[0]) for unit in units])
    unit = units[0] or (space and "mm")
    return Placement(origin * factors, np.diag(spacing * factors), unit, space)


def _directions(head: Head, count: int) -> list[np.ndarray | None] | None:
    text = head.get("spacedirections")
    if not text:
        return None
    dimensions = _dimensions(head)
    found: list[Any] = [
        None if none else _vector(numbers, "space directions", dimensions)
        for numbers, none in _VECTOR_OR_NONE.findall(text)
    ]
    if len(found) != count:
        raise FileFormatError(f"space directions must be {count} vectors, got {text[:80]!r}")
    # Older programs write a vector of NaN for none.
    steps = [None if step is None or np.all(np.isnan(step)) else step for step in found]
    return [_in_space(step) for step in steps] if dimensions == 4 else steps


def _in_space(step: np.ndarray | None) -> np.ndarray | None:
    if step is None or not step[:3].any():
        return None
    if step[3]:
        raise FileFormatError(f"expected an axis along space or time, got {step.tolist()}")
    return step[:3]


def _dimensions(head: Head) -> int:
    timed = _TIMED.search(head.get("space").lower())
    return 4 if timed or head.get("spacedimension") == "4" else 3


def _vector(text: str, what: str, count: int) -> np.ndarray:
    return np.array(real_numbers(text.replace(",", " "), what, count))


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
    return component_names(
        count, () if endings == VECTOR and frame not in ("", _IDENTITY) else endings
    )


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
        "space directions: " + " ".join(_nrrd_vector(step) for step in placed.steps),
        "kinds: domain domain domain",
        "endian: little",
        "encoding: raw",
        f"space origin: {_nrrd_vector(placed.origin)}",
    ]
    lines += [f'space units: "{unit}" "{unit}" "{unit}"'] if unit else []
    return lines + ([f"sample units: {volume.units[name]}"] if volume.units[name] else [])


def _nrrd_vector(numbers: np.ndarray) -> str:
    return "(" + ",".join(repr(float(number)) for number in numbers) + ")"
