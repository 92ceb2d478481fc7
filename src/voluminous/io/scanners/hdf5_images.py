"""Images in HDF5: Imaris (.ims, channels of a microscope at several resolutions) and ITK."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...errors import FileFormatError, InputError
from ..guard import by_library
from ..hdf5 import data_set, holds, opened, read
from ..payload import checked_shape
from .placement import LPS, Placement, length_unit
from .voxels import (
    TIMED,
    VECTOR,
    Channel,
    VoxelReader,
    Voxels,
    channel,
    component_names,
    time_step,
    times_meta,
)

if TYPE_CHECKING:
    import h5py

_INFO, _LEVEL = "DataSetInfo/Image", "DataSet/ResolutionLevel"
_ITK = "ITKImage/0"


class ImarisReader(VoxelReader):
    """All channels at one time and one resolution, a field each."""

    name = "imaris"
    description = "an Imaris image (.ims)"
    suffixes = (".ims",)
    options = {  # noqa: RUF012 - as in Reader
        **TIMED,
        "level": "resolution, from 0, the finest",
    }

    def matches(self, path: Path, head: bytes) -> bool:
        return holds(path, head, lambda file: _INFO in file and f"{_LEVEL} 0" in file)

    def voxels(self, path: Path, *, time: int = 0, level: int = 0) -> Voxels:
        with by_library("h5py"), opened(path) as file:
            info, count = file[_INFO], len(file["DataSet"])
            if f"{_LEVEL} {level}" not in file:
                raise InputError(f"level must be from 0 to {count - 1}, got {level!r}")
            times = len(file[f"{_LEVEL} {level}"])
            step = time_step(time, times)
            place = f"{_LEVEL} {level}/TimePoint {step}"
            groups = [file[f"{place}/Channel {k}"] for k in range(len(file[place]))]
            # Blocks at the end are filled up: the data sets can be larger than the image.
            sizes = {tuple(_numbers(g, f"ImageSize{a}")[0] for a in "XYZ") for g in groups}
            items = [data_set(path, group, "Data") for group in groups]
            if len(sizes) != 1 or len({item.dtype for item in items}) != 1:
                raise FileFormatError(f"expected channels of one size and type, got {sizes}")
            shape = checked_shape(sizes.pop(), "ImageSizeX, Y and Z")
            if any(i.ndim != 3 or np.any(np.less(i.shape[::-1], shape)) for i in items):
                raise FileFormatError(f"a channel has fewer values than its size {shape}")
            low, high = (
                np.array([_numbers(info, f"{end}{k}")[0] for k in range(3)])
                for end in ("ExtMin", "ExtMax")
            )
            widths = (high - low) / shape
            unit = length_unit(_text(info, "Unit") or "um")
            channels = [_channel(file.get(f"DataSetInfo/Channel {k}")) for k in range(len(groups))]
            return Voxels(
                shape=shape,
                dtype=items[0].dtype.newbyteorder("="),
                placement=Placement(low + widths / 2, np.diag(widths), unit),
                load=functools.partial(_load_channel, path, place, shape),
                components=component_names(len(groups)),
                channels=channels,
                meta=times_meta(times, step),
            )


def _load_channel(path: Path, place: str, shape: tuple[int, ...], number: int) -> np.ndarray:
    with opened(path) as file:
        values = read(data_set(path, file[f"{place}/Channel {number}"], "Data"))
    return np.asarray(values.transpose()[tuple(slice(n) for n in shape)])


def _text(group: h5py.Group, name: str) -> str:
    value = group.attrs.get(name)
    return "" if value is None else b"".join(np.ravel(value)).decode("utf-8", "replace").strip()


def _numbers(group: h5py.Group, name: str) -> list[float]:
    return [float(word) for word in _text(group, name).split()]


def _channel(group: h5py.Group | None) -> Channel:
    if group is None:
        return {}
    color = [255 * c for c in _numbers(group, "Color")]
    return channel(_text(group, "Name"), color, _numbers(group, "ColorRange"))


class ITKReader(VoxelReader):
    """An image of three dimensions, with one value or several per voxel, by ITK or SimpleITK."""

    name = "itk"
    description = "an image of ITK in an HDF5 file"
    suffixes = (".hdf5", ".h5")

    def matches(self, path: Path, head: bytes) -> bool:
        return holds(path, head, lambda file: f"{_ITK}/VoxelData" in file)

    def voxels(self, path: Path) -> Voxels:
        with by_library("h5py"), opened(path) as file:
            item = data_set(path, file[_ITK], "VoxelData")
            sizes, origin, spacing, rows = (
                file[f"{_ITK}/{name}"][()]
                for name in ("Dimension", "Origin", "Spacing", "Directions")
            )
            shape = tuple(int(n) for n in sizes)
            if len(shape) != 3 or item.shape[:3] != shape[::-1] or item.ndim > 4:
                raise FileFormatError(
                    f"expected an image of three dimensions, got Dimension {shape} and values of "
                    f"shape {item.shape}"
                )
            count = item.shape[3] if item.ndim == 4 else 1
            vector = VECTOR if count == 3 and item.dtype.kind == "f" else ()
            return Voxels(
                shape=shape,
                dtype=item.dtype.newbyteorder("="),
                placement=Placement(origin, rows * spacing[:, None], "mm", LPS),
                load=functools.partial(_load_component, path),
                components=component_names(count, vector),
            )


def _load_component(path: Path, component: int) -> np.ndarray:
    with opened(path) as file:
        values = read(data_set(path, file[_ITK], "VoxelData"))
    return np.asarray((values[..., component] if values.ndim == 4 else values).transpose())
