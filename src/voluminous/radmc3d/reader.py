"""The reader for models of RADMC-3D."""

from __future__ import annotations

import functools
from codecs import BOM_UTF8
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FileFormatError, InputError, UnitsError, VoluminousError
from ..io.boxes import boxes
from ..io.contents import Contents, ContentsReader, StoredField
from ..io.contract import FieldChoice, FieldInfo, UnitLike
from ..io.guard import placed
from ..units import parse_unit
from .fields import FORMATS, GRID, INPUT, FieldPart, field_files, find, parts_of, preferred
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
