"""The sub-steps that RADMC-3D's second order takes in spherical grids.

Interpolation along a straight line between two walls is poor where the line turns by a large angle
around the centre. RADMC-3D 2.0 therefore ends a step inside its cell where the line, from distance
r at closest approach b, has turned by about ``camera_maxdphi = 0.1``.
"""

from __future__ import annotations

from typing import Any

from ...backend import dr
from .approach import dot
from .gaps import Step
from .walk import Cursor, CurvilinearWalk, Track

# RADMC-3D's default of camera_maxdphi.
_LARGEST_TURN = 0.1
# Distance from the centre, in units of the scale, below which turning does not count.
_NEAREST = 1e-9


def cut(closest: Any, radius: Any, t: Any, length: Any) -> tuple[Any, Any]:
    """Return where a step that turns too far is to end, and which do.

    Parameters
    ----------
    closest, radius : array
        Distance from the centre at the closest approach, and where the step begins.
    t, length : array
        Where it begins, and how long it is.
    """
    turn = closest * length / (radius * (radius + length))
    short = turn > _LARGEST_TURN
    return dr.fma(length, _LARGEST_TURN / dr.select(short, turn, 1.0), t), short


def exact_cut(walk: Any, track: Any, begin: Any, t: Any, around_axis: bool) -> tuple[Any, Any]:
    """Return where steps from `begin` to a wall at `t` that turn too far end, and which do.

    With p where a step begins and d its direction, across the axis or in space, the line has turned
    by ψ after the distance ``|p|² tan ψ / (|p × d| - p·d tan ψ)``: never, if that is negative.
    RADMC-3D's estimate is far too small for rays that come near the centre.
    """
    point = walk.point(track, begin)
    if around_axis:
        point[2] = walk.backend.Float(0)
        (x, y, _), (dx, dy, _) = track.point, track.direction
        across = dr.abs(dr.fma(x, dy, -y * dx))
    else:  # distances count from the closest approach
        across = dr.sqrt(dot(track.point, track.point))
    square = dot(point, point)
    pace = dr.fma(dot(point, track.direction), -_LARGEST_TURN, across)
    # In the centre itself angles are of no meaning: rays go on.
    turns = (pace > 0.0) & (square > _NEAREST**2)
    end = dr.fma(square, _LARGEST_TURN / dr.select(turns, pace, 1.0), begin)
    short = turns & (end < t)
    return dr.select(short, end, t), short


class SteppedWalk(CurvilinearWalk):
    """Rays through a spherical grid in steps around the centre of at most a tenth of a radian."""

    stops_inside = True

    def _step(self, track: Track, cursor: Cursor) -> Step:
        """Return where rays leave the present cell, or as far inside as a step may go."""
        count, ahead, t, family = super()._step(track, cursor)
        part, short = self._cut(track, cursor, t)
        if self.has_gaps:
            short &= ~self._in_gap(track, cursor.count)
        return (
            dr.select(short, cursor.count, count),
            dr.select(short, cursor.ahead, ahead),
            dr.select(short, part, t),
            dr.select(short, -1, family),
        )

    def _cut(self, track: Track, cursor: Cursor, t: Any) -> tuple[Any, Any]:
        """Return where steps to a wall at `t` that turn too far are to end, and which do."""
        closest, radius = self._radius(track, 0.0), self._radius(track, cursor.t)
        return cut(closest, radius, cursor.t, t - cursor.t)

    def _radius(self, track: Track, t: Any) -> Any:
        point = self.point(track, t)
        return dr.sqrt(dot(point, point))
