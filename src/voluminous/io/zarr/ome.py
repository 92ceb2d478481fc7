"""OME-Zarr: images of microscopes, in several resolutions and channels.

Versions 0.4 and 0.5 of the specification, https://ngff.openmicroscopy.org; earlier ones have no
sizes of voxels.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...errors import FileFormatError, InputError, unknown_name
from ...memory import available_memory
from ..axes import AXES
from ..contract import FieldInfo
from ..scanners.placement import Placement, conversion, equal_voxels, length_unit
from ..scanners.voxels import Y_DOWN, Channel, VoxelReader, Voxels, channel, component_names
from .store import checked, opened, part, root_fits

if TYPE_CHECKING:
    import zarr

_OLD_AXES = ("t", "c", "z", "y", "x")
# A picture takes up to so many bytes a cell beside the values: four numbers between cell centres.
_PICTURE = 16


class OMEZarrReader(VoxelReader):
    """Reads the channels of one resolution level."""

    name = "ome-zarr"
    description = "an OME-Zarr image"
    suffixes = (".zarr",)
    options = {  # noqa: RUF012 - as in Reader
        **VoxelReader.options,
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
        fits = root_fits(path, head, lambda root: bool(_images(root)))
        return ".ome." in path.name.lower() if fits is None else fits

    def voxels(
        self,
        path: Path,
        *,
        level: int | None = None,
        channel: int | None = None,
        time: int | None = None,
        image: Any = None,
        bounds: Any = None,
        spacing: Any = None,
        unit: Any = None,
    ) -> Voxels:
        with opened(path) as root:
            result = _chosen_image(root, image)
            arrays = [checked(root[place]) for place, *_ in result.levels]
            number = _level_number(arrays, result, level)
            sizes = dict(zip(result.axes, arrays[number].shape, strict=True))
            dtype = np.dtype(arrays[number].dtype)
            pieces = dict(zip(result.axes, arrays[number].chunks, strict=True))
            finer = [dict(zip(result.axes, a.shape, strict=True)) for a in arrays[number:]]
        times, count = sizes.get("t", 1), sizes.get("c", 1)
        names = component_names(count)
        if time is None and times > 1:
            raise InputError(f"there are {times} times; choose one with time=0 … time={times - 1}")
        step = 0 if time is None else _numbered("time", time, times)
        numbers = range(count) if channel is None else [_numbered("channel", channel, count)]
        channels = (*result.channels, *[{}] * count)
        _, scale, shift = result.levels[number]
        shape = tuple(sizes[axis] for axis in AXES)
        if bounds is not None or spacing is not None:
            placement = equal_voxels(shape, spacing, unit or result.unit, bounds)
        else:
            placement = Placement(shift, np.diag(scale), unit or result.unit)

        places = [place for place, *_ in result.levels[number:]]
        return Voxels(
            shape=shape,
            dtype=dtype,
            placement=placement,
            load=functools.partial(_voxels, path, result.axes, places, step, tuple(numbers)),
            components=tuple(names[k] for k in numbers),
            name="channel" if count > 1 else path.name.split(".")[0],
            channels=[channels[k] for k in numbers],
            meta={"level": number, "levels": len(arrays), "time_number": step, **Y_DOWN},
            chunks=tuple(pieces[axis] for axis in AXES),
            coarser=[tuple(level[axis] for axis in AXES) for level in finer[1:]],
        )

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        return super().info(path, **{"time": 0, **options})  # those of all times are alike


def _voxels(
    path: Path,
    axes: tuple[str, ...],
    places: Sequence[str],
    time: int,
    channels: Sequence[int],
    component: int,
    box: Any = (slice(None),) * 3,
    level: int = 0,
) -> np.ndarray:
    chosen = {"t": time, "c": channels[component], **dict(zip(AXES, box, strict=True))}
    values = part(path, places[level], tuple(chosen[axis] for axis in axes))
    left = [axis for axis in axes if axis in AXES]
    return np.asarray(values.transpose([left.index(axis) for axis in AXES]))


class _Multiscale(NamedTuple):
    """An image in several resolutions, finest first."""

    axes: tuple[str, ...]  # t, c, z, y, x, as far as they are there, in the arrays' order
    unit: str  # of lengths; empty where there is none
    # Place of the array, and sizes of voxels and centre of the first along x, y, z.
    levels: list[tuple[str, np.ndarray, np.ndarray]]
    channels: tuple[Channel, ...]


def _multiscales(node: Any) -> Mapping[str, Any] | None:
    """Return the attributes that have ``multiscales``: version 0.5 has them in ``ome``."""
    for result in (node.attrs.get("ome"), dict(node.attrs)):
        if isinstance(result, Mapping) and isinstance(result.get("multiscales"), list):
            return result
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


def _chosen_image(root: Any, asked: Any) -> _Multiscale:
    images = _images(root)
    if asked is None and len(images) > 1:
        first = next(iter(images))
        raise InputError(f"there are images {', '.join(images)}; choose one with image={first!r}")
    place = str(asked).strip("/") if asked is not None else next(iter(images), "")
    if place not in images:
        raise unknown_name("image", place, images)
    try:
        return _parsed(images[place], place)
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(
            f"the multiscales of {place or 'the image'} are not as OME-Zarr has them "
            f"({type(error).__name__}: {error})"
        ) from error


def _parsed(attributes: Mapping[str, Any], place: str) -> _Multiscale:
    image = attributes["multiscales"][0]
    given = image.get("axes") or _OLD_AXES
    listed = [axis if isinstance(axis, Mapping) else {"name": axis} for axis in given]
    axes = tuple(str(axis["name"]).lower() for axis in listed)
    if not image["datasets"] or len(set(axes)) < len(axes) or not {*AXES} <= set(axes):
        raise FileFormatError(f"expected an image with axes z, y and x, got {', '.join(axes)}")
    order = [axes.index(axis) for axis in AXES]
    units = [length_unit(str(listed[k].get("unit", ""))) for k in order]
    factors = np.array([conversion(u, units[0]) if all(units) else 1.0 for u in units])
    levels = []
    for data in image["datasets"]:
        scale, shift = np.ones(len(axes)), np.zeros(len(axes))
        after = image.get("coordinateTransformations") or []
        for step in [*(data.get("coordinateTransformations") or []), *after]:
            kind = step["type"]
            numbers = np.array(step.get(kind, 0 if kind == "identity" else ()), float)
            if kind not in ("scale", "translation", "identity"):
                raise ValueError(f"unknown transformation {kind!r}")
            if kind != "identity" and numbers.shape != scale.shape:
                raise ValueError(f"expected {len(axes)} numbers, got {numbers.size}")
            factor = numbers if kind == "scale" else 1.0
            scale, shift = scale * factor, shift * factor
            shift = shift + (numbers if kind == "translation" else 0.0)
        levels.append(
            (f"{place}/{data['path']}".strip("/"), scale[order] * factors, shift[order] * factors)
        )
    return _Multiscale(axes, units[0] if all(units) else "", levels, _channels(attributes))


def _channels(attributes: Mapping[str, Any]) -> tuple[Channel, ...]:
    """Return the channels in ``omero``, which gives colours as RRGGBB."""
    omero = attributes.get("omero")
    listed = omero.get("channels") if isinstance(omero, Mapping) else None
    result: list[Channel] = []
    for entry in listed if isinstance(listed, list) else []:
        given = entry if isinstance(entry, Mapping) else {}
        try:
            code = bytes.fromhex(str(given.get("color", "")).lstrip("#"))
            window = given.get("window")
            ends = [window["start"], window["end"]] if isinstance(window, Mapping) else None
            result.append(channel(given.get("label"), code, ends))
        except (KeyError, TypeError, ValueError):  # a name is worth more than a wrong colour
            result.append(channel(given.get("label")))
    return tuple(result)


def _level_number(arrays: Sequence[zarr.Array[Any]], image: _Multiscale, asked: Any) -> int:
    for array, (place, *_) in zip(arrays, image.levels, strict=True):
        if len(array.shape) != len(image.axes) or 0 in array.shape:
            raise FileFormatError(
                f"{place!r} has shape {array.shape}, expected axes {', '.join(image.axes)} "
                "of at least one voxel"
            )
    if asked is not None:
        return _numbered("level", asked, len(arrays))
    free = available_memory() // 2
    for number, array in enumerate(arrays):
        cells = math.prod(
            n for n, axis in zip(array.shape, image.axes, strict=True) if axis in AXES
        )
        if cells * (np.dtype(array.dtype).itemsize + _PICTURE) <= free:
            return number
    return len(arrays) - 1


def _numbered(what: str, asked: Any, count: int) -> int:
    if not isinstance(asked, (int, np.integer)) or not 0 <= asked < count:
        raise InputError(f"{what} must be a number from 0 to {count - 1}, got {asked!r}")
    return int(asked)
