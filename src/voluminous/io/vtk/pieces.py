"""Data in pieces, each a box of points: put together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...errors import FileFormatError
from ...memory import check_memory
from ..payload import checked_shape
from .axes import Even, Uneven
from .dataset import Array, Dataset


def together(parts: Sequence[Dataset]) -> Dataset:
    """Return the smallest box that holds all pieces, with the arrays that all have.

    Raises
    ------
    FileFormatError
        If there is no piece, or pieces do not fill the box.
    """
    if not parts:
        raise FileFormatError("expected a piece with points in it, there is none")
    first = parts[0]
    if len(parts) == 1:
        return first
    low = np.min([part.low for part in parts], axis=0)
    counts = np.max([np.add(part.low, part.points) for part in parts], axis=0) - low
    points = checked_shape(counts, "the number of points")
    there = sum(math.prod(part.points) for part in parts)
    if there < math.prod(points):
        raise FileFormatError(
            f"the pieces have {there} points, expected at least {math.prod(points)} to fill a box "
            f"of {' x '.join(map(str, points))}"
        )
    starts = [np.subtract(part.low, low) for part in parts]
    known = [{(array.at, array.name): array for array in part.arrays} for part in parts]
    whole = Dataset(points, _arrange(parts, starts, low, points), [], first.active, first.meta)
    arrays = [
        _joined(whole, starts, [arrays[key] for arrays in known])
        for key in known[0]
        if all(key in arrays for arrays in known)
    ]
    return replace(whole, arrays=arrays, low=tuple(int(n) for n in low))


def _arrange(parts: Sequence[Dataset], starts: Any, low: Any, points: tuple[int, ...]) -> Any:
    first = parts[0].arrange
    if isinstance(first, Even):
        return replace(first, low=tuple(int(n) for n in low), points=points)
    lines = [np.full(n, np.nan) for n in points]
    for part, start in zip(parts, starts, strict=True):
        place: Any = part.arrange
        for axis, own in enumerate(place.lines):
            lines[axis][start[axis] : start[axis] + len(own)] = own
    return Uneven(tuple(lines))


def _joined(whole: Dataset, starts: Any, arrays: list[Array]) -> Array:
    first = arrays[0]
    if len({(array.dtype, array.components) for array in arrays}) > 1:
        raise FileFormatError(f"array {first.name!r} has another type in some of the pieces")

    def load() -> np.ndarray:
        shape = (*whole.shape(first.at)[::-1], first.components)
        size = math.prod(shape) * (first.dtype.itemsize + 1)
        check_memory(size, f"putting together {first.name!r}", "open one of the pieces")
        out, filled = np.empty(shape, first.dtype), np.zeros(shape[:3], bool)
        for array, start in zip(arrays, starts, strict=True):
            values = array.load()
            ends = zip(start[::-1], values.shape[:3], strict=True)
            box = tuple(slice(a, a + n) for a, n in ends)
            out[box], filled[box] = values, True
        if not filled.all():
            raise FileFormatError(
                f"array {first.name!r}: {np.count_nonzero(~filled)} of {filled.size} values are in "
                "none of the pieces"
            )
        return out

    return replace(first, load=load)
