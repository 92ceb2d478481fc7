"""Meshes and curved grids of VTK, resampled to equal cells."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import InputError
from ...memory import check_memory
from .library import heard, vtk

_INSIDE = "vtkValidPointMask"
_FLOATS = (10, 11)  # VTK_FLOAT, VTK_DOUBLE


def resampled(mesh: Any, resolution: Any) -> Any:
    """Return image data whose points are the centres of equal cells that fill a mesh's bounds.

    Parameters
    ----------
    mesh : vtkDataSet or composite
        Whose values are sampled: those at points interpolated, those in cells as they are. Where
        it has two of one name, that in cells is called ``name_cell``.
    resolution : int or three int
        Cells along the longest side, or along x, y and z.

    Returns
    -------
    image : vtkImageData
        Floating-point numbers at its points, NaN outside of the mesh.

    Raises
    ------
    InputError
        If there is no such resolution, or none of the cells' centres lies in the mesh.
    """
    parts = [part for part in leaves(mesh) if part.GetNumberOfCells()]
    solid = max((part.GetMaxSpatialDimension() for part in parts), default=0)
    parts = [part for part in parts if part.GetMaxSpatialDimension() == solid]
    if solid < 2:
        raise InputError("it holds points or lines, which fill no space")
    limits = np.array([part.GetBounds() for part in parts]).reshape(-1, 3, 2)
    low, high = limits[..., 0].min(axis=0), limits[..., 1].max(axis=0)
    shape = _shape(resolution, high - low)
    check_memory(16 * int(np.prod(shape, dtype=object)), "resampling", "choose fewer cells")
    widths = (high - low) / shape
    # A flat mesh becomes one layer, as thick as its cells are wide.
    steps = np.where(widths > 0, widths, widths.max())
    image = vtk("vtkCommonDataModel").vtkImageData()
    image.SetDimensions(*(int(n) for n in shape))
    image.SetSpacing(*steps)
    image.SetOrigin(*(low + widths / 2))
    probe = vtk("vtkFiltersCore").vtkResampleWithDataSet()
    probe.SetInputData(image)
    probe.SetSourceData(_prepared(parts))
    probe.PassPartialArraysOn()
    with heard():
        probe.Update()
    found = probe.GetOutput()
    convert = vtk("util.numpy_support")
    data = found.GetPointData()
    inside = convert.vtk_to_numpy(data.GetArray(_INSIDE)) != 0
    if not inside.any():
        raise InputError(
            "none of the cells' centres lies in the mesh: it is a surface, or resolution is too low"
        )
    # The numbers stay VTK's, with their units and names of components.
    for number in range(data.GetNumberOfArrays()):
        array = data.GetArray(number)
        if array is not None and array.GetDataType() in _FLOATS:
            convert.vtk_to_numpy(array)[~inside] = np.nan
    data.RemoveArray(_INSIDE)
    data.RemoveArray("vtkGhostType")
    cells = found.GetCellData()
    cells.Initialize()
    found.GetFieldData().ShallowCopy(parts[0].GetFieldData())
    return found


def leaves(mesh: Any) -> list[Any]:
    """Return the data sets in a composite one, or the only one there is."""
    if not mesh.IsA("vtkCompositeDataSet"):
        return [mesh]
    steps, found = mesh.NewIterator(), []
    while not steps.IsDoneWithTraversal():
        found.append(steps.GetCurrentDataObject())
        steps.GoToNextItem()
    return [part for part in found if part.IsA("vtkDataSet")]


def _shape(resolution: Any, lengths: np.ndarray) -> np.ndarray:
    asked = np.asarray(resolution)
    if asked.shape not in ((), (3,)) or asked.dtype.kind not in "iu" or np.any(asked < 1):
        raise InputError(
            f"resolution must be a positive whole number, or three, got {resolution!r}"
        )
    if asked.shape == ():
        asked = np.maximum(np.rint(asked * lengths / lengths.max()), 1).astype(int)
    return np.where(lengths > 0, asked, 1)


def _prepared(parts: list[Any]) -> Any:
    """Return copies in which whole numbers at points are fractions, and no two names are one."""
    blocks = vtk("vtkCommonDataModel").vtkMultiBlockDataSet()
    convert = vtk("util.numpy_support")
    for number, part in enumerate(parts):
        copy = part.NewInstance()
        copy.ShallowCopy(part)
        points, cells = copy.GetPointData(), copy.GetCellData()
        for data in (points, cells):
            for array in [data.GetArray(n) for n in range(data.GetNumberOfArrays())]:
                if array is None or array.GetName() in (None, "vtkGhostType"):
                    continue
                name = array.GetName()
                if data is cells and points.HasArray(name):
                    name = f"{name}_cell"
                elif array.GetDataType() in _FLOATS:
                    continue
                values = convert.vtk_to_numpy(array)
                changed = convert.numpy_to_vtk(
                    values.astype(np.result_type(values.dtype, np.float32)), deep=True
                )
                changed.CopyComponentNames(array)
                changed.SetName(name)
                data.RemoveArray(array.GetName())
                data.AddArray(changed)
        blocks.SetBlock(number, copy)
    return blocks
