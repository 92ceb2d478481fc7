"""Tables of labels: numbers with names and colours, of 3D Slicer, FreeSurfer, FSL and ITK-SNAP."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ...errors import FileFormatError
from ...files import check_readable

SUFFIXES = (".ctbl", ".lut", ".label", ".txt")
_LARGEST = 1 << 24
# ITK-SNAP: number, red, green, blue, opacity, visible, mesh, "name".
_SNAP = re.compile(r'(\d+)\s+(\d+)\s+(\d+)\s+(\d+)\s+([\d.]+)\s+([01])\s+[01]\s+"(.*)"')
# 3D Slicer and FreeSurfer: number, name, red, green, blue and perhaps alpha, from 0 to 255.
_SLICER = re.compile(r"(\d+)\s+(.+?)\s+(\d+)\s+(\d+)\s+(\d+)(?:\s+(\d+))?")
# FSLeyes: number, red, green and blue from 0 to 1, name.
_FSL = re.compile(r"(\d+)\s+([01]?\.\d+|[01])\s+([01]?\.\d+|[01])\s+([01]?\.\d+|[01])(?:\s+(.*))?")

Label = dict[str, Any]


def read_label_table(path: Path) -> list[Label]:
    """Return ``{"number", "name", "color", "visible", "opacity"}`` of each label but 0.

    Raises
    ------
    FileFormatError
        If a line is none of a table.
    """
    check_readable(path)
    if path.stat().st_size > _LARGEST:
        raise FileFormatError(f"{path} is too long for a table of labels")
    rows = []
    for number, line in enumerate(path.read_text("utf-8-sig", "replace").splitlines(), start=1):
        text = line.partition("#")[0].strip()
        try:  # a name may have a "#"
            row = _row(line.strip()) or _row(text)
        except (ValueError, OverflowError):
            row = None
        if text and row is None:
            raise FileFormatError(
                f"{path}, line {number}: expected a label's number, name and colour, such as "
                f"'1 liver 221 130 101 255', got {line[:80]!r}"
            )
        rows += [row] if text and row is not None else []
    if not rows:
        raise FileFormatError(f"{path} is a table of labels without any")
    # FreeSurfer's alpha counts the other way round, and is 0 throughout.
    seen = any(row["opacity"] for row in rows)
    return [{**row, "opacity": row["opacity"] if seen else 1.0} for row in rows if row["number"]]


def _row(text: str) -> Label | None:
    if found := _SNAP.fullmatch(text):
        number, *rgb, alpha, visible, name = found.groups()
        return _label(number, name, [int(c) / 255 for c in rgb], float(alpha), visible == "1")
    if found := _SLICER.fullmatch(text):
        number, name, *rgb, alpha = found.groups()
        return _label(number, name, [int(c) / 255 for c in rgb], int(alpha or 255) / 255)
    if found := _FSL.fullmatch(text):
        number, *rgb, name = found.groups()
        return _label(number, name or number, [float(c) for c in rgb])
    return None


def _label(
    number: str, name: str, color: list[float], opacity: float = 1.0, visible: bool = True
) -> Label:
    return {
        "number": int(number),
        "name": name.replace("_", " ").strip(),
        "color": [round(min(max(0.0, c), 1.0), 4) for c in color],
        "opacity": min(opacity, 1.0),
        "visible": visible,
    }


def segments(header: Mapping[str, Any]) -> Iterator[tuple[int, Label]]:
    """Yield layer and label of the segments in the header of a ``.seg.nrrd`` file."""
    number = 0
    while f"Segment{number}_ID" in header or f"Segment{number}_Name" in header:
        of = f"Segment{number}_"
        color = str(header.get(f"{of}Color", "")).split()
        label = str(header.get(f"{of}LabelValue", number + 1))
        name = str(header.get(f"{of}Name", header.get(f"{of}ID", label)))
        try:
            rgb = [float(c) for c in color] if len(color) == 3 else []
            made = _label(label, name, rgb)
            layer = int(header.get(f"{of}Layer", 0))
        except ValueError:
            raise FileFormatError(
                f"segment {number} of its header: expected three numbers as Color and whole ones "
                f"as LabelValue and Layer, got {' '.join(color)!r}, {label!r}"
            ) from None
        yield layer, {key: value for key, value in made.items() if key != "color" or rgb}
        number += 1
