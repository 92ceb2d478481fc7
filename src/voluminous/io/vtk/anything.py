"""Legacy files of VTK (.vtk), and what else PyVista reads: images, meshes of some fifty formats.

https://docs.vtk.org/en/latest/vtk_file_formats/vtk_legacy_file_format.html
"""

from __future__ import annotations

import math
import mmap
import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from ...errors import FileFormatError, InputError
from ...packages import require
from .dataset import OPTIONS, Dataset, DatasetReader
from .library import check_numbers, heard, vtk
from .objects import dataset_of, leaves

_MAGIC = b"# vtk DataFile Version"
_DIMENSIONS = re.compile(rb"\bDIMENSIONS\s+(\d+)\s+(\d+)\s+(\d+)\b", re.IGNORECASE)
# Without these only the first array of each sort is read.
_ALL = ("Scalars", "Vectors", "Normals", "Tensors", "ColorScalars", "TCoords", "Fields")
# How files announce where arrays are, and their names: as attributes, or in a FIELD.
_ANNOUNCED = re.compile(
    rb"\n[ \t]*(?![\d.+-])(?:(POINT|CELL|ROW)_DATA[ \t]|(?:SCALARS|VECTORS|NORMALS|TENSORS6?"
    rb"|COLOR_SCALARS|TEXTURE_COORDINATES|\w+_IDS)[ \t]+(\S+)|(\S+)[ \t]+\d+[ \t]+\d+[ \t]+"
    rb"(?:bit|float|double|string|vtk\w+|(?:unsigned_)?(?:char|short|int|long))[ \t]*\r?\n)",
    re.IGNORECASE,
)
# How Tecplot's text begins: other programs call anything .dat.
_TECPLOT = (b"TITLE", b"VARIABLES", b"ZONE", b"FILETYPE")


class VTKReader(DatasetReader):
    """Legacy files, as text or binary."""

    name = "vtk"
    description = "a legacy VTK file (.vtk)"
    suffixes = (".vtk",)
    packages = ("vtkmodules",)
    extra = "vtk"

    def matches(self, path: Path, head: bytes) -> bool:
        return head.startswith(_MAGIC)

    def dataset(self, path: Path, *, resolution: Any = None, **options: Any) -> Dataset:
        with open(path, "rb") as file:
            result = _DIMENSIONS.search(file.read(4096))
        size = path.stat().st_size
        # VTK takes memory as announced, and ends the process where there is not that much.
        if result and math.prod(max(int(n) - 1, 1) for n in result.groups()) > 8 * size:
            raise FileFormatError(
                f"{result[0].decode()} are more than a file of {size} bytes holds; it is cut short"
            )
        reader = vtk("vtkIOLegacy").vtkGenericDataObjectReader()
        reader.SetFileName(str(path))
        for sort in _ALL:
            getattr(reader, f"ReadAll{sort}On")()
        try:
            with heard():
                reader.Update()
        finally:  # its names tell more than what VTK says
            _check_arrays(path, reader.GetOutput())
        if reader.GetOutput() is None:
            raise FileFormatError("expected DATASET and its kind in line 4")
        return dataset_of(reader.GetOutput(), resolution, reader.GetHeader() or "")


def _check_arrays(path: Path, output: Any) -> None:
    """Refuse a file with arrays that VTK did not read: over some it stops without a word."""
    kinds = {b"": "Field", b"POINT": "Point", b"CELL": "Cell", b"ROW": "Row"}
    getters = {kind: f"Get{name}Data" for kind, name in kinds.items()}
    has = {k: getattr(output, get)() for k, get in getters.items() if hasattr(output, get)}
    given = {
        (kind, data.GetAbstractArray(k).GetName())
        for kind, data in has.items()
        for k in range(data.GetNumberOfArrays())
    }
    kind, lost = b"", []
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        for line in _ANNOUNCED.finditer(content):
            kind = (line[1] or kind).upper()
            name = unquote((line[2] or line[3] or b"").decode("utf-8", "replace"))
            lost += [name] if name and (kind, name) not in given else []
        if lost:
            listed = ", ".join(lost)[:200]
            check_numbers(content, f" (VTK did not read its arrays {listed})")
            raise FileFormatError(f"VTK did not read its arrays {listed}")


class PyVistaReader(DatasetReader):
    """Simulations on meshes and rarer images, recognised by their suffixes."""

    name = "pyvista"
    description = "a file that PyVista reads (images, meshes of simulations)"
    # Of all that PyVista reads: no pictures, no surfaces, and nothing that has a reader here.
    suffixes = (
        *(".slc", ".cube", ".dem", ".segy", ".sgy", ".grdecl"),
        *(".cas", ".case", ".cgns", ".e", ".ex2", ".exii", ".exo", ".foam", ".inp", ".nek5000"),
        *(".neu", ".p3d", ".pvtk", ".res", ".series", ".vrt", ".xdmf"),
    )
    options = {  # noqa: RUF012 - as in Reader
        **OPTIONS,
        "time": "of a series the step nearest to this time; by default the last",
    }
    packages = ("pyvista",)
    extra = "vtk"

    def matches(self, path: Path, head: bytes) -> bool:
        suffix = path.suffix.lower()
        if suffix == ".dat":
            return head.lstrip().upper().startswith(_TECPLOT)
        # An empty file called .foam stands for the folder of a run of OpenFOAM.
        return suffix in self.suffixes and path.is_file() and bool(head or suffix == ".foam")

    def dataset(
        self, path: Path, *, resolution: Any = None, time: float | None = None, **options: Any
    ) -> Dataset:
        pyvista = require("pyvista", "vtk", "reading this file")
        _check_survival(path)
        with heard(warnings=False):
            reader = pyvista.get_reader(str(path))
            meta = _choose_time(reader, time)
            mesh = reader.read()
            if path.suffix.lower() == ".cube":
                _place_cube(mesh, reader.reader.GetTransform().GetMatrix())
        parts = [part for part in leaves(mesh) if part.GetNumberOfPoints()]
        if not parts:
            raise InputError("there are no points in it")
        # What is alone need not be a mesh: it may be image data.
        result = dataset_of(parts[0] if len(parts) == 1 else mesh, resolution)
        result.meta.update(meta)
        return result


def _check_survival(path: Path) -> None:
    """Let another process read the file first: VTK crashes on many that are damaged."""
    # Inside of a program (ParaView, Blender) that is not the interpreter none can be started.
    if "py" not in Path(sys.executable or "").name.lower() or hasattr(sys, "frozen"):
        return
    script = f"import sys; sys.path[:] = {sys.path!r}; import pyvista\n"
    script += "pyvista.get_reader(sys.argv[1]).read()"
    command = [sys.executable, "-I", "-c", script, str(path.absolute())]
    if subprocess.run(command, capture_output=True, check=False).returncode < 0:
        raise FileFormatError("VTK crashes on it: it is damaged, cut short or of another kind")


def _place_cube(mesh: Any, to_indices: Any) -> None:
    """Put voxels of a Gaussian cube where its header says: VTK leaves them at 0, 1, 2 …"""
    elements = [[to_indices.GetElement(i, j) for j in range(4)] for i in range(4)]
    try:
        matrix = np.linalg.inv(elements)
    except np.linalg.LinAlgError as error:
        raise FileFormatError("the axes of its voxels do not span a volume") from error
    steps = np.linalg.norm(matrix[:3, :3], axis=0)
    mesh.spacing, mesh.origin = steps, matrix[:3, 3]
    mesh.direction_matrix = matrix[:3, :3] / steps
    for name in list(mesh.point_data):  # VTK's name is the second line with its end
        mesh.rename_array(name, name.strip() or "values")


def _choose_time(reader: Any, time: float | None) -> dict[str, float]:
    times = np.asarray(getattr(reader, "time_values", ()), float)
    if not len(times):
        if time is not None:
            raise InputError("time is given, but there is only one step in it")
        return {}
    step = len(times) - 1 if time is None else int(np.argmin(np.abs(times - time)))
    reader.set_active_time_value(times[step])
    return {"time": float(times[step])}
