"""Access to the VTK library; messages in its output window become errors."""

from __future__ import annotations

import mmap
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ...errors import FileFormatError
from ...packages import require

# VTK does not detect truncated files: the last tag must lie in this many bytes at the end.
_TAIL = 1024
_LONGEST = 400
# VTK adds a prefix to messages and a dump of the request after them; users need neither.
_NOISE = re.compile(r"(?:ERROR|Warning|Generic Warning): In .*?, line \d+\s*|\w+ \(0x\w+\): ")
_HARMLESS = re.compile(
    r"Warning: In .*?\n.*?(?:No (?:spacing|origin) read|Not all meta data was read).*\n*"
)
_DUMP = re.compile(r"ERROR: In vtkExecutive.*?(?:\n\n\n\n|\Z)", re.DOTALL)


# A number as Fortran writes it where its exponent has three digits.
_FORTRAN = re.compile(rb"(?<![^\s>])[-+]?\d*\.\d*[-+]\d{3}(?![^\s<])")


def vtk(module: str) -> Any:
    """Return a module of VTK, such as ``"vtkIOXML"``."""
    return require(f"vtkmodules.{module}", "vtk", "reading and writing files of VTK")


@contextmanager
def heard(warnings: bool = True) -> Iterator[None]:
    """Raise VTK's messages as an error; with `warnings` False, only if they contain an error."""
    core = vtk("vtkCommonCore")
    window, log = core.vtkOutputWindow, core.vtkLogger
    before, verbosity = window.GetInstance(), log.GetCurrentVerbosityCutoff()
    silent = core.vtkStringOutputWindow()
    silent.SetDisplayModeToNever()
    window.SetInstance(silent)
    log.SetStderrVerbosity(log.VERBOSITY_OFF)
    try:
        yield
    finally:
        window.SetInstance(before)
        log.SetStderrVerbosity(verbosity)
    text = _HARMLESS.sub("", silent.GetOutput())
    if text.strip() and (warnings or "ERROR:" in text):
        plain = _NOISE.sub("", _DUMP.sub("", text) or text).splitlines()
        lines = dict.fromkeys(line.strip() for line in plain if line.strip())
        raise FileFormatError(f"VTK cannot read it: {'; '.join(lines)[:_LONGEST]}")


def check_numbers(content: mmap.mmap, hint: str = "") -> None:
    """Refuse text with what VTK takes for two numbers, so that all others move up."""
    end = content.find(b"<AppendedData")
    odd = _FORTRAN.search(content, 0, len(content) if end == -1 else end)
    if odd:
        raise FileFormatError(
            f"{odd[0].decode()} is no number{hint}; write exponents of three digits with an E"
        )


def tree(path: Path) -> Any:
    """Return the outermost element of an XML file of VTK."""
    with open(path, "rb") as file:
        file.seek(max(path.stat().st_size - _TAIL, 0))
        if b"</VTKFile" not in file.read():
            raise FileFormatError("it is cut short: expected </VTKFile> at its end")
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            check_numbers(content)
    parser = vtk("vtkIOXMLParser").vtkXMLDataParser()
    parser.SetFileName(str(path))
    with heard():
        parser.Parse()
    root = parser.GetRootElement()
    if root is None or root.GetName() != "VTKFile":
        raise FileFormatError("expected <VTKFile>, the outermost element is another")
    return root


def children(element: Any, name: str = "") -> list[Any]:
    """Return the direct children of an element, optionally only those called `name`."""
    inside = map(element.GetNestedElement, range(element.GetNumberOfNestedElements()))
    return [child for child in inside if name in ("", child.GetName())]


def check_arrays(piece: Any) -> None:
    """Reject arrays on which VTK crashes: too many components, or a negative offset."""
    for array in (a for section in children(piece) for a in children(section, "DataArray")):
        count, offset = (array.GetAttribute(k) or "1" for k in ("NumberOfComponents", "offset"))
        if not (count.strip().isdigit() and offset.strip().isdigit()) or int(count) > 4096:
            raise FileFormatError(
                f"array {array.GetAttribute('Name')!r} has {count:.20} components at {offset:.20}"
            )
