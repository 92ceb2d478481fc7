"""The reader for models of RADMC-3D."""

from __future__ import annotations

import functools
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import FileFormatError, InputError, UnitsError, VoluminousError
from ...units import parse_unit
from ..contract import FieldChoice, FieldInfo, Reader, UnitLike
from ..guard import placed
from .fields import FieldFile, FieldPart, Model, holds_model, open_model

if TYPE_CHECKING:
    from ...volume import Volume
    from .grids import ArrangedGrid


class RADMC3DReader(Reader):
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
        try:
            return holds_model(path, head)
        except OSError:
            return False

    def read(self, path: Path, fields: FieldChoice = None, **options: Any) -> Volume:
        from ...volume import Volume

        unit = options.get("unit")
        _check_length(unit)
        model = open_model(path)
        chosen = model.chosen(fields)
        for part in chosen.values():
            if isinstance(part.file, VoluminousError):
                raise part.file
            part.file.expect(part)
        cells = _cells(model, unit)
        volume = Volume(cells.grid)
        volume.meta["coordsystem"] = model.grid.coordinates
        for name, part in chosen.items():
            volume[name] = _deferred(part, cells)
        return volume

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        model = open_model(path)
        shape = model.grid.shape
        if math.prod(shape) != model.grid.cells:
            shape = (model.grid.cells,)
        parts = (model.parts[place] for place in model.own)
        return tuple(FieldInfo(p.name, p.place, shape, str(_dtype(p)), p.unit) for p in parts)

    def write(self, volume: Volume, path: Path, **options: Any) -> None:
        from .writer import write

        write(volume, path, **options)


def _dtype(part: FieldPart) -> np.dtype:
    if isinstance(part.file, FieldFile):
        return part.file.planes.dtype.newbyteorder("=")
    return np.dtype(np.float64)


def _check_length(unit: UnitLike) -> None:
    known = parse_unit(unit)
    if unit is not None and (known is None or known.physical_type != "length"):
        raise UnitsError(f"unit must be a length such as 'au', got {unit!r}")


def _cells(model: Model, unit: UnitLike) -> ArrangedGrid:
    from .grids import cartesian_grid, spherical_grid

    make = spherical_grid if model.grid.spherical else cartesian_grid
    try:
        with placed(model.grid_path.name):
            return make(model.grid, unit)
    except FileFormatError:
        raise
    except InputError as error:  # the file's numbers make no valid grid
        raise FileFormatError(str(error)) from error


def _deferred(part: FieldPart, cells: ArrangedGrid) -> Deferred:
    assert isinstance(part.file, FieldFile)
    planes = part.file.planes
    stays = planes.mapped and part.part is None and cells.in_order and planes.dtype.isnative
    return Deferred(functools.partial(_load, part, cells), _dtype(part), part.unit, stays)


def _load(part: FieldPart, cells: ArrangedGrid) -> Any:
    assert isinstance(part.file, FieldFile)
    return cells.arranged(part.file.values(part))
