"""The walk of rays through a Cartesian grid (Amanatides & Woo 1987).

A ray's cell is an integer, and the distance of the next wall is computed from it afresh: rounding
never accumulates and no ray leaks. The lengths of a ray's segments add up to its chord.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...backend import dr
from ..axes import AxisTrack, Side, make_axis
from ..box_walk import BoxWalk
from ..contract import Corners, Segment
from ..wall_corners import bilinear, pick, trilinear

# Cells along each axis of the blocks that rays leap over (`grids.cartesian.leap`).
BLOCK = 4


@dataclass
class Track:
    """What is constant along a ray: its axes, the strides with their signs, and where it leaves.

    `bounded` tells (while tracing) that rays may end inside a cell; `entry` is how far from the
    ray's origin it enters the domain.
    """

    axes: list[AxisTrack]
    cell_stride: list[Any]
    vertex_stride: list[Any]
    leave: Any
    bounded: bool
    entry: Any


@dataclass
class Cursor:
    """Where a ray is: mirrored cell indices, flat numbers of cell and lower vertex, distance."""

    index: list[Any]
    cell: Any
    vertex: Any
    t: Any
    inside: Any


@dataclass
class Exit:
    """How a segment leaves its cell: through which wall, and where the two cells are."""

    through: list[Any]
    index: list[Any]
    vertex: Any
    next_vertex: Any


class CartesianWalk(BoxWalk):
    """Rays through a `CartesianGrid`; see `grids.contract.Walk`."""

    leaps = True  # rays may cross empty blocks in one step (`grids.cartesian.leap`)

    def __init__(self, edges: Any, scale: float, backend: Any) -> None:
        self.backend = backend
        self.axes = [make_axis(e, scale, backend) for e in edges]
        self.scale, self.to_scale = backend.wide(scale), backend.wide(1.0 / scale)
        self.counts = [len(e) - 1 for e in edges]
        self.cell_strides = self._strides(self.counts)
        self.vertex_strides = self._strides([n + 1 for n in self.counts])
        # What the last block lacks.
        self.lacking = [dr.opaque(backend.Float, -n % BLOCK) for n in self.counts]

    def _strides(self, counts: Any) -> list[Any]:
        return [dr.opaque(self.backend.Int, s) for s in (counts[1] * counts[2], counts[2], 1)]

    def _start(
        self, sides: list[Side], arrive: Any, begin: Any, inside: Any, bound: Any
    ) -> tuple[Track, Any]:
        Float, Int = self.backend.Float, self.backend.Int
        tracks, index, cell, vertex = [], [], Int(0), Int(0)
        cell_stride, vertex_stride = [], []
        here = (arrive + begin) * self.scale
        for a, (axis, side) in enumerate(zip(self.axes, sides, strict=True)):
            own = axis.cell(side, dr.fma(here, side.direction, side.origin))
            mirrored = dr.select(side.down, axis.last_cell - own, own)
            # The wall it comes in through is known: it must not be found again by arithmetic.
            on_wall = (side.arrive == arrive) & (begin == 0)
            mirrored = dr.select(on_wall, 0, mirrored)
            track = axis.track(side, dr.fma(arrive, side.speed, side.position))
            # A wall that rounding puts behind the start has been crossed: rays nearly parallel to
            # it would meet it far behind, and be as much too long.
            passed = axis.crossing(track, Float(mirrored)) < Float(begin)
            mirrored = dr.select(passed, dr.minimum(mirrored + 1, axis.last_cell), mirrored)
            own = dr.select(side.down, axis.last_cell - mirrored, mirrored)
            cell += own * self.cell_strides[a]
            vertex += dr.select(side.down, own + 1, own) * self.vertex_strides[a]
            cell_stride.append(_signed(self.cell_strides[a], side.down))
            vertex_stride.append(_signed(self.vertex_strides[a], side.down))
            tracks.append(track)
            index.append(Float(mirrored))
        lasts = [Float(axis.last_cell) for axis in self.axes]
        leave = least(self._crossings(tracks, lasts))
        if bound is not None:
            leave = dr.minimum(leave, bound)
        whole = Track(tracks, cell_stride, vertex_stride, leave, bound is not None, arrive)
        t = Float(begin)
        return whole, Cursor(index, cell, vertex, t, inside & (t < leave))

    def _crossings(self, tracks: list[AxisTrack], index: list[Any]) -> list[Any]:
        return [
            axis.crossing(track, i) for axis, track, i in zip(self.axes, tracks, index, strict=True)
        ]

    def next(self, track: Any, cursor: Any) -> tuple[Segment, Any]:
        """Return the segment through the present cell, and the cursor in the next one."""
        ahead = self._crossings(track.axes, cursor.index)
        wall = least(ahead)
        through = nearest(ahead)
        end = lesser(wall, track.leave) if track.bounded else wall
        index = [
            dr.select(crossed, i + 1.0, i) for crossed, i in zip(through, cursor.index, strict=True)
        ]
        vertex = cursor.vertex + pick(through, track.vertex_stride)
        leaving = Exit(through, cursor.index, cursor.vertex, vertex)
        cell, length = self.backend.UInt(cursor.cell), end - cursor.t
        segment = Segment(cell, length, cursor.t, end, cursor.inside, leaving)
        onward = cursor.cell + pick(through, track.cell_stride)
        # `leave` is a crossing itself, computed alike: a ray never steps beyond the last cell.
        return segment, Cursor(index, onward, vertex, end, end < track.leave)

    def at(self, track: Any, index: list[Any], t: Any) -> Any:
        """Return the cursor in the cell with mirrored indices, at a distance."""
        Int = self.backend.Int
        cell, vertex = Int(0), Int(0)
        for i, axis, a in zip(index, self.axes, range(3), strict=True):
            down = track.cell_stride[a] < 0
            mirrored = Int(i)
            own = dr.select(down, axis.last_cell - mirrored, mirrored)
            cell += own * self.cell_strides[a]
            vertex += dr.select(down, own + 1, own) * self.vertex_strides[a]
        return Cursor(list(index), cell, vertex, t, t < track.leave)

    def precise(self, track: Any, cursor: Any) -> Any:
        """Return the cursor in the cell it is in: this walk never takes wider steps."""
        return cursor

    def settle(self, cursor: Any, width: Any) -> Any:
        """Return the cursor as it is: this walk never takes wider steps."""
        return cursor

    def entry_corners(self, track: Track, cursor: Cursor) -> Corners:
        """Return the eight vertices of the cell and trilinear weights at the cursor."""
        return trilinear(cursor.vertex, self._entry_fractions(track, cursor), track.vertex_stride)

    def exit_corners(self, track: Track, segment: Segment) -> Corners:
        """Return the vertices around the end of a segment: four of the wall it leaves through."""
        leaving, f = segment.exit, self._exit_fractions(track, segment)
        if track.bounded:  # it may end inside the cell
            return trilinear(leaving.vertex, f, track.vertex_stride)
        return bilinear(leaving.next_vertex, leaving.through, f, track.vertex_stride)

    def _entry_fractions(self, track: Track, cursor: Cursor) -> list[Any]:
        return self.fractions(track, cursor.index, cursor.t)

    def _exit_fractions(self, track: Track, segment: Segment) -> list[Any]:
        return self.fractions(track, segment.exit.index, segment.end)

    def fractions(self, track: Track, index: list[Any], t: Any) -> list[Any]:
        """Return where in its mirrored cell a ray is along each axis, from 0 to 1."""
        return [
            axis.fraction(a, i, t) for axis, a, i in zip(self.axes, track.axes, index, strict=True)
        ]


def lesser(a: Any, b: Any) -> Any:
    """Return the smaller of two numbers that are no NaN: one instruction, dr.minimum takes four."""
    return dr.select(a < b, a, b)


def least(values: list[Any]) -> Any:
    """Return the smallest of three."""
    return lesser(lesser(values[0], values[1]), values[2])


def nearest(ways: list[Any]) -> list[Any]:
    """Return for each axis whether its wall is the nearest; the first one where two are."""
    x = (ways[0] <= ways[1]) & (ways[0] <= ways[2])
    y = ~x & (ways[1] <= ways[2])
    return [x, y, ~(x | y)]


def _signed(stride: Any, down: Any) -> Any:
    return dr.select(down, -stride, stride)
