"""Gradients and Laplacians on grids of any cells, from the cells beyond their faces.

The gradient is the linear function through the cell's own value that fits the cells beyond its six
faces best (least squares), each difference weighted by the inverse cube of its distance: among
cells in line that is the slope of the parabola through three of them, as on a Cartesian grid,
whatever their widths. It is exact for linear fields everywhere.

The Laplacian is made of parabolas through the cell and, along each axis, its two neighbours, moved
onto the axis with the gradient; so it vanishes for linear fields. At the surface the second
derivative across it is that of the cell further in.

Trees have kernels for derivatives (`tree_slopes`), which are more exact at jumps of level.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..geometry import metric, position
from ..grids.contract import basis, native_centers
from ..memory import check_memory

if TYPE_CHECKING:
    from ..grids.contract import Grid

_CHUNK = 1 << 16
# Where to look, in cell widths: just beyond the face, since neighbours may be narrow.
_AHEAD = 0.5 + 2**-6
# From a corner of the domain inwards, one step for each axis.
_STEPS_INWARDS = 3
# A direction in which neighbours tell so little, compared with the others, is left out.
_LEAST = 1e-12


class NeighbourDifferences:
    """Differences between neighbours, which are found by the `locate` of a grid.

    `values` (N,).
    """

    def __init__(self, grid: Grid, evaluate: Callable[[int, int], np.ndarray]) -> None:
        size = grid.size
        check_memory(40 * size, f"differences between {size} cells", "coarsen the volume")
        self.grid, self.values = grid, evaluated(size, evaluate)
        self.centers = np.asarray(grid.cell_centers(0, size))

    def gradient(self, runs: Sequence[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
        """Return gradients (3, n) of runs of cells, and which cells are at the surface (n,)."""
        parts = [self._neighbours(first, last) for first, last in runs]
        ends = np.concatenate([(weight == 0.0).any(axis=0) for _, _, _, weight in parts])
        return np.concatenate([_gradient(*part[1:]) for part in parts], axis=1), ends

    def derivative(self, operation: str) -> np.ndarray:
        """Return a derivative in all cells, (N,); operations: see `structured`."""
        out, size = np.empty(self.grid.size), self.grid.size
        if operation == "laplacian":
            check_memory(48 * size, f"second differences of {size} cells", "coarsen the volume")
            bends, inner = np.empty((3, size)), np.empty((3, size), np.int64)
        for first, last in _parts(size):
            number, *differences = self._neighbours(first, last)
            gradient = _gradient(*differences)
            if operation == "laplacian":
                along = basis(self.grid, first, last)
                bends[:, first:last] = _second(along, gradient, *differences)
                inner[:, first:last] = np.where(number[1::2] >= 0, number[1::2], number[::2])
            elif operation == "gradmag":
                out[first:last] = np.sqrt(np.sum(gradient * gradient, axis=0))
            else:
                out[first:last] = gradient["xyz".index(operation[-1])]
        return filled_up(bends, inner).sum(axis=0) if operation == "laplacian" else out

    def _neighbours(
        self, first: int, last: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return what lies beyond the faces of cells: below and above, for each axis in turn.

        Numbers (6, n), -1 where nothing is; vectors from centre to centre (6, 3, n), differences of
        the values (6, n), and inverse cubes of the distances (6, n), 0 where nothing is.
        """
        grid, own = self.grid, np.arange(first, last)
        middle = native_centers(grid, first, last)
        width = grid.cell_sizes(first, last) / metric(tuple(grid.coordinates), middle)
        number = np.empty((6, last - first), np.int64)
        for face in range(6):
            place = middle.copy()
            place[face // 2] += (-_AHEAD, _AHEAD)[face % 2] * width[face // 2]
            points = position(tuple(grid.coordinates), place).T
            number[face] = grid.locate(np.ascontiguousarray(points))
        number[number == own] = -1  # one cell goes all around
        there = number >= 0
        vector = np.moveaxis(self.centers[:, number] - self.centers[:, None, own], 0, 1)
        distance = np.sqrt(np.sum(vector * vector, axis=1))
        weight = np.where(there, 1.0 / np.where(there, distance, 1.0) ** 3, 0.0)
        return number, vector, self.values[number] - self.values[own], weight


def evaluated(size: int, evaluate: Callable[[int, int], np.ndarray]) -> np.ndarray:
    """Return in double precision what `evaluate` gives for all cells, some at a time."""
    values = np.empty(size)
    for first, last in _parts(size):
        values[first:last] = evaluate(first, last)
    return values


def _parts(size: int) -> Iterator[tuple[int, int]]:
    return ((first, min(first + _CHUNK, size)) for first in range(0, size, _CHUNK))


def filled_up(
    bends: np.ndarray, inner: np.ndarray, unknown: np.ndarray | bool = False
) -> np.ndarray:
    """Return second derivatives (3, N), at the surface those of the cells further in.

    They are NaN where a neighbour is missing, and `inner` (3, N) is the number of the one on the
    other side there. `unknown` (N,) is where others know more, if there are any that know.
    """
    for own, beside in zip(bends, inner, strict=True):
        waiting = np.isnan(own) | unknown
        for _ in range(_STEPS_INWARDS):
            lacking = np.flatnonzero(waiting)
            own[lacking] = own[beside[lacking]]
            waiting[lacking] = waiting[beside[lacking]]
        own[np.isnan(own)] = 0.0  # two cells are all there is
    return bends


def _gradient(vector: np.ndarray, rise: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the gradients (3, n) that fit the differences best; zero where nothing tells."""
    matrix = np.einsum("fn,fan,fbn->nab", weight, vector, vector)
    right = np.einsum("fn,fan->na", np.where(weight > 0.0, weight * rise, 0.0), vector)
    regular = np.linalg.det(matrix) > _LEAST * np.trace(matrix, axis1=1, axis2=2) ** 3
    out = np.zeros_like(right)
    out[regular] = np.linalg.solve(matrix[regular], right[regular, :, None])[..., 0]
    inverse = np.linalg.pinv(matrix[~regular], rcond=_LEAST, hermitian=True)
    out[~regular] = np.einsum("nab,nb->na", inverse, right[~regular])
    return np.asarray(out.T)


def _second(
    along: np.ndarray,
    gradient: np.ndarray,
    vector: np.ndarray,
    rise: np.ndarray,
    weight: np.ndarray,
) -> np.ndarray:
    """Return the second derivatives along directions (3, 3, n); NaN where a neighbour is missing.

    The part of a rise that is aside of a direction follows from the gradient.
    """
    along = np.repeat(along, 2, axis=0)
    distance = np.sum(vector * along, axis=1)
    slope = np.sum(along * gradient, axis=1)
    rise = rise - (np.sum(vector * gradient, axis=1) - distance * slope)
    there = weight > 0.0
    both = there[::2] & there[1::2] & (distance[::2] < 0) & (distance[1::2] > 0)
    before, behind = np.where(both, distance[::2], -1.0), np.where(both, distance[1::2], 1.0)
    bend = 2.0 * (rise[1::2] / behind - rise[::2] / before) / (behind - before)
    return np.where(both, bend, np.nan)
