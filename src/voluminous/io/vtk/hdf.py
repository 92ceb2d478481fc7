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
from ..hdf5 import data_set, is_hdf5, opened, read, text
from .dataset import (
    ADVICE,
    CELL,
    POINT,
    UPRIGHT,
    DataArray,
    Dataset,
    DatasetReader,
    Even,
    cell_counts,
)
from .library import heard, vtk
from .objects import dataset_of

_ROOT = "VTKHDF"
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
            kind = text(root.attrs.get("Type", b""))
            if kind != "ImageData":
                kind = kind[:100] or "data of no type"
                raise InputError(f"it holds {kind}, not a regular grid{ADVICE}")
            if "Steps" in root:
                raise InputError("it is a series of times; save one of them as .vti, or as .vtkhdf")
            extent = _numbers(root, "WholeExtent", 6).astype(np.int64)
            points = tuple(int(n) for n in extent[1::2] - extent[::2] + 1)
            if min(points) < 1 or max(points) > 2**31:
                raise FileFormatError(f"WholeExtent is {extent.tolist()}: it holds no points")
            place = Even(
                _numbers(root, "Origin", 3, (0, 0, 0)),
                _numbers(root, "Spacing", 3, (1, 1, 1)),
                _numbers(root, "Direction", 9, UPRIGHT),
                tuple(extent[::2].tolist()),
                points,
            )
            active = {
                at: name
                for tag, at in _SECTIONS
                for name, item in (root.get(tag) or {}).items()
                if text(item.attrs.get("Attribute", b"")) == "Scalars"
            }
            return Dataset(points, place, list(_arrays(path, root, points)), active)


def _arrays(path: Path, root: Any, points: tuple[int, ...]) -> Iterator[DataArray]:
    for tag, at in _SECTIONS:
        shape = cell_counts(points, at)[::-1]
        for name in root.get(tag) or ():
            item = data_set(path, root[tag], name)
            if item.shape[:3] != shape or item.ndim > 4:
                raise FileFormatError(
                    f"{item.name} has the shape {item.shape}, but there are {shape} {at}s (z, y, x)"
                )
            load = functools.partial(_load, path, f"{_ROOT}/{tag}", name)
            count = item.shape[3] if item.ndim == 4 else 1
            yield DataArray(name, at, count, item.dtype.newbyteorder("="), load)


def _load(path: Path, group: str, name: str) -> np.ndarray:
    with opened(path) as file:
        values = read(data_set(path, file[group], name))
    return values if values.ndim == 4 else values[..., None]


def _numbers(root: Any, name: str, count: int, default: Any = ()) -> np.ndarray:
    values = np.ravel(root.attrs.get(name, default))
    if len(values) != count or values.dtype.kind not in "fiu" or not np.isfinite(values).all():
        raise FileFormatError(f"expected {name} to be {count} numbers, got {values!r:.100}")
    return values
