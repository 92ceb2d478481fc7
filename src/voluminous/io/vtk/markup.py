"""The XML of VTK's files: elements, and where in the file the text of each is.

Values are not read here: of an array of any size only its place is remembered. What comes after
``<AppendedData>`` need not be XML, and is not looked at.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat

from ...errors import FileFormatError

# More than any sound file has: a damaged one must not take time and memory.
_DEEPEST = 32
_MOST_ELEMENTS = 250_000
_LONGEST_TAG = 1 << 20
_PIECE = 1 << 18
APPENDED = "AppendedData"


@dataclass
class Element:
    """One element.

    Attributes
    ----------
    tag : str
        Its name.
    attributes : dict of str
        As in the file.
    children : list of Element
        The elements in it.
    text : tuple of two int
        First byte of the longest stretch of text directly in it, and the byte after the last.
        Values and ``InformationKey`` elements may come in any order.
    start : int
        Byte at which the element begins.
    """

    tag: str
    attributes: dict[str, str]
    start: int
    children: list[Element] = field(default_factory=list)
    text: tuple[int, int] = (0, 0)

    def child(self, tag: str) -> Element | None:
        """Return the first element of a name in this one."""
        return next(self.all(tag), None)

    def all(self, tag: str) -> Iterator[Element]:
        """Return the elements of a name in this one."""
        return (child for child in self.children if child.tag == tag)

    def needed(self, tag: str) -> Element:
        """Return the first element of a name in this one, which must be there."""
        found = self.child(tag)
        if found is None:
            raise FileFormatError(f"expected <{tag}> in <{self.tag}>, there is none")
        return found


class _DataBegin(Exception):
    """The values begin, which may be no XML."""


class _Builder:
    """Makes elements of what expat reports."""

    def __init__(self) -> None:
        self.open: list[Element] = []
        self.root: Element | None = None
        self.count = 0
        # Where the text began that is going on; None between elements.
        self._text: int | None = None
        self.parser = parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._characters
        parser.StartDoctypeDeclHandler = self._refuse

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._end_text()
        element = Element(tag, attributes, self.parser.CurrentByteIndex)
        self.count += 1
        if len(self.open) >= _DEEPEST or self.count > _MOST_ELEMENTS:
            raise FileFormatError(
                f"byte {element.start}: more than {_DEEPEST} elements in each other, or "
                f"{_MOST_ELEMENTS} in all; expected a file of VTK"
            )
        if self.open:
            self.open[-1].children.append(element)
        else:
            self.root = element
        self.open.append(element)
        if tag == APPENDED:
            raise _DataBegin
        self.parser.CharacterDataHandler = self._characters

    def _end(self, tag: str) -> None:
        self._end_text()
        self.open.pop()
        self.parser.CharacterDataHandler = self._characters

    def _characters(self, text: str) -> None:
        self._text = self.parser.CurrentByteIndex
        self.parser.CharacterDataHandler = None  # where it ends the next tag tells

    def _end_text(self) -> None:
        if self._text is not None and self.open:
            start, end = self.open[-1].text
            found = self._text, self.parser.CurrentByteIndex
            if found[1] - found[0] > end - start:
                self.open[-1].text = found
        self._text = None

    def _refuse(self, *declared: Any) -> None:
        raise FileFormatError(
            "it declares a document type (DTD), which no file of VTK does: entities in it could "
            "grow to any size"
        )


def elements(path: Path) -> Element:
    """Return the outermost element of a file, up to the values that are appended.

    Raises
    ------
    FileFormatError
        If it is no XML; says where.
    """
    builder = _Builder()
    fed = 0
    with open(path, "rb") as file:
        try:
            while piece := file.read(_PIECE):
                builder.parser.Parse(piece)
                fed += len(piece)
                _check_progress(builder.parser.CurrentByteIndex, fed)
            builder.parser.Parse(b"", True)
        except _DataBegin:
            pass
        except expat.ExpatError as error:
            raise FileFormatError(
                f"line {error.lineno}: expected XML, or the file is cut short ({error})"
            ) from error
    if builder.root is None:
        raise FileFormatError("expected XML with an element, there is none")
    return builder.root


def _check_progress(reached: int, fed: int) -> None:
    """Refuse a tag that goes on and on: expat would keep all of it."""
    if fed - reached > _LONGEST_TAG:
        raise FileFormatError(f"byte {reached}: a tag of more than {_LONGEST_TAG} bytes")
