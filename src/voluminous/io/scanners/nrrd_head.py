"""The head of an NRRD file: ``field: value``, and what its axes are."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError, InputError
from ..payload import checked_shape
from .heads import head_lines, real_numbers, whole_numbers
from .lengths import conversion, length_unit
from .placement import LPS, Placement

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
    """The fields of a head, and where it ends.

    Attributes
    ----------
    fields : dict of str
        By name, in lower case without spaces: ``"spacedirections"``.
    rest : tuple of str
        The lines behind ``data file: LIST``.
    end : int
        The byte behind it.
    closed : bool
        True if an empty line closes it: data can follow.
    """

    fields: dict[str, str]
    rest: tuple[str, ...]
    end: int
    closed: bool

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
    """Return the head of a file.

    Raises
    ------
    FileFormatError
        If a line is neither a field nor a comment.
    """
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
    """Return which axes are space.

    Parameters
    ----------
    head : Head
    timed : bool
        True if the user says that there is an axis of time: the last, if the file does not tell.

    Raises
    ------
    FileFormatError
        If they are not three, or more than one is left.
    InputError
        If there are four, and nothing tells which is none.
    """
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
