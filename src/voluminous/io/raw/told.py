"""What is told of a file of bare numbers: by its name, by a file beside it, or by the user."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...errors import FileFormatError, InputError
from ..payload import checked_shape

_SHAPE = re.compile(r"(?<![\d.])(?<!\d[xX×])(\d+)[xX×](\d+)[xX×](\d+)(?!\d|[xX×]\d)")
_KIND = re.compile(
    r"(?<![a-z])(?P<kind>u?int|float|uchar|u?short|u?char|double|[uifs])(?P<bits>8|16|32|64)?"
    r"_?(?P<order>le|be)?(?![a-z0-9])",
    re.IGNORECASE,
)
# NumPy's letter of a word, and its bits if no number follows.
_WORDS = {
    "uint": ("u", "32"),
    "int": ("i", "32"),
    "float": ("f", "32"),
    "double": ("f", "64"),
    "uchar": ("u", "8"),
    "char": ("i", "8"),
    "ushort": ("u", "16"),
    "short": ("i", "16"),
    "u": ("u", ""),
    "i": ("i", ""),
    "s": ("i", ""),
    "f": ("f", ""),
}


@dataclass(frozen=True)
class Told:
    """What is known of a file of bare numbers; None where it is not.

    Attributes
    ----------
    shape : tuple of three int
        Cells along x, y and z.
    dtype : dtype
        With the order of bytes.
    spacing, origin : tuple of three float
        Size of a cell, and the centre of the first.
    direction : tuple of three tuples of three float
        A matrix: column a is the unit vector along axis a of the cells, where these are not x, y
        and z.
    unit : str
        Of length.
    turnable : bool
        True if the shape may be meant in the opposite order.
    source : str
        Who tells it.
    """

    shape: tuple[int, int, int] | None = None
    dtype: np.dtype[Any] | None = None
    spacing: tuple[float, float, float] | None = None
    origin: tuple[float, float, float] | None = None
    direction: tuple[tuple[float, ...], ...] | None = None
    unit: str = ""
    turnable: bool = False
    source: str = ""

    def over(self, other: Told) -> Told:
        """Return all that is told here, completed by another."""
        # By identity: to NumPy a dtype of float64 equals None.
        known = {n: v for n, v in vars(self).items() if not (v is None or isinstance(v, str))}
        known |= {n: v for n, v in vars(self).items() if isinstance(v, str) and v}
        if self.shape is None:
            known.pop("turnable")
            known.pop("source", None)
        return replace(other, **known)


def told_by_name(stem: str) -> tuple[Told, str]:
    """Return what the name of a file tells, and the name without that.

    Names of `Open SciVis Datasets <https://klacansky.com/open-scivis-datasets>`_ are like
    ``bonsai_256x256x256_uint8.raw``, x first; others list z first.

    Examples
    --------
    >>> told, rest = told_by_name("foot_256x256x128_uint16be")
    >>> told.shape, told.dtype.str, rest
    ((256, 256, 128), '>u2', 'foot')
    """
    shape = _SHAPE.search(stem)
    kind = _kind_in(stem[: shape.start()] if shape else "", stem[shape.end() :] if shape else stem)
    rest = stem
    for match in (kind, shape):
        rest = rest.replace(match[0], "") if match else rest
    numbers: Any = tuple(int(n) for n in shape.groups()) if shape else None
    if numbers is not None and not all(numbers):
        numbers = None
    turnable = numbers is not None and numbers[0] != numbers[2]
    told = Told(numbers, _dtype(kind), turnable=turnable, source="the file's name")
    return told, re.sub(r"[_\-. ]+$|(?<=[_\-. ])[_\-. ]+", "", rest)


def _kind_in(before: str, after: str) -> re.Match[str] | None:
    """Return the type in a name: behind the shape, or in front of it if it tells the bits."""
    words = [m for m in _KIND.finditer(after) if m["bits"] or len(m["kind"]) > 1]
    found = words or [m for m in _KIND.finditer(before) if m["bits"]]
    return found[-1] if found else None


def _dtype(match: re.Match[str] | None) -> np.dtype[Any] | None:
    if match is None:
        return None
    letter, bits = _WORDS[match["kind"].lower()]
    size = int(match["bits"] or bits) // 8
    order = ">" if (match["order"] or "").lower() == "be" else "<"
    try:
        return np.dtype(f"{order}{letter}{size}")
    except TypeError:  # float8
        return None


def told_by_options(options: Mapping[str, Any]) -> Told:
    """Return what the user tells.

    Raises
    ------
    InputError
        If it cannot be a shape or a type.
    """
    shape, dtype = options.get("shape"), options.get("dtype")
    return Told(
        None if shape is None else given_shape(shape),
        None if dtype is None else given_dtype(dtype),
        source="the option shape",
    )


def given_shape(shape: Any) -> Any:
    """Return three positive whole numbers.

    Raises
    ------
    InputError
        If it is anything else.
    """
    try:
        numbers = checked_shape(tuple(shape))
    except (TypeError, ValueError, OverflowError, FileFormatError):
        numbers = ()
    if len(numbers) != 3:
        raise InputError(f"shape must be (nx, ny, nz), positive whole numbers, got {shape!r}")
    return numbers


def given_dtype(dtype: Any) -> np.dtype[Any]:
    """Return a type of real numbers.

    Raises
    ------
    InputError
        If it is none.
    """
    try:
        found = np.dtype(dtype)
    except TypeError as error:
        raise InputError(f"dtype must be a type such as 'uint16', got {dtype!r}") from error
    if found.kind not in "fiub":
        raise InputError(f"dtype must be a type of real numbers, got {found}")
    return found
