"""The reader for models of RADMC-3D."""

from __future__ import annotations

import functools
import warnings
from codecs import BOM_UTF8
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from ..errors import FileFormatError, InputError, UnitsError, VoluminousError
from ..io.boxes import boxes
from ..io.contract import Contents, ContentsReader, FieldChoice, FieldInfo, StoredField, UnitLike
from ..io.fortran import BinaryFile, CellData, RecordFile, TextFile
from ..io.guard import placed
from ..io.names import field_name
from ..units import parse_unit
from .grid_file import GridFile, read_grid

if TYPE_CHECKING:
    from ..volume import Volume
    from .grids import ArrangedGrid


@dataclass(frozen=True)
class Model(Contents):
    """The contents of a model directory."""

    own: tuple[str, ...] = ()  # places selected by the given path: all, or those of one file
    parts: dict[str, FieldPart] = field(default_factory=dict)


class RADMC3DReader(ContentsReader):
    """Directories with ``amr_grid.inp`` and files such as ``gas_density.inp``."""

    name = "radmc3d"
    description = "a RADMC-3D model (a directory, or a file in one)"
    options = {  # noqa: RUF012 - as in Reader
        "unit": "unit of lengths in the grid, which files have in cm (default)"
    }
    writes = True
    writes_directory = True
    write_options = {  # noqa: RUF012 - as in Reader
        "binary": "True for binary files in place of text"
    }

    def matches(self, path: Path, head: bytes) -> bool:
        directory = path if path.is_dir() else path.parent
        if path.is_file() and (path.suffix not in FORMATS or not _begins(path.suffix, head)):
            return False
        try:
            return bool(find(directory, GRID, INPUT))
        except OSError:
            return False

    def contents(self, path: Path, **options: Any) -> Model:
        unit: UnitLike = options.get("unit")
        length = parse_unit(unit)
        if unit is not None and (length is None or length.physical_type != "length"):
            raise UnitsError(f"unit must be a length such as 'au', got {unit!r}")
        directory = path if path.is_dir() else path.parent
        grid_path = preferred(find(directory, GRID, INPUT), path)
        with placed(grid_path.name), FORMATS[grid_path.suffix](grid_path) as source:
            grid = read_grid(source)
        one_file = path.is_file() and path.stem != GRID
        parts = [part for file in field_files(directory, path) for part in parts_of(file, grid)]
        own = [p.place for p in parts if not one_file or p.place.split(":")[0] == path.name]
        if not own:
            missing = "no values on the grid" if one_file else "no file with values on the grid"
            raise FileFormatError(f"expected a file such as gas_density.inp; there is {missing}")
        # Made when first needed: a description of the model needs no grid.
        cells = functools.cache(lambda: _cells(grid_path.name, grid, unit))
        regular = grid.flags is None and grid.layers is None
        shape = grid.shape if regular else (grid.cells,)

        def stored(part: FieldPart) -> StoredField:
            if isinstance(part.file, VoluminousError):
                return StoredField(part.name, part.place, shape, np.dtype("f8"), part.unit, cells)
            file, data = part.file, part.file.data
            in_order = grid.flags is not None and part.part is None and data.dtype.isnative
            pieces = None
            if in_order and data.in_parts:
                parts = functools.partial(_leaves, data.plane, part.plane)
                pieces = boxes(parts, [shape], (), (0,), (False,))
            return StoredField(
                part.name,
                part.place,
                shape,
                data.dtype.newbyteorder("="),
                part.unit,
                lambda: cells().arranged(file.values(part.plane, part.first, part.part)),
                pieces,
            )

        return Model(
            [stored(part) for part in parts],
            lambda chosen: cells().grid,
            # Where `model.read_model` finds dust, molecules and stars.
            {"coordsystem": grid.coordinates, "radmc3d": str(directory.resolve())},
            tuple(own),
            {part.place: part for part in parts},
        )

    def chosen(self, contents: Contents, fields: FieldChoice) -> Mapping[str, StoredField]:
        assert isinstance(contents, Model)
        parts = contents.parts
        if fields is None:
            fields = list(contents.own)
        elif isinstance(fields, (str, list, tuple)):  # a name may stand for several species
            known = {*parts, *(part.name for part in parts.values())}
            fields = [
                one
                for name in ([fields] if isinstance(fields, str) else fields)
                for one in [p for p in parts if p.partition(".")[0] == name and name not in known]
                or [name]
            ]
        chosen = super().chosen(contents, fields)
        for stored in chosen.values():
            part = parts[stored.place]
            if isinstance(part.file, VoluminousError):
                raise part.file
            part.file.expected.add((part.plane, part.first))
        return chosen

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        model = self.contents(path, **options)
        return tuple(f.info for f in model.fields if f.place in model.own)

    def write(self, volume: Volume, path: Path, **options: Any) -> None:
        from .writer import write

        write(volume, path, **options)


def _leaves(plane: Callable[..., np.ndarray], k: int, index: Any, level: int) -> np.ndarray:
    return plane(k, index)


def _cells(name: str, grid: GridFile, unit: UnitLike) -> ArrangedGrid:
    from .grids import grid_from

    try:
        with placed(name):
            return grid_from(grid, unit)
    except FileFormatError:
        raise
    except InputError as error:  # the file's numbers make no valid grid
        raise FileFormatError(str(error)) from error


def _begins(suffix: str, head: bytes) -> bool:
    if suffix[1] not in "ub":
        return head.removeprefix(BOM_UTF8).split(maxsplit=1)[:1] in ([b"1"], [b"2"])
    numbers, kind = ((4, 8, 16), "i4") if suffix[1] == "u" else ((1, 2), "i8")
    starts = [np.array(n, order + kind).tobytes() for n in numbers for order in "<>"]
    return any(head.startswith(start) for start in starts)


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
