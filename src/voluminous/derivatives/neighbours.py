"""Differences between neighbours that may be of any size: gradients and Laplacians on trees.

Through each face of a cell we look at the cell beyond; where that is smaller, at four of the cells
beyond (all of them where one cell meets 2 × 2). The gradient is the linear function through the
cell's own value that fits those best (least squares), each difference weighted by the inverse cube
of its distance: among cells in line that is the slope of the parabola through three of them, as on
a Cartesian grid, whatever their widths. It is exact for linear fields everywhere, at jumps of level
and at the surface of the domain too.

On trees of boxes, straight or bent, kernels do the same, but at jumps of level derivatives are
those of quadratic functions (`tree_slopes`).

The Laplacian is made of parabolas through the cell and, along each axis, the means of what lies
beyond its two faces, moved onto the axis with the gradient; so it vanishes for linear fields. At
the surface the second derivative across it is that of the cell further in; across the only cell
along an angle, where all is symmetric, it follows from the gradient.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..geometry import metric, position
from ..memory import check_memory

if TYPE_CHECKING:
    from ..grids.contract import Grid

_CHUNK = 1 << 16
# Where to look, in cell widths: just beyond the face (neighbours may be narrow), and aside where
# the centres of cells half as wide are.
_AHEAD, _ASIDE = 0.5 + 2**-6, 0.25
_SIDES = ((1, 1), (1, -1), (-1, 1), (-1, -1))
# From a corner of the domain inwards, one step for each axis.
_STEPS_INWARDS = 3
# A direction in which neighbours tell so little, compared with the others, is left out.
_LEAST = 1e-12


class NeighbourDifferences:
    """What is known of all cells of any grid, to compare neighbours.

    Parameters
    ----------
    grid : grid
        See `grids.contract.Grid`; neighbours are found by its `locate`.
    evaluate : callable
        Returns what is differentiated, for the cells between two numbers.

    Attributes
    ----------
    values, levels : arrays, shape (N,)
    centers : array, shape (3, N)
    """

    def __init__(self, grid: Grid, evaluate: Callable[[int, int], np.ndarray]) -> None:
        size = grid.size
        check_memory(40 * size, f"differences between {size} cells", "coarsen the volume")
        self.grid, self.values = grid, evaluated(size, evaluate)
        self.levels = np.asarray(grid.levels).reshape(-1)
        self.centers = np.asarray(grid.cell_centers(0, size))

    def gradient(self, runs: Sequence[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
        """Return gradients (3, n) of runs of cells, and which cells are at the surface (n,)."""
        gradients, ends = zip(*(self._of_run(*run) for run in runs), strict=True)
        return np.concatenate(gradients, axis=1), np.concatenate(ends)

    def _of_run(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        faces, count = _faces(self, first, last), last - first
        missing = [np.bincount(face.cell, minlength=count) == 0 for face in faces]
        return _gradient(faces, count), np.any(missing, axis=0)

    def derivative(self, operation: str) -> np.ndarray:
        """Return a derivative in all cells, float64, shape (N,)."""
        if operation == "laplacian":
            return self._laplacian()
        out = np.empty(self.grid.size)
        for first, last in _parts(self.grid.size):
            gradient = _gradient(_faces(self, first, last), last - first)
            if operation == "gradmag":
                out[first:last] = np.sqrt(np.sum(gradient * gradient, axis=0))
            else:
                out[first:last] = gradient["xyz".index(operation[-1])]
        return out

    def _laplacian(self) -> np.ndarray:
        size = self.grid.size
        check_memory(48 * size, f"second differences of {size} cells", "coarsen the volume")
        bends, inner = np.empty((3, size)), np.empty((3, size), np.int64)
        for first, last in _parts(size):
            part = slice(first, last)
            bends[:, part], inner[:, part] = _second_derivatives(self, first, last)
        return filled_up(bends, inner).sum(axis=0)


@dataclass
class Face:
    """What lies beyond one face of some cells: m neighbours.

    Attributes
    ----------
    cell : int array, shape (m,)
        Whose neighbours they are, counted from the first of the cells.
    number : int array, shape (m,)
        Which cells they are.
    way : array, shape (3, m)
        From centre to centre.
    rise : array, shape (m,)
        Difference of the values.
    weight : array, shape (m,)
        One over the number of neighbours that the cell has beyond this face.
    """

    cell: np.ndarray
    number: np.ndarray
    way: np.ndarray
    rise: np.ndarray
    weight: np.ndarray

    def summed(self, values: np.ndarray, count: int) -> np.ndarray:
        """Return the sums of values (m,) over the neighbours of each of `count` cells."""
        return np.bincount(self.cell, values, count)


@dataclass
class CellRun:
    """Some consecutive cells: middles and widths in their own coordinates, both (3, n)."""

    first: int
    last: int
    middle: np.ndarray
    width: np.ndarray


def evaluated(size: int, evaluate: Callable[[int, int], np.ndarray]) -> np.ndarray:
    """Return in double precision what `evaluate` gives for all cells, some at a time."""
    values = np.empty(size)
    for first, last in _parts(size):
        values[first:last] = evaluate(first, last)
    return values


def _parts(size: int) -> list[tuple[int, int]]:
    return [(first, min(first + _CHUNK, size)) for first in range(0, size, _CHUNK)]


def filled_up(
    bends: np.ndarray, inner: np.ndarray, unknown: np.ndarray | bool = False
) -> np.ndarray:
    """Return second derivatives (3, N), at the surface those of the cells further in."""
    for own, beside in zip(bends, inner, strict=True):
        waiting = np.isnan(own) | unknown
        for _ in range(_STEPS_INWARDS):
            lacking = np.flatnonzero(waiting)
            own[lacking] = own[beside[lacking]]
            waiting[lacking] = waiting[beside[lacking]]
        own[np.isnan(own)] = 0.0  # two cells are all there is
    return bends


def _second_derivatives(
    cells: NeighbourDifferences, first: int, last: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return those along the axes of some cells, and who else may know; see `filled_up`."""
    faces, basis = _faces(cells, first, last), cells.grid.basis(first, last)
    gradient = _gradient(faces, last - first)
    own = np.arange(first, last)
    bends, inner = np.empty((3, last - first)), np.empty((3, last - first), np.int64)
    for axis, along in enumerate(basis):
        pair = faces[2 * axis : 2 * axis + 2]
        bends[axis] = _second(pair, along, gradient)
        inner[axis] = own
        for face in pair:
            inner[axis, face.cell] = face.number
        alone = inner[axis] == own  # one cell goes all around
        bends[axis, alone] = _turning(cells, axis, own[alone], gradient[:, alone])
    return bends, inner


def _turning(
    cells: NeighbourDifferences, axis: int, which: np.ndarray, gradient: np.ndarray
) -> np.ndarray:
    """Return the second derivative across the only cell along an axis, where all is symmetric.

    Along an angle the gradient turns: it is the gradient's part away from the axis (centre), over
    the distance from there.
    """
    name = cells.grid.coordinates[axis]
    away = {"phi": (0, 1), "theta": (0, 1, 2)}.get(name, ())
    center = cells.centers[:, which]
    square = np.sum(center[list(away)] ** 2, axis=0)
    inward = np.sum((center * gradient)[list(away)], axis=0)
    return np.asarray(np.divide(inward, square, out=np.zeros(len(which)), where=square > 0.0))


def _faces(cells: NeighbourDifferences, first: int, last: int) -> list[Face]:
    """Return what lies beyond the faces of cells: below and above, for each axis in turn."""
    grid = cells.grid
    middle = grid.native_centers(first, last)
    width = grid.cell_sizes(first, last) / metric(tuple(grid.coordinates), middle)
    part = CellRun(first, last, middle, width)
    return [_face(cells, part, axis, sense) for axis in range(3) for sense in (-1, 1)]


def _face(cells: NeighbourDifferences, part: CellRun, axis: int, sense: int) -> Face:
    """Look through a face: once, or at four places where smaller cells or holes are beyond it."""
    cell = np.arange(part.last - part.first)
    number = _beyond(cells, part, cell, axis, sense, _SIDES[0])
    many = cell[(number < 0) | (cells.levels[number] > cells.levels[part.first : part.last])]
    others = [_beyond(cells, part, many, axis, sense, side) for side in _SIDES[1:]]
    cell, number = np.concatenate([cell, *[many] * 3]), np.concatenate([number, *others])
    there = (number >= 0) & (number != part.first + cell)
    cell, number = cell[there], number[there]
    own, count = part.first + cell, np.bincount(cell, minlength=1)
    return Face(
        cell,
        number,
        cells.centers[:, number] - cells.centers[:, own],
        cells.values[number] - cells.values[own],
        1.0 / count[cell],
    )


def _beyond(
    cells: NeighbourDifferences,
    part: CellRun,
    which: np.ndarray,
    axis: int,
    sense: int,
    side: tuple[int, int],
) -> np.ndarray:
    offset = np.insert(_ASIDE * np.array(side), axis, _AHEAD * sense)
    own = part.middle[:, which] + part.width[:, which] * offset[:, None]
    place = position(tuple(cells.grid.coordinates), own)
    return np.asarray(cells.grid.locate(np.ascontiguousarray(place.T)))


def _gradient(faces: list[Face], count: int) -> np.ndarray:
    """Return the gradients (3, n) that fit the differences best; zero where nothing tells."""
    matrix, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for face in faces:
        square = np.sum(face.way * face.way, axis=0)
        pull = face.weight / (square * np.sqrt(square)) * face.way
        for a in range(3):
            right[:, a] += face.summed(pull[a] * face.rise, count)
            for b in range(a + 1):
                matrix[:, a, b] += face.summed(pull[a] * face.way[b], count)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        matrix[:, a, b] = matrix[:, b, a]
    return _solved(matrix, right).T


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the solutions (n, 3) of small symmetric systems, the least ones of singular ones."""
    size = np.trace(matrix, axis1=1, axis2=2)
    regular = np.linalg.det(matrix) > _LEAST * size**3
    out = np.zeros_like(right)
    out[regular] = np.linalg.solve(matrix[regular], right[regular, :, None])[..., 0]
    inverse = np.linalg.pinv(matrix[~regular], rcond=_LEAST, hermitian=True)
    out[~regular] = np.einsum("nab,nb->na", inverse, right[~regular])
    return out


def _second(pair: list[Face], along: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Return the second derivative along a direction (3, n), from the faces before and behind.

    NaN where one has nothing beyond.
    """
    (before, fell), (behind, rose) = (_onto(face, along, gradient) for face in pair)
    both = (before < 0) & (behind > 0)
    before, behind = np.where(both, before, -1.0), np.where(both, behind, 1.0)
    return np.where(both, 2.0 * (rose / behind - fell / before) / (behind - before), np.nan)


def _onto(face: Face, along: np.ndarray, gradient: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far away a face's neighbours are along a direction, and the rise to there."""
    ahead, slope = along[:, face.cell], gradient[:, face.cell]
    distance = np.sum(face.way * ahead, axis=0)
    aside = np.sum(face.way * slope, axis=0) - distance * np.sum(ahead * slope, axis=0)
    count = along.shape[1]
    rise = face.summed(face.weight * (face.rise - aside), count)
    return face.summed(face.weight * distance, count), rise
