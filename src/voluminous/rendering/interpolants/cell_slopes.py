"""Gradients of a field in all cells of a tree, in kernels.

As in `derivatives.neighbours`: the linear function through a cell's own value that fits those of
the cells beyond its faces best, each difference weighted by the inverse cube of its distance. Four
places are looked at beyond each face; where they are in one cell, it counts once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...backend import dr, from_host

# Where to look beyond a face, in widths of the cell: where centres of cells half as wide are.
_SIDES = ((1, 1), (1, -1), (-1, 1), (-1, -1))
_ASIDE = 0.25
# Entries of a symmetric matrix.
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
# What keeps a direction in which no neighbour tells anything at no slope, relative to others.
_LEAST = 1e-13


@dataclass
class State:
    """Sums over the faces of cells: which one is next, the symmetric matrix, the right side."""

    face: Any
    matrix: list[Any]
    right: list[Any]


class CellSlopes:
    """Computes gradients, per length of the grid's scale.

    Parameters
    ----------
    around : Surroundings
    spacing : Spacing
    values : array
        The field, for all cells.
    backend : Backend
        In double precision.
    """

    def __init__(self, around: Any, spacing: Any, values: Any, backend: Any) -> None:
        self.around, self.spacing, self.values, self.backend = around, spacing, values, backend
        # Of each face and axis: 1 or -1 across it, and 0 along it.
        sense = np.array([s * np.eye(3)[a] for a in range(3) for s in (-1, 1)])
        # Of each axis: whether "aside" is along it, in the first or in the second of `_SIDES`.
        aside = np.array([np.roll([0, 1, 0], a) for a in range(3) for _ in range(2)])
        other = np.array([np.roll([0, 0, 1], a) for a in range(3) for _ in range(2)])
        self.tables = [
            [from_host(backend.Float, table[:, a]) for a in range(3)]
            for table in (sense, aside, other)
        ]

    def of(self, number: Any, boxes: Any) -> list[Any]:
        """Return the gradients in cells, given by their numbers and where they are."""
        real, UInt, size = self.backend.Float, self.backend.UInt, boxes.size
        middle = [dr.fma(s, 0.5, a) for a, s in zip(boxes.low, size, strict=True)]
        value = real(dr.gather(type(self.values), self.values, number))

        def more(state: State) -> Any:
            return state.face < 6

        def step(state: State) -> tuple[State]:
            matrix, right = self._through(state.face, middle, size, value)
            return (
                State(
                    state.face + 1,
                    [a + b for a, b in zip(state.matrix, matrix, strict=True)],
                    [a + b for a, b in zip(state.right, right, strict=True)],
                ),
            )

        zero = dr.zeros(real, dr.width(number))
        state = State(
            dr.zeros(UInt, dr.width(number)),
            [real(zero) for _ in range(6)],
            [real(zero) for _ in range(3)],
        )
        (state,) = dr.while_loop((state,), more, step, label="slopes")
        return solved(state.matrix, state.right)

    def _through(
        self, face: Any, middle: list[Any], size: list[Any], value: Any
    ) -> tuple[list[Any], list[Any]]:
        """Return the sums over the neighbours beyond a face, each side having its share."""
        real = self.backend.Float
        sense, first, second = (
            [dr.gather(real, column, face) for column in table] for table in self.tables
        )
        active = dr.full(self.backend.Bool, True, dr.width(middle))
        matrix, right, count = [real(0)] * 6, [real(0)] * 3, real(0)
        for one, two in _SIDES:
            place = [
                m + s * dr.fma(0.5, n, _ASIDE * (one * a + two * b)) + 0.5 * n
                for m, s, n, a, b in zip(middle, size, sense, first, second, strict=True)
            ]
            cell, there = self.around.cell_at(place, active)
            corner, extent = self.around.box(cell)
            beyond = [dr.fma(e, 0.5, c) for c, e in zip(corner, extent, strict=True)]
            way = [dr.select(there, w, 0.0) for w in self.spacing.ways(middle, beyond)]
            rise = real(dr.gather(type(self.values), self.values, cell.number, there)) - value
            square = way[0] * way[0] + way[1] * way[1] + way[2] * way[2]
            weight = dr.select(there, 1.0 / (square * dr.sqrt(square)), 0.0)
            pull = [weight * w for w in way]
            right = [dr.fma(p, rise, r) for p, r in zip(pull, right, strict=True)]
            matrix = [dr.fma(pull[a], way[b], m) for (a, b), m in zip(_PAIRS, matrix, strict=True)]
            count += dr.select(there, 1.0, 0.0)
        share = dr.select(count > 0.0, 1.0 / count, 0.0)
        return [share * m for m in matrix], [share * r for r in right]


def solved(matrix: list[Any], right: list[Any]) -> list[Any]:
    """Return the solutions of small symmetric systems, the least ones where there are many.

    Parameters
    ----------
    matrix : list of six arrays
        xx, yy, zz, xy, xz, yz.
    right : list of three arrays
    """
    trace = matrix[0] + matrix[1] + matrix[2]
    ridge = dr.select(trace > 0.0, _LEAST * trace, 1.0)
    a, b, c = (m + ridge for m in matrix[:3])
    d, e, f = matrix[3:]
    minors = [b * c - f * f, e * f - d * c, d * f - b * e]
    others = [a * c - e * e, d * e - a * f, a * b - d * d]
    inverse = 1.0 / (a * minors[0] + d * minors[1] + e * minors[2])
    x, y, z = right
    return [
        (minors[0] * x + minors[1] * y + minors[2] * z) * inverse,
        (minors[1] * x + others[0] * y + others[1] * z) * inverse,
        (minors[2] * x + others[1] * y + others[2] * z) * inverse,
    ]
