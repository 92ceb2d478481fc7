"""Files with values on the cells: their heads, and which fields are in them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError, VoluminousError
from ..guard import placed
from ..names import field_name
from .binary import BinaryPlanes
from .grid_file import GridFile, Source
from .known import Kind, known_kind, opened
from .records import RecordFile, RecordPlanes
from .text import TextPlanes

_VECTOR = 3
# More species than anyone has: memory is not taken for a damaged number.
_MOST_PARTS = 1 << 16


@dataclass(frozen=True)
class Part:
    """A field in a file.

    Attributes
    ----------
    name : str
    place : str
        The file's name, and which of its fields.
    unit : str
    plane, column : int
        Which array of the file it is in, and which of the values per cell there.
    file : FieldFile or VoluminousError
        The file; or why it cannot be read.
    """

    name: str
    place: str
    unit: str
    plane: int
    column: int
    file: FieldFile | VoluminousError


@dataclass
class FieldFile:
    """A file with values on the cells, of which the head has been read.

    Attributes
    ----------
    path : Path
    planes : BinaryPlanes, TextPlanes or RecordPlanes
        Its arrays.
    width : int
        How many values each cell has, side by side.
    """

    path: Path
    planes: BinaryPlanes | TextPlanes | RecordPlanes
    width: int
    _wanted: dict[int, set[int]] = field(default_factory=dict)
    _kept: dict[int, NDArray[np.generic]] = field(default_factory=dict)

    def expect(self, part: Part) -> None:
        """Take note of a field that will be read."""
        self._wanted.setdefault(part.plane, set()).add(part.column)

    def values(self, part: Part) -> NDArray[np.generic]:
        """Return a field in the file's order.

        Where values of several fields are side by side, they are kept until the last one of those
        expected has been read: a text is read once.
        """
        with placed(self.path.name):
            plane = self._kept.pop(part.plane, None)
            plane = self.planes.plane(part.plane) if plane is None else plane
        wanted = self._wanted.get(part.plane, set())
        wanted.discard(part.column)
        if wanted:
            self._kept[part.plane] = plane
        return plane[part.column :: self.width]


def parts_of(path: Path, grid: GridFile) -> list[Part]:
    """Return the fields in a file; none if RADMC-3D has no such file, and it looks like none.

    Of a file that cannot be read there is one part, which tells why.
    """
    kind = known_kind(path.stem)
    try:
        with placed(path.name), opened(path) as source:
            return _parts(path, source, kind, grid)
    except VoluminousError as error:
        unit = kind.unit if kind else ""
        name = field_name(path.stem)
        return [Part(name, path.name, unit, 0, 0, error)] if kind else []


def _parts(path: Path, source: Source, kind: Kind | None, grid: GridFile) -> list[Part]:
    expected = 2 if kind and kind.layout == "frequencies" else 1
    if (number := source.format(True)) != expected:
        raise FileFormatError(f"the format number must be {expected}, got {number}")
    (cells,) = source.integers(1, "the number of cells")
    if cells != grid.cells:
        raise FileFormatError(
            f"it has {cells} cells, but the grid has {grid.cells}; read other fields with "
            "fields=[…], or put the file elsewhere"
        )
    kind = kind or _guessed(source, cells)
    endings = _endings(source, kind, grid)
    side_by_side = kind.layout in ("vector", "levels")
    width = len(endings) if side_by_side else 1
    planes = source.planes(1 if side_by_side else len(endings), width * cells)
    file, name = FieldFile(path, planes, width), field_name(path.stem)
    return [
        Part(
            f"{name}_{ending}" if ending else name,
            f"{path.name}:{ending}" if ending else path.name,
            kind.unit,
            0 if side_by_side else k,
            k if side_by_side else 0,
            file,
        )
        for k, ending in enumerate(endings)
    ]


def _guessed(source: Source, cells: int) -> Kind:
    """Return what a file holds that RADMC-3D does not know: one value per cell, or three."""
    if isinstance(source, RecordFile):
        raise FileFormatError("RADMC-3D has no such file")
    vector = source.width(cells) == _VECTOR
    return Kind("vector" if vector else "scalar", "")


def _endings(source: Source, kind: Kind, grid: GridFile) -> list[str]:
    if kind.layout in ("scalar", "vector"):
        return list(grid.names) if kind.layout == "vector" else [""]
    (count,) = source.integers(1, f"the number of {kind.layout}")
    if not 1 <= count <= _MOST_PARTS:
        raise FileFormatError(
            f"the number of {kind.layout} must be from 1 to {_MOST_PARTS}, got {count}"
        )
    if kind.layout == "levels":
        return [str(level) for level in source.integers(count, "the levels")]
    if kind.layout == "frequencies":
        source.reals(count, "the frequencies")
    return [str(k + 1) for k in range(count)] if count > 1 else [""]
