"""Vertices around a ray in a cell of a curvilinear grid, and their weights.

Interpolation is linear in each of the grid's own coordinates, as in RADMC-3D (which interpolates in
r, θ and φ). Vertices are numbered in C order, one more than cells along each axis.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ...backend import Float, dr
from ...backend.types import Int
from ..contract import Corners

if TYPE_CHECKING:
    from ...backend.device import Backend
    from ..contract import Grid


def cell_corners(walk: Any, track: Any, leaving: Any) -> Corners:
    """Return the vertices of a cell and weights where a ray is.

    If that is on a wall, its coordinate there is the wall's, exactly.
    """
    index = walk.cells_near(track, leaving.count)
    fractions = _fractions(walk, index, walk.point(track, leaving.t))
    for a, family in enumerate(walk.families):
        crossed = leaving.family == a
        vertex = family.vertex(track.axes[a], leaving.count[a])
        last = vertex > family.last_cell  # it has no cell above
        fractions[a] = dr.select(crossed, dr.select(last, walk.backend.Float(1), 0), fractions[a])
        index[a] = dr.select(crossed, dr.select(last, family.last_cell, vertex), index[a])
    base = _flat(index, walk.vertex_strides)
    return _multilinear(walk, base, fractions, walk.vertex_strides)


def wall_corners(walk: Any, track: Any, leaving: Any) -> Corners:
    """Return the vertices of the wall that a segment leaves through, and weights."""
    index = walk.cells_near(track, leaving.count)
    fractions = _fractions(walk, index, walk.point(track, leaving.t))
    base: Any = 0
    for a, (family, stride) in enumerate(zip(walk.families, walk.vertex_strides, strict=True)):
        vertex = family.vertex(track.axes[a], leaving.count[a])
        vertex = dr.clip(vertex, 0, family.last_cell + 1)
        base += dr.select(leaving.family == a, vertex, index[a]) * stride
    chosen, strides = [], []
    for k in range(1, len(index)):
        # The k-th of the other axes: those before the wall's own come first.
        own = leaving.family >= k
        chosen.append(dr.select(own, fractions[k - 1], fractions[k]))
        strides.append(dr.select(own, walk.vertex_strides[k - 1], walk.vertex_strides[k]))
    return _multilinear(walk, base, chosen, strides)


def _fractions(walk: Any, index: list[Any], point: list[Any]) -> list[Any]:
    return [family.fraction(i, point) for family, i in zip(walk.families, index, strict=True)]


def _flat(index: list[Any], strides: list[Any]) -> Any:
    total: Any = 0
    for i, stride in zip(index, strides, strict=True):
        total += i * stride
    return total


def _multilinear(walk: Any, base: Any, fractions: list[Any], strides: list[Any]) -> Corners:
    vertices, weights = [base], [walk.backend.Float(1)]
    for f, stride in zip(fractions, strides, strict=True):
        vertices += [v + stride for v in vertices]
        upper = [w * f for w in weights]
        weights = [w - u for w, u in zip(weights, upper, strict=True)] + upper
    return Corners(vertices, weights)


def cells_around(grid: Grid, lane: Int, backend: Backend) -> list[tuple[Any, Any]]:
    """Return the eight cells around vertices, and whether each of them exists.

    Azimuth that spans a full circle is cyclic: the first and the last vertex have the same cells.
    Cells next to a mirrored midplane lie on both sides of it. There is nothing beyond the other
    ends, the poles included: what RADMC-3D does.
    """
    cyclic = grid.coordinates.index("phi") if grid.is_periodic else None
    folded = grid.coordinates.index("theta") if grid.mirror else None
    found = [(backend.Int(0), backend.Bool(True))]
    for axis, (number, count) in enumerate(
        zip(_unravel(lane, grid.shape, backend), grid.shape, strict=True)
    ):
        last = dr.opaque(backend.Int, count - 1)
        sides = [_side(n, last, axis == cyclic, axis == folded) for n in (number - 1, number)]
        found = [
            (flat * (last + 1) + cell, exists & there)
            for flat, exists in found
            for cell, there in sides
        ]
    return found


def _side(cell: Int, last: Float, cyclic: bool, folded: bool) -> tuple[Any, Any]:
    if cyclic:
        cell = dr.select(cell < 0, last, dr.select(cell > last, 0, cell))
    elif folded:
        cell = dr.select(cell > last, last, cell)
    inside = (cell >= 0) & (cell <= last)
    return dr.clip(cell, 0, last), inside


def _unravel(lane: Int, shape: tuple[int, ...], backend: Backend) -> list[Any]:
    Int, UInt, rest, numbers = backend.Int, backend.UInt, backend.UInt(lane), []
    for count in shape[:0:-1]:
        row = backend.quotient(rest, dr.opaque(UInt, count + 1))
        numbers.append(Int(rest) - Int(row) * dr.opaque(Int, count + 1))
        rest = row
    return [Int(rest), *numbers[::-1]]
