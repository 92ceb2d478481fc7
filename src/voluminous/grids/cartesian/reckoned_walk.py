"""The walk by dead reckoning: every position follows from the one before, as in RADMC-3D 2.0.

RADMC-3D starts a ray far behind the domain and carries its position from wall to wall: the
coordinate that crosses is SET to the wall, the others advance by distance times direction. Its
second order shows the last bits of that in its images, so only the same operations in the same
order reproduce them. Which cell comes next is still counted (`CartesianWalk`): no ray leaks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from ...backend import dr
from ...backend.functions import unit_interval
from ..contract import Ray, Segment
from ..wall_corners import pick
from .walk import CartesianWalk, Cursor, Exit, Track, nearest


@dataclass
class ReckonedTrack(Track):
    """Also its direction, and per axis the number of the wall it enters by and the step on."""

    direction: list[Any]
    first_wall: list[Any]
    step: list[Any]


@dataclass
class ReckonedCursor(Cursor):
    """Also where the ray is, in the volume's coordinates."""

    position: list[Any]


@dataclass
class ReckonedExit(Exit):
    """Also where in its cell the segment ends, as a fraction along each axis."""

    fractions: list[Any]


class ReckonedWalk(CartesianWalk):
    """Rays that have a `Ray.start` through a `CartesianGrid`; in double precision."""

    leaps = False  # every position follows from the one before

    def enter(self, ray: Ray) -> tuple[ReckonedTrack, ReckonedCursor]:
        plain_track, cursor = super().enter(ray)
        down = [d < 0 for d in ray.direction]
        first_wall = [
            dr.select(is_down, axis.last_cell + 1, 0)
            for is_down, axis in zip(down, self.axes, strict=True)
        ]
        step = [dr.select(is_down, self.backend.Int(-1), 1) for is_down in down]
        track = ReckonedTrack(
            **vars(plain_track), direction=ray.direction, first_wall=first_wall, step=step
        )
        walls = [self._edge(a, number) for a, number in enumerate(first_wall)]
        ways = _ways(ray.start, ray.direction, walls)
        # The last of the three planes to be met is the one the ray enters by.
        before = [
            dr.select(d == 0, math.inf, -way) for way, d in zip(ways, ray.direction, strict=True)
        ]
        position = _advance(ray.start, ray.direction, walls, nearest(before))
        return track, ReckonedCursor(**vars(cursor), position=position)

    def next(self, track: Any, cursor: Any) -> tuple[Segment, ReckonedCursor]:
        segment, counted = super().next(track, cursor)
        behind, ahead = self._walls(track, cursor.index)
        here = cursor.position
        there = _advance(here, track.direction, ahead, segment.exit.through)
        dx, dy, dz = (b - a for a, b in zip(here, there, strict=True))
        segment.length = dr.sqrt(dx * dx + dy * dy + dz * dz) * self.to_scale
        fractions = _fractions(there, behind, ahead)
        segment.exit = ReckonedExit(**vars(segment.exit), fractions=fractions)
        return segment, ReckonedCursor(**vars(counted), position=there)

    def _edge(self, axis: int, number: Any) -> Any:
        return dr.gather(self.backend.Wide, self.axes[axis].edges, self.backend.UInt(number))

    def _walls(self, track: Any, index: list[Any]) -> tuple[list[Any], list[Any]]:
        """Return the walls of the present cell, one per axis: behind the ray and ahead of it."""
        numbers = [
            first + self.backend.Int(i) * step
            for first, i, step in zip(track.first_wall, index, track.step, strict=True)
        ]
        behind = [self._edge(a, number) for a, number in enumerate(numbers)]
        ahead = [self._edge(a, number + track.step[a]) for a, number in enumerate(numbers)]
        return behind, ahead

    def _entry_fractions(self, track: Any, cursor: Any) -> list[Any]:
        return _fractions(cursor.position, *self._walls(track, cursor.index))

    def _exit_fractions(self, track: Any, segment: Segment) -> list[Any]:
        return list(segment.exit.fractions)


def _ways(position: Any, direction: Any, walls: Any) -> list[Any]:
    """Return how far it is to a wall of each axis; not finite for rays along the walls."""
    return [(w - p) / d for w, p, d in zip(walls, position, direction, strict=True)]


def _advance(position: Any, direction: Any, walls: Any, through: Any) -> list[Any]:
    """Return the point where rays meet that one of three walls which they go through."""
    way = pick(through, _ways(position, direction, walls))
    return [
        dr.select(crossed, w, p + way * d)
        for crossed, w, p, d in zip(through, walls, position, direction, strict=True)
    ]


def _fractions(position: Any, behind: Any, ahead: Any) -> list[Any]:
    return [
        unit_interval((p - b) / (a - b)) for p, b, a in zip(position, behind, ahead, strict=True)
    ]
