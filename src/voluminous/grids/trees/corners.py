"""Where in its cell a ray is, and the vertices around it, on a walk through a tree.

RADMC-3D's rule: on the wall between two cells, the vertices are those of the finer one. So what is
interpolated is continuous along a ray.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...backend import dr
from ...backend.functions import unit_interval
from ..contract import Corners, Segment
from ..wall_corners import bilinear, trilinear
from .lookup import Cell


@dataclass
class Corner:
    """The vertex of a cell that a ray comes by first, and the steps to the others."""

    base: Any
    strides: list[Any]


def first_corner(walk: Any, track: Any, cell: Cell, active: Any) -> Corner:
    """Return the first corner of cells, in the sense of the rays.

    In a hole that of any cell: its values are multiplied by a length of zero, but must be there.
    """
    number = cell.number
    if walk.holes:
        number = dr.select(walk.lookup.is_cell(cell), number, 0)
    base, strides = walk.grid.vertex_numbers.traced(walk.backend).of(number, active)
    signed = []
    for stride, flip in zip(strides, track.way.flip, strict=True):
        base = base + (stride & flip)  # all bits or none: modulo 2^32, the stride or minus it
        signed.append((stride ^ flip) - flip)
    return Corner(base, signed)


def fractions(walk: Any, track: Any, cell: Cell, t: Any) -> list[Any]:
    """Return where in cells rays are at a distance, from 0 to 1 in the sense of the rays."""
    # Sizes along the axes are one and the same array mostly: so is one over it.
    inverse = [1.0 / size for size in walk.lookup.sizes(cell)]
    return [
        unit_interval(axis.beyond(own, t, low) * part)
        for axis, own, low, part in zip(walk.axes, track.axes, cell.low, inverse, strict=True)
    ]


def entry_corners(walk: Any, track: Any, cursor: Any) -> Corners:
    """Return the vertices of the cell that the cursor is in, and trilinear weights."""
    corner = first_corner(walk, track, cursor.cell, cursor.inside)
    return trilinear(corner.base, fractions(walk, track, cursor.cell, cursor.t), corner.strides)


def exit_corners(walk: Any, track: Any, segment: Segment) -> Corners:
    """Return the vertices around the end of a segment: four of the wall it leaves through."""
    leaving = segment.exit
    entered = entered_is_finer(walk, leaving)
    cell = choose(entered, leaving.entered, leaving.left)
    corner = first_corner(walk, track, cell, segment.active)
    f = fractions(walk, track, cell, segment.end)
    ahead = dr.select(entered, 0.0, walk.backend.Float(1))
    f = [dr.select(crossed, ahead, v) for crossed, v in zip(leaving.through, f, strict=True)]
    if track.bounded:  # it may end inside the cell
        f = [
            dr.select(leaving.ends, own, v)
            for own, v in zip(fractions(walk, track, leaving.left, segment.end), f, strict=True)
        ]
        return trilinear(corner.base, f, corner.strides)
    base = corner.base
    for crossed, stride in zip(leaving.through, corner.strides, strict=True):
        base += dr.select(crossed & ~entered, stride, 0)
    return bilinear(base, leaving.through, f, corner.strides)


def entered_is_finer(walk: Any, leaving: Any) -> Any:
    """Return which rays come to a finer cell than they leave, or come out of a hole."""
    old, new = (walk.lookup.sizes(cell) for cell in (leaving.left, leaving.entered))
    finer = (new[0] < old[0]) | (new[1] < old[1]) | (new[2] < old[2])
    if walk.holes:
        finer = finer & walk.lookup.is_cell(leaving.entered)
        finer |= ~walk.lookup.is_cell(leaving.left) & walk.lookup.is_cell(leaving.entered)
    return leaving.onward & finer


def choose(mask: Any, first: Cell, second: Cell) -> Cell:
    """Return one of two cells."""
    return Cell(
        dr.select(mask, first.number, second.number),
        [dr.select(mask, a, b) for a, b in zip(first.low, second.low, strict=True)],
        [dr.select(mask, a, b) for a, b in zip(first.size, second.size, strict=True)],
    )
