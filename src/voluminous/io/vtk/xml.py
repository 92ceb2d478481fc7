"""Readers of VTK XML files: image data (.vti), rectilinear grids (.vtr), their pieces and blocks.

https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import FileFormatError, InputError
from ..contract import FieldInfo, Reader
from ..guard import placed
from ..payload import inside
from .blocks import Blocks, alike, joined, listed, patches
from .dataset import ADVICE, OPTIONS, Dataset
from .library import check_arrays, children, tree
from .objects import dataset_of, lazy_dataset, updated
from .write import write_image, write_rectilinear

if TYPE_CHECKING:
    from ...volume import Volume

# An XML declaration and comments may precede the first tag.
_FIRST_TAG = re.compile(
    rb"(?:\xef\xbb\xbf)?\s*(?:<\?[^>]*>\s*|<!--(?:(?!-->).)*-->\s*)*<VTKFile\b([^>]*)", re.DOTALL
)
_TYPE = re.compile(rb"""\btype\s*=\s*["'](\w+)["']""")
_GRIDS = ("ImageData", "RectilinearGrid")
# Each of these types contains <DataSet> elements, at any depth, that name files.
_SERIES = "Collection"
_BLOCKS = (
    *("vtkMultiBlockDataSet", "vtkPartitionedDataSet", "vtkPartitionedDataSetCollection"),
    *("vtkOverlappingAMR", "vtkNonOverlappingAMR", "vtkHierarchicalBoxDataSet", _SERIES),
)


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
        result = _TYPE.search(tag[1])
        return not self.kind or (result is not None and result[1].decode() == self.kind)

    def read(
        self,
        path: Path,
        fields: Any = None,
        *,
        unit: Any = None,
        resolution: Any = None,
        **options: Any,
    ) -> Volume:
        result = _opened(path, resolution)
        if isinstance(result, Dataset):
            return result.volume(fields, unit)
        return patches(result, fields, unit)

    def info(self, path: Path, *, resolution: Any = None, **options: Any) -> tuple[FieldInfo, ...]:
        result = _opened(path, resolution)
        # Several patches: report the shapes of the first one.
        return (result if isinstance(result, Dataset) else alike(result)[0]).infos()


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


def _opened(path: Path, resolution: Any) -> Dataset | Blocks:
    root = tree(path)  # VTK does not notice that a file is cut short
    kind = root.GetAttribute("type") or ""
    if resolution is not None:
        return dataset_of(updated("IOXML", "XMLGenericDataObjectReader", path), resolution)
    if kind not in _BLOCKS:
        return _dataset(path, root)
    blocks = _blocks(path, kind, list(_named(root, "")))
    return joined(blocks) or blocks


def _dataset(path: Path, root: Any) -> Dataset:
    kind = root.GetAttribute("type") or "data of no type"
    if kind.removeprefix("P") not in _GRIDS:
        raise InputError(f"it holds {kind[:100]}, not a regular grid{ADVICE}")
    for piece in (p for element in children(root, kind) for p in children(element, "Piece")):
        check_arrays(piece)
        if kind.startswith("P"):
            source = inside(path.parent, piece.GetAttribute("Source") or "")
            with placed(source.name):
                for part in (p for e in children(tree(source)) for p in children(e, "Piece")):
                    check_arrays(part)
    return lazy_dataset("IOXML", f"XML{kind}Reader", path)


def _blocks(path: Path, kind: str, elements: list[tuple[str, Any]]) -> Blocks:
    """Return the blocks on regular grids; a warning names those that are none."""
    times = {e.GetAttribute("timestep") or "0": e.GetAttribute("file") for _, e in elements}
    if kind == _SERIES and len(times) > 1:
        steps = [f"{path.parent / file} (time {t})" for t, file in times.items()]
        raise InputError(
            f"it is a series of {len(times)} times; open one of them:\n{listed(steps)}"
        )
    result: Blocks = {}
    others, why = [], ""
    for name, element in elements:
        inside(path.parent, element.GetAttribute("file"))
        file = path.parent / element.GetAttribute("file")
        label = f"{name} ({file})" if name else str(file)
        try:
            with placed(file.name):
                result[label] = _dataset(file, tree(file))
        except FileFormatError:
            raise
        except InputError as error:
            others.append(label)
            why = str(error)
    if not elements:
        raise FileFormatError("it names no files of data")
    if not result and len(others) == 1:
        raise InputError(why)
    if not result:
        raise InputError(f"none of its blocks is a regular grid{ADVICE}:\n{listed(others)}")
    if others:
        warnings.warn(
            f"{path.name}: blocks that are no regular grids are left out:\n{listed(others)}",
            stacklevel=2,
        )
    return result


def _named(element: Any, above: str) -> Iterator[tuple[str, Any]]:
    """Yield (name, element) for each file; the names of the enclosing blocks precede its name."""
    for child in children(element):
        name = "/".join(filter(None, (above, child.GetAttribute("name"))))
        if child.GetName() == "DataSet" and child.GetAttribute("file"):
            yield name, child
        else:
            yield from _named(child, name)
