"""XML files of VTK: image data (.vti), rectilinear grids (.vtr), and pieces of them (.vtm …)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..contract import FieldInfo, Reader
from .dataset import Dataset
from .files import IMAGE, RECTILINEAR, dataset
from .library import heard, tree, vtk
from .multiblock import datasets, names_others
from .objects import dataset_of
from .patches import infos_of_blocks, volume_of_blocks
from .volumes import OPTIONS, infos, volume_of
from .write import write_image, write_rectilinear

if TYPE_CHECKING:
    from ...volume import Volume

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
