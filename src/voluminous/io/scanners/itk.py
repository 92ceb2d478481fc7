"""HDF5 files of ITK and SimpleITK: an image with its place."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ..hdf5 import data_set, is_hdf5, opened, read
from .placement import LPS, Placement
from .voxels import VECTOR, VoxelReader, Voxels, components

_IMAGE = "ITKImage/0"


class ITKReader(VoxelReader):
    """An image of three dimensions, with one value or several per voxel."""

    name = "itk"
    description = "an image of ITK in an HDF5 file"
    suffixes = (".hdf5", ".h5")

    def matches(self, path: Path, head: bytes) -> bool:
        if not is_hdf5(head):
            return False
        try:
            with opened(path) as file:
                return f"{_IMAGE}/VoxelData" in file
        except Exception:  # damaged: whoever reads it says so
            return False

    def voxels(self, path: Path) -> Voxels:
        with opened(path) as file:
            group = file[_IMAGE]
            item = data_set(path, group, "VoxelData")
            shape = tuple(int(n) for n in _numbers(path, group, "Dimension"))
            if len(shape) != 3 or item.shape[:3] != shape[::-1] or item.ndim > 4:
                raise FileFormatError(
                    f"expected an image of three dimensions, got Dimension {shape} and values of "
                    f"shape {item.shape}"
                )
            origin, spacing, rows = (
                _numbers(path, group, name) for name in ("Origin", "Spacing", "Directions")
            )
            if (len(origin), len(spacing), rows.shape) != (3, 3, (3, 3)):
                raise FileFormatError("expected Origin, Spacing and Directions in three dimensions")
            count = item.shape[3] if item.ndim == 4 else 1
            vector = VECTOR if count == 3 and item.dtype.kind == "f" else ()
            return Voxels(
                shape=shape,
                dtype=item.dtype.newbyteorder("="),
                placement=Placement(origin, rows * spacing[:, None], "mm", LPS),
                load=functools.partial(_load, path),
                components=("",) if count == 1 else components(count, vector),
            )


def _load(path: Path, component: int) -> np.ndarray:
    with opened(path) as file:
        values = read(data_set(path, file[_IMAGE], "VoxelData"))
    return (values[..., component] if values.ndim == 4 else values).transpose()


def _numbers(path: Path, group: Any, name: str) -> np.ndarray:
    item = data_set(path, group, name)
    if item.size > 16:
        raise FileFormatError(f"expected a few numbers in {name}, got the shape {item.shape}")
    return np.asarray(item[()])
