"""The walk through the dual grid where it is as coarse as a picture allows.

Blocks of cells in which a coarser interpolant is as good are crossed in steps of 2, 4 or 8 cells:
`leap` says how wide, block by block. Walls of wide steps are walls of cells, counted like
them: no ray leaks. Counting must not depend on the sense of a ray, so the number of dual cells is
rounded up to a multiple of the widest step; rays never come to the cells that are added.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ...backend import dr
from ...backend.functions import inverse_power_of_two, unit_interval
from ...backend.types import Float, Mask
from ..box_walk import Side
from ..contract import Segment
from ..lanes import least, lesser, nearest
from .dual_walk import Chord, DualTrack, DualWalk
from .leap import cell_ahead

if TYPE_CHECKING:
    from ...backend.device import Backend

# log2 of the widest step.
WIDEST = 3


def padded_count(cells: int) -> int:
    """Return how many dual cells there are along an axis of so many cells, with those added."""
    return -(-(cells + 1) >> WIDEST) << WIDEST


@dataclass
class CoarseCursor:
    """Where a ray is: mirrored indices of the first of so many cells, and the distance."""

    index: list[Any]
    width: Any
    t: Float
    inside: Mask


@dataclass
class CoarseExit:
    """The step that a segment crosses: mirrored indices of its first cell, and how many."""

    index: list[Any]
    width: Any


class CoarseChord(Chord):
    """A segment as a straight line through a cube of dual cells."""

    walk: CoarseWalk

    @property
    def width(self) -> Any:
        """How many cells wide the cube is."""
        return self.segment.exit.width

    @property
    def base(self) -> list[Any]:
        """Its first dual cell along each axis, counted upwards."""
        Int = self.walk.backend.Int
        wide = Int(self.width)
        return [
            dr.select(sign < 0, axis.last_cell + 1 - wide - Int(i), Int(i))
            for axis, sign, i in zip(
                self.walk.axes, self.track.sign, self.segment.exit.index, strict=True
            )
        ]

    @property
    def cell(self) -> Any:
        return self._flat(self.walk.own_cells)

    @property
    def corner(self) -> Any:
        return self._flat(self.walk.own_corners)

    def _flat(self, strides: list[Any]) -> Any:
        found = [i * stride for i, stride in zip(self.base, strides, strict=True)]
        return self.walk.backend.UInt(found[0] + found[1] + found[2])

    def _fractions(self, t: Float) -> list[Any]:
        exit_ = self.segment.exit
        scale, found = inverse_power_of_two(exit_.width), []
        for k in range(3):
            own = self.track.axes[k]
            here = dr.fma(t, own.speed, own.position) - exit_.index[k]
            f = unit_interval(here * scale)
            found.append(dr.fma(f, self.track.sign[k], self.track.offset[k]))
        return found


class CoarseWalk(DualWalk):
    """Rays through the dual of a uniform `CartesianGrid`, in steps of one or more cells."""

    def __init__(self, edges: Any, scale: float, backend: Backend) -> None:
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

    def next(self, track: Any, cursor: Any) -> tuple[Segment, CoarseCursor]:
        last = cursor.width - 1.0
        ahead = self._crossings(track.axes, [i + last for i in cursor.index])
        end = lesser(least(ahead), track.leave)
        index = [
            dr.select(crossed, i + cursor.width, i)
            for crossed, i in zip(nearest(ahead), cursor.index, strict=True)
        ]
        leaving = CoarseExit(cursor.index, cursor.width)
        segment = Segment(None, end - cursor.t, cursor.t, end, cursor.inside, leaving)
        return segment, CoarseCursor(index, cursor.width, end, end < track.leave)

    def at(self, track: Any, index: list[Any], t: Float) -> CoarseCursor:
        return CoarseCursor(list(index), self.backend.Float(1), t, t < track.leave)

    def precise(self, track: Any, cursor: Any) -> CoarseCursor:
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
