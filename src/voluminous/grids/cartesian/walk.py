"""The walk of rays through a Cartesian grid (Amanatides & Woo 1987).

A ray's cell is an integer, and the distance of the next wall is computed from it afresh: rounding
never accumulates and no ray leaks. The lengths of a ray's segments add up to its chord.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr
from ...backend.types import Float, Int, Mask
from ..box_walk import NEVER, AxisTrack, BoxWalk, Side, make_axis
from ..contract import CellBox, Corners, Segment, Skip, Track
from ..lanes import bilinear, least, lesser, nearest, pick, trilinear

if TYPE_CHECKING:
    from ...backend.device import Backend

# Cells along each axis of the bricks that rays leap over (`grids.cartesian.leap`).
BRICK = 4


@dataclass
class CartesianTrack(Track):
    """What is constant along a ray: its axes, the strides with their signs, and where it leaves.

    `bounded` tells (while tracing) that rays may end inside a cell; `entry` is how far from the
    ray's origin it enters the domain. A walk confined to a box has `last`: the mirrored indices of
    the last cells in it.
    """

    axes: list[AxisTrack]
    cell_stride: list[Int]
    vertex_stride: list[Int]
    leave: Float
    bounded: bool
    entry: Float
    last: list[Float] | None = field(default=None, kw_only=True)


@dataclass
class CartesianCursor:
    """Where a ray is: mirrored cell indices, flat numbers of cell and lower vertex, distance."""

    index: list[Float]
    cell: Int
    vertex: Int
    t: Float
    inside: Mask


@dataclass
class Exit:
    """How a segment leaves its cell: through which wall, and where the two cells are."""

    through: list[Mask]
    index: list[Float]
    vertex: Int
    next_vertex: Int


class CartesianWalk(BoxWalk):
    """Rays through a `CartesianGrid`; see `grids.contract.Walk`.

    Confined to a box of cells, its crossings are computed as without it, from the edges of the
    whole grid: what boxes contribute to a ray adds up to the same bits.
    """

    def __init__(
        self,
        edges: Sequence[np.ndarray],
        scale: float,
        backend: Backend,
        *,
        box: CellBox | None = None,
    ) -> None:
        self.backend = backend
        self.axes = [make_axis(e, scale, backend) for e in edges]
        self.scale, self.to_scale = backend.wide(scale), backend.wide(1.0 / scale)
        self.counts = [len(e) - 1 for e in edges]
        self.box = None if box is None else self._ends(box)
        held = self.counts if box is None else self._held(box)
        self.cell_strides = self._strides(held)
        self.vertex_strides = self._strides([n + 1 for n in held])
        # What the last brick lacks.
        self.lacking = [dr.opaque(backend.Float, -n % BRICK) for n in self.counts]

    def _strides(self, counts: Sequence[int]) -> list[Float]:
        return [dr.opaque(self.backend.Int, s) for s in (counts[1] * counts[2], counts[2], 1)]

    def _ends(self, box: CellBox) -> list[tuple[Int, ...]]:
        return [
            tuple(dr.opaque(self.backend.Int, n) for n in (low, high - 1, low))
            for low, high in zip(box.low, box.high, strict=True)
        ]

    def _held(self, box: CellBox) -> list[int]:
        return [high - low for low, high in zip(box.low, box.high, strict=True)]

    def _start(
        self, sides: list[Side], arrive: Float, begin: Float, inside: Mask, bound: Float
    ) -> tuple[CartesianTrack, Any]:
        Float = self.backend.Float
        tracks, index = [], []
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
            cell_stride.append(_signed(self.cell_strides[a], side.down))
            vertex_stride.append(_signed(self.vertex_strides[a], side.down))
            tracks.append(track)
            index.append(Float(mirrored))
        lasts = [Float(axis.last_cell) for axis in self.axes]
        leave = least(self._crossings(tracks, lasts))
        if bound is not None:
            leave = dr.minimum(leave, bound)
        whole = CartesianTrack(tracks, cell_stride, vertex_stride, leave, bound is not None, arrive)
        t = Float(begin)
        if self.box is not None:
            index, t, there = self._into_box(self.box, whole, index, t)
            inside &= there
        return whole, replace(self.at(whole, index, t), inside=inside & (t < leave))

    def _into_box(
        self,
        box: list[tuple[Int, ...]],
        track: CartesianTrack,
        index: list[Float],
        t: Float,
    ) -> tuple[list[Float], Float, Mask]:
        """Return where rays are first in a cell of the box, and which rays come to one.

        They are there once they have crossed the last of the walls before it. Walls of the other
        axes that they cross at the same distance come before or after it in the order of `nearest`.
        """
        Float, never = self.backend.Float, -NEVER
        down = [stride < 0 for stride in track.cell_stride]
        ends = [
            [dr.select(d, axis.last_cell - b, a), dr.select(d, axis.last_cell - a, b)]
            for d, axis, (a, b, _) in zip(down, self.axes, box, strict=True)
        ]
        first = [Float(low) for low, _ in ends]
        track.last = [Float(high) for _, high in ends]
        before = [i < low for i, low in zip(index, first, strict=True)]
        walls = [dr.select(b, low - 1.0, i) for b, low, i in zip(before, first, index, strict=True)]
        crossed = [
            dr.select(b, c, never)
            for b, c in zip(before, self._crossings(track.axes, walls), strict=True)
        ]
        # The last wall of all; of equal ones the last axis: `nearest` crosses the first one first.
        at_z = (crossed[2] >= crossed[0]) & (crossed[2] >= crossed[1])
        at_y = ~at_z & (crossed[1] >= crossed[0])
        by = [~(at_z | at_y), at_y, at_z]
        enters = before[0] | before[1] | before[2]
        here = dr.select(enters, pick(by, crossed), t)
        found, there = [], dr.full(self.backend.Bool, True)
        for a, axis in enumerate(self.axes):
            # Whether a wall of this axis at the very distance of the entry is crossed before it.
            earlier = self.backend.Bool(False)
            for later in range(a + 1, 3):
                earlier |= by[later]
            i = self._advanced(axis, track.axes[a], index[a], here, earlier)
            i = dr.select(by[a], first[a], i)
            found.append(dr.select(enters, i, index[a]))
            there &= (found[a] >= first[a]) & (found[a] <= track.last[a])
        return found, here, there

    def _advanced(self, axis: Any, track: AxisTrack, start: Float, t: Float, equal: Mask) -> Float:
        """Return the mirrored cell at a distance: all walls before it are crossed.

        Those at the very distance are where `equal` is true. The place at the distance is right but
        for rounding: by one cell at most.
        """
        last = self.backend.Float(axis.last_cell)

        def passed(i: Float) -> Mask:
            wall = axis.crossing(track, i)
            return (wall < t) | ((wall == t) & equal)

        i = dr.clip(axis.cell_at(track, t) - 1.0, start, last)
        for _ in range(2):
            i = dr.select(passed(i) & (i < last), i + 1.0, i)
        return dr.select(track.pace == 0.0, start, i)

    def _crossings(self, tracks: list[AxisTrack], index: list[Float]) -> list[Float]:
        return [
            axis.crossing(track, i) for axis, track, i in zip(self.axes, tracks, index, strict=True)
        ]

    def next(self, track: Any, cursor: Any) -> tuple[Segment, Any]:
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
        inside = end < track.leave
        if track.last is not None:
            for i, last in zip(index, track.last, strict=True):
                inside &= i <= last
        return segment, CartesianCursor(index, onward, vertex, end, inside)

    def skipper(self, track: Any, bricks: Any = None) -> Skip | None:
        from .leap import BrickRays

        return None if bricks is None or self.box is not None else BrickRays(self, track, bricks)

    def at(self, track: Any, index: list[Float], t: Float) -> Any:
        """Return the cursor in the cell with mirrored indices, at a distance."""
        Int = self.backend.Int
        cell, vertex = Int(0), Int(0)
        for i, axis, a in zip(index, self.axes, range(3), strict=True):
            down = track.cell_stride[a] < 0
            mirrored = Int(i)
            own = dr.select(down, axis.last_cell - mirrored, mirrored)
            if self.box is not None:
                own = own - self.box[a][2]
            cell += own * self.cell_strides[a]
            vertex += dr.select(down, own + 1, own) * self.vertex_strides[a]
        return CartesianCursor(list(index), cell, vertex, t, t < track.leave)

    def precise(self, track: Any, cursor: Any) -> Any:
        """Return the cursor in the cell it is in: this walk never takes wider steps."""
        return cursor

    def settle(self, cursor: Any, width: Float) -> Any:
        """Return the cursor as it is: this walk never takes wider steps."""
        return cursor

    def entry_corners(self, track: CartesianTrack, cursor: CartesianCursor) -> Corners:
        return trilinear(
            cursor.vertex, self.fractions(track, cursor.index, cursor.t), track.vertex_stride
        )

    def exit_corners(self, track: CartesianTrack, segment: Segment) -> Corners:
        leaving = segment.exit
        f = self.fractions(track, leaving.index, segment.end)
        if track.bounded:  # it may end inside the cell
            return trilinear(leaving.vertex, f, track.vertex_stride)
        return bilinear(leaving.next_vertex, leaving.through, f, track.vertex_stride)

    def fractions(self, track: CartesianTrack, index: list[Float], t: Float) -> list[Float]:
        """Return where in its mirrored cell a ray is along each axis, from 0 to 1."""
        return [
            axis.fraction(a, i, t) for axis, a, i in zip(self.axes, track.axes, index, strict=True)
        ]


def _signed(stride: Int, down: Mask) -> Int:
    return dr.select(down, -stride, stride)
