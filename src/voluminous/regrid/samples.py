"""What two sets of cells of any shape share, by points spread in them.

Of a point it is known in which cell of either grid it lies. Where the cells of the one grid are the
smaller ones, its points are taken, and elsewhere those of the other: each region of space is
counted once, and no cell is too small to be met.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..geometry import metric, mirror_images, position
from ..progress import reported_range

# Points looked at at once.
_CHUNK = 1 << 20
# Intervals of angles that a point stands for are not longer than this over the number of points per
# axis: cells may go all around. With four points there a wedge kept its integral on an axisymmetric
# grid to 30 %, with a 64th of the circle for each to 0.5 %.
_ANGLE = np.pi / 8.0

Overlap = tuple[np.ndarray, np.ndarray, np.ndarray]


def sampled_overlaps(cells: Any, others: Any, count: int) -> Iterator[Overlap]:
    """Yield what cells of one grid share with the cells of another, from count³ points or more.

    Yields
    ------
    cell, other : int arrays, shape (n,)
        Flat numbers.
    volume : array, shape (n,)
        Of what they share, about. A pair comes more than once.
    """
    yield from _smaller(cells, others, count, equal=True)
    for other, cell, volume in _smaller(others, cells, count, equal=False):
        yield cell, other, volume


def _smaller(cells: Any, others: Any, count: int, *, equal: bool) -> Iterator[Overlap]:
    """Yield the same for places where the cells are smaller than the others, or equal."""
    own, theirs = (grid.cell_volumes.reshape(-1) for grid in (cells, others))
    for cell, points, volume in points_in(cells, count):
        other = others.locate(points)
        small = own[cell] <= theirs[other] if equal else own[cell] < theirs[other]
        counts = (other >= 0) & small
        yield cell[counts], other[counts], volume[counts]


def points_in(grid: Any, count: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield points spread evenly in the cells of a grid.

    Yields
    ------
    cell : int array, shape (n,)
        The cells they are in.
    points : array, shape (n, 3)
    volume : array, shape (n,)
        What each stands for; a cell's add up to its volume.
    """
    volumes, images = grid.cell_volumes.reshape(-1), mirror_images(grid)
    counts = points_along(grid, count)
    steps = [(np.arange(n) + 0.5) / n - 0.5 for n in counts]
    offsets = np.array(np.meshgrid(*steps, indexing="ij")).reshape(3, 1, -1)
    step = max(1, _CHUNK // (offsets.shape[2] * len(images)))
    for first in reported_range(grid.size, step):
        last = min(first + step, grid.size)
        own, weight = _within(grid, offsets, first, last)
        share = weight / weight.sum(axis=1, keepdims=True) * volumes[first:last, None]
        points = position(tuple(grid.coordinates), own.reshape(3, -1)).T
        cell = np.repeat(np.arange(first, last), offsets.shape[2])
        for image in images:
            yield cell, np.ascontiguousarray(points * image), share.ravel() / len(images)


def points_along(grid: Any, count: int) -> list[int]:
    """Return how many points are taken along each axis of a cell: more along wide angles."""
    widths = [
        np.diff(edges).max() if name in ("theta", "phi") else 0.0
        for name, edges in zip(grid.coordinates, grid.edges, strict=False)
    ]
    return [max(count, math.ceil(width * count / _ANGLE - 1e-9)) for width in widths]


def _within(grid: Any, offsets: np.ndarray, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
    """Return own coordinates (3, n, m) of points in cells, and volumes per coordinate (n, m)."""
    system = tuple(grid.coordinates)
    centers = grid.native_centers(first, last)
    widths = grid.cell_sizes(first, last) / metric(system, centers)
    own = centers[..., None] + widths[..., None] * offsets
    return own, np.prod(metric(system, own.reshape(3, -1)), axis=0).reshape(own.shape[1:])
