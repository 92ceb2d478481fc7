"""Layers: patches of finer cells over a base grid, each inside its parent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import FileFormatError
from .grid_file import DEEPEST, GridFile

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Boxes:
    """The base grid and its layers, in cells of their own levels.

    Attributes
    ----------
    level : array of int64, shape (n + 1,)
    low, shape : array of int64, shape (n + 1, 3)
        First cell, counted across the domain, and number of cells.
    """

    level: Ints
    low: Ints
    shape: Ints


def boxes(grid: GridFile) -> Boxes:
    """Return where the layers of a grid are.

    Raises
    ------
    FileFormatError
        If one is not inside its parent, or the tree is too deep.
    """
    layers = np.zeros((0, 7), np.int64) if grid.layers is None else grid.layers
    count = len(layers) + 1
    level = np.zeros(count, np.int64)
    low, shape = np.zeros((count, 3), np.int64), np.zeros((count, 3), np.int64)
    shape[0] = grid.shape
    for k, (parent, *numbers) in enumerate(layers.tolist(), start=1):
        if not 0 <= parent < k:
            raise FileFormatError(
                f"the parent of layer {k} must be from 0 to {k - 1}, got {parent}: a layer comes "
                "after its parent"
            )
        first, cells = [n - 1 for n in numbers[:3]], numbers[3:]
        whole = shape[parent].tolist()
        if any(f < 0 or n < 1 or f + n > m for f, n, m in zip(first, cells, whole, strict=True)):
            raise FileFormatError(
                f"layer {k} begins at cell {numbers[:3]} and covers {cells} of its parent "
                f"{parent}, which has {whole}"
            )
        level[k] = level[parent] + 1
        low[k] = grid.factors * (low[parent] + first)
        shape[k] = grid.factors * cells
    if level.max() > DEEPEST:
        raise FileFormatError(f"layers are {level.max()} levels deep; {DEEPEST} are the most")
    return Boxes(level, low, shape)


def uncovered(grid: GridFile) -> list[NDArray[np.bool_]]:
    """Return, for the base grid and each layer, which cells no finer layer covers.

    Takes a byte per cell in the file.

    Raises
    ------
    FileFormatError
        If layers with the same parent overlap.
    """
    found = boxes(grid)
    seen = [np.ones(shape, bool) for shape in found.shape.tolist()]
    layers = () if grid.layers is None else grid.layers.tolist()
    for k, (parent, *numbers) in enumerate(layers, start=1):
        ranges = zip(numbers[:3], numbers[3:], strict=True)
        part = tuple(slice(first - 1, first - 1 + count) for first, count in ranges)
        if not seen[parent][part].all():
            raise FileFormatError(f"layer {k} overlaps another one on its parent {parent}")
        seen[parent][part] = False
    return seen


def leaves(grid: GridFile) -> tuple[Ints, Ints, Ints]:
    """Return the cells that are seen: levels, indices in cells of their levels, and their values.

    The last one says which of the values in the file they have.
    """
    found, seen = boxes(grid), uncovered(grid)
    index, value, first = [], [], 0
    for low, mask in zip(found.low, seen, strict=True):
        flat = np.flatnonzero(mask.ravel(order="F"))
        index.append(np.stack(np.unravel_index(flat, mask.shape, order="F"), axis=1) + low)
        value.append(first + flat)
        first += mask.size
    level = np.repeat(found.level, [len(part) for part in value])
    return level, np.concatenate(index), np.concatenate(value)
