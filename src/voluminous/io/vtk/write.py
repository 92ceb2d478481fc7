"""Writes volumes as image data (.vti) or rectilinear grids (.vtr): cell data, appended as bytes."""

from __future__ import annotations

import errno
import warnings
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...grids.cartesian.grid import CartesianGrid
from ...packages import require
from ..axes import cartesian
from ..scanners.placement import direction_of, middle_of
from ..scanners.voxels import VECTOR
from .library import heard, vtk

if TYPE_CHECKING:
    from ...volume import Volume


def write_image(volume: Volume, path: Path) -> None:
    """Write a volume of equal cells as image data."""
    grid, direction = cartesian(volume), direction_of(volume)
    if not (isinstance(grid, CartesianGrid) and grid.is_uniform):
        raise InputError("image data have equal cells, these are not: write a .vtr file")
    low = grid.bounds[:, 0]
    if not np.array_equal(direction, np.eye(3)):
        # The grid of an oblique volume lies about the scan's true centre.
        middle = middle_of(volume)
        low = middle + direction @ (low - middle)
    widths = np.ptp(grid.bounds, axis=1) / grid.shape
    image = _pyvista().ImageData(dimensions=[n + 1 for n in grid.shape], spacing=widths, origin=low)
    image.direction_matrix = direction
    _write(volume, image, path, "ImageData")


def write_rectilinear(volume: Volume, path: Path) -> None:
    """Write a volume of any cells between planes."""
    grid = cartesian(volume)
    if not np.array_equal(direction_of(volume), np.eye(3)):
        warnings.warn(
            "rectilinear grids of VTK cannot be turned: what meta['direction'] says of the cells "
            "is lost. A .vti file keeps it",
            stacklevel=2,
        )
    edges = [np.asarray(line, float) for line in grid.edges]
    _write(volume, _pyvista().RectilinearGrid(*edges), path, "RectilinearGrid")


def _pyvista() -> Any:
    return require("pyvista", "vtk", "writing files of VTK")


def _write(volume: Volume, mesh: Any, path: Path, kind: str) -> None:
    key = vtk("vtkCommonCore").vtkDataArray.UNITS_LABEL()
    for name, parts in _columns(volume):
        values = np.stack([volume.array(part).T.ravel() for part in parts], axis=-1)
        # VTK has no half precision.
        dtype = np.float32 if values.dtype == np.float16 else values.dtype.newbyteorder("=")
        mesh.cell_data[name] = values.astype(dtype, copy=False).squeeze()
        if volume.units[parts[0]]:
            information = mesh.GetCellData().GetArray(name).GetInformation()
            information.Set(key, volume.units[parts[0]])
        if len(parts) == 1 and mesh.GetCellData().GetScalars() is None:
            mesh.GetCellData().SetActiveScalars(name)
    meta = {("TimeValue" if name == "time" else name): v for name, v in volume.meta.items()}
    if volume.unit is not None:
        meta["length_unit"] = str(volume.unit)
    for name, value in meta.items():
        if isinstance(value, (str, Real)) and not isinstance(value, bool):
            mesh.field_data[name] = value if isinstance(value, str) else [float(value)]
    writer = getattr(vtk("vtkIOXML"), f"vtkXML{kind}Writer")()
    writer.SetInputData(mesh)
    writer.SetFileName(str(path))
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()
    writer.SetCompressorTypeToNone()
    writer.SetHeaderTypeToUInt64()
    try:
        with heard():
            writer.Write()
    except FileFormatError as error:  # it does not tell why
        raise OSError(errno.EIO, "VTK could not write it", str(path)) from error


def _columns(volume: Volume) -> list[tuple[str, tuple[str, ...]]]:
    """Return the arrays to write: a field each, or the three of a vector that fit together."""
    done, result = set(), []
    kinds = {
        name: (known["dtype"], volume.units[name])
        for name, known in volume.describe()["fields"].items()
    }
    for name in volume.fields:
        base = name.removesuffix(VECTOR[0])
        parts = tuple(base + ending for ending in VECTOR)
        alike = {kinds.get(part) for part in parts} == {kinds[name]}
        if name != base and alike and base not in kinds:
            done |= set(parts)
            result.append((base, parts))
    return result + [(name, (name,)) for name in volume.fields if name not in done]
