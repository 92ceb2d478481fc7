"""The files of a RADMC-3D model and the fields in them.

RADMC-3D identifies files by name; any other file of values on the grid is read as a field too.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from ..errors import FileFormatError, VoluminousError
from ..io.fortran import BinaryFile, CellData, RecordFile, TextFile
from ..io.guard import placed
from ..io.names import field_name
from .grid_file import GridFile

GRID = "amr_grid"
# Suffixes in order of preference: RADMC-3D stops if there is more than one.
FORMATS: dict[str, type[BinaryFile]] = {
    **dict.fromkeys((".binp", ".bdat", ".bout"), BinaryFile),
    **dict.fromkeys((".inp", ".dat", ".out"), TextFile),
    **dict.fromkeys((".uinp", ".udat", ".uout"), RecordFile),
}
INPUT = (".binp", ".inp", ".uinp")
# Upper limit on species: a damaged number must not cause a huge allocation.
_MOST_PARTS = 1 << 16


class FieldKind(NamedTuple):
    """Layout and unit of the values in a file."""

    # One value per cell, three, one array per species, several per cell, or one per frequency.
    layout: Literal["scalar", "vector", "species", "levels", "frequencies"]
    unit: str
    suffix: str = ".inp"  # of text files


_DENSITY, _NUMBER, _INTENSITY = "g / cm3", "1 / cm3", "erg / (s cm2 Hz sr)"
KINDS = {
    "gas_density": FieldKind("scalar", _DENSITY),
    "gas_temperature": FieldKind("scalar", "K"),
    "gas_velocity": FieldKind("vector", "cm / s"),
    "dust_density": FieldKind("species", _DENSITY),
    "dust_temperature": FieldKind("species", "K", ".dat"),
    "stellarsrc_density": FieldKind("species", _DENSITY),
    "electron_numdens": FieldKind("scalar", _NUMBER),
    "ion_numdens": FieldKind("scalar", _NUMBER),
    "microturbulence": FieldKind("scalar", "cm / s"),
    "escprob_lengthscale": FieldKind("scalar", "cm"),
    "grainalign_dir": FieldKind("vector", ""),
    "heatsource": FieldKind("scalar", "erg / (s cm3)"),
    "mean_intensity": FieldKind("frequencies", _INTENSITY, ".out"),
}
# Files that exist once per molecule.
_PREFIXES = {
    "numberdens_": FieldKind("scalar", _NUMBER),
    "levelpop_": FieldKind("levels", _NUMBER, ".dat"),
}


def known_kind(stem: str) -> FieldKind | None:
    """Return the kind of a file with this name (no suffix); None if RADMC-3D defines none."""
    for prefix, kind in _PREFIXES.items():
        if stem.startswith(prefix) and stem != prefix:
            return kind
    return KINDS.get(stem)


@dataclass
class FieldFile:
    """A file of cell values; a plane of several fields is cached until all of them are read."""

    name: str
    data: CellData
    expected: set[tuple[int, int]] = field(default_factory=set)  # plane and part
    cached: dict[int, np.ndarray] = field(default_factory=dict)

    def values(self, plane: int, first: int, part: slice | None) -> np.ndarray:
        with placed(self.name):
            values = self.cached.pop(plane, None)
            values = self.data.plane(plane) if values is None else values
        self.expected.discard((plane, first))
        if any(other == plane for other, _ in self.expected):
            self.cached[plane] = values
        return values if part is None else values[part].copy()


class FieldPart(NamedTuple):
    """One field in a file: its plane, and its values within the plane."""

    name: str
    place: str  # file name and field within the file
    unit: str
    file: FieldFile | VoluminousError  # or the reason why it cannot be read
    plane: int = 0
    first: int = 0
    part: slice | None = None  # all of them


def parts_of(path: Path, grid: GridFile) -> list[FieldPart]:
    """Return the fields in a file; for an invalid RADMC-3D file, one part that states the error."""
    kind = known_kind(path.stem)
    try:
        with placed(path.name), FORMATS[path.suffix](path) as source:
            return _parts(path, source, kind, grid)
    except VoluminousError as error:
        return [FieldPart(field_name(path.stem), path.name, kind.unit, error)] if kind else []


def _parts(
    path: Path, source: BinaryFile, kind: FieldKind | None, grid: GridFile
) -> list[FieldPart]:
    expected = 2 if kind and kind.layout == "frequencies" else 1
    if (number := source.format(True)) != expected:
        raise FileFormatError(f"the format number must be {expected}, got {number}")
    (cells,) = source.integers(1, "the number of cells")
    if cells != grid.cells:
        raise FileFormatError(
            f"it has {cells} cells, but the grid has {grid.cells}; read other fields with "
            "fields=[…], or put the file elsewhere"
        )
    if kind is None:  # a file that RADMC-3D does not define: one or three values per cell
        if isinstance(source, RecordFile):
            raise FileFormatError("RADMC-3D has no such file")
        kind = FieldKind("vector" if source.width(cells) == 3 else "scalar", "")
    endings = _endings(source, kind.layout, grid)
    count = len(endings)
    mixed = kind.layout in ("vector", "levels")  # all values of a cell side by side
    whole = mixed or isinstance(source, TextFile)
    data = source.data(1, count * cells) if whole else source.data(count, cells)
    file, stem, parts = FieldFile(path.name, data), field_name(path.stem), []
    for k, ending in enumerate(endings):
        name, place = (f"{s}{ending and sep}{ending}" for s, sep in ((stem, "_"), (path.name, ":")))
        part = slice(k, None, count) if mixed else slice(k * cells, (k + 1) * cells)
        if count == 1 or not whole:
            parts.append(FieldPart(name, place, kind.unit, file, k))
        else:
            parts.append(FieldPart(name, place, kind.unit, file, 0, k, part))
    return parts


def _endings(source: BinaryFile, layout: str, grid: GridFile) -> list[str]:
    if layout in ("scalar", "vector"):
        return list(grid.names) if layout == "vector" else [""]
    (count,) = source.integers(1, f"the number of {layout}")
    if not 1 <= count <= _MOST_PARTS:
        raise FileFormatError(
            f"the number of {layout} must be from 1 to {_MOST_PARTS}, got {count}"
        )
    if layout == "levels":
        return [str(level) for level in source.integers(count, "the levels")]
    if layout == "frequencies":
        source.reals(count, "the frequencies")
    return [str(k + 1) for k in range(count)] if count > 1 else [""]


# The directory


def find(directory: Path, stem: str, suffixes: tuple[str, ...]) -> list[Path]:
    """Return the existing files of this name, in order of preference."""
    paths = [directory / (stem + suffix) for suffix in suffixes]
    return [path for path in paths if path.is_file()]


def preferred(paths: list[Path], given: Path) -> Path:
    """Return the given file if it is one of several encodings, else the first with a warning."""
    if given in paths:
        return given
    if len(paths) > 1:
        others = " and ".join(path.name for path in paths[1:])
        warnings.warn(
            f"{paths[0].name} is read, and {others} beside it is not; RADMC-3D would stop at that",
            stacklevel=2,
        )
    return paths[0]


def field_files(directory: Path, given: Path) -> list[Path]:
    """Return the files of a model besides the grid, each in one encoding."""
    order = list(FORMATS)
    encodings: dict[str, list[Path]] = {}
    for path in sorted(directory.iterdir()):
        if path.suffix in FORMATS and path.stem != GRID and path.is_file():
            encodings.setdefault(path.stem, []).append(path)
    return [
        preferred(sorted(paths, key=lambda p: order.index(p.suffix)), given)
        for paths in encodings.values()
    ]
