"""From an XML file of VTK to what is in it: one piece, several, or pieces in files of their own.

https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...memory import check_memory
from ..guard import placed
from ..payload import checked_shape, inside
from .axes import ADVICE, Even
from .dataset import CELL, POINT, Array, Dataset
from .library import check_arrays, children, heard, needed, numbers, tree, vtk
from .objects import arrays_of, dataset_of
from .pieces import together

IMAGE, RECTILINEAR, STRUCTURED = "ImageData", "RectilinearGrid", "StructuredGrid"


def dataset(path: Path) -> Dataset:
    """Return what is in a file.

    Raises
    ------
    FileFormatError
        If it is damaged.
    InputError
        If its data are on no rectilinear grid; says what to do.
    """
    root = tree(path)
    told = root.GetAttribute("type") or ""
    kind = told.removeprefix("P")
    if kind not in (IMAGE, RECTILINEAR, STRUCTURED):
        raise InputError(f"it holds {told[:100] or 'data of no type'}, not a regular grid{ADVICE}")
    element = needed(root, told)
    if told == kind:
        whole = together(_pieces(path, kind, element))
        return replace(whole, arrange=_told(element, whole.arrange))
    parts = []
    for child in children(element, "Piece"):
        source = inside(path.parent, child.GetAttribute("Source") or "")
        with placed(source.name):
            inner = tree(source)
            if inner.GetAttribute("type") != kind:
                raise FileFormatError(f"a piece of {path.name}: expected a VTK file with {kind}")
            parts += _pieces(source, kind, needed(inner, kind))
    whole = together(parts)
    meta: dict[str, Any] = {}
    for part in parts:
        meta |= part.meta
    return replace(whole, arrange=_told(element, whole.arrange), active=_active(element), meta=meta)


def _told(element: Any, arrange: Any) -> Any:
    """Return where image data are, as its element says: VTK passes over what is no number."""
    if not isinstance(arrange, Even):
        return arrange
    counts = {"Origin": 3, "Spacing": 3, "Direction": 9}
    given = {
        name.lower(): numbers(element, name, count, float)
        for name, count in counts.items()
        if element.GetAttribute(name)
    }
    return replace(arrange, **given)


def _active(element: Any) -> dict[str, str]:
    """Return the names of the active scalars, as the file says that names the pieces."""
    sections = [(at, children(element, f"P{tag}Data")) for at, tag in _SECTIONS]
    told = {at: found[0].GetAttribute("Scalars") for at, found in sections if found}
    return {at: name for at, name in told.items() if name}


_SECTIONS = ((POINT, "Point"), (CELL, "Cell"))


def _pieces(path: Path, kind: str, element: Any) -> list[Dataset]:
    parts = []
    for piece in children(element, "Piece"):
        extent = numbers(piece, "Extent", 6)
        check_arrays(piece)
        if all(low <= high for low, high in zip(extent[::2], extent[1::2], strict=True)):
            parts.append(_piece(path, kind, extent))
    return parts


def _piece(path: Path, kind: str, extent: tuple[int, ...]) -> Dataset:
    """Return what is in a part of a file, whose values are read when they are used."""
    low, high = extent[::2], extent[1::2]
    points = checked_shape(np.subtract(high, low) + 1, "the number of points")
    if kind == STRUCTURED:
        check_memory(24 * math.prod(points), "the points of the grid", "is the file damaged?")
    place = dataset_of(_read(path, kind, extent, ""))
    # The first cell alone tells all that is to be known of the arrays.
    first = [n for a, b in zip(low, high, strict=True) for n in (a, min(a + 1, b))]
    told = dataset_of(_read(path, kind, first))
    arrays = [replace(array, load=functools.partial(_load, path, kind, extent, array))
              for array in told.arrays]  # fmt: skip
    return replace(place, arrays=arrays, active=told.active, meta=told.meta)


def _load(path: Path, kind: str, extent: tuple[int, ...], array: Array) -> np.ndarray:
    values = array.components * array.dtype.itemsize
    size = math.prod(b - a + 1 for a, b in zip(extent[::2], extent[1::2], strict=True)) * values
    check_memory(size, f"reading {array.name!r}", "read a coarser copy; is the file damaged?")
    found = arrays_of(_read(path, kind, extent, array.place))
    return next(a for a in found if (a.at, a.name) == (array.at, array.name)).load()


def _read(path: Path, kind: str, extent: Any, only: str | None = None) -> Any:
    """Return VTK's object of a part of a file, with all arrays, or with the one at a place."""
    reader = getattr(vtk("vtkIOXML"), f"vtkXML{kind}Reader")()
    reader.SetFileName(str(path))
    with heard():
        reader.UpdateInformation()
        if only is not None:
            for at, tag in _SECTIONS:
                selection = getattr(reader, f"Get{tag}DataArraySelection")()
                selection.DisableAllArrays()
                if only.startswith(f"{at}/"):
                    selection.EnableArray(only.removeprefix(f"{at}/"))
        reader.UpdateExtent(extent)
    return reader.GetOutput()
