"""OME-Zarr: images of microscopes, in several resolutions and channels."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import FileFormatError, InputError, unknown_name
from ..arrays.layout import AXES
from ..channels import Y_DOWN, channel_meta
from ..contract import FieldInfo, Reader
from ..names import chosen_fields
from .choice import channel_names, counts, level_number, time_number, voxels
from .multiscale import Multiscale, multiscale_in, parsed
from .opened import zarr_array, zarr_store
from .store import Store, holds_zarr, node_at, stored

if TYPE_CHECKING:
    from ...volume import Volume


class OMEZarrReader(Reader):
    """Channels on the voxels of one resolution."""

    name = "ome-zarr"
    description = "an OME-Zarr image"
    suffixes = (".zarr",)
    options = {  # noqa: RUF012 - as in Reader
        "level": "resolution, 0 is the finest; by default the finest that fits into memory",
        "channel": "number of the only channel to read; by default all, a field each",
        "time": "number of the time, where there are several",
        "image": "place of the image, where there are several",
        "bounds": "(low, high) or ((x0, x1), (y0, y1), (z0, z1)), in place of the file's",
        "spacing": "width of a voxel, or one per axis, in place of the file's",
        "unit": "unit of length",
    }
    packages = ("zarr",)
    extra = "arrays"

    def matches(self, path: Path, head: bytes) -> bool:
        if not holds_zarr(path, head):
            return False
        try:
            with stored(path) as store:
                return bool(_images(store))
        except (FileFormatError, OSError):
            return ".ome." in path.name.lower()  # of others the plain reader tells what is wrong

    def read(self, path: Path, fields: Any = None, **options: Any) -> Volume:
        from ...volume import Volume

        image = _image(path, options.get("image"))
        with zarr_store(path) as opened:
            arrays = [zarr_array(opened, level.place) for level in image.levels]
            number = level_number(arrays, image, options.get("level"))
            level, shape = image.levels[number], arrays[number].shape
            dtype = np.dtype(arrays[number].dtype)
        time = time_number(image, shape, options.get("time"))
        names = channel_names(image, shape, _stem(path), options.get("channel"))
        volume = Volume(voxels(image, level, shape, options))
        chosen = chosen_fields({str(k): n for k, n in names.items()}, fields, "channel")
        for name, place in chosen.items():
            load = functools.partial(_values, path, level.place, image.axes, time, int(place))
            volume[name] = Deferred(load, dtype)
        entries = dict(enumerate(image.channels))
        volume.meta |= {"level": number, "levels": len(arrays), "time_number": time, **Y_DOWN}
        volume.meta |= channel_meta((n, entries.get(int(k), {})) for n, k in chosen.items())
        return volume

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        image = _image(path, options.get("image"))
        with zarr_store(path) as opened:
            array = zarr_array(opened, image.levels[0].place)
            names = channel_names(image, array.shape, _stem(path), options.get("channel"))
            shape = counts(image, array.shape)[::-1]
            return tuple(FieldInfo(n, str(k), shape, str(array.dtype)) for k, n in names.items())


def _stem(path: Path) -> str:
    return path.name.split(".")[0]


def _images(store: Store) -> list[str]:
    """Return the places of images: the root, or what Bio-Formats puts into it."""
    root = node_at(store)
    if root is None or root.is_array:
        return []
    if multiscale_in(root.attributes) is not None:
        return [""]
    told = root.attributes.get("ome")
    if "bioformats2raw.layout" not in {*root.attributes, *(told if isinstance(told, dict) else ())}:
        return []
    nodes = ((name, node_at(store, name)) for name in store.children(""))
    return [n for n, node in nodes if node and multiscale_in(node.attributes) is not None]


def _image(path: Path, asked: Any) -> Multiscale:
    """Return what is said of the image that is asked for, or of the only one.

    Raises
    ------
    InputError
        If there are several, and none is asked for.
    UnknownNameError
        If there is no such image.
    """
    with stored(path) as store:
        places = _images(store)
        if asked is None and len(places) > 1:
            raise InputError(
                f"there are images {', '.join(places)}; choose one with image={places[0]!r}"
            )
        place = str(asked).strip("/") if asked is not None else places[0] if places else ""
        node = node_at(store, place)
        told = None if node is None else multiscale_in(node.attributes)
        if told is None:
            raise unknown_name("image", place, places)
        return parsed(told, place)


def _values(path: Path, place: str, axes: Sequence[str], time: int, channel: int) -> np.ndarray:
    """Return one channel at one time, as [ix, iy, iz]."""
    chosen = {"t": time, "c": channel}
    with zarr_store(path) as opened:
        array = zarr_array(opened, place)
        found = np.asarray(array[tuple(chosen.get(axis, slice(None)) for axis in axes)])
    kept = [axis for axis in axes if axis not in chosen]
    return found.transpose([kept.index(axis) for axis in AXES])
