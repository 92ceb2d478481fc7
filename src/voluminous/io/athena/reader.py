"""Athena++ files: blocks of cells with their values, in HDF5."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import FileFormatError
from ...units import unit_name
from ..axes import round_unit
from ..contract import FieldInfo, Reader
from ..hdf5 import holds, opened
from ..names import chosen_fields
from .mesh import Mesh, checked, read_mesh
from .variables import CodeUnits, Variable, variables

if TYPE_CHECKING:
    from ...volume import Volume
    from .arrange import Arrange

_MARKS = ("RootGridSize", "MeshBlockSize", "VariableNames", "Coordinates")
_LENGTHS = {"cartesian": (0, 1, 2), "spherical": (0,), "cylindrical": (0, 2)}


class AthenaReader(Reader):
    """Blocks of any level, Cartesian, spherical or cylindrical; nothing is resampled."""

    name = "athena"
    description = "an Athena++ file (.athdf)"
    suffixes = (".athdf",)
    options = {  # noqa: RUF012 - as in Reader
        "unit": "unit of length of the grid; without length_unit, what numbers in the file are in",
        "length_unit": "the code's unit of length, such as '1.5e16 cm'",
        "mass_unit": "the code's unit of mass",
        "time_unit": "the code's unit of time",
        "velocity_unit": "the code's unit of velocity, in place of time_unit",
        "density_unit": "the code's unit of density, in place of mass_unit",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        return holds(path, head, lambda file: all(mark in file.attrs for mark in _MARKS))

    def read(
        self, path: Path, fields: Any = None, *, unit: Any = None, **code_units: Any
    ) -> Volume:
        from ...volume import Volume
        from .arrange import grid_of_mesh

        units = CodeUnits(**code_units)
        with opened(path) as file:
            mesh = read_mesh(file)
            known = {v.place: v for v in variables(file.attrs, mesh.kind)}
            edges, own = in_unit(mesh.kind, mesh.edges, units, unit)
            grid, arrange = grid_of_mesh(mesh, edges, own)
            volume = Volume(grid)
            volume.meta.update(_meta(file, units))
            names = {place: v.name for place, v in known.items()}
            for name, place in chosen_fields(names, fields).items():
                variable = known[place]
                dataset = _dataset(file, variable, mesh)
                factor, field_unit = units.of(variable.kind)
                load = functools.partial(_load, path, variable, mesh, arrange, factor)
                volume[name] = Deferred(load, _native(dataset.dtype), field_unit)
        return volume

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        options.pop("unit", None)
        units = CodeUnits(**options)
        with opened(path) as file:
            mesh = read_mesh(file)
            return tuple(
                FieldInfo(
                    v.name,
                    v.place,
                    _dataset(file, v, mesh).shape[1:],
                    str(_native(file[v.dataset].dtype)),
                    unit_name(units.of(v.kind)[1]),
                )
                for v in variables(file.attrs, mesh.kind)
            )


def _dataset(file: Any, variable: Variable, mesh: Mesh) -> Any:
    dataset = checked(file[variable.dataset])
    blocks = (len(mesh.level), *mesh.block[::-1].tolist())
    if dataset.shape[1:] != blocks or variable.row >= dataset.shape[0]:
        raise FileFormatError(
            f"{variable.dataset!r} has shape {dataset.shape}, expected the variables of blocks "
            f"{blocks} (block, z, y, x)"
        )
    if dataset.dtype.kind not in "fiu":
        raise FileFormatError(f"{variable.dataset!r} must be numbers, got {dataset.dtype}")
    return dataset


def _load(path: Path, variable: Variable, mesh: Mesh, arrange: Arrange, factor: float) -> Any:
    with opened(path) as file:
        values = _dataset(file, variable, mesh)[variable.row]
    values = values.astype(_native(values.dtype), copy=False)
    return arrange((values if factor == 1 else values * factor).transpose(0, 3, 2, 1))


def _native(dtype: Any) -> Any:
    return np.dtype(dtype).newbyteorder("=")


def in_unit(
    kind: str, edges: Sequence[np.ndarray], units: CodeUnits, unit: Any
) -> tuple[Sequence[np.ndarray], Any]:
    """Return the edges of a grid in the unit that the volume shall have, and that."""
    if units.length is None:
        return edges, unit
    lengths = _LENGTHS[kind]
    width = max(float(np.ptp(edges[axis])) for axis in lengths)
    own = round_unit(width * units.length) if unit is None else unit
    factor = units.length.to(own)
    return [e * factor if axis in lengths else e for axis, e in enumerate(edges)], own


def _meta(file: Any, units: CodeUnits) -> dict[str, Any]:
    meta: dict[str, Any] = {}
    if "Time" in file.attrs:
        factor, unit = units.of(("time", (0, 0, 1), "s"))
        meta["time"] = float(file.attrs["Time"]) * factor
        meta["time_unit"] = unit_name(unit)
    if "NumCycles" in file.attrs:
        meta["cycle"] = int(file.attrs["NumCycles"])
    return meta
