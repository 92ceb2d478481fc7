"""The sub-steps that RADMC-3D's second order takes in spherical grids.

Interpolation along a straight line between two walls is poor where the line turns by a large angle
around the centre. RADMC-3D 2.0 therefore ends a step inside its cell where the line, from distance
r at closest approach b, has turned by about ``camera_maxdphi = 0.1``.
"""

from __future__ import annotations

from typing import Any

from ...backend import dr
from ...backend.types import Float
from .approach import dot
from .walk import CurvilinearWalk, Step, SurfaceCursor, SurfaceTrack

# RADMC-3D's default of camera_maxdphi.
_LARGEST_TURN = 0.1


def cut(closest: Any, radius: Float, t: Float, length: Float) -> tuple[Any, Any]:
    """Return where a step that turns too far is to end, and which do."""
    turn = closest * length / (radius * (radius + length))
    short = turn > _LARGEST_TURN
    return dr.fma(length, _LARGEST_TURN / dr.select(short, turn, 1.0), t), short


class SteppedWalk(CurvilinearWalk):
    """Rays through a spherical grid in steps around the centre of at most a tenth of a radian."""

    stops_inside = True

    def _step(self, track: SurfaceTrack, cursor: SurfaceCursor) -> Step:
        count, ahead, t, family = super()._step(track, cursor)
        part, short = self._cut(track, cursor, t)
        return (
            dr.select(short, cursor.count, count),
            dr.select(short, cursor.ahead, ahead),
            dr.select(short, part, t),
            dr.select(short, -1, family),
        )

    def _cut(self, track: SurfaceTrack, cursor: SurfaceCursor, t: Float) -> tuple[Any, Any]:
        """Return where steps to a wall at `t` that turn too far are to end, and which do."""
        closest, radius = self._radius(track, 0.0), self._radius(track, cursor.t)
        return cut(closest, radius, cursor.t, t - cursor.t)

    def _radius(self, track: SurfaceTrack, t: Float) -> Any:
        point = self.point(track, t)
        return dr.sqrt(dot(point, point))
