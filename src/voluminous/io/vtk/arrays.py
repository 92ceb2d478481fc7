"""The arrays that the XML of a file of VTK speaks of."""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import unescape

from ...errors import FileFormatError
from ..unit_texts import known_unit
from .attributes import one_of, value_type, whole
from .dataset import CELL, POINT
from .encoded import Encoded, Encoding, appended_start
from .markup import APPENDED, Element
from .pieces import Part, Piece

_SECTIONS = (("PointData", POINT), ("CellData", CELL))
_FORMATS = {name: name for name in ("ascii", "binary", "appended")}
_LONGEST_UNIT = 200
_MOST_LABELS = 64


def encoding(path: Path, root: Element) -> Encoding:
    """Return how a file writes values, as its outermost element says."""
    appended = root.child(APPENDED)
    start, raw = -1, False
    if appended is not None:
        raw = one_of(appended, "encoding", {"raw": True, "base64": False}, False)
        with open(path, "rb") as file:
            start = appended_start(file, appended.start)
    return Encoding(
        path,
        order=one_of(root, "byte_order", {"LittleEndian": "<", "BigEndian": ">"}, "<"),
        head=one_of(root, "header_type", {"UInt32": "u4", "UInt64": "u8"}, "u4"),
        compressor=root.attributes.get("compressor", ""),
        appended=start,
        raw=raw,
    )


def piece(coded: Encoding, element: Element) -> Piece:
    """Return a piece of the data."""
    extent = whole(element, "Extent", 6)
    parts = {}
    for tag, at in _SECTIONS:
        section = element.child(tag)
        for number, array in enumerate(section.all("DataArray") if section else ()):
            found = encoded(coded, array, f"{tag}_{number}")
            parts[at, found.name] = _part(coded, found, array)
    places = element.child("Coordinates") or element.child("Points")
    coordinates = [
        encoded(coded, array, "coordinates")
        for array in (places.all("DataArray") if places else ())
    ]
    points = tuple(high - low + 1 for low, high in zip(extent[::2], extent[1::2], strict=True))
    return Piece(extent[::2], points, parts, tuple(coordinates))


def encoded(coded: Encoding, element: Element, name: str) -> Encoded:
    """Return where and how an array is written; `name` if it has none."""
    name = element.attributes.get("Name") or name
    kind = one_of(element, "format", _FORMATS, "ascii")
    start, end = element.text
    if kind == "appended":
        if coded.appended < 0:
            raise FileFormatError(
                f"array {name!r} is appended, but there is no <{APPENDED}>: is the file cut short?"
            )
        start, end = coded.appended + whole(element, "offset", 1)[0], 0
        if start < coded.appended:
            raise FileFormatError(f"array {name!r}: its offset is negative")
    return Encoded(name, coded, kind, value_type(element), start, end)


def _part(coded: Encoding, found: Encoded, element: Element) -> Part:
    told = element.attributes
    components = whole(element, "NumberOfComponents", 1)[0] if "NumberOfComponents" in told else 1
    labels = tuple(told.get(f"ComponentName{k}", "") for k in range(min(components, _MOST_LABELS)))
    return Part(found, components, labels if all(labels) else (), _unit(coded, element))


def _unit(coded: Encoding, element: Element) -> str:
    """Return the unit that VTK's key for it tells, as astropy knows it."""
    for key in element.all("InformationKey"):
        start, end = key.text
        if key.attributes.get("name") == "UNITS_LABEL" and end - start < _LONGEST_UNIT:
            with open(coded.path, "rb") as file:
                file.seek(start)
                return known_unit(unescape(file.read(end - start).decode("utf-8", "replace")))
    return ""
