"""HDF5: fields by the paths of their data sets, units from their attributes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError
from ..hdf5 import check_place, first_bytes, is_hdf5, opened, read, text, warn_of_missing
from ..units import known_unit
from .layout import Entry
from .named_arrays import NamedArraysReader

if TYPE_CHECKING:
    from ...volume import Volume

# Layouts with an order of axes and places of cells of their own: by a place, or a pattern
# of names in the root.
_LAYOUTS = {
    r"Grid\d{8}": "a piece of an output of Enzo; open its file of parameters or its directory",
    "DataContainers": "a file of DREAM.3D",
    "DataStructure": "a file of DREAM3D-NX",
    "s00/resolutions": "a file of BigDataViewer; export it as OME-Zarr or TIFF",
    "CGNSLibraryVersion": "a CGNS file; save it as .vtk with ParaView or PyVista",
    ".silo": "a Silo file; save it as .vtk with VisIt",
    "Chimera": "a map of UCSF Chimera; save it as .mrc",
    "HDFEOS INFORMATION": "an HDF-EOS file; open it with xarray, then vm.Volume.from_xarray",
}
_MATLAB = b"MATLAB 7.3 MAT-file"
_PLACED_BY = ("axes", "bounds", "spacing", "x", "y", "z")
_UNIT_ATTRIBUTES = ("units", "unit", "Units", "Unit", "UNITS", "UNIT")


class HDF5Reader(NamedArraysReader):
    """Any HDF5 file with data sets of three dimensions on a Cartesian grid."""

    name = "hdf5"
    description = "an HDF5 file"
    suffixes = (".h5", ".hdf5", ".he5", ".hdf", ".mat")
    remote = True

    def matches(self, path: Path, head: bytes) -> bool:
        return is_hdf5(head)

    def read(self, path: Path, fields: Any = None, **options: Any) -> Volume:
        if all(options.get(name) is None for name in _PLACED_BY):
            with opened(path) as file:
                known = next((what for mark, what in _LAYOUTS.items() if _has(file, mark)), None)
            if known:
                raise FileFormatError(
                    f"expected plain arrays, this is {known}. To read its arrays as they are, say "
                    "what they are: axes='zyx' (or 'xyz'), bounds=… or spacing=…"
                )
        return super().read(path, fields, **options)

    @contextmanager
    def entries(
        self, path: Path, only: str | None = None, **options: Any
    ) -> Iterator[dict[str, Entry]]:
        import h5py

        backwards = first_bytes(path, len(_MATLAB)) == _MATLAB
        with opened(path) as file:
            entries: dict[str, Entry] = {}

            def visit(place: str, item: Any) -> None:
                if isinstance(item, h5py.Dataset) and item.shape is not None:
                    entries[place] = _entry(path, item, backwards)

            if only is None:
                file.visititems(visit)  # does not follow links to other places
            else:
                visit(only, file[only])
            yield entries


def _has(file: Any, mark: str) -> bool:
    return mark in file or any(re.fullmatch(mark, name) for name in file)


def _entry(path: Path, item: Any, backwards: bool) -> Entry:
    """Return a data set; its axes run backwards in files of MATLAB and Octave, as they show it."""
    scales, dims = _scales(item)
    sense = -1 if backwards or "OCTAVE_NEW_FORMAT" in item.parent.attrs else 1

    def load(index: Any = ...) -> np.ndarray:
        check_place(path, item)
        stored = index if sense == 1 or index is ... else index[::-1]
        warn_of_missing(item, stored)
        values = read(item) if index is ... else item[stored]
        return values if sense == 1 else values.T

    dims, scales, chunks = dims[::sense], scales[::sense], (item.chunks or ())[::sense]
    unit, shape = _unit(item), item.shape[::sense]
    return Entry(shape, item.dtype, unit, load, scales=scales, dims=dims, chunks=chunks)


def _scales(item: Any) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return, per axis, the place of its dimension scale and its name; empty where there is none.

    Scales are described in https://support.hdfgroup.org/documentation/hdf5/latest/_h5_d_s__u_g.html.
    """
    if not {"DIMENSION_LIST", "DIMENSION_LABELS"} & set(item.attrs):
        return (), ()
    places = tuple(axis[0].name.strip("/") if len(axis) else "" for axis in item.dims)
    labels = tuple(axis.label for axis in item.dims)
    names = (label or p.rsplit("/", 1)[-1] for label, p in zip(labels, places, strict=True))
    return places, tuple(names)


def _unit(item: Any) -> str:
    """Return the unit in a data set's attributes; omit units that astropy cannot parse."""
    texts = (text(item.attrs.get(name)) for name in _UNIT_ATTRIBUTES)
    return next((unit for unit in map(known_unit, texts) if unit), "")
