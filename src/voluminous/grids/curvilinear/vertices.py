"""The cells around the vertices of a curvilinear grid."""

from __future__ import annotations

from typing import Any

from ...backend import dr


def cells_around(grid: Any, lane: Any, backend: Any) -> list[tuple[Any, Any]]:
    """Return the eight cells around vertices, and whether each of them exists.

    Azimuth that spans a full circle is cyclic: the first and the last vertex have the same cells.
    Cells next to a mirrored midplane lie on both sides of it. There is nothing beyond the other
    ends, the poles included: what RADMC-3D does.

    Parameters
    ----------
    grid : CurvilinearGrid
        With `shape`, `coordinates`, `is_periodic` and `mirror`.
    lane : array of UInt
        Flat numbers of vertices (C order, one more than cells along each axis).

    Returns
    -------
    list of (array of Int, array of Bool)
        Flat numbers of cells; those that do not exist are numbers of others.
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


def _side(cell: Any, last: Any, cyclic: bool, folded: bool) -> tuple[Any, Any]:
    if cyclic:
        cell = dr.select(cell < 0, last, dr.select(cell > last, 0, cell))
    elif folded:
        cell = dr.select(cell > last, last, cell)
    inside = (cell >= 0) & (cell <= last)
    return dr.clip(cell, 0, last), inside


def _unravel(lane: Any, shape: tuple[int, ...], backend: Any) -> list[Any]:
    Int, UInt, rest, numbers = backend.Int, backend.UInt, backend.UInt(lane), []
    for count in shape[:0:-1]:
        row = backend.quotient(rest, dr.opaque(UInt, count + 1))
        numbers.append(Int(rest) - Int(row) * dr.opaque(Int, count + 1))
        rest = row
    return [Int(rest), *numbers[::-1]]
