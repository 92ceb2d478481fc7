"""OME-Zarr: images of microscopes, in several resolutions and channels.

Versions 0.4 and 0.5 of the specification, https://ngff.openmicroscopy.org; earlier ones have no
sizes of voxels.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...deferred import Deferred
from ...errors import FileFormatError, InputError, UnitsError, VoluminousError, unknown_name
from ...memory import available_memory
from ...units import parse_unit
from ..arrays.layout import AXES, equal_cells
from ..channels import Y_DOWN, Channel, channel, channel_fields, channel_meta
from ..contract import FieldInfo, Reader
from ..names import chosen_fields, field_name
from ..unit_texts import known_unit
from .store import checked, holds_zarr, opened

if TYPE_CHECKING:
    import zarr

    from ...grids import CartesianGrid
    from ...volume import Volume

_OLD_AXES = ("t", "c", "z", "y", "x")
# A picture takes up to so many bytes a cell beside the values: four numbers between cell centres.
_PICTURE = 16


class OMEZarrReader(Reader):
    """Reads the channels of one resolution level."""

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
    remote = True

    def matches(self, path: Path, head: bytes) -> bool:
        if not holds_zarr(path, head):
            return False
        try:
            with opened(path) as root:
                return bool(_images(root))
        except VoluminousError:  # the plain reader says what is wrong with others
            return ".ome." in path.name.lower()

    def read(self, path: Path, fields: Any = None, **options: Any) -> Volume:
        from ...volume import Volume

        with opened(path) as root:
            image = _chosen_image(root, options.get("image"))
            arrays = [checked(root[level.place]) for level in image.levels]
            number = _level_number(arrays, image, options.get("level"))
            level, shape = image.levels[number], arrays[number].shape
            dtype = np.dtype(arrays[number].dtype)
        times, time = image.count(shape, "t"), options.get("time")
        if time is None and times > 1:
            raise InputError(f"there are {times} times; choose one with time=0 … time={times - 1}")
        time = 0 if time is None else _numbered("time", time, times)
        names = _channel_names(path, image, shape, options.get("channel"))
        volume = Volume(_grid(image, level, shape, options))
        chosen = chosen_fields({str(k): n for k, n in names.items()}, fields, "channel")
        for name, place in chosen.items():
            load = functools.partial(_values, path, level.place, image.axes, time, int(place))
            volume[name] = Deferred(load, dtype)
        entries = dict(enumerate(image.channels))
        volume.meta |= {"level": number, "levels": len(arrays), "time_number": time, **Y_DOWN}
        volume.meta |= channel_meta((n, entries.get(int(k), {})) for n, k in chosen.items())
        return volume

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        with opened(path) as root:
            image = _chosen_image(root, options.get("image"))
            array = checked(root[image.levels[0].place])
            names = _channel_names(path, image, array.shape, options.get("channel"))
            shape = tuple(image.count(array.shape, axis) for axis in "zyx")
            return tuple(FieldInfo(n, str(k), shape, str(array.dtype)) for k, n in names.items())


class ImageLevel(NamedTuple):
    """One resolution level: its array and, per axis, the voxel size and the first voxel centre."""

    place: str
    scale: list[float]
    translation: list[float]


@dataclass(frozen=True)
class Multiscale:
    """An image in several resolutions, finest first."""

    axes: tuple[str, ...]  # t, c, z, y, x, as far as they are there, in the arrays' order
    unit: str  # of x; empty where there is none
    ratios: dict[str, float]  # units of z, y and x over that of x
    levels: list[ImageLevel]
    channels: tuple[Channel, ...]

    def count(self, shape: Sequence[int], axis: str) -> int:
        """Return the size of an array along an axis; 1 if the axis does not exist."""
        return int(shape[self.axes.index(axis)]) if axis in self.axes else 1


def _multiscales(node: Any) -> Mapping[str, Any] | None:
    """Return the attributes that have ``multiscales``: version 0.5 has them in ``ome``."""
    for found in (node.attrs.get("ome"), dict(node.attrs)):
        if isinstance(found, Mapping) and isinstance(found.get("multiscales"), list):
            return found
    return None


def _images(root: Any) -> dict[str, Mapping[str, Any]]:
    """Return place → attributes of images: the root, or those that Bio-Formats puts into it."""
    if not hasattr(root, "members"):
        return {}
    attributes = _multiscales(root)
    if attributes is not None:
        return {"": attributes}
    ome = root.attrs.get("ome")
    if "bioformats2raw.layout" not in {*root.attrs, *(ome if isinstance(ome, dict) else ())}:
        return {}
    inside = {name: _multiscales(node) for name, node in sorted(root.groups())}
    return {name: attributes for name, attributes in inside.items() if attributes is not None}


def _chosen_image(root: Any, asked: Any) -> Multiscale:
    images = _images(root)
    if asked is None and len(images) > 1:
        first = next(iter(images))
        raise InputError(f"there are images {', '.join(images)}; choose one with image={first!r}")
    place = str(asked).strip("/") if asked is not None else next(iter(images), "")
    if place not in images:
        raise unknown_name("image", place, images)
    return _parsed(images[place], place)


def _parsed(attributes: Mapping[str, Any], place: str) -> Multiscale:
    """Return the first image that attributes describe."""
    try:
        image = attributes["multiscales"][0]
        given = image.get("axes") or _OLD_AXES
        listed = [axis if isinstance(axis, Mapping) else {"name": axis} for axis in given]
        axes = tuple(str(axis["name"]).lower() for axis in listed)
        units = [known_unit(str(axis.get("unit", ""))) for axis in listed]
        after = image.get("coordinateTransformations") or []
        levels = [_level(data, after, len(axes), place) for data in image["datasets"]]
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        raise FileFormatError(
            f"the multiscales of {place or 'the image'} are not as OME-Zarr has them "
            f"({type(error).__name__}: {error})"
        ) from error
    if not levels or len(set(axes)) < len(axes) or not {*AXES} <= set(axes):
        raise FileFormatError(f"expected an image with axes z, y and x, got {', '.join(axes)}")
    unit, ratios = _common_unit({a: units[axes.index(a)] for a in AXES})
    return Multiscale(axes, unit, ratios, levels, _channels(attributes))


def _channels(attributes: Mapping[str, Any]) -> tuple[Channel, ...]:
    """Return the channels in ``omero``, which gives colours as RRGGBB."""
    omero = attributes.get("omero")
    listed = omero.get("channels") if isinstance(omero, Mapping) else None
    found: list[Channel] = []
    for entry in listed if isinstance(listed, list) else []:
        given = entry if isinstance(entry, Mapping) else {}
        try:
            code = bytes.fromhex(str(given.get("color", "")).lstrip("#"))
            window = given.get("window")
            ends = [window["start"], window["end"]] if isinstance(window, Mapping) else None
            found.append(channel(given.get("label"), code, ends))
        except (KeyError, TypeError, ValueError):  # a name is worth more than a wrong colour
            found.append(channel(given.get("label")))
    return tuple(found)


def _common_unit(units: Mapping[str, str]) -> tuple[str, dict[str, float]]:
    """Return the unit of x and each unit over it; "" and ratios of 1 if they do not convert."""
    none = "", dict.fromkeys(AXES, 1.0)
    if not all(units.values()):
        return none
    try:
        along_x = parse_unit(units["x"])
        ratios = {axis: float(parse_unit(unit).to(along_x)) for axis, unit in units.items()}
    except (UnitsError, ValueError):
        return none
    return units["x"], ratios


def _level(data: Mapping[str, Any], after: Sequence[Any], count: int, place: str) -> ImageLevel:
    scale, shift = np.ones(count), np.zeros(count)
    for step in [*(data.get("coordinateTransformations") or []), *after]:
        kind = step["type"]
        if kind not in ("scale", "translation", "identity"):
            raise ValueError(f"unknown transformation {kind!r}")
        if kind == "identity":
            continue
        if len(step[kind]) != count:
            raise ValueError(f"expected {count} numbers, got {len(step[kind])}")
        numbers = np.array([float(number) for number in step[kind]])
        if kind == "scale":
            scale, shift = scale * numbers, shift * numbers
        else:
            shift = shift + numbers
    return ImageLevel(f"{place}/{data['path']}".strip("/"), scale.tolist(), shift.tolist())


def _level_number(arrays: Sequence[zarr.Array], image: Multiscale, asked: Any) -> int:
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
        cells = math.prod(image.count(array.shape, axis) for axis in AXES)
        if cells * (np.dtype(array.dtype).itemsize + _PICTURE) <= free:
            return number
    return len(arrays) - 1


def _channel_names(
    path: Path, image: Multiscale, shape: Sequence[int], asked: Any
) -> dict[int, str]:
    """Return number → name of the channels: labels, else numbers; the file's name of a lone one."""
    count = image.count(shape, "c")
    lone = [field_name(path.name.split(".")[0])]
    names = channel_fields(
        image.channels, lone if count == 1 else [f"channel_{k}" for k in range(count)]
    )
    chosen = range(count) if asked is None else [_numbered("channel", asked, count)]
    return {k: names[k] for k in chosen}


def _numbered(what: str, asked: Any, count: int) -> int:
    if not isinstance(asked, (int, np.integer)) or not 0 <= asked < count:
        raise InputError(f"{what} must be a number from 0 to {count - 1}, got {asked!r}")
    return int(asked)


def _grid(
    image: Multiscale, level: ImageLevel, shape: Sequence[int], options: Mapping[str, Any]
) -> CartesianGrid:
    """Return the grid of a resolution; the file gives the centre of the first voxel."""
    from ...grids import CartesianGrid

    counts = tuple(image.count(shape, axis) for axis in AXES)
    unit = options.get("unit") or image.unit
    if options.get("bounds") is not None or options.get("spacing") is not None:
        return equal_cells(counts, options, unit)
    bounds = []
    for axis, n in zip(AXES, counts, strict=True):
        k, ratio = image.axes.index(axis), image.ratios[axis]
        step = level.scale[k] * ratio
        low = level.translation[k] * ratio - 0.5 * step
        if not 0 < step < math.inf or not math.isfinite(low):
            raise FileFormatError(
                f"voxels of {level.place!r} have size {step} along {axis} and begin at {low}; "
                "give spacing=… in place of that"
            )
        bounds.append((low, low + n * step))
    return CartesianGrid.uniform(counts, bounds, unit=unit)


def _values(path: Path, place: str, axes: Sequence[str], time: int, channel: int) -> np.ndarray:
    """Return one channel at one time step, indexed [ix, iy, iz]."""
    chosen = {"t": time, "c": channel}
    with opened(path) as root:
        array: Any = checked(root[place])
        found = np.asarray(array[tuple(chosen.get(axis, slice(None)) for axis in axes)])
    kept = [axis for axis in axes if axis not in chosen]
    return found.transpose([kept.index(axis) for axis in AXES])
