"""What else PyVista reads: image data as they are, meshes of some fifty formats resampled."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...packages import require
from ..contract import FieldInfo, Reader
from .dataset import Dataset
from .library import heard
from .meshes import leaves
from .objects import dataset_of
from .volumes import OPTIONS, infos, volume_of

if TYPE_CHECKING:
    from ...volume import Volume

# How Tecplot's text begins: other programs call anything .dat.
_TECPLOT = (b"TITLE", b"VARIABLES", b"ZONE", b"FILETYPE")


class PyVistaReader(Reader):
    """Simulations on meshes and rarer images, known by the ends of their names."""

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
        """Return True for a file of such a name."""
        suffix = path.suffix.lower()
        if suffix == ".dat":
            return head.lstrip().upper().startswith(_TECPLOT)
        # An empty file called .foam stands for the folder of a run of OpenFOAM.
        return suffix in self.suffixes and path.is_file() and bool(head or suffix == ".foam")

    def read(
        self,
        path: Path,
        fields: Any = None,
        *,
        unit: Any = None,
        resolution: Any = None,
        time: float | None = None,
        **options: Any,
    ) -> Volume:
        """Return the volume."""
        return volume_of(_dataset(path, resolution, time), fields, unit)

    def info(
        self,
        path: Path,
        *,
        resolution: Any = None,
        time: float | None = None,
        **options: Any,
    ) -> tuple[FieldInfo, ...]:
        """Return the arrays, component by component."""
        return infos(_dataset(path, resolution, time))


def _dataset(path: Path, resolution: Any, time: float | None) -> Dataset:
    pyvista = require("pyvista", "vtk", "reading this file")
    with heard(warnings=False):
        reader = pyvista.get_reader(str(path))
        meta = _choose_time(reader, time)
        mesh = reader.read()
    parts = [part for part in leaves(mesh) if part.GetNumberOfPoints()]
    if not parts:
        raise InputError("there are no points in it")
    # What is alone need not be a mesh: it may be image data.
    found = dataset_of(parts[0] if len(parts) == 1 else mesh, resolution)
    found.meta.update(meta)
    return found


def _choose_time(reader: Any, time: float | None) -> dict[str, float]:
    """Set the step to read; return its time, if there are several."""
    times = np.asarray(getattr(reader, "time_values", ()), float)
    if not len(times):
        if time is not None:
            raise InputError("time is given, but there is only one step in it")
        return {}
    step = len(times) - 1 if time is None else int(np.argmin(np.abs(times - time)))
    reader.set_active_time_value(times[step])
    return {"time": float(times[step])}
