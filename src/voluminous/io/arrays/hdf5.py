"""HDF5: fields by the paths of their data sets, units from their attributes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import UnitsError
from ...units import parse_unit, unit_name
from .layout import AXES
from .named_arrays import Entry, NamedArraysReader

if TYPE_CHECKING:
    from ...volume import Volume

_MAGIC = b"\x89HDF\r\n\x1a\n"
_UNIT_ATTRIBUTES = ("units", "unit", "Units", "Unit", "UNITS", "UNIT")


class HDF5Reader(NamedArraysReader):
    """Any HDF5 file with data sets of three dimensions on a Cartesian grid."""

    name = "hdf5"
    description = "an HDF5 file"
    suffixes = (".h5", ".hdf5", ".he5", ".hdf")
    writes = True

    def matches(self, path: Path, head: bytes) -> bool:
        """Return True for a file that starts as HDF5 files do (a user block may come first)."""
        starts = (0, 512, 1024, 2048)
        return any(head[start:].startswith(_MAGIC) for start in starts)

    @contextmanager
    def entries(self, path: Path, **options: Any) -> Iterator[dict[str, Entry]]:
        """Give all data sets; each is read when it is asked for."""
        import h5py

        with h5py.File(path, "r") as file:
            found: dict[str, Entry] = {}

            def visit(place: str, item: Any) -> None:
                if isinstance(item, h5py.Dataset) and item.shape is not None:
                    found[place] = Entry(item.shape, item.dtype, _unit(item), lambda: item[()])

            file.visititems(visit)
            yield found

    def write(self, volume: Volume, path: Path) -> None:
        """Write ``/x, /y, /z`` (edges) and a data set per field, each with its ``units``."""
        import h5py

        from ..cartesian import cartesian

        grid = cartesian(volume)
        with h5py.File(path, "w") as file:
            for axis, edges in zip(AXES, grid.edges, strict=True):
                file[axis] = edges
                file[axis].attrs["units"] = unit_name(grid.unit)
            for name in volume.fields:
                file[name] = volume.array(name)
                file[name].attrs["units"] = volume.units[name]


def _unit(item: Any) -> str:
    """Return the unit in a data set's attributes; what astropy does not know is left out."""
    for name in _UNIT_ATTRIBUTES:
        text = _text(item.attrs.get(name))
        try:
            if text:
                return unit_name(parse_unit(text))
        except UnitsError:
            continue
    return ""


def _text(attribute: Any) -> str:
    """Return an attribute that is one text; the empty string for any other."""
    values = np.ravel(attribute)
    first = values[0] if values.size == 1 else ""
    text = first.decode("utf-8", "replace") if isinstance(first, bytes) else first
    return text.strip() if isinstance(text, str) else ""
