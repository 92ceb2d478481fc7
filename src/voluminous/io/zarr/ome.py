"""What OME-Zarr says of an image: its axes, its levels, and how large their voxels are.

Versions 0.4 and 0.5 of the specification, https://ngff.openmicroscopy.org; earlier ones have no
sizes of voxels.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import FileFormatError, InputError, unknown_name
from ...memory import available_memory
from ..arrays.layout import AXES, equal_cells
from ..channels import Y_DOWN, Channel, channel_fields, channel_meta, omero_channels
from ..contract import FieldInfo, Reader
from ..names import chosen_fields, field_name
from ..unit_texts import known_unit
from .store import Store, holds_zarr, node_at, stored, zarr_array, zarr_store

if TYPE_CHECKING:
    from ...grids import CartesianGrid
    from ...volume import Volume


_OLD_AXES = ("t", "c", "z", "y", "x")


@dataclass(frozen=True)
class Level:
    """One resolution: where the array is, and per axis the size of a voxel and its first centre."""

    place: str
    scale: tuple[float, ...]
    translation: tuple[float, ...]


@dataclass(frozen=True)
class Multiscale:
    """An image in several resolutions, finest first."""

    # ``t``, ``c``, ``z``, ``y``, ``x``, as far as they are there, in the arrays' order
    axes: tuple[str, ...]
    unit: str  # of x (astropy's name, empty where there is none)
    ratios: dict[str, float]  # unit of z, y and x over that of x
    levels: tuple[Level, ...]  # the resolutions
    channels: tuple[Channel, ...]  # labels, colours and windows, see `channels`


def multiscale_in(attributes: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return the attributes that have ``multiscales``: version 0.5 has them in ``ome``."""
    inner = attributes.get("ome")
    for found in (inner, attributes):
        if isinstance(found, Mapping) and isinstance(found.get("multiscales"), list):
            return found
    return None


def parsed(attributes: Mapping[str, Any], place: str) -> Multiscale:
    """Return the first image that attributes describe."""
    try:
        image = attributes["multiscales"][0]
        told = image.get("axes") or list(_OLD_AXES)
        axes = tuple(_axis_name(axis) for axis in told)
        units = {_axis_name(a): _axis_unit(a) for a in told}
        after = _transformed(image.get("coordinateTransformations"), len(axes), None)
        levels = tuple(_level(data, len(axes), after, place) for data in image["datasets"])
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        raise FileFormatError(
            f"the multiscales of {place or 'the image'} are not as OME-Zarr has them "
            f"({type(error).__name__}: {error})"
        ) from error
    if not levels or len(set(axes)) < len(axes) or not {"x", "y", "z"} <= set(axes):
        raise FileFormatError(f"expected an image with axes z, y and x, got {', '.join(axes)}")
    unit, ratios = _common_unit(units)
    return Multiscale(axes, unit, ratios, levels, omero_channels(attributes))


def _axis_name(axis: Any) -> str:
    return str(axis["name"] if isinstance(axis, Mapping) else axis).lower()


def _axis_unit(axis: Any) -> str:
    return known_unit(str(axis.get("unit", ""))) if isinstance(axis, Mapping) else ""


def _common_unit(units: Mapping[str, str]) -> tuple[str, dict[str, float]]:
    """Return the unit of x, and those of all axes over it; none where they do not convert."""
    from astropy import units as u

    try:
        own = u.Unit(units["x"])
        return units["x"], {axis: float(u.Unit(units[axis]).to(own)) for axis in "xyz"}
    except u.UnitsError:
        return "", dict.fromkeys("xyz", 1.0)


def _level(
    data: Mapping[str, Any], count: int, after: tuple[list[float], list[float]], place: str
) -> Level:
    scale, shift = _transformed(data.get("coordinateTransformations"), count, after)
    path = str(data["path"]).strip("/")
    return Level(f"{place}/{path}" if place else path, tuple(scale), tuple(shift))


def _transformed(
    steps: Any, count: int, after: tuple[list[float], list[float]] | None
) -> tuple[list[float], list[float]]:
    """Return scale and translation of steps one after the other, then of those `after` them."""
    scale, shift = [1.0] * count, [0.0] * count
    for step in steps or []:
        kind = step["type"]
        if kind == "scale":
            factors = _numbers(step["scale"], count)
            scale = [s * f for s, f in zip(scale, factors, strict=True)]
            shift = [s * f for s, f in zip(shift, factors, strict=True)]
        elif kind == "translation":
            moved = _numbers(step["translation"], count)
            shift = [s + m for s, m in zip(shift, moved, strict=True)]
        elif kind != "identity":
            raise ValueError(f"unknown transformation {kind!r}")
    if after is not None:
        shift = [s * f + m for s, f, m in zip(shift, *after, strict=True)]
        scale = [s * f for s, f in zip(scale, after[0], strict=True)]
    return scale, shift


def _numbers(values: Sequence[Any], count: int) -> list[float]:
    if len(values) != count:
        raise ValueError(f"expected {count} numbers, got {len(values)}")
    return [float(value) for value in values]


# A picture takes up to so many bytes a cell beside the values: four numbers between cell centres.
_PICTURE = 16


def level_number(arrays: Sequence[Any], image: Multiscale, asked: Any) -> int:
    """Return the resolution asked for, or the finest of which a picture fits into memory."""
    for array, level in zip(arrays, image.levels, strict=True):
        if len(array.shape) != len(image.axes) or 0 in array.shape:
            raise FileFormatError(
                f"{level.place!r} has shape {array.shape}, expected axes {', '.join(image.axes)} "
                "of at least one voxel"
            )
    if asked is not None:
        return _numbered("level", asked, len(arrays))
    free = available_memory() // 2
    for number, array in enumerate(arrays):
        size = np.dtype(array.dtype).itemsize + _PICTURE
        if math.prod(counts(image, array.shape)) * size <= free:
            return number
    return len(arrays) - 1


def counts(image: Multiscale, shape: Sequence[int]) -> tuple[int, ...]:
    """Return the number of voxels along x, y and z."""
    return tuple(int(shape[image.axes.index(axis)]) for axis in AXES)


def time_number(image: Multiscale, shape: Sequence[int], asked: Any) -> int:
    """Return the time asked for, or the only one."""
    count = int(shape[image.axes.index("t")]) if "t" in image.axes else 1
    if asked is None and count > 1:
        raise InputError(f"there are {count} times; choose one with time=0 … time={count - 1}")
    return 0 if asked is None else _numbered("time", asked, count)


def channel_names(image: Multiscale, shape: Sequence[int], stem: str, asked: Any) -> dict[int, str]:
    """Return number → name of the channels: their labels, else numbered, or the file's if alone."""
    count = int(shape[image.axes.index("c")]) if "c" in image.axes else 1
    numbered = [field_name(stem)] if count == 1 else [f"channel_{k}" for k in range(count)]
    names = channel_fields(image.channels, numbered)
    chosen = range(count) if asked is None else [_numbered("channel", asked, count)]
    return {k: names[k] for k in chosen}


def _numbered(what: str, asked: Any, count: int) -> int:
    if not isinstance(asked, (int, np.integer)) or not 0 <= asked < count:
        raise InputError(f"{what} must be a number from 0 to {count - 1}, got {asked!r}")
    return int(asked)


def voxels(
    image: Multiscale, level: Level, shape: Sequence[int], options: Mapping[str, Any]
) -> CartesianGrid:
    """Return the grid of a resolution; the file tells the centre of the first voxel."""
    from ...grids import CartesianGrid

    number, unit = counts(image, shape), options.get("unit") or image.unit
    if options.get("bounds") is not None or options.get("spacing") is not None:
        return equal_cells(number, options, unit)
    bounds = []
    for axis, n in zip(AXES, number, strict=True):
        k, ratio = image.axes.index(axis), image.ratios[axis]
        step = level.scale[k] * ratio
        low = level.translation[k] * ratio - 0.5 * step
        if not 0 < step < math.inf or not math.isfinite(low):
            raise FileFormatError(
                f"voxels of {level.place!r} have size {step} along {axis} and begin at {low}; "
                "give spacing=… in place of that"
            )
        bounds.append((low, low + n * step))
    return CartesianGrid.uniform(number, bounds, unit=unit)


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
    """Return what is said of the image that is asked for, or of the only one."""
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
