"""XML files of VTK: image data (.vti), rectilinear grids (.vtr), and pieces of them (.vtm …)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..contract import FieldInfo, Reader
from .document import IMAGE, RECTILINEAR, document
from .markup import elements
from .multiblock import documents, names_others
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
    description = "a VTK file in several pieces (.pvti, .pvtr, .vtm)"
    suffixes: tuple[str, ...] = (".pvti", ".pvtr", ".vts", ".vtm", ".vthb", ".pvd")
    options = OPTIONS
    kind = ""

    def matches(self, path: Path, head: bytes) -> bool:
        """Return True for XML of VTK with data of this kind."""
        tag = _FIRST_TAG.match(head)
        if tag is None:
            return False
        found = _TYPE.search(tag[1])
        return not self.kind or (found is not None and found[1].decode() == self.kind)

    def read(self, path: Path, fields: Any = None, **options: Any) -> Volume:
        """Return the volume; values are read when they are used."""
        if names_others(elements(path)):
            return volume_of_blocks(documents(path), fields, **options)
        return volume_of(document(path).dataset(), fields, **options)

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        """Return the arrays, component by component."""
        if names_others(elements(path)):
            return infos_of_blocks(documents(path))
        return infos(document(path).dataset())


class VTIReader(VTKXMLReader):
    """Image data."""

    name = "vti"
    description = "a file of VTK image data (.vti)"
    suffixes = (".vti",)
    kind = IMAGE
    writes = True

    def write(self, volume: Volume, path: Path) -> None:
        """Write a volume of equal cells."""
        write_image(volume, path)


class VTRReader(VTKXMLReader):
    """Rectilinear grids."""

    name = "vtr"
    description = "a VTK rectilinear grid (.vtr)"
    suffixes = (".vtr",)
    kind = RECTILINEAR
    writes = True

    def write(self, volume: Volume, path: Path) -> None:
        """Write a volume whose cells lie between planes."""
        write_rectilinear(volume, path)
