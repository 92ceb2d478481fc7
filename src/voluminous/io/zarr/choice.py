"""Which part of a microscope's image: the resolution, the time, the channels, and their voxels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError
from ...memory import available_memory
from ..arrays.layout import AXES, equal_cells
from ..channels import channel_fields
from ..names import field_name
from .multiscale import Level, Multiscale

if TYPE_CHECKING:
    from ...grids import CartesianGrid

# A picture takes up to so many bytes a cell beside the values: four numbers between cell centres.
_PICTURE = 16


def level_number(arrays: Sequence[Any], image: Multiscale, asked: Any) -> int:
    """Return the resolution asked for, or the finest of which a picture fits into memory.

    Raises
    ------
    FileFormatError
        If an array has other axes than the image.
    InputError
        If there is no such resolution.
    """
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
    """Return the time asked for, or the only one.

    Raises
    ------
    InputError
        If there are several and none is asked for, or there is no such time.
    """
    count = int(shape[image.axes.index("t")]) if "t" in image.axes else 1
    if asked is None and count > 1:
        raise InputError(f"there are {count} times; choose one with time=0 … time={count - 1}")
    return 0 if asked is None else _numbered("time", asked, count)


def channel_names(image: Multiscale, shape: Sequence[int], stem: str, asked: Any) -> dict[int, str]:
    """Return number → name of the channels: their labels, else numbered, or the file's if alone.

    Raises
    ------
    InputError
        If there is no such channel.
    """
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
    """Return the grid of a resolution; the file tells the centre of the first voxel.

    Raises
    ------
    FileFormatError
        If the file gives voxels of no size, and no option does.
    """
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
