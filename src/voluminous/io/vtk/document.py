"""From the XML of a file of VTK to what is in it.

https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import FileFormatError, InputError
from ..guard import placed
from ..payload import inside
from ..scanners.placement import Arrangement
from .arrays import encoding, piece
from .attributes import real
from .axes import ADVICE, UPRIGHT, aligned_lines, even_arrangement, uneven_arrangement
from .dataset import CELL, POINT, Dataset
from .markup import Element, elements
from .meta import field_data
from .pieces import Piece, Whole

IMAGE, RECTILINEAR, STRUCTURED = "ImageData", "RectilinearGrid", "StructuredGrid"


@dataclass(frozen=True)
class Document:
    """A file's element for its data, and the pieces in it.

    Attributes
    ----------
    kind : str
        `IMAGE`, `RECTILINEAR` or `STRUCTURED`.
    element : Element
        Has the attributes of the whole.
    pieces : list of Piece
        Of this file, or of all files that it names.
    active : dict of str
        Names of the active scalars, at points and in cells.
    meta : dict
        What else it tells.
    """

    kind: str
    element: Element
    pieces: list[Piece]
    active: dict[str, str]
    meta: dict[str, Any]

    def dataset(self) -> Dataset:
        """Return what is in it as for any file of VTK."""
        whole = Whole(self.pieces)
        arrange = functools.partial(_arrangement, self.kind, self.element, whole)
        return Dataset(whole.points, arrange, whole.arrays(), self.active, self.meta)


def document(path: Path) -> Document:
    """Return what is in a file.

    Raises
    ------
    FileFormatError
        If it is damaged.
    InputError
        If its data are on no rectilinear grid; says what to do.
    """
    root = elements(path)
    if root.tag != "VTKFile":
        raise FileFormatError(f"expected <VTKFile>, got <{root.tag:.100}>")
    told = root.attributes.get("type", "")
    kind = told.removeprefix("P")
    if kind not in (IMAGE, RECTILINEAR, STRUCTURED):
        raise InputError(f"it holds {told[:100] or 'data of no type'}, not a regular grid{ADVICE}")
    element = root.needed(told)
    if told == kind:
        return _serial(path, kind, root, element)
    return _parallel(path, kind, element)


def _serial(path: Path, kind: str, root: Element, element: Element) -> Document:
    """Return what is in a file of its own."""
    coded = encoding(path, root)
    pieces = [piece(coded, child) for child in element.all("Piece")]
    for found, child in zip(pieces, element.all("Piece"), strict=True):
        _check_coordinates(kind, found, child)
    meta = field_data(coded, element.child("FieldData"))
    first = element.child("Piece")
    return Document(kind, element, pieces, _active(first, ""), meta)


def _parallel(path: Path, kind: str, element: Element) -> Document:
    """Return what is in the files that one names."""
    pieces: list[Piece] = []
    meta: dict[str, Any] = {}
    for child in element.all("Piece"):
        source = inside(path.parent, child.attributes.get("Source", ""))
        with placed(source.name):
            root = elements(source)
            if (root.tag, root.attributes.get("type")) != ("VTKFile", kind):
                raise FileFormatError(f"a piece of {path.name}: expected a VTK file with {kind}")
            found = _serial(source, kind, root, root.needed(kind))
        pieces += found.pieces
        meta |= found.meta
    return Document(kind, element, pieces, _active(element, "P"), meta)


def _active(element: Element | None, prefix: str) -> dict[str, str]:
    """Return the names of the active scalars."""
    active = {}
    for at, tag in ((POINT, "PointData"), (CELL, "CellData")):
        section = element.child(prefix + tag) if element is not None else None
        if section is not None and section.attributes.get("Scalars"):
            active[at] = section.attributes["Scalars"]
    return active


def _check_coordinates(kind: str, found: Piece, element: Element) -> None:
    """Check that a piece tells where its points are, if it has to."""
    expected = {IMAGE: 0, RECTILINEAR: 3, STRUCTURED: 1}[kind]
    if kind != IMAGE and len(found.coordinates) != expected:
        raise FileFormatError(
            f"byte {element.start}: expected {expected} arrays of coordinates, got "
            f"{len(found.coordinates)}"
        )


def _arrangement(kind: str, element: Element, whole: Whole, at: str, unit: Any) -> Arrangement:
    """Return where the cells are."""
    if kind == RECTILINEAR:
        return uneven_arrangement(whole.lines(), at, unit)
    if kind == STRUCTURED:
        return uneven_arrangement(aligned_lines(whole.mesh()), at, unit)
    origin = real(element, "Origin", (0.0, 0.0, 0.0))
    spacing = real(element, "Spacing", (1.0, 1.0, 1.0))
    direction = real(element, "Direction", UPRIGHT)
    return even_arrangement(origin, spacing, direction, whole.low, whole.points, at, unit)
