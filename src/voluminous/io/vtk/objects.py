"""Volumes of VTK's and PyVista's objects: image data, rectilinear grids."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...packages import require
from ..unit_texts import known_unit
from .axes import ADVICE, UPRIGHT, aligned_lines, cell_counts, even_arrangement, uneven_arrangement
from .dataset import CELL, POINT, Array, Dataset, told
from .meta import plain_value
from .volumes import volume_of

if TYPE_CHECKING:
    from ...volume import Volume


def from_pyvista(dataset: Any, fields: Any = None, *, unit: Any = None) -> Volume:
    """Return a volume of an object of PyVista or VTK.

    Parameters
    ----------
    dataset : pyvista.ImageData, pyvista.RectilinearGrid, or VTK's own
        Also a `StructuredGrid` whose points lie on planes of constant x, y and z. Values at points
        become cells around these; arrays of three components become three fields ``name_x``,
        ``name_y``, ``name_z``.
    fields : None, str, sequence of str or dict, optional
        Which arrays, as for `voluminous.open`; by default all at points, or all in cells, whichever
        the active scalars are, or most. ``{"density": "cell/rho"}`` is one in cells by another
        name.
    unit : str or unit, optional
        Of lengths, which VTK does not know.

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
    >>> volume = vm.from_pyvista(mesh, "Spatial Point Data")  # doctest: +SKIP
    """
    return volume_of(_dataset(dataset), fields, unit).load()


def _dataset(dataset: Any) -> Dataset:
    """Return what an object holds as for any file of VTK."""
    kinds: dict[str, Callable[[Any], Any]] = {
        "vtkImageData": _image,
        "vtkRectilinearGrid": _rectilinear,
        "vtkStructuredGrid": _structured,
    }
    is_a = getattr(dataset, "IsA", lambda name: False)
    kind = next((kind for kind in kinds if is_a(kind)), None)
    if kind is None:
        raise InputError(
            "expected image data or a rectilinear grid of PyVista or VTK, got "
            f"{type(dataset).__name__}{ADVICE if hasattr(dataset, 'IsA') else ''}"
        )
    points = _points(dataset)
    if min(points) < 1:
        raise InputError(f"the {type(dataset).__name__} is empty: it has {points} points")
    arrays = list(_arrays(dataset, points))
    active = {
        at: data.GetScalars().GetName()
        for at, data in _attributes(dataset)
        if data.GetScalars() is not None and data.GetScalars().GetName()
    }
    return Dataset(points, kinds[kind](dataset), arrays, active, told(_remarks(dataset)))


def _points(dataset: Any) -> tuple[int, ...]:
    """Return the number of points along x, y and z, which all kinds tell by their extent."""
    extent = dataset.GetExtent()
    return tuple(high - low + 1 for low, high in zip(extent[::2], extent[1::2], strict=True))


def _image(dataset: Any) -> Callable[[str, Any], Any]:
    low = dataset.GetExtent()[::2]
    matrix = dataset.GetDirectionMatrix() if hasattr(dataset, "GetDirectionMatrix") else None
    direction = UPRIGHT
    if matrix is not None:
        direction = tuple(matrix.GetElement(i, j) for i in range(3) for j in range(3))
    place = (dataset.GetOrigin(), dataset.GetSpacing(), direction, low, _points(dataset))
    return lambda at, unit: even_arrangement(*place, at, unit)


def _rectilinear(dataset: Any) -> Callable[[str, Any], Any]:
    lines = [_numpy(getattr(dataset, f"Get{axis}Coordinates")()) for axis in "XYZ"]
    return lambda at, unit: uneven_arrangement(lines, at, unit)


def _structured(dataset: Any) -> Callable[[str, Any], Any]:
    shape = (*_points(dataset)[::-1], 3)
    lines = aligned_lines(_numpy(dataset.GetPoints().GetData()).reshape(shape))
    return lambda at, unit: uneven_arrangement(lines, at, unit)


def _attributes(dataset: Any) -> Iterator[tuple[str, Any]]:
    yield POINT, dataset.GetPointData()
    yield CELL, dataset.GetCellData()


def _arrays(dataset: Any, points: tuple[int, ...]) -> Iterator[Array]:
    for at, data in _attributes(dataset):
        shape = cell_counts(points, at)[::-1]
        for number in range(data.GetNumberOfArrays()):
            array = data.GetArray(number)  # None for texts
            if array is not None and array.GetNumberOfComponents():
                yield _array(array, array.GetName() or f"{at}_{number}", at, shape)


def _array(array: Any, name: str, at: str, shape: tuple[int, ...]) -> Array:
    components = array.GetNumberOfComponents()
    labels = tuple(array.GetComponentName(k) or "" for k in range(components))

    def load() -> np.ndarray:
        return _numpy(array).reshape(*shape, components)

    key = _units_key()
    unit = array.GetInformation().Get(key) if array.HasInformation() and key is not None else None
    dtype = _numpy(array).dtype
    return Array(
        name, at, components, dtype, load, labels if all(labels) else (), known_unit(unit or "")
    )


def _units_key() -> Any:
    return require("vtkmodules.vtkCommonCore", "vtk", "from_pyvista").vtkDataArray.UNITS_LABEL()


def _numpy(array: Any) -> np.ndarray:
    """Return the values of a VTK array, which are not copied."""
    support = require("vtkmodules.util.numpy_support", "vtk", "from_pyvista")
    values: np.ndarray = support.vtk_to_numpy(array)
    return values


def _remarks(dataset: Any) -> dict[str, Any]:
    """Return the numbers that field data tell."""
    data, found = dataset.GetFieldData(), {}
    for number in range(data.GetNumberOfArrays()):
        array = data.GetArray(number)
        value = plain_value(_numpy(array)) if array is not None else None
        if value is not None:
            found[array.GetName()] = value
    return found
