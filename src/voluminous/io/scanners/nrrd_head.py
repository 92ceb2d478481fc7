"""The head of an NRRD file: ``field: value``, and what its axes are."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError
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
# Kinds of an axis along which one goes through space.
_SPATIAL = ("domain", "space", "none", "???", "")
_VECTOR_OR_NONE = re.compile(r"\(([^()]*)\)|(none)", re.IGNORECASE)
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


def axes_of(head: Head) -> Axes:
    """Return which axes are space.

    Raises
    ------
    FileFormatError
        If they are not three, or more than one is left.
    """
    count = len(head.sizes)
    kinds = [kind.lower() for kind in head.words("kinds", count)]
    spacings = head.words("spacings", count)
    directions = _directions(head, count)
    space = tuple(
        axis
        for axis in range(count)
        if kinds[axis] in _SPATIAL
        and spacings[axis].lower() != "nan"
        and (directions is None or directions[axis] is not None)
    )
    others = [axis for axis in range(count) if axis not in space]
    if len(space) != 3 or len(others) > 1:
        raise FileFormatError(
            f"expected three axes of space and at most one other, got sizes {head.sizes} with "
            f"kinds {head.get('kinds') or '(none)'!r}; a line such as 'kinds: vector domain domain "
            "domain' tells what they are"
        )
    return Axes(space, others[0] if others else None, kinds[others[0]] if others else "")


def placement_of(head: Head, axes: Axes) -> Placement:
    """Return where the voxels are."""
    directions = _directions(head, len(head.sizes))
    space = _SPACES.get(head.get("space").lower(), "")
    if directions is None:
        return _along_axes(head, axes, space)
    origin = _vector(head.get("spaceorigin").strip("()") or "0,0,0", "space origin")
    units = [length_unit(unit) for unit in head.words("spaceunits", 3)]
    factors = np.array([conversion(unit, units[0]) for unit in units])
    steps = np.array([directions[axis] for axis in axes.space])
    # Patients are measured in mm.
    return Placement(origin * factors, steps * factors, units[0] or (space and "mm"), space)


def _along_axes(head: Head, axes: Axes, space: str) -> Placement:
    """Return the placement by a spacing and a lowest position for each axis."""
    count = len(head.sizes)

    def along(name: str, default: float) -> np.ndarray:
        words = head.words(name, count)
        return np.array(
            [real_numbers(words[k], name, 1)[0] if words[k] else default for k in axes.space]
        )

    spacing, low = along("spacings", 1.0), along("axismins", 0.0)
    in_cells = np.array([head.words("centers", count)[k].lower() == "cell" for k in axes.space])
    # The lowest position is a wall of cells, or the first sample.
    origin = np.where(in_cells & np.isfinite(low) & bool(head.get("axismins")), 0.5, 0.0)
    origin = np.where(np.isfinite(low), low, 0.0) + origin * spacing
    units = [length_unit(head.words("units", count)[k]) for k in axes.space]
    factors = np.array([conversion(unit, units[0]) for unit in units])
    unit = units[0] or (space and "mm")
    return Placement(origin * factors, np.diag(spacing * factors), unit, space)


def _directions(head: Head, count: int) -> list[np.ndarray | None] | None:
    """Return a step, or None, for each axis; None if the file does not tell."""
    text = head.get("spacedirections")
    if not text:
        return None
    found: list[Any] = [
        None if none else _vector(numbers, "space directions")
        for numbers, none in _VECTOR_OR_NONE.findall(text)
    ]
    if len(found) != count:
        raise FileFormatError(f"space directions must be {count} vectors, got {text[:80]!r}")
    # Older programs write a vector of NaN for none.
    return [None if step is None or np.all(np.isnan(step)) else step for step in found]


def _vector(text: str, what: str) -> np.ndarray:
    return np.array(real_numbers(text.replace(",", " "), what, 3))
