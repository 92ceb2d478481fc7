"""Derivatives at jumps of level: quadratic functions that fit all cells around best.

Beyond a face where cells are of another size their centres lie aside of the axis, and parabolas
along it are off by as much there as second derivatives are, however small the cells. The quadratic
function through a cell's own value that fits the others best (least squares, weighted by the
inverse fourth power of the distance) is exact for quadratic fields. For others second derivatives
are off by the first order in the cells' size, and slopes by the second, where those of linear
functions are off by the first.

Looked for are the cells at 56 places: those of a lattice with half the cell's spacing, 4 points
wide, which lie around it. A cell that is found more than once counts as often. Where cells are much
narrower along one axis the lattice is laid a second time, wider along that one.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr, from_host

if TYPE_CHECKING:
    from .cell_slopes import CellSlopes, Part

_LATTICE = (-0.75, -0.25, 0.25, 0.75)
_PLACES = np.array(
    [place for place in itertools.product(_LATTICE, repeat=3) if max(map(abs, place)) > 0.5]
)
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
# Entries of a symmetric matrix of nine by nine, and of a vector.
_COUNT = 9
_ENTRIES = [(row, column) for row in range(_COUNT) for column in range(row + 1)]
# A direction of which cells tell less than this part of what others do is left out.
_LEAST = 1e-9


@dataclass
class State:
    """Sums over places, and which one is next: the matrix and the right side of the best fit."""

    place: Any
    matrix: list[Any]
    right: list[Any]


def fitted(slopes: CellSlopes, part: Part) -> tuple[list[Any], list[Any]]:
    """Return first and second derivatives along the axes in some cells (traced).

    They are per length of the grid's scale, and per its square.

    Parameters
    ----------
    slopes : CellSlopes
        Of the field, its first.
    part : Part
        The cells; there must be others all around.
    """
    real, UInt = slopes.backend.Float, slopes.backend.UInt
    tables = [from_host(real, column) for column in _PLACES.T]
    reaches = slopes.spacing.reaches(part.middle, part.size)
    width = slopes.spacing.widths(part.middle, reaches[-1])
    count = dr.width(part.middle)
    active = dr.full(slopes.backend.Bool, True, count)

    def more(state: State) -> Any:
        return state.place < len(_PLACES) * len(reaches)

    def step(state: State) -> tuple[State]:
        offset = [dr.gather(real, column, state.place % len(_PLACES)) for column in tables]
        size = reaches[0]
        for turn, reach in enumerate(reaches[1:], 1):
            far = state.place >= turn * len(_PLACES)
            size = [dr.select(far, r, s) for r, s in zip(reach, size, strict=True)]
        place = [dr.fma(s, o, m) for m, s, o in zip(part.middle, size, offset, strict=True)]
        found = slopes.towards(part, place, active)
        terms = _terms([w / own for w, own in zip(found.way, width, strict=True)])
        square = terms[0] * terms[0] + terms[1] * terms[1] + terms[2] * terms[2]
        weight = dr.select(found.there, 1.0 / (square * square), 0.0)  # nowhere the way is zero
        pull = [weight * term for term in terms]
        matrix = [
            dr.fma(pull[row], terms[column], total)
            for (row, column), total in zip(_ENTRIES, state.matrix, strict=True)
        ]
        right = [
            dr.fma(p, found.rises[0], total) for p, total in zip(pull, state.right, strict=True)
        ]
        return (State(state.place + 1, matrix, right),)

    zeros = dr.zeros(real, count)
    state = State(
        dr.zeros(UInt, count),
        [real(zeros) for _ in _ENTRIES],
        [real(zeros) for _ in range(_COUNT)],
    )
    (state,) = dr.while_loop((state,), more, step, label="quadratic fit")
    found = _solved(dict(zip(_ENTRIES, state.matrix, strict=True)), state.right)
    first = [g / w for g, w in zip(found[:3], width, strict=True)]
    return first, [h / (w * w) for h, w in zip(found[3:6], width, strict=True)]


def _terms(way: list[Any]) -> list[Any]:
    """Return what slopes, second derivatives and mixed ones are multiplied with."""
    bends = [(0.5 if a == b else 1.0) * way[a] * way[b] for a, b in _PAIRS]
    return [*way, *bends]


def _solved(matrix: dict[tuple[int, int], Any], right: list[Any]) -> list[Any]:
    """Return the solutions of symmetric systems (Cholesky), given by their lower halves.

    Rows and columns are scaled so that the diagonal is one.
    """
    size = [matrix[k, k] for k in range(_COUNT)]
    scale = [dr.select(s > 0.0, dr.rsqrt(dr.select(s > 0.0, s, 1.0)), 0.0) for s in size]
    lower: dict[tuple[int, int], Any] = {}
    for row in range(_COUNT):
        for column in range(row):
            rest = matrix[row, column] * scale[row] * scale[column]
            for k in range(column):
                rest -= lower[row, k] * lower[column, k]
            lower[row, column] = rest / lower[column, column]
        rest = type(right[0])(1.0)
        for k in range(row):
            rest -= lower[row, k] * lower[row, k]
        lower[row, row] = dr.select(rest > _LEAST, dr.sqrt(rest), dr.inf)
    found = [r * s for r, s in zip(right, scale, strict=True)]
    for row in range(_COUNT):
        for k in range(row):
            found[row] = found[row] - lower[row, k] * found[k]
        found[row] = found[row] / lower[row, row]
    for row in reversed(range(_COUNT)):
        for k in range(row + 1, _COUNT):
            found[row] = found[row] - lower[k, row] * found[k]
        found[row] = found[row] / lower[row, row]
    return [f * s for f, s in zip(found, scale, strict=True)]
