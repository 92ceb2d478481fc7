"""Legacy files of VTK (.vtk), as text or binary: words after the title, not lines.

https://docs.vtk.org/en/latest/vtk_file_formats/vtk_legacy_file_format.html
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

from ...errors import FileFormatError
from .dataset import Dataset
from .library import heard, vtk
from .objects import dataset_of
from .volumes import DatasetReader

_MAGIC = b"# vtk DataFile Version"
_DIMENSIONS = re.compile(rb"\bDIMENSIONS\s+(\d+)\s+(\d+)\s+(\d+)\b", re.IGNORECASE)
_HEAD = 4096
# Without these only the first array of each sort is read.
_ALL = ("Scalars", "Vectors", "Normals", "Tensors", "ColorScalars", "TCoords", "Fields")


class VTKReader(DatasetReader):
    """Legacy files."""

    name = "vtk"
    description = "a legacy VTK file (.vtk)"
    suffixes = (".vtk",)
    packages = ("vtkmodules",)
    extra = "vtk"

    def matches(self, path: Path, head: bytes) -> bool:
        return head.startswith(_MAGIC)

    def dataset(self, path: Path, *, resolution: Any = None, **options: Any) -> Dataset:
        return _dataset(path, resolution)


def _dataset(path: Path, resolution: Any) -> Dataset:
    with open(path, "rb") as file:
        told = _DIMENSIONS.search(file.read(_HEAD))
    size = path.stat().st_size
    # VTK takes memory as announced, and ends the process where there is not that much.
    if told and math.prod(max(int(n) - 1, 1) for n in told.groups()) > 8 * size:
        raise FileFormatError(
            f"{told[0].decode()} are more than a file of {size} bytes holds; it is cut short"
        )
    reader = vtk("vtkIOLegacy").vtkGenericDataObjectReader()
    reader.SetFileName(str(path))
    for sort in _ALL:
        getattr(reader, f"ReadAll{sort}On")()
    with heard():
        reader.Update()
    found = reader.GetOutput()
    if found is None:
        raise FileFormatError("expected DATASET and its kind in line 4")
    return dataset_of(found, resolution, reader.GetHeader() or "")
