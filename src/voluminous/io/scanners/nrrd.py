"""NRRD (.nrrd, .nhdr): what 3D Slicer and Teem write. pynrrd reads the header."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...packages import require
from ..guard import by_library
from ..payload import checked_shape
from ..units import known_unit
from .label_tables import segments
from .placement import LPS, Placement, conversion, lattice, length_unit, single_field, slabs
from .stored import StoredNumbers, data_files, header_lines
from .voxels import COLORS, TIMED, VECTOR, VoxelReader, Voxels, component_names, time_step

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
# Of each axis in space; NaN of another.
_NUMBERS = ("spacings", "axis mins", "axis maxs")
# Kinds of spatial axes.
_SPATIAL = ("domain", "space", "none", "???", "")
_ENDINGS = {
    **dict.fromkeys(("vector", "3-vector", "covariant-vector", "3-gradient", "3-normal"), VECTOR),
    **dict.fromkeys(("rgb-color", "rgba-color", "3-color", "4-color"), COLORS),
}
_TYPES = {"f4": "float", "f8": "double"}
_PACKINGS = {
    "raw": "",
    **dict.fromkeys(("ascii", "text", "txt"), "text"),
    **dict.fromkeys(("gzip", "gz"), "zlib"),
    **dict.fromkeys(("bzip2", "bz2"), "bz2"),
}

_Header = dict[str, Any]


class NRRDReader(VoxelReader):
    """An NRRD of three axes of space, and perhaps one of components or of time."""

    name = "nrrd"
    description = "an NRRD file (.nrrd, .nhdr)"
    suffixes = (".nrrd", ".nhdr")
    packages = ("nrrd",)
    extra = "medical"
    options = TIMED
    writes = True

    def matches(self, path: Path, head: bytes) -> bool:
        return head.startswith(_MAGIC)

    def voxels(self, path: Path, *, time: int | None = None) -> Voxels:
        nrrd = require("nrrd", self.extra, f"reading {self.description}")
        header, stored = _read_header(nrrd, path)
        sizes: tuple[int, ...] = header["sizes"]
        space, other, kind = _axes(header, time is not None)
        others = 1 if other is None else sizes[other]
        timed = kind == "time"
        step = time_step(0 if time is None else time, others if timed else 1)
        dtype = stored.dtype.newbyteorder("=")
        labels: list[list[Any]] = [[] for _ in range(others)]
        for layer, label in segments(header):
            labels[min(max(layer, 0), others - 1)].append(label)

        def load(component: int) -> np.ndarray:
            values = stored.read(0, sizes[::-1]).transpose()
            part = 0 if other is None else step if timed else component
            return values if other is None else np.asarray(values.take(part, other))

        return Voxels(
            shape=tuple(sizes[axis] for axis in space),
            dtype=dtype,
            placement=_placement(header, space),
            load=load,
            components=("",) if timed else _components(header, kind, others, dtype),
            unit=known_unit(header.get("sample units", "").strip('"')),
            meta={"times": others, "time_step": step} if timed else {},
            labels=labels,
        )

    def write(self, volume: Volume, path: Path) -> None:
        name = single_field(volume, "an NRRD file")
        values, (origin, steps) = volume.array(name), lattice(volume)
        unit = volume.grid.describe()["unit"]
        dtype = np.dtype(np.uint8 if values.dtype == np.bool_ else values.dtype)
        patient = "orientation" in volume.meta
        lines = [
            "NRRD0005",
            f"type: {_TYPES.get(dtype.str[1:], dtype.name)}",
            "dimension: 3",
            "space: left-posterior-superior" if patient else "space dimension: 3",
            "sizes: " + " ".join(map(str, values.shape)),
            "space directions: " + " ".join(_written(step) for step in steps),
            "kinds: domain domain domain",
            "endian: little",
            "encoding: raw",
            f"space origin: {_written(origin)}",
        ]
        lines += [f'space units: "{unit}" "{unit}" "{unit}"'] if unit else []
        lines += [f"sample units: {volume.units[name]}"] if volume.units[name] else []
        with open(path, "wb") as file:
            file.write("\n".join([*lines, "", ""]).encode())
            file.writelines(slabs(values))


def _written(numbers: np.ndarray) -> str:
    return "(" + ",".join(repr(float(number)) for number in numbers) + ")"


def _read_header(nrrd: Any, path: Path) -> tuple[_Header, StoredNumbers]:
    lines, end = header_lines(path, lambda line: not line)
    lists = [k for k, line in enumerate(lines) if re.match(r"data ?file:\s*LIST", line)]
    stop = lists[0] + 1 if lists else len(lines)
    with by_library("pynrrd"):
        header = nrrd.read_header(iter(line + "\n" for line in lines[:stop]))
        dimension, sizes = header["dimension"], header["sizes"]
        dtype, packing = nrrd.reader._determine_datatype(header), header["encoding"].lower()
    header["sizes"] = checked_shape(sizes, "sizes")
    if dimension != len(sizes):
        raise FileFormatError(f"dimension is {dimension}, but there are {len(sizes)} sizes")
    named = header.pop("data file", None) or header.pop("datafile", None)
    if named is None and lines[-1]:
        raise FileFormatError("expected an empty line between its header and the data")
    files = data_files(path, named, lines[stop:] if lists else ()) if named else (path,)
    slices = header["sizes"][-1]
    if slices % len(files) and len(files) % slices:
        raise FileFormatError(f"{slices} slices do not fill {len(files)} files evenly")
    lines, skipped = (header.get(f"{k} skip", header.get(f"{k}skip", 0)) for k in ("line", "byte"))
    if packing not in _PACKINGS or lines < 0 or skipped < -1 or (lines and len(files) > 1):
        raise FileFormatError(
            f"expected encoding {', '.join(_PACKINGS)} (lines to skip in one file only), got "
            f"{packing!r}, line skip {lines}, byte skip {skipped}"
        )
    start = 0 if named else end
    with open(files[0], "rb") as file:
        file.seek(start)
        while lines and file.readline():
            lines -= 1
        start = file.tell()
    packing, count = _PACKINGS[packing], math.prod(header["sizes"])
    if not packing:
        start = -1 if skipped == -1 else start + skipped
    stored = StoredNumbers(files, dtype, count, start, packing, max(skipped, 0))
    stored.check()
    return header, stored


def _per_axis(header: _Header, name: str, default: Any) -> list[Any]:
    count = len(header["sizes"])
    values = list(header.get(name, [default] * count))
    if len(values) != count:
        raise FileFormatError(f"{name} must be {count} entries, got {values}")
    return values


def _directions(header: _Header) -> list[np.ndarray | None] | None:
    if "space directions" not in header:
        return None
    steps = _per_axis(header, "space directions", None)
    return [None if step is None or np.isnan(step).all() else step for step in steps]


def _axes(header: _Header, timed: bool) -> tuple[tuple[int, ...], int | None, str]:
    """Return which three axes are space, which one is not, if any, and its kind.

    If the user gives a time, the last of four axes is time unless the file says otherwise.
    """
    sizes: tuple[int, ...] = header["sizes"]
    count = len(sizes)
    kinds = [kind.lower() for kind in _per_axis(header, "kinds", "")]
    known = [_per_axis(header, name, 0.0) for name in _NUMBERS if name in header]
    directions = _directions(header)
    space = tuple(
        axis
        for axis in range(count)
        if kinds[axis] in _SPATIAL
        and (not known or any(np.isfinite(numbers[axis]) for numbers in known))
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
            f"kinds {header.get('kinds') or '(none)'}; a line such as 'kinds: vector domain "
            "domain domain' says what they are"
        )
    if not others:
        return space, None, ""
    return space, others[0], kinds[others[0]] or ("time" if timed else _SHORT)


def _placement(header: _Header, space: tuple[int, ...]) -> Placement:
    directions = _directions(header)
    named = _SPACES.get(header.get("space", "").lower(), "")
    if directions is None:
        origin, steps, units = _along_axes(header, list(space))
    else:
        origin = np.asarray(header.get("space origin", np.zeros(3)))
        units = [length_unit(text) for text in header.get("space units", [""] * 3)]
        steps = np.array([directions[axis] for axis in space])
    factors = np.array([conversion(unit, units[0]) for unit in units])
    # Patients are measured in mm.
    return Placement(origin * factors, steps * factors, units[0] or (named and "mm"), named)


def _along_axes(header: _Header, places: list[int]) -> tuple[np.ndarray, np.ndarray, list[str]]:
    spacing, low, high = (np.array(_per_axis(header, name, np.nan))[places] for name in _NUMBERS)
    centers = header.get("centers", "").split() or _per_axis(header, "centerings", "")
    # Positions are those of the outer walls of cells, by Teem's default too, or of nodes.
    at_nodes = np.array([centers[k].lower() == "node" for k in places])
    steps = np.array(header["sizes"])[places] - at_nodes
    spans = np.where(steps > 0, (high - low) / np.maximum(steps, 1), np.nan)
    spacing = np.where(np.isfinite(spacing), spacing, np.where(np.isfinite(spans), spans, 1.0))
    low = np.where(np.isfinite(low), low, high - steps * spacing)
    origin = np.where(np.isfinite(low), low + np.where(at_nodes, 0.0, 0.5) * spacing, 0.0)
    units = _per_axis(header, "units", "")
    return origin, np.diag(spacing), [length_unit(units[k]) for k in places]


def _components(header: _Header, kind: str, count: int, dtype: np.dtype[Any]) -> tuple[str, ...]:
    endings = _ENDINGS.get(kind, ())
    if kind == _SHORT and count >= len(VECTOR):
        endings = COLORS if dtype == np.uint8 else VECTOR[:count]
    # In a frame of their own, x, y and z would be others.
    frame = header.get("measurement frame")
    turned = endings == VECTOR and frame is not None and not np.array_equal(frame, np.eye(3))
    return component_names(count, () if turned else endings)
