"""Volumes of VTK's and PyVista's objects: image data, rectilinear grids, meshes resampled."""

from __future__ import annotations

import contextlib
import functools
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...memory import check_memory
from ...packages import require
from ..units import known_unit
from .dataset import (
    ADVICE,
    CELL,
    POINT,
    UPRIGHT,
    DataArray,
    Dataset,
    Even,
    Uneven,
    cell_counts,
)
from .library import heard, vtk

if TYPE_CHECKING:
    from ...volume import Volume

# More numbers are no remark but data.
_MOST_NUMBERS = 16
_LONGEST_TEXT = 4096
# Of the names that programs use for the one number that all know.
_TIME = ("TimeValue", "TIME", "Time", "time")
_TIME_IN_TITLE = re.compile(r"\btime\s*=\s*([-+.\deE]+)")
# What VTK writes as title of everything.
_NO_TITLE = "vtk output"


def from_pyvista(
    dataset: Any, fields: Any = None, *, unit: Any = None, resolution: Any = None
) -> Volume:
    """Return a volume of an object of PyVista or VTK.

    Parameters
    ----------
    dataset : pyvista.ImageData, pyvista.RectilinearGrid, or VTK's own
        Values at points become cells around these; arrays of three components become three fields
        ``name_x``, ``name_y``, ``name_z``.
    fields : None, str, sequence of str or dict, optional
        Which arrays, as for `voluminous.open`; by default all at points, or all in cells, whichever
        the active scalars are, or most. ``{"density": "cell/rho"}`` is one in cells by another
        name.
    unit : str or unit, optional
        Of lengths, which VTK does not know.
    resolution : int or three int, optional
        Resample to equal cells: so many along the longest side, or along x, y and z. Needed for
        meshes and curved grids; cells whose centre lies outside of a mesh are NaN.

    Returns
    -------
    Volume
        With copies of the values: VTK keeps x fastest, volumes z.

    Raises
    ------
    InputError
        If it is something else: says what to do.

    Examples
    --------
    >>> mesh = pyvista.examples.load_uniform()  # doctest: +SKIP
    >>> volume = vm.Volume.from_pyvista(mesh, "Spatial Point Data")  # doctest: +SKIP
    """
    return dataset_of(dataset, resolution).volume(fields, unit).load()


def dataset_of(dataset: Any, resolution: Any = None, title: str = "") -> Dataset:
    """Return what an object holds; a mesh or a curved grid needs a resolution."""
    if not hasattr(dataset, "IsA"):
        raise InputError(f"expected an object of PyVista or VTK, got {type(dataset).__name__}")
    if resolution is not None:
        dataset = _resampled(dataset, resolution)
    is_image = dataset.IsA("vtkImageData")
    if not is_image and not dataset.IsA("vtkRectilinearGrid"):
        raise InputError(
            f"expected image data or a rectilinear grid, got {type(dataset).__name__}{ADVICE}"
        )
    points = _points(dataset)
    if min(points) < 1:
        raise InputError(f"the {type(dataset).__name__} is empty: it has {points} points")
    low = dataset.GetExtent()[::2]
    place: Even | Uneven
    if is_image:
        matrix = dataset.GetDirectionMatrix()
        direction = tuple(matrix.GetElement(i, j) for i in range(3) for j in range(3))
        place = Even(dataset.GetOrigin(), dataset.GetSpacing(), direction or UPRIGHT, low, points)
    else:
        lines = (_numpy(getattr(dataset, f"Get{axis}Coordinates")()) for axis in "XYZ")
        place = Uneven(tuple(lines))
    active = {
        at: data.GetScalars().GetName()
        for at, data in _attributes(dataset)
        if data.GetScalars() is not None and data.GetScalars().GetName()
    }
    return Dataset(points, place, list(arrays_of(dataset)), active, _meta(dataset, title))


def _reader(module: str, kind: str, path: Path) -> Any:
    reader = getattr(vtk(f"vtk{module}"), f"vtk{kind}")()
    reader.SetFileName(str(path))
    with heard():
        reader.UpdateInformation()
    return reader


def updated(module: str, kind: str, path: Path) -> Any:
    """Return what one of VTK's readers makes of a file."""
    reader = _reader(module, kind, path)
    with heard():
        reader.Update()
    return reader.GetOutput()


def lazy_dataset(module: str, kind: str, path: Path) -> Dataset:
    """Return what one of VTK's readers makes of a file; each array is read on first use."""
    key = vtk("vtkCommonExecutionModel").vtkStreamingDemandDrivenPipeline.WHOLE_EXTENT()
    extent = _reader(module, kind, path).GetOutputInformation(0).Get(key)
    if extent is None or any(a > b for a, b in zip(extent[::2], extent[1::2], strict=True)):
        raise FileFormatError("expected a piece with points in it, there is none")

    def read(part: Sequence[int], only: str = "/") -> Any:
        """Return a part of the grid, with all arrays, or with the one at a place."""
        reader = _reader(module, kind, path)
        with heard():
            for at in (POINT, CELL) if only != "/" else ():
                selection = getattr(reader, f"Get{at.title()}DataArraySelection")()
                selection.DisableAllArrays()
                if only.startswith(f"{at}/"):
                    selection.EnableArray(only.removeprefix(f"{at}/"))
            reader.UpdateExtent(part)
        return reader.GetOutput()

    def load(array: DataArray) -> np.ndarray:
        points = math.prod(b - a + 1 for a, b in zip(extent[::2], extent[1::2], strict=True))
        size = points * array.components * array.dtype.itemsize
        check_memory(size, f"reading {array.name!r}", "read a coarser copy; is the file damaged?")
        matches = arrays_of(read(extent, array.place))
        return next(a for a in matches if (a.at, a.name) == (array.at, array.name)).load()

    # Read one cell to get the types, components and units of the arrays.
    ends = zip(extent[::2], extent[1::2], strict=True)
    first = dataset_of(read([n for a, b in ends for n in (a, min(a + 1, b))]))
    arrays = [replace(array, load=functools.partial(load, array)) for array in first.arrays]
    place = dataset_of(read(extent, ""))
    return replace(place, arrays=arrays, active=first.active, meta=first.meta)


def _points(dataset: Any) -> tuple[int, ...]:
    extent = dataset.GetExtent()
    return tuple(high - low + 1 for low, high in zip(extent[::2], extent[1::2], strict=True))


def _attributes(dataset: Any) -> tuple[tuple[str, Any], ...]:
    return (POINT, dataset.GetPointData()), (CELL, dataset.GetCellData())


def arrays_of(dataset: Any) -> Iterator[DataArray]:
    """Give the arrays of numbers at points and in cells."""
    points, key = _points(dataset), vtk("vtkCommonCore").vtkDataArray.UNITS_LABEL()
    for at, data in _attributes(dataset):
        shape = cell_counts(points, at)[::-1]
        for number in range(data.GetNumberOfArrays()):
            array = data.GetArray(number)  # None for texts
            if array is not None and array.GetNumberOfComponents():
                count = array.GetNumberOfComponents()
                labels = tuple(array.GetComponentName(k) or "" for k in range(count))
                unit = array.GetInformation().Get(key) if array.HasInformation() else None
                yield DataArray(
                    array.GetName() or f"{at}_{number}",
                    at,
                    count,
                    _numpy(array).dtype,
                    functools.partial(_shaped, array, (*shape, count)),
                    labels if all(labels) else (),
                    known_unit((unit or "").strip()),
                )


def _shaped(array: Any, shape: tuple[int, ...]) -> np.ndarray:
    return _numpy(array).reshape(shape)


def _numpy(array: Any) -> np.ndarray:
    values: np.ndarray = vtk("util.numpy_support").vtk_to_numpy(array)
    return values


def _meta(dataset: Any, title: str) -> dict[str, Any]:
    """Return the remarks in a file; some codes write the time into the title."""
    data = dataset.GetFieldData()
    meta: dict[str, Any] = {}
    for number in range(data.GetNumberOfArrays()):
        array = data.GetAbstractArray(number)
        name = "time" if array.GetName() in _TIME else array.GetName()
        if array.IsA("vtkStringArray"):
            texts = map(array.GetValue, range(array.GetNumberOfValues()))
            meta[name] = "\n".join(texts)[:_LONGEST_TEXT]
        elif array.IsA("vtkDataArray") and 0 < array.GetNumberOfValues() <= _MOST_NUMBERS:
            numbers = _numpy(array).ravel().tolist()
            meta[name] = numbers[0] if len(numbers) == 1 else numbers
    matches = _TIME_IN_TITLE.search(title)
    if matches and "time" not in meta:
        with contextlib.suppress(ValueError):
            meta["time"] = float(matches[1])
    return meta if title in ("", _NO_TITLE) else {"title": title, **meta}


def _resampled(mesh: Any, resolution: Any) -> Any:
    parts = [part for part in leaves(mesh) if part.GetNumberOfCells()]
    solid = max((part.GetMaxSpatialDimension() for part in parts), default=0)
    parts = [part for part in parts if part.GetMaxSpatialDimension() == solid]
    if solid < 2:
        raise InputError("it holds points or lines, which fill no space")
    limits = np.array([part.GetBounds() for part in parts]).reshape(-1, 3, 2)
    low, high = limits[..., 0].min(axis=0), limits[..., 1].max(axis=0)
    asked, lengths = np.asarray(resolution), high - low
    if asked.shape not in ((), (3,)) or asked.dtype.kind not in "iu" or np.any(asked < 1):
        raise InputError(
            f"resolution must be a positive whole number, or three, got {resolution!r}"
        )
    if asked.shape == ():
        asked = np.maximum(np.rint(asked * lengths / lengths.max()), 1).astype(int)
    shape = np.where(lengths > 0, asked, 1)
    check_memory(16 * int(np.prod(shape, dtype=object)), "resampling", "choose fewer cells")
    # A flat mesh becomes one layer, as thick as its cells are wide.
    widths = lengths / shape
    steps = np.where(widths > 0, widths, widths.max())
    pyvista = require("pyvista", "vtk", "resampling")
    probe = vtk("vtkFiltersCore").vtkResampleWithDataSet()
    image = pyvista.ImageData(dimensions=shape, spacing=steps, origin=low + widths / 2)
    probe.SetInputData(image)
    probe.SetSourceData(pyvista.MultiBlock([_prepared(pyvista.wrap(part)) for part in parts]))
    probe.PassPartialArraysOn()
    with heard():
        probe.Update()
    result = pyvista.wrap(probe.GetOutput())
    inside = result.point_data.pop("vtkValidPointMask") != 0
    if not inside.any():
        raise InputError(
            "none of the cells' centres lies in the mesh: it is a surface, or resolution is too low"
        )
    for name, values in result.point_data.items():
        if name != "vtkGhostType":  # all others are fractions
            values[~inside] = np.nan
    result.point_data.pop("vtkGhostType", None)
    result.clear_cell_data()
    result.GetFieldData().ShallowCopy(parts[0].GetFieldData())
    return result


def leaves(mesh: Any) -> list[Any]:
    """Return the data sets in a composite one, or the only one there is."""
    if not mesh.IsA("vtkCompositeDataSet"):
        return [mesh]
    steps, matches = mesh.NewIterator(), []
    while not steps.IsDoneWithTraversal():
        matches.append(steps.GetCurrentDataObject())
        steps.GoToNextItem()
    return [part for part in matches if part.IsA("vtkDataSet")]


def _prepared(part: Any) -> Any:
    copy = part.copy(deep=False)
    for name in set(copy.cell_data.keys()) & set(copy.point_data.keys()):
        copy.cell_data[f"{name}_cell"] = copy.cell_data.pop(name)
    for data in (copy.point_data, copy.cell_data):
        for name, values in data.items():
            if values.dtype.kind in "iub" and name != "vtkGhostType":
                data[name] = values.astype(np.result_type(values.dtype, np.float32))
    return copy
