"""Legacy files of VTK (.vtk): structured points and rectilinear grids, as text or binary.

https://docs.vtk.org/en/latest/vtk_file_formats/vtk_legacy_file_format.html
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError
from ..contract import FieldInfo, Reader
from ..payload import checked_shape
from ..scanners.placement import Arrangement
from .axes import ADVICE, UPRIGHT, aligned_lines, cell_counts, even_arrangement, uneven_arrangement
from .dataset import Dataset, told
from .legacy_arrays import Arrays
from .legacy_values import Lines, Stored
from .volumes import OPTIONS, infos, volume_of

if TYPE_CHECKING:
    from ...volume import Volume

_MAGIC = b"# vtk DataFile Version"
_KINDS = ("STRUCTURED_POINTS", "RECTILINEAR_GRID", "STRUCTURED_GRID")


class VTKReader(Reader):
    """Legacy files."""

    name = "vtk"
    description = "a legacy VTK file (.vtk)"
    suffixes = (".vtk",)
    options = OPTIONS

    def matches(self, path: Path, head: bytes) -> bool:
        """Return True for a file that starts as they do."""
        return head.startswith(_MAGIC)

    def read(self, path: Path, fields: Any = None, **options: Any) -> Volume:
        """Return the volume; values are read when they are used."""
        return volume_of(_dataset(path), fields, **options)

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        """Return the arrays, component by component."""
        return infos(_dataset(path))


def _dataset(path: Path) -> Dataset:
    with open(path, "rb") as file:
        return _Legacy(Lines(path, file)).dataset()


class _Legacy:
    """The head and the geometry of a file."""

    def __init__(self, lines: Lines) -> None:
        self._lines = lines
        self._points: tuple[int, ...] = ()
        self._numbers = {"ORIGIN": (0.0, 0.0, 0.0), "SPACING": (1.0, 1.0, 1.0)}
        self._coordinates: dict[str, Stored] = {}
        self._arrays = Arrays(lines, self._counts)
        self._title, self._kind = self._head()
        self._keywords: dict[str, Callable[[list[str]], None]] = {
            "DIMENSIONS": self._dimensions,
            "ORIGIN": self._three,
            "SPACING": self._three,
            "ASPECT_RATIO": self._three,
            "X_COORDINATES": self._line,
            "Y_COORDINATES": self._line,
            "Z_COORDINATES": self._line,
            "POINTS": self._mesh,
            **self._arrays.keywords,
        }

    def dataset(self) -> Dataset:
        """Return what is in the file."""
        while words := self._lines.words():
            keyword = words[0].upper()
            place = f"byte {self._lines.file.tell()}: {keyword[:40]!r}"
            if keyword not in self._keywords:
                raise FileFormatError(f"{place} is no keyword of legacy VTK files")
            try:
                self._keywords[keyword](words)
            except (IndexError, ValueError) as error:
                if isinstance(error, InputError):
                    raise
                raise FileFormatError(f"{place}: expected more, or numbers ({error})") from error
        arrays = self._arrays
        return Dataset(
            self._shape(),
            self._arrange,
            arrays.found,
            arrays.active,
            told(arrays.remarks, self._title),
        )

    def _head(self) -> tuple[str, str]:
        """Return title and kind of data; notes whether it is text or binary."""
        self._lines.line()
        title = self._lines.line()
        way = self._lines.line().upper()
        if way not in ("ASCII", "BINARY"):
            raise FileFormatError(f"line 3: expected ASCII or BINARY, got {way[:40]!r}")
        self._lines.binary = way == "BINARY"
        words = self._lines.words()
        kind = " ".join(words[1:2]).upper()
        if len(words) != 2 or words[0].upper() != "DATASET":
            raise FileFormatError(f"line 4: expected DATASET and its kind, got {words[:4]}")
        if kind not in _KINDS:
            raise InputError(f"it holds {kind[:40]}, not a regular grid{ADVICE}")
        return title, kind

    def _dimensions(self, words: list[str]) -> None:
        counts = [int(word) for word in words[1:4]]
        if len(counts) != 3:
            raise FileFormatError(f"expected three DIMENSIONS, got {words[1:]}")
        self._points = checked_shape(counts, "DIMENSIONS")

    def _three(self, words: list[str]) -> None:
        numbers = tuple(float(word) for word in words[1:4])
        if len(numbers) != 3 or not np.isfinite(numbers).all():
            raise FileFormatError(f"expected three finite numbers as {words[0]}, got {words[1:]}")
        self._numbers["ORIGIN" if words[0].upper() == "ORIGIN" else "SPACING"] = numbers

    def _line(self, words: list[str]) -> None:
        axis = "XYZ".index(words[0][0].upper())
        if int(words[1]) != self._shape()[axis]:
            raise FileFormatError(
                f"expected {self._shape()[axis]} {words[0]}, as DIMENSIONS say, got {words[1][:40]}"
            )
        self._coordinates["xyz"[axis]] = self._arrays.other(words[0], words[2], int(words[1]))

    def _mesh(self, words: list[str]) -> None:
        if int(words[1]) != math.prod(self._shape()):
            raise FileFormatError(f"expected POINTS for all DIMENSIONS, got {words[1][:40]}")
        self._coordinates["mesh"] = self._arrays.other("POINTS", words[2], 3 * int(words[1]), 3)

    def _shape(self) -> tuple[int, ...]:
        if not self._points:
            raise FileFormatError("expected DIMENSIONS before data")
        return self._points

    def _counts(self, at: str) -> tuple[int, ...]:
        return cell_counts(self._shape(), at)[::-1]

    def _arrange(self, at: str, unit: Any) -> Arrangement:
        """Return where the cells are."""
        if self._kind == "STRUCTURED_POINTS":
            origin, spacing = self._numbers["ORIGIN"], self._numbers["SPACING"]
            return even_arrangement(origin, spacing, UPRIGHT, (0, 0, 0), self._points, at, unit)
        needed = ("mesh",) if self._kind == "STRUCTURED_GRID" else ("x", "y", "z")
        missing = [name for name in needed if name not in self._coordinates]
        if missing:
            raise FileFormatError(f"expected coordinates of the points, {missing} missing")
        values = [self._coordinates[name].values() for name in needed]
        if needed == ("mesh",):
            values = aligned_lines(values[0].reshape(*self._points[::-1], 3))
        return uneven_arrangement(values, at, unit)
