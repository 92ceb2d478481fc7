"""From an XML file of VTK to what is in it: one piece, several, or pieces in files of their own.

https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

from __future__ import annotations

import functools
import math
import re
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...memory import check_memory
from ..contract import FieldInfo, Reader
from ..guard import placed
from ..payload import checked_shape, inside
from .blocks import LISTED, Block, infos_of_blocks, listed, together, volume_of_blocks
from .dataset import ADVICE, CELL, OPTIONS, POINT, Array, Dataset, Even, infos, volume_of
from .library import check_arrays, children, heard, needed, numbers, tree, vtk
from .objects import arrays_of, dataset_of
from .write import write_image, write_rectilinear

if TYPE_CHECKING:
    from ...volume import Volume


IMAGE, RECTILINEAR, STRUCTURED = "ImageData", "RectilinearGrid", "StructuredGrid"


def dataset(path: Path) -> Dataset:
    """Return what is in a file."""
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


# All of these have elements <DataSet> that name files, at any depth.
_KINDS = (
    *("vtkMultiBlockDataSet", "vtkPartitionedDataSet", "vtkPartitionedDataSetCollection"),
    *("vtkOverlappingAMR", "vtkNonOverlappingAMR", "vtkHierarchicalBoxDataSet"),
)
_SERIES = "Collection"
_MOST_BLOCKS = 100_000


def names_others(root: Any) -> bool:
    """Return True for a file that only names others."""
    return root.GetAttribute("type") in (*_KINDS, _SERIES)


def datasets(path: Path) -> dict[Block, Dataset]:
    """Return the blocks on regular grids; a warning names those that are none."""
    found, others, why = {}, [], ""
    for block in _blocks(path):
        try:
            with placed(block.path.name):
                found[block] = dataset(block.path)
        except FileFormatError:
            raise
        except InputError as error:
            others.append(block)
            why = why or str(error)
    if not found and len(others) == 1:
        raise InputError(why)
    if not found:
        raise InputError(f"none of its blocks is a regular grid{ADVICE}:\n{listed(others)}")
    if others:
        warnings.warn(
            f"{path.name}: blocks that are no regular grids are left out:\n{listed(others)}",
            stacklevel=2,
        )
    return found


def _blocks(path: Path) -> list[Block]:
    root = tree(path)
    told = root.GetAttribute("type")
    told_of = list(_named(needed(root, told), ""))
    if not told_of:
        raise FileFormatError("it names no files of data")
    if len(told_of) > _MOST_BLOCKS:
        raise FileFormatError(f"it names {len(told_of)} files, more than {_MOST_BLOCKS}")
    if told == _SERIES:
        _check_times(path, [element for _, element in told_of])
    return [
        Block(name, path.parent / element.GetAttribute("file"))
        for name, element in told_of
        if inside(path.parent, element.GetAttribute("file"))
    ]


def _named(element: Any, above: str) -> Iterator[tuple[str, Any]]:
    """Give the elements of files, each with its name: those of the blocks it is in before it."""
    for child in children(element):
        own = child.GetAttribute("name") or ""
        name = f"{above}/{own}" if above and own else above or own
        if child.GetName() == "DataSet" and child.GetAttribute("file"):
            yield name, child
        else:
            yield from _named(child, name)


def _check_times(path: Path, sets: list[Any]) -> None:
    times = {element.GetAttribute("timestep") or "0": element for element in sets}
    if len(times) > 1:
        lines = [f"  {path.parent / e.GetAttribute('file')} (time {t})" for t, e in times.items()]
        more = [f"  … and {len(lines) - LISTED} more"] if len(lines) > LISTED else []
        raise InputError(
            f"it is a series of {len(times)} times; open one of them:\n"
            + "\n".join(lines[:LISTED] + more)
        )


# What may come before the first tag: a declaration, and comments.
_FIRST_TAG = re.compile(
    rb"(?:\xef\xbb\xbf)?\s*(?:<\?[^>]*>\s*|<!--(?:(?!-->).)*-->\s*)*<VTKFile\b([^>]*)", re.DOTALL
)
_TYPE = re.compile(rb"""\btype\s*=\s*["'](\w+)["']""")


class VTKXMLReader(Reader):
    """All that is XML of VTK, and has no reader of its own: refused with advice, if need be."""

    name = "vtk-xml"
    description = "an XML file of VTK: pieces, blocks, or a mesh"
    suffixes: tuple[str, ...] = (
        *(".pvti", ".pvtr", ".vts", ".vtm", ".vthb", ".pvd"),
        *(".vtu", ".pvtu", ".vtp", ".pvts", ".vtmb", ".vtpd", ".vtpc"),
    )
    packages = ("vtkmodules",)
    extra = "vtk"
    options = OPTIONS
    kind = ""

    def matches(self, path: Path, head: bytes) -> bool:
        tag = _FIRST_TAG.match(head)
        if tag is None:
            return False
        found = _TYPE.search(tag[1])
        return not self.kind or (found is not None and found[1].decode() == self.kind)

    def read(
        self,
        path: Path,
        fields: Any = None,
        *,
        unit: Any = None,
        resolution: Any = None,
        **options: Any,
    ) -> Volume:
        if resolution is not None:
            return volume_of(_resampled(path, resolution), fields, unit)
        if names_others(tree(path)):
            return volume_of_blocks(datasets(path), fields, unit)
        return volume_of(dataset(path), fields, unit)

    def info(self, path: Path, *, resolution: Any = None, **options: Any) -> tuple[FieldInfo, ...]:
        if resolution is not None:
            return infos(_resampled(path, resolution))
        if names_others(tree(path)):
            return infos_of_blocks(datasets(path))
        return infos(dataset(path))


def _resampled(path: Path, resolution: Any) -> Dataset:
    tree(path)  # VTK does not tell of a file that is cut short
    reader = vtk("vtkIOXML").vtkXMLGenericDataObjectReader()
    reader.SetFileName(str(path))
    with heard():
        reader.Update()
    return dataset_of(reader.GetOutput(), resolution)


class VTIReader(VTKXMLReader):
    """Image data."""

    name = "vti"
    description = "a file of VTK image data (.vti)"
    suffixes = (".vti",)
    kind = IMAGE
    writes = True

    def write(self, volume: Volume, path: Path) -> None:
        write_image(volume, path)


class VTRReader(VTKXMLReader):
    """Rectilinear grids."""

    name = "vtr"
    description = "a VTK rectilinear grid (.vtr)"
    suffixes = (".vtr",)
    kind = RECTILINEAR
    writes = True

    def write(self, volume: Volume, path: Path) -> None:
        write_rectilinear(volume, path)
