"""NRRD (.nrrd, .nhdr): what 3D Slicer and Teem write. A header of lines ``field: value``."""

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
    StoredNumbers,
    data_files,
    header_lines,
    real_numbers,
    whole_numbers,
)
from .voxels import COLORS, VECTOR, VoxelReader, Voxels, component_names, time_step

if TYPE_CHECKING:
    from ...volume import Volume

_MAGIC = b"NRRD000"
_SPACES = {
    "right-anterior-superior": "RAS",
    "ras": "RAS",
    "left-anterior-superior": "LAS",
    "las": "LAS",
    "left-posterior-superior": LPS,
    "lps": LPS,
}
# The kind of a short axis without a kind: components, by all experience.
_SHORT, _MOST_COMPONENTS = "short", 4
# Kinds of spatial axes.
_SPATIAL = ("domain", "space", "none", "???", "")
_VECTOR_OR_NONE = re.compile(r"\(([^()]*)\)|(none)", re.IGNORECASE)
# Spaces such as right-anterior-superior-time, or RAST.
_TIMED = re.compile(r"-time$|(?<=s)t$")
_QUOTED = re.compile(r'"([^"]*)"')
_NAMES = {
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
_TYPES = {name: code for code, names in _NAMES.items() for name in names}
_PACKINGS = {
    "raw": PLAIN,
    **dict.fromkeys(("txt", "text", "ascii"), TEXT),
    **dict.fromkeys(("gz", "gzip"), GZIP),
    **dict.fromkeys(("bz2", "bzip2"), BZIP2),
}
_ENDINGS = {
    **dict.fromkeys(("vector", "3-vector", "covariant-vector", "3-gradient", "3-normal"), VECTOR),
    **dict.fromkeys(("rgb-color", "rgba-color", "3-color", "4-color"), COLORS),
}
_LONGEST_LINE = 1 << 16
_IDENTITY = "(1,0,0)(0,1,0)(0,0,1)"


@dataclass(frozen=True)
class NrrdHeader:
    """The fields of a header, and where it ends."""

    fields: dict[str, str]  # by name, in lower case without spaces: ``"spacedirections"``
    rest: tuple[str, ...]  # the lines behind ``data file: LIST``
    end: int  # the byte behind it
    closed: bool  # True if an empty line closes it: data can follow

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

    @property
    def dimensions(self) -> int:
        """Of the space: three, or four with time."""
        timed = _TIMED.search(self.get("space").lower())
        return 4 if timed or self.get("spacedimension") == "4" else 3

    def words(self, name: str, count: int) -> list[str]:
        """Return one word per axis; empty ones if the field is not there."""
        text = self.get(name)
        found = _QUOTED.findall(text) if '"' in text else text.split()
        if text and len(found) != count:
            raise FileFormatError(f"{name} must be {count} words, got {text[:80]!r}")
        return found or [""] * count

    def directions(self) -> list[np.ndarray | None] | None:
        """Return the steps along the axes, None for one that is not in space."""
        text = self.get("spacedirections")
        found: list[np.ndarray | None] = []
        if not text:
            return None
        for numbers, none in _VECTOR_OR_NONE.findall(text):
            step = None if none else _vector(numbers, "space directions", self.dimensions)
            # Older programs write a vector of NaN instead of "none".
            if step is None or np.all(np.isnan(step)):
                found.append(None)
                continue
            if len(step) == 4 and step[:3].any() and step[3]:
                raise FileFormatError(f"expected an axis along space or time, got {step.tolist()}")
            found.append(step[:3] if len(step) == 3 or step[:3].any() else None)
        if len(found) != len(self.sizes):
            raise FileFormatError(
                f"space directions must be {len(self.sizes)} vectors, got {text[:80]!r}"
            )
        return found


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
        return head.startswith(_MAGIC)

    def voxels(self, path: Path, *, time: int | None = None) -> Voxels:
        header = _read_header(path)
        sizes = header.sizes
        space, other, kind = _axes(header, time is not None)
        stored = _stored(path, header).check()
        others = 1 if other is None else sizes[other]
        timed = kind == "time"
        step = time_step(0 if time is None else time, others if timed else 1)

        def load(component: int) -> np.ndarray:
            number = step if timed else component
            if other is None or other == len(sizes) - 1:
                size = int(np.prod(sizes[:3], dtype=object))
                return stored.read(number * size, sizes[2::-1]).transpose()
            index = (slice(None),) * other + (number,)
            return stored.read(0, sizes[::-1]).transpose()[index]

        return Voxels(
            shape=tuple(sizes[axis] for axis in space),
            dtype=stored.dtype.newbyteorder("="),
            placement=_placement(header, space),
            load=load,
            components=("",) if timed else _components(header, kind, others, stored.dtype),
            unit=known_unit(header.get("sampleunits").strip('"')),
            meta={"times": others, "time_step": step} if timed else {},
        )

    def write(self, volume: Volume, path: Path) -> None:
        name = single_field(volume, "an NRRD file")
        values, placed = volume.array(name), lattice(volume)
        unit = volume.grid.describe()["unit"]
        dtype = np.dtype(np.uint8 if values.dtype == np.bool_ else values.dtype)
        patient = volume.meta.get("orientation") == LPS
        lines = [
            "NRRD0005",
            f"type: {_NAMES[dtype.str[1:]][-1]}",
            "dimension: 3",
            "space: left-posterior-superior" if patient else "space dimension: 3",
            "sizes: " + " ".join(map(str, values.shape)),
            "space directions: " + " ".join(_written(step) for step in placed.steps),
            "kinds: domain domain domain",
            "endian: little",
            "encoding: raw",
            f"space origin: {_written(placed.origin)}",
        ]
        lines += [f'space units: "{unit}" "{unit}" "{unit}"'] if unit else []
        lines += [f"sample units: {volume.units[name]}"] if volume.units[name] else []
        with open(path, "wb") as file:
            file.write("\n".join([*lines, "", ""]).encode())
            file.writelines(slabs(values))


def _written(numbers: np.ndarray) -> str:
    return "(" + ",".join(repr(float(number)) for number in numbers) + ")"


def _vector(text: str, what: str, count: int) -> np.ndarray:
    return np.array(real_numbers(text.replace(",", " "), what, count))


def _read_header(path: Path) -> NrrdHeader:
    lines, end, closed = header_lines(path, lambda line: not line)
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
            return NrrdHeader(fields, tuple(text for text in lines[number:] if text), end, closed)
    return NrrdHeader(fields, (), end, closed)


def _axes(header: NrrdHeader, timed: bool) -> tuple[tuple[int, ...], int | None, str]:
    """Return which three axes are space, which one is not, if any, and its kind.

    If the user gives a time, the last of four axes is time unless the file says otherwise.
    """
    sizes = header.sizes
    count = len(sizes)
    kinds = [kind.lower() for kind in header.words("kinds", count)]
    spacings, lows = header.words("spacings", count), header.words("axismins", count)
    directions = header.directions()
    space = tuple(
        axis
        for axis in range(count)
        if kinds[axis] in _SPATIAL
        and (spacings[axis].lower() != "nan" or lows[axis].lower() not in ("", "nan"))
        and (directions is None or directions[axis] is not None)
    )
    others = [axis for axis in range(count) if axis not in space]
    if len(space) == count == 4:
        if timed:
            return space[:3], 3, "time"
        for axis in (0, 3):
            rest = tuple(k for k in space if k != axis)
            few = sizes[axis] <= _MOST_COMPONENTS < min(sizes[k] for k in rest)
            if few or sizes[axis] == 1:
                return rest, axis, _SHORT
        raise InputError(
            f"it has four axes, of sizes {sizes}, and no kinds. If the last is "
            f"time, choose one of its {sizes[3]} steps with time=0; else add a line to its header "
            "such as 'kinds: vector domain domain domain'"
        )
    if len(space) != 3 or len(others) > 1:
        raise FileFormatError(
            f"expected three axes of space and at most one other, got sizes {sizes} with "
            f"kinds {header.get('kinds') or '(none)'!r}; a line such as 'kinds: vector domain "
            "domain domain' says what they are"
        )
    kind = kinds[others[0]] if others else ""
    # An axis along no direction, and yet a domain, is what four-dimensional spaces have: time.
    kind = "time" if kind in _SPATIAL[:2] and header.dimensions == 4 else kind
    return space, others[0] if others else None, kind


def _placement(header: NrrdHeader, space: tuple[int, ...]) -> Placement:
    directions = header.directions()
    named = _SPACES.get(_TIMED.sub("", header.get("space").lower()), "")
    if directions is None:
        origin, steps, units = _along_axes(header, list(space))
    else:
        origin = np.zeros(3)
        if header.get("spaceorigin"):
            text = header.get("spaceorigin").strip("()")
            origin = _vector(text, "space origin", header.dimensions)[:3]
        units = [length_unit(u) for u in header.words("spaceunits", header.dimensions)[:3]]
        steps = np.array([directions[axis] for axis in space])
    factors = np.array([conversion(unit, units[0]) for unit in units])
    # Patients are measured in mm.
    return Placement(origin * factors, steps * factors, units[0] or (named and "mm"), named)


def _along_axes(header: NrrdHeader, places: list[int]) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return origin, steps and units by the spacing and the limits of each axis."""
    count = len(header.sizes)

    def along(name: str) -> np.ndarray:
        words = header.words(name, count)
        return np.array([real_numbers(words[k] or "nan", name, 1)[0] for k in places])

    spacing, low, high = along("spacings"), along("axismins"), along("axismaxs")
    centers = header.words("centers" if header.get("centers") else "centerings", count)
    # Positions are those of the outer walls of cells, by Teem's default too, or of nodes.
    at_nodes = np.array([centers[k].lower() == "node" for k in places])
    steps = np.array(header.sizes)[places] - at_nodes
    spans = np.where(steps > 0, (high - low) / np.maximum(steps, 1), np.nan)
    spacing = np.where(np.isfinite(spacing), spacing, np.where(np.isfinite(spans), spans, 1.0))
    low = np.where(np.isfinite(low), low, high - steps * spacing)
    origin = np.where(np.isfinite(low), low + np.where(at_nodes, 0.0, 0.5) * spacing, 0.0)
    words = header.words("units", count)
    return origin, np.diag(spacing), [length_unit(words[k]) for k in places]


def _components(header: NrrdHeader, kind: str, count: int, dtype: np.dtype[Any]) -> tuple[str, ...]:
    frame = header.get("measurementframe").replace(" ", "")
    endings = _ENDINGS.get(kind, ())
    if kind == _SHORT and count >= len(VECTOR):
        endings = COLORS if dtype == np.uint8 else VECTOR[:count]
    # In a frame of their own, x, y and z would be others.
    turned = endings == VECTOR and frame not in ("", _IDENTITY)
    return component_names(count, () if turned else endings)


def _stored(path: Path, header: NrrdHeader) -> StoredNumbers:
    code = _TYPES.get(header.get("type").lower())
    if code is None:
        raise FileFormatError(
            f"type must be one of {', '.join(_TYPES)}, got {header.get('type')!r}"
        )
    encoding, endian = header.get("encoding").lower(), header.get("endian").lower()
    if encoding not in _PACKINGS:
        raise FileFormatError(f"encoding must be raw, ascii, gzip or bzip2, got {encoding!r}")
    packing, dtype = _PACKINGS[encoding], np.dtype(code)
    if endian not in ("little", "big") and dtype.itemsize > 1 and packing != TEXT:
        raise FileFormatError(f"endian must be little or big, got {endian!r}")
    dtype = dtype.newbyteorder(">" if endian == "big" else "<")
    named, start = header.get("datafile"), header.end
    files: tuple[Path, ...] = (path,)
    if named:
        listed = named.split()[0] == "LIST"
        files, start = data_files(path, list(header.rest) if listed else named), 0
    elif not header.closed:
        raise FileFormatError(
            "expected an empty line between its header and the data, or data file:"
        )
    count = int(np.prod(header.sizes, dtype=object))
    (lines,) = whole_numbers(header.get("lineskip") or "0", "line skip")[:1]
    (skipped,) = whole_numbers(header.get("byteskip") or "0", "byte skip")[:1]
    if lines:
        start = _behind_lines(files, start, lines)
    if skipped == -1 and packing == PLAIN:
        return StoredNumbers(files, dtype, count, packing, AT_THE_END)
    return StoredNumbers(files, dtype, count, packing, start, skipped)


def _behind_lines(files: tuple[Path, ...], start: int, lines: int) -> int:
    if len(files) > 1 or lines < 0:
        raise FileFormatError("line skip needs a single file of data")
    with open(files[0], "rb") as file:
        file.seek(start)
        for _ in range(lines):
            if not file.readline(_LONGEST_LINE):
                raise FileFormatError(f"{files[0].name} ends within the {lines} lines to skip")
        return file.tell()
