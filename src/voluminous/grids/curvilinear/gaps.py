"""Rays through space between surfaces that belongs to no cell: crossed in one step."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

from ...backend import Int, dr
from ...backend.types import Float, Mask
from ..box_walk import NEVER
from ..contract import Walk
from .crossing import either, later, lesser, nearest

# Counts beyond a wall, and the distance of that wall.
Jump = tuple[list[Any], Any]


@dataclass
class GapLanding:
    """Where rays are once none of them is in a gap: see `grids.contract.Landing`."""

    cursor: Any
    moved: Mask
    walk: Any
    track: Any

    def holds(self, cursor: Any) -> Any:
        """Return the lanes that are in a cell still."""
        return ~self.walk.in_gap(self.track, cursor.count)


class GapCrossing(Walk):
    """What a walk does in a cavity, in open cones at the poles, in an empty wedge.

    A ray leaves a gap through that wall of its family which is next. Where it is then among the
    walls of the others is looked up, as where it enters the domain: how many there are in the gap
    does not matter. The lanes of a vector do that together: when one comes to a gap, it waits until
    the others have come to one, or are out (when each did at once, discs took a tenth longer).
    """

    backend: Any
    families: list[Any]
    has_gaps: bool

    def cross(self, track: Any, cursor: Any) -> GapLanding:
        gap = cursor.inside & self.in_gap(track, cursor.count)

        def beyond(cursor: Any) -> tuple[Any]:
            count, t = self._cross_gap(track, cursor.count, cursor.t, gap)
            return (self._standing(track, count, t, cursor.inside & (t < track.leave)),)

        def stay(cursor: Any) -> tuple[Any]:
            return (cursor,)

        (there,) = dr.if_stmt((cursor,), gap, beyond, stay, label="gap")
        return GapLanding(there, gap, self, track)

    def _standing(self, track: Any, count: list[Any], t: Float, inside: Mask) -> Any:
        raise NotImplementedError

    def _times(self, track: Any, count: list[Any]) -> list[Any]:
        return [f.time(a, k) for f, a, k in zip(self.families, track.axes, count, strict=True)]

    def _gaps(self, track: Any, count: list[Any]) -> list[Any]:
        """Return for each family the lanes between walls of it that hold no cell."""
        return [
            family.in_gap(a, k) if family.has_gaps else self.backend.Bool(False)
            for family, a, k in zip(self.families, track.axes, count, strict=True)
        ]

    def in_gap(self, track: Any, count: list[Any]) -> Any:
        """Return the lanes that are in no cell."""
        return functools.reduce(either, self._gaps(track, count))

    def _cross_gap(self, track: Any, count: list[Any], t: Float, lanes: Int) -> Jump:
        """Move those lanes that are in a gap to the first cell beyond, or out of the domain."""

        def in_gap(count: list[Any], t: Float) -> Any:
            return lanes & (t < track.leave) & self.in_gap(track, count)

        def cross(count: list[Any], t: Float) -> Jump:
            return self._jump(track, count, t)

        return dr.while_loop((count, t), in_gap, cross, label="gap")

    def _jump(self, track: Any, count: list[Any], t: Float) -> Jump:
        gaps, ahead = self._gaps(track, count), self._times(track, count)
        ends = [dr.select(g, -way, NEVER) for g, way in zip(gaps, ahead, strict=True)]
        through = nearest(ends)
        end = lesser(later(-functools.reduce(lesser, ends), t), track.leave)
        count = dr.if_stmt(
            (count, through, end),
            end < track.leave,
            functools.partial(self._passed, track),
            _as_they_are,
        )
        return beyond(count, through), end

    def _passed(self, track: Any, count: list[Any], through: list[Any], end: Float) -> list[Any]:
        """Return counts where all walls of the other families on the way have been crossed."""
        return [
            dr.select(own, k, dr.maximum(k, family.enter(a, end)))
            for own, k, family, a in zip(through, count, self.families, track.axes, strict=True)
        ]


def _as_they_are(count: list[Any], through: list[Any], end: Float) -> list[Any]:
    """Return counts of rays that leave the domain: searching took a tenth of a disc's picture."""
    return count


def beyond(count: list[Any], through: list[Any]) -> list[Any]:
    """Return the counts beyond a wall."""
    return [dr.select(own, k + 1, k) for own, k in zip(through, count, strict=True)]
