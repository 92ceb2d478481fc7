"""Readers of VTK XML files: image data (.vti), rectilinear grids (.vtr), their pieces and blocks.

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
from .blocks import Block, alike, joined, listed, patches, together
from .dataset import ADVICE, CELL, OPTIONS, POINT, DataArray, Dataset, Even
from .library import check_arrays, children, heard, needed, numbers, tree, vtk
from .objects import arrays_of, dataset_of
from .write import write_image, write_rectilinear

if TYPE_CHECKING:
    from ...volume import Volume

# An XML declaration and comments may precede the first tag.
_FIRST_TAG = re.compile(
    rb"(?:\xef\xbb\xbf)?\s*(?:<\?[^>]*>\s*|<!--(?:(?!-->).)*-->\s*)*<VTKFile\b([^>]*)", re.DOTALL
)
_TYPE = re.compile(rb"""\btype\s*=\s*["'](\w+)["']""")
_GRIDS = ("ImageData", "RectilinearGrid", "StructuredGrid")
_SECTIONS = ((POINT, "Point"), (CELL, "Cell"))
_PLACE = {"Origin": 3, "Spacing": 3, "Direction": 9}
# Each of these types contains <DataSet> elements, at any depth, that name files.
_SERIES = "Collection"
_BLOCKS = (
    *("vtkMultiBlockDataSet", "vtkPartitionedDataSet", "vtkPartitionedDataSetCollection"),
    *("vtkOverlappingAMR", "vtkNonOverlappingAMR", "vtkHierarchicalBoxDataSet", _SERIES),
)
_MOST_BLOCKS = 100_000


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
        found = _opened(path, resolution)
        if isinstance(found, Dataset):
            return found.volume(fields, unit)
        return patches(found, fields, unit)

    def info(self, path: Path, *, resolution: Any = None, **options: Any) -> tuple[FieldInfo, ...]:
        found = _opened(path, resolution)
        # Several patches: report the shapes of the first one.
        return (found if isinstance(found, Dataset) else alike(found)[0]).infos()


class VTIReader(VTKXMLReader):
    """Image data."""

    name = "vti"
    description = "a file of VTK image data (.vti)"
    suffixes = (".vti",)
    kind = "ImageData"
    writes = True

    def write(self, volume: Volume, path: Path) -> None:
        write_image(volume, path)


class VTRReader(VTKXMLReader):
    """Rectilinear grids."""

    name = "vtr"
    description = "a VTK rectilinear grid (.vtr)"
    suffixes = (".vtr",)
    kind = "RectilinearGrid"
    writes = True

    def write(self, volume: Volume, path: Path) -> None:
        write_rectilinear(volume, path)


def _opened(path: Path, resolution: Any) -> Dataset | dict[Block, Dataset]:
    """Return what is in a file, as one, or as blocks that fill no box together."""
    root = tree(path)  # VTK does not notice that a file is cut short
    if resolution is not None:
        reader = vtk("vtkIOXML").vtkXMLGenericDataObjectReader()
        reader.SetFileName(str(path))
        with heard():
            reader.Update()
        return dataset_of(reader.GetOutput(), resolution)
    if root.GetAttribute("type") not in _BLOCKS:
        return _dataset(path)
    blocks = _blocks(path, root)
    return joined(blocks) or blocks


def _dataset(path: Path) -> Dataset:
    """Return what is in a file of one grid, or of its pieces."""
    root = tree(path)
    parallel = root.GetAttribute("type") or ""
    kind = parallel.removeprefix("P")
    if kind not in _GRIDS:
        raise InputError(
            f"it holds {parallel[:100] or 'data of no type'}, not a regular grid{ADVICE}"
        )
    element = needed(root, parallel)
    if parallel == kind:
        whole = together(_pieces(path, kind, element))
    else:
        parts: list[Dataset] = []
        for child in children(element, "Piece"):
            source = inside(path.parent, child.GetAttribute("Source") or "")
            with placed(source.name):
                inner = tree(source)
                if inner.GetAttribute("type") != kind:
                    raise FileFormatError(
                        f"a piece of {path.name}: expected a VTK file with {kind}"
                    )
                parts += _pieces(source, kind, needed(inner, kind))
        sections = [(at, children(element, f"P{tag}Data")) for at, tag in _SECTIONS]
        active = {at: found[0].GetAttribute("Scalars") for at, found in sections if found}
        meta = {name: value for part in parts for name, value in part.meta.items()}
        shown = {at: name for at, name in active.items() if name}
        whole = replace(together(parts), active=shown, meta=meta)
    if isinstance(whole.arrange, Even):  # as the element says: VTK passes over what is no number
        given = {
            name.lower(): numbers(element, name, count, float)
            for name, count in _PLACE.items()
            if element.GetAttribute(name)
        }
        whole = replace(whole, arrange=replace(whole.arrange, **given))
    return whole


def _pieces(path: Path, kind: str, element: Any) -> list[Dataset]:
    """Return the pieces in a file; their values are read on first use."""
    parts = []
    for piece in children(element, "Piece"):
        extent = numbers(piece, "Extent", 6)
        check_arrays(piece)
        low, high = extent[::2], extent[1::2]
        if any(a > b for a, b in zip(low, high, strict=True)):
            continue
        points = checked_shape(np.subtract(high, low) + 1, "the number of points")
        if kind == "StructuredGrid":
            size = 24 * math.prod(points)
            check_memory(size, "the points of the grid", "is the file damaged?")
        place = dataset_of(_read(path, kind, extent, ""))
        # Read one cell to get the types, components and units of the arrays.
        corner = [n for a, b in zip(low, high, strict=True) for n in (a, min(a + 1, b))]
        first = dataset_of(_read(path, kind, corner))
        arrays = [
            replace(array, load=functools.partial(_load, path, kind, extent, array))
            for array in first.arrays
        ]
        parts.append(replace(place, arrays=arrays, active=first.active, meta=first.meta))
    return parts


def _load(path: Path, kind: str, extent: tuple[int, ...], array: DataArray) -> np.ndarray:
    points = math.prod(b - a + 1 for a, b in zip(extent[::2], extent[1::2], strict=True))
    size = points * array.components * array.dtype.itemsize
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


def _blocks(path: Path, root: Any) -> dict[Block, Dataset]:
    """Return the blocks on regular grids; a warning names those that are none."""
    kind = root.GetAttribute("type")
    files = list(_named(needed(root, kind), ""))
    if not 0 < len(files) <= _MOST_BLOCKS:
        raise FileFormatError(
            f"it names {len(files)} files, expected 1 to {_MOST_BLOCKS}"
            if files
            else "it names no files of data"
        )
    times = {element.GetAttribute("timestep") or "0": element for _, element in files}
    if kind == _SERIES and len(times) > 1:
        steps = [f"{path.parent / e.GetAttribute('file')} (time {t})" for t, e in times.items()]
        raise InputError(
            f"it is a series of {len(times)} times; open one of them:\n{listed(steps)}"
        )
    found, others, why = {}, [], ""
    for name, element in files:
        inside(path.parent, element.GetAttribute("file"))
        block = Block(name, path.parent / element.GetAttribute("file"))
        try:
            with placed(block.path.name):
                found[block] = _dataset(block.path)
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


def _named(element: Any, above: str) -> Iterator[tuple[str, Any]]:
    """Yield (name, element) for each file; the names of the enclosing blocks precede its name."""
    for child in children(element):
        name = "/".join(filter(None, (above, child.GetAttribute("name"))))
        if child.GetName() == "DataSet" and child.GetAttribute("file"):
            yield name, child
        else:
            yield from _named(child, name)
