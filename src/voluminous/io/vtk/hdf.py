"""VTK's data in HDF5 (.vtkhdf): image data.

https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/index.html
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError, InputError
from ..hdf5 import data_set, is_hdf5, opened, read
from ..scanners.placement import Arrangement
from .dataset import (
    ADVICE,
    CELL,
    POINT,
    UPRIGHT,
    Array,
    Dataset,
    DatasetReader,
    cell_counts,
    even_arrangement,
)
from .library import heard, vtk
from .objects import dataset_of

_ROOT, _IMAGE = "VTKHDF", "ImageData"
_SECTIONS = (("PointData", POINT), ("CellData", CELL))


class VTKHDFReader(DatasetReader):
    """Image data of one time in an HDF5 file of VTK."""

    name = "vtkhdf"
    description = "an HDF5 file of VTK with image data (.vtkhdf)"
    suffixes = (".vtkhdf",)

    def matches(self, path: Path, head: bytes) -> bool:
        if not is_hdf5(head):
            return False
        try:
            with opened(path) as file:
                return "Type" in file[_ROOT].attrs
        except Exception:  # damaged, or another: whoever reads it says so
            return path.suffix.lower() in self.suffixes

    def dataset(self, path: Path, *, resolution: Any = None, **options: Any) -> Dataset:
        return _dataset(path, resolution)


def _dataset(path: Path, resolution: Any = None) -> Dataset:
    if resolution is not None:
        reader = vtk("vtkIOHDF").vtkHDFReader()
        reader.SetFileName(str(path))
        with heard():
            reader.Update()
        return dataset_of(reader.GetOutput(), resolution)
    with opened(path) as file:
        if _ROOT not in file:
            raise FileFormatError(f"expected a group {_ROOT}, there is none")
        root = file[_ROOT]
        _check_kind(root)
        extent = _numbers(root, "WholeExtent", 6).astype(np.int64)
        points = tuple(int(n) for n in extent[1::2] - extent[::2] + 1)
        if min(points) < 1 or max(points) > 2**31:
            raise FileFormatError(f"WholeExtent is {extent.tolist()}: it holds no points")
        place = {
            "origin": _numbers(root, "Origin", 3, (0, 0, 0)),
            "spacing": _numbers(root, "Spacing", 3, (1, 1, 1)),
            "direction": _numbers(root, "Direction", 9, UPRIGHT),
        }

        def arrange(at: str, unit: Any) -> Arrangement:
            return even_arrangement(**place, low=extent[::2], points=points, at=at, unit=unit)

        arrays = [a for tag, at in _SECTIONS for a in _arrays(path, root, tag, at, points)]
        return Dataset(points, arrange, arrays, _active(root))


def _check_kind(root: Any) -> None:
    """Refuse what is no image of one time."""
    kind = root.attrs.get("Type", b"")
    kind = kind.decode("utf-8", "replace") if isinstance(kind, bytes) else str(kind)
    if kind != _IMAGE:
        raise InputError(f"it holds {kind[:100] or 'data of no type'}, not a regular grid{ADVICE}")
    if "Steps" in root:
        raise InputError("it is a series of times; save one of them as .vti, or as .vtkhdf")


def _arrays(path: Path, root: Any, tag: str, at: str, points: Any) -> Iterator[Array]:
    shape = cell_counts(points, at)[::-1]
    for name in root.get(tag) or ():
        item = data_set(path, root[tag], name)
        if item.shape[:3] != shape or item.ndim > 4:
            raise FileFormatError(
                f"{item.name} has the shape {item.shape}, but there are {shape} {at}s (z, y, x)"
            )
        load = functools.partial(_load, path, item.name)
        dtype = item.dtype.newbyteorder("=")
        yield Array(name, at, item.shape[3] if item.ndim == 4 else 1, dtype, load)


def _load(path: Path, place: str) -> np.ndarray:
    group, _, name = place.rpartition("/")
    with opened(path) as file:
        values = read(data_set(path, file[group], name))
    return values if values.ndim == 4 else values[..., None]


def _active(root: Any) -> dict[str, str]:
    found = {}
    for tag, at in _SECTIONS:
        for name, item in (root.get(tag) or {}).items():
            if bytes(item.attrs.get("Attribute", b"")) == b"Scalars":
                found[at] = name
    return found


def _numbers(root: Any, name: str, count: int, default: Any = None) -> np.ndarray:
    values = np.ravel(root.attrs.get(name, () if default is None else default))
    if len(values) != count or values.dtype.kind not in "fiu" or not np.isfinite(values).all():
        raise FileFormatError(f"expected {name} to be {count} numbers, got {values!r:.100}")
    return values
