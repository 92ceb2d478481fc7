"""Differences between neighbours that may be of any size: gradients and Laplacians on trees.

Through each face of a cell we look at the cell beyond; where that is smaller, at four of the cells
beyond (all of them where one cell meets 2 × 2). The gradient is the linear function through the
cell's own value that fits those best (least squares), each difference weighted by the inverse cube
of its distance: among cells in line that is the slope of the parabola through three of them, as on
a Cartesian grid, whatever their widths. It is exact for linear fields everywhere, at jumps of level
and at the surface of the domain too.

The Laplacian is made of parabolas through the cell and, along each axis, the means of what lies
beyond its two faces, moved onto the axis with the gradient; so it vanishes for linear fields. An
axis along which a neighbour is missing is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..geometry import metric, position
from ..memory import check_memory

_CHUNK = 1 << 16
# Where to look, in cell widths: just beyond the face (neighbours may be narrow), and aside where
# the centres of cells half as wide are.
_AHEAD, _ASIDE = 0.5 + 2**-6, 0.25
_SIDES = ((1, 1), (1, -1), (-1, 1), (-1, -1))
# A direction in which neighbours tell so little, compared with the others, is left out.
_LEAST = 1e-12


class Cells:
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

    def __init__(self, grid: Any, evaluate: Callable[[int, int], np.ndarray]) -> None:
        size = grid.size
        check_memory(40 * size, f"differences between {size} cells", "coarsen the volume")
        self.grid, self.values = grid, np.empty(size)
        for first, last in _parts(size):
            self.values[first:last] = evaluate(first, last)
        self.levels = np.asarray(grid.levels).reshape(-1)
        self.centers = np.asarray(grid.cell_centers(0, size))

    def gradient(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Return gradients (3, n) of consecutive cells, and which cells are at the surface (n,)."""
        faces, count = _faces(self, first, last), last - first
        missing = [np.bincount(face.cell, minlength=count) == 0 for face in faces]
        return _gradient(faces, count), np.any(missing, axis=0)

    def derivative(self, operation: str) -> np.ndarray:
        """Return a derivative in all cells, float64, shape (N,).

        Parameters
        ----------
        operation : str
            See `differences.differentiate`.
        """
        out = np.empty(self.grid.size)
        for first, last in _parts(self.grid.size):
            out[first:last] = _differentiated(self, operation, first, last)
        return out


@dataclass
class Face:
    """What lies beyond one face of some cells: m neighbours.

    Attributes
    ----------
    cell : int array, shape (m,)
        Whose neighbours they are, counted from the first of the cells.
    way : array, shape (3, m)
        From centre to centre.
    rise : array, shape (m,)
        Difference of the values.
    weight : array, shape (m,)
        One over the number of neighbours that the cell has beyond this face.
    """

    cell: np.ndarray
    way: np.ndarray
    rise: np.ndarray
    weight: np.ndarray

    def summed(self, values: np.ndarray, count: int) -> np.ndarray:
        """Return the sums of values (m,) over the neighbours of each of `count` cells."""
        return np.bincount(self.cell, values, count)


@dataclass
class Part:
    """Some consecutive cells: middles and widths in their own coordinates, both (3, n)."""

    first: int
    last: int
    middle: np.ndarray
    width: np.ndarray


def _parts(size: int) -> list[tuple[int, int]]:
    return [(first, min(first + _CHUNK, size)) for first in range(0, size, _CHUNK)]


def _differentiated(cells: Cells, operation: str, first: int, last: int) -> np.ndarray:
    faces = _faces(cells, first, last)
    gradient = _gradient(faces, last - first)
    if operation == "gradmag":
        return np.asarray(np.sqrt(np.sum(gradient * gradient, axis=0)))
    if operation == "laplacian":
        basis = cells.grid.basis(first, last)
        pairs = zip(faces[::2], faces[1::2], basis, strict=True)
        return np.asarray(sum(_second(pair, along, gradient) for *pair, along in pairs))
    return np.asarray(gradient["xyz".index(operation[-1])])


def _faces(cells: Cells, first: int, last: int) -> list[Face]:
    """Return what lies beyond the faces of cells: below and above, for each axis in turn."""
    grid = cells.grid
    middle = grid.native_centers(first, last)
    width = grid.cell_sizes(first, last) / metric(tuple(grid.coordinates), middle)
    part = Part(first, last, middle, width)
    return [_face(cells, part, axis, sense) for axis in range(3) for sense in (-1, 1)]


def _face(cells: Cells, part: Part, axis: int, sense: int) -> Face:
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
        cells.centers[:, number] - cells.centers[:, own],
        cells.values[number] - cells.values[own],
        1.0 / count[cell],
    )


def _beyond(
    cells: Cells, part: Part, which: np.ndarray, axis: int, sense: int, side: tuple[int, int]
) -> np.ndarray:
    """Return the cells at a place beyond a face of some cells of a part."""
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
    """Return the second derivative along a direction (3, n), from the faces before and behind."""
    (before, fell), (behind, rose) = (_onto(face, along, gradient) for face in pair)
    both = (before < 0) & (behind > 0)
    before, behind = np.where(both, before, -1.0), np.where(both, behind, 1.0)
    return np.where(both, 2.0 * (rose / behind - fell / before) / (behind - before), 0.0)


def _onto(face: Face, along: np.ndarray, gradient: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far away a face's neighbours are along a direction, and the rise to there."""
    ahead, slope = along[:, face.cell], gradient[:, face.cell]
    distance = np.sum(face.way * ahead, axis=0)
    aside = np.sum(face.way * slope, axis=0) - distance * np.sum(ahead * slope, axis=0)
    count = along.shape[1]
    rise = face.summed(face.weight * (face.rise - aside), count)
    return face.summed(face.weight * distance, count), rise
