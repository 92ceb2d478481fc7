"""The files of a RADMC-3D model and the fields in them.

RADMC-3D identifies files by name; any other file of values on the grid is read as a field too.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ...errors import FileFormatError, VoluminousError
from ..contract import FieldChoice
from ..guard import placed
from ..names import chosen_fields, field_name
from .encodings import BinaryFile, EncodedFile, RecordFile, TextFile, ValuePlanes
from .grid_file import GridFile, read_grid

GRID = "amr_grid"
# Suffixes in order of preference: RADMC-3D stops if there is more than one.
FORMATS: dict[str, type[EncodedFile]] = {
    **dict.fromkeys((".binp", ".bdat", ".bout"), BinaryFile),
    **dict.fromkeys((".inp", ".dat", ".out"), TextFile),
    **dict.fromkeys((".uinp", ".udat", ".uout"), RecordFile),
}
INPUT = (".binp", ".inp", ".uinp")
_PREFERENCE = {suffix: rank for rank, suffix in enumerate(FORMATS)}
# Upper limit on species: a damaged number must not cause a huge allocation.
_MOST_PARTS = 1 << 16


@dataclass(frozen=True)
class FieldKind:
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


def find(directory: Path, stem: str, suffixes: tuple[str, ...]) -> list[Path]:
    """Return the existing files of this name, in order of preference."""
    paths = [directory / (stem + suffix) for suffix in suffixes]
    return [path for path in paths if path.is_file()]


@dataclass(frozen=True)
class FieldPart:
    """One field in a file: its plane, and its values within the plane."""

    name: str
    place: str  # file name and field within the file
    unit: str
    file: FieldFile | VoluminousError  # or the reason why it cannot be read
    plane: int = 0
    part: slice | None = None  # all of them


@dataclass
class FieldFile:
    """A file of cell values."""

    path: Path
    planes: ValuePlanes
    _wanted: dict[int, int] = field(default_factory=dict)
    _kept: dict[int, np.ndarray] = field(default_factory=dict)

    def expect(self, part: FieldPart) -> None:
        """Register a field that will be read."""
        self._wanted[part.plane] = self._wanted.get(part.plane, 0) + 1

    def values(self, part: FieldPart) -> np.ndarray:
        """Return a field in the file's cell order.

        A plane shared by several fields is cached until the last expected field has been read.
        """
        with placed(self.path.name):
            plane = self._kept.pop(part.plane, None)
            plane = self.planes.plane(part.plane) if plane is None else plane
        self._wanted[part.plane] = self._wanted.get(part.plane, 0) - 1
        if self._wanted[part.plane] > 0:
            self._kept[part.plane] = plane
        return plane if part.part is None else plane[part.part].copy()


def parts_of(path: Path, grid: GridFile) -> list[FieldPart]:
    """Return the fields in a file; for an invalid RADMC-3D file, one part that states the error."""
    kind = known_kind(path.stem)
    try:
        with placed(path.name), FORMATS[path.suffix](path) as source:
            return _parts(path, source, kind, grid)
    except VoluminousError as error:
        return [FieldPart(field_name(path.stem), path.name, kind.unit, error)] if kind else []


def _parts(
    path: Path, source: EncodedFile, kind: FieldKind | None, grid: GridFile
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
    kind = kind or _guessed(source, cells)
    endings = _endings(source, kind, grid)
    count = len(endings)
    # A text file is read completely.
    planes = count if kind.layout not in ("vector", "levels") else 1
    one = planes == 1 or isinstance(source, TextFile)
    file = FieldFile(
        path, source.planes(1 if one else planes, count * cells // (1 if one else planes))
    )

    def part(k: int) -> tuple[int, slice | None]:
        if count == 1 or not one:
            return k, None
        return 0, slice(k, None, count) if planes == 1 else slice(k * cells, (k + 1) * cells)

    name = field_name(path.stem)
    return [
        FieldPart(
            f"{name}_{ending}" if ending else name,
            f"{path.name}:{ending}" if ending else path.name,
            kind.unit,
            file,
            *part(k),
        )
        for k, ending in enumerate(endings)
    ]


def _guessed(source: EncodedFile, cells: int) -> FieldKind:
    """Return the kind of a file that RADMC-3D does not define: one or three values per cell."""
    if isinstance(source, RecordFile):
        raise FileFormatError("RADMC-3D has no such file")
    return FieldKind("vector" if source.width(cells) == 3 else "scalar", "")


def _endings(source: EncodedFile, kind: FieldKind, grid: GridFile) -> list[str]:
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


@dataclass(frozen=True)
class Model:
    """The contents of a model directory."""

    grid_path: Path
    grid: GridFile
    parts: dict[str, FieldPart]  # all fields by place
    own: tuple[str, ...]  # places selected by the given path: all, or those of one file

    def chosen(self, fields: FieldChoice) -> dict[str, FieldPart]:
        """Return the requested fields by their requested names."""
        known = {place: part.name for place, part in self.parts.items()}
        if fields is None:
            known = {place: known[place] for place in self.own}
        else:
            fields = self._expanded(fields, known)
        return {name: self.parts[place] for name, place in chosen_fields(known, fields).items()}

    def _expanded(self, fields: FieldChoice, known: dict[str, str]) -> Any:
        """Replace each name that stands for several species by the names of these species."""
        if isinstance(fields, str):
            fields = [fields]
        if not isinstance(fields, (list, tuple)):
            return fields
        found: list[Any] = []
        for name in fields:
            several = [place for place in known if place.partition(".")[0] == name]
            direct = name in known or name in known.values()
            found += several if several and not direct else [name]
        return found


def open_model(path: Path) -> Model:
    """Return the model in a directory, or in the directory that contains the given file."""
    directory = path if path.is_dir() else path.parent
    grids = find(directory, GRID, INPUT)
    grid_path = path if path in grids else grids[0]
    if path not in grids:
        _warn_of_others(grids)
    with placed(grid_path.name), FORMATS[grid_path.suffix](grid_path) as source:
        grid = read_grid(source)
    one_file = path.is_file() and path not in grids
    parts = [part for file in _files(directory, path) for part in parts_of(file, grid)]
    own = [part.place for part in parts if not one_file or part.place.split(":")[0] == path.name]
    if not own:
        known = "no file with values on the grid" if not one_file else "no values on the grid"
        raise FileFormatError(f"expected a file such as gas_density.inp; there is {known}")
    return Model(grid_path, grid, {part.place: part for part in parts}, tuple(own))


def _files(directory: Path, given: Path) -> list[Path]:
    found: dict[str, list[Path]] = {}
    for path in sorted(directory.iterdir()):
        if path.suffix in FORMATS and path.stem != GRID and path.is_file():
            found.setdefault(path.stem, []).append(path)
    chosen = []
    for paths in found.values():
        paths.sort(key=lambda path: (path != given, _PREFERENCE[path.suffix]))
        if paths[0] != given:
            _warn_of_others(paths)
        chosen.append(paths[0])
    return chosen


def _warn_of_others(paths: list[Path]) -> None:
    if len(paths) > 1:
        others = " and ".join(path.name for path in paths[1:])
        warnings.warn(
            f"{paths[0].name} is read, and {others} beside it is not; RADMC-3D would stop at that",
            stacklevel=2,
        )


def holds_model(path: Path, head: bytes) -> bool:
    """Return True for a directory with a grid file, and for a model file in such a directory."""
    directory = path if path.is_dir() else path.parent
    if path.is_file() and (path.suffix not in FORMATS or not _begins(path.suffix, head)):
        return False
    return bool(find(directory, GRID, INPUT))


def _begins(suffix: str, head: bytes) -> bool:
    if suffix[1] not in "ub":
        return head.split(maxsplit=1)[:1] in ([b"1"], [b"2"])
    numbers, kind = ((4, 8, 16), "i4") if suffix[1] == "u" else ((1, 2), "i8")
    starts = [np.array(n, order + kind).tobytes() for n in numbers for order in "<>"]
    return any(head.startswith(start) for start in starts)
