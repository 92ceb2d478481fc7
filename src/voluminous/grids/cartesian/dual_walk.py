"""The walk of rays through the dual grid: cells whose corners are the centres of the grid's cells.

Inside a dual cell a field given at cell centres is trilinear, so along a ray it is a cubic. The
outermost layer of dual cells reaches as far beyond the domain's face as the outermost centres lie
within it; rays walk through the inner half of it, where fields are constant across the face.

`CoarseWalk` walks through the dual grid where it is as coarse as a picture allows. Bricks of cells
in which a coarser interpolant is as good are crossed in steps of 2, 4 or 8 cells: `leap` says how
wide, brick by brick. Walls of wide steps are walls of cells, counted like them: no ray leaks.
Counting must not depend on the sense of a ray, so the number of dual cells is rounded up to a
multiple of the widest step; rays never come to the cells that are added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr
from ...backend.functions import inverse_power_of_two, unit_interval
from ...backend.types import Float, Int, Mask
from ..box_walk import Side
from ..contract import CellBox, Ray, Segment
from ..lanes import least, lesser, nearest
from ..straight_chord import StraightChord
from .leap import cell_ahead
from .walk import CartesianCursor, CartesianTrack, CartesianWalk

if TYPE_CHECKING:
    from ...backend.device import Backend

# log2 of the widest step.
WIDEST = 3


@dataclass
class DualTrack(CartesianTrack):
    """Also how mirrored fractions become real ones, the first corner, and the ray itself.

    `sign`, `offset`: the fraction along an axis is ``offset + sign · mirrored fraction``;
    `first_corner`: what to add to the mirrored lower vertex to get the lower vertex; `origin`,
    `direction`: the point where distances start, and the vector per distance, in the volume's unit.
    """

    sign: list[Float]
    offset: list[Float]
    first_corner: Int
    origin: list[Float]
    direction: list[Float]


class Chord(StraightChord):
    """A segment through a dual cell."""

    @property
    def index(self) -> list[Int]:
        """Number of the dual cell along each axis."""
        kind = self.walk.backend.Int
        places = zip(self.walk.axes, self.track.sign, self.segment.exit.index, strict=True)
        return [dr.select(sign < 0, axis.last_cell - kind(i), kind(i)) for axis, sign, i in places]

    @property
    def corner(self) -> Int:
        """Flat number of the cell's lower corner, among the padded centres."""
        return self.walk.backend.UInt(self.segment.exit.vertex + self.track.first_corner)

    def _fractions(self, t: Float) -> list[Float]:
        track = self.track
        mirrored = self.walk.fractions(track, self.segment.exit.index, t)
        return [dr.fma(f, s, o) for f, s, o in zip(mirrored, track.sign, track.offset, strict=True)]


def dual_edges(edges: np.ndarray, multiple: int = 1) -> np.ndarray:
    """Return the centres of cells, and one more on either side, mirrored at the outermost faces.

    More follow at equal distances, until there is a multiple of so many dual cells.
    """
    centers = 0.5 * (edges[1:] + edges[:-1])
    below, above = 2.0 * edges[0] - centers[0], 2.0 * edges[-1] - centers[-1]
    more = np.arange(1, -len(edges) % multiple + 1) * (edges[-1] - edges[-2])
    return np.concatenate([[below], centers, [above], above + more])


class DualWalk(CartesianWalk):
    """Rays through the dual of a `CartesianGrid`."""

    in_cells, continuous = False, True

    def __init__(
        self,
        edges: Sequence[np.ndarray],
        scale: float,
        backend: Backend,
        multiple: int = 1,
        *,
        box: CellBox | None = None,
    ) -> None:
        self.cells = [len(e) - 1 for e in edges]
        super().__init__([dual_edges(e, multiple) for e in edges], scale, backend, box=box)
        self.faces = [(backend.wide(e[0]), backend.wide(e[-1])) for e in edges]

    def _ends(self, box: CellBox) -> list[tuple[Int, ...]]:
        # Dual cell i lies between the centres of cells i - 1 and i, the last one beyond them all.
        return [
            tuple(
                dr.opaque(self.backend.Int, k)
                for k in (low, high if high == n else high - 1, max(low - 1, 0))
            )
            for low, high, n in zip(box.low, box.high, self.cells, strict=True)
        ]

    def _held(self, box: CellBox) -> list[int]:
        return [part.stop - part.start + 1 for part in box.with_ghosts]

    def enter(self, ray: Ray) -> tuple[CartesianTrack, CartesianCursor]:
        first, last = self._between_faces(ray)
        if ray.first is not None:
            first = dr.maximum(first, ray.first)
        if ray.last is not None:
            last = dr.minimum(last, ray.last)
        return super().enter(replace(ray, first=first, last=last))

    def _between_faces(self, ray: Ray) -> tuple[Float, Float]:
        """Return where rays enter and leave the domain; in the wrong order if they never do."""
        Wide = self.backend.Wide
        # These are in the volume's unit, where any number may be a length.
        first, last = Wide(-dr.inf), Wide(dr.inf)
        for axis, origin, direction, (low, high) in zip(
            self.axes, ray.origin, ray.direction, self.faces, strict=True
        ):
            side = axis.side(origin, direction)
            between = (origin >= low) & (origin <= high)
            per_length = side.pace * axis.speed_unit
            arrive = dr.select(side.down, origin - high, low - origin) * per_length
            leave = dr.select(side.down, origin - low, high - origin) * per_length
            never = dr.select(between, Wide(-dr.inf), Wide(dr.inf))
            first = dr.maximum(first, dr.select(side.parallel, never, arrive))
            last = dr.minimum(last, dr.select(side.parallel, Wide(dr.inf), leave))
        return first, last

    def _start(
        self, sides: list[Side], arrive: Float, begin: Float, inside: Mask, bound: Float
    ) -> tuple[DualTrack, CartesianCursor]:
        track, cursor = super()._start(sides, arrive, begin, inside, bound)
        Float = self.backend.Float
        down = [side.down for side in sides]
        sign = [dr.select(d, Float(-1), 1) for d in down]
        offset = [dr.select(d, Float(1), 0) for d in down]
        first_corner = self.backend.Int(0)
        for is_down, stride in zip(down, self.vertex_strides, strict=True):
            first_corner -= dr.select(is_down, stride, 0)
        here = arrive * self.scale
        origin = [Float(dr.fma(here, side.direction, side.origin)) for side in sides]
        direction = [Float(side.direction * self.scale) for side in sides]
        whole = DualTrack(
            **vars(track),
            sign=sign,
            offset=offset,
            first_corner=first_corner,
            origin=origin,
            direction=direction,
        )
        return whole, cursor

    def chord(self, track: DualTrack, segment: Segment) -> Chord:
        return Chord(self, track, segment)


@dataclass
class CoarseCursor:
    """Where a ray is: mirrored indices of the first of so many cells, and the distance.

    It is the `Segment.exit` of the step that begins there, too.
    """

    index: list[Float]
    width: Float
    t: Float
    inside: Mask


@dataclass
class FineCell:
    """A dual cell in a cube of them, by its number along each axis."""

    walk: CoarseWalk
    index: list[Int]

    @property
    def cell(self) -> Int:
        """Flat number of the cell."""
        return self._flat(self.walk.own_cells)

    @property
    def corner(self) -> Int:
        """Flat number of the cell's lower corner."""
        return self._flat(self.walk.own_corners)

    def _flat(self, strides: list[Int]) -> Int:
        x, y, z = (i * stride for i, stride in zip(self.index, strides, strict=True))
        return self.walk.backend.UInt(x + y + z)


class CoarseChord(Chord):
    """A segment as a straight line through a cube of dual cells."""

    walk: CoarseWalk

    @property
    def width(self) -> Float:
        """How many cells wide the cube is."""
        return self.segment.exit.width

    def at(self, s: Float) -> tuple[FineCell, list[Float]]:
        Int, width = self.walk.backend.Int, self.width
        last = Int(width) - 1
        index, inside = [], []
        for axis, sign, i, a, b in zip(
            self.walk.axes,
            self.track.sign,
            self.segment.exit.index,
            self.start,
            self.end,
            strict=True,
        ):
            first = dr.select(sign < 0, axis.last_cell - last - Int(i), Int(i))
            place = dr.fma(s, b - a, a) * width
            cell = dr.minimum(Int(place), last)
            index.append(first + cell)
            inside.append(place - cell)
        return FineCell(self.walk, index), inside

    def _fractions(self, t: Float) -> list[Float]:
        step, track = self.segment.exit, self.track
        scale, fractions = inverse_power_of_two(step.width), []
        for own, i, sign, offset in zip(
            track.axes, step.index, track.sign, track.offset, strict=True
        ):
            f = unit_interval((dr.fma(t, own.speed, own.position) - i) * scale)
            fractions.append(dr.fma(f, sign, offset))
        return fractions


class CoarseWalk(DualWalk):
    """Rays through the dual of a uniform `CartesianGrid`, in steps of one or more cells."""

    def __init__(self, edges: Sequence[np.ndarray], scale: float, backend: Backend) -> None:
        super().__init__(edges, scale, backend, 1 << WIDEST)
        counts = [len(e) for e in edges]  # of dual cells, without those that were added
        self.own_cells = self._strides(counts)
        self.own_corners = self._strides([n + 1 for n in counts])

    def _start(
        self, sides: list[Side], arrive: Float, begin: Float, inside: Mask, bound: Float
    ) -> tuple[DualTrack, Any]:
        track, cursor = super()._start(sides, arrive, begin, inside, bound)
        one = self.backend.Float(1)
        return track, CoarseCursor(cursor.index, one, cursor.t, cursor.inside)

    def next(self, track: DualTrack, cursor: Any) -> tuple[Segment, CoarseCursor]:
        last = cursor.width - 1.0
        ahead = self._crossings(track.axes, [i + last for i in cursor.index])
        end = lesser(least(ahead), track.leave)
        index = [
            dr.select(crossed, i + cursor.width, i)
            for crossed, i in zip(nearest(ahead), cursor.index, strict=True)
        ]
        segment = Segment(None, end - cursor.t, cursor.t, end, cursor.inside, cursor)
        return segment, CoarseCursor(index, cursor.width, end, end < track.leave)

    def at(self, track: DualTrack, index: list[Float], t: Float) -> CoarseCursor:
        return CoarseCursor(list(index), self.backend.Float(1), t, t < track.leave)

    def precise(self, track: DualTrack, cursor: Any) -> CoarseCursor:
        index = [
            cell_ahead(axis, own, cursor.t, i, i + (cursor.width - 1.0))
            for axis, own, i in zip(self.axes, track.axes, cursor.index, strict=True)
        ]
        return CoarseCursor(index, self.backend.Float(1), cursor.t, cursor.inside)

    def settle(self, cursor: Any, width: Float) -> CoarseCursor:
        narrow = inverse_power_of_two(width)
        index = [dr.floor(i * narrow) * width for i in cursor.index]
        return CoarseCursor(index, width, cursor.t, cursor.inside)

    def chord(self, track: DualTrack, segment: Segment) -> CoarseChord:
        return CoarseChord(self, track, segment)
