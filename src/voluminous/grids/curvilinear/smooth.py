"""Where segments must end so that own coordinates are smooth enough on them for cubics.

Along a ray that passes the axis or the centre at distance q, with u counted from the closest
approach, radii are √(q² + u²) and angles those of the point (u, q): functions with singularities at
u = ±iq. The cubic through four values on a segment is off by about (h/4ρ)⁴, with h its length and ρ
the distance of the singularities from it, which is the ray's least distance from the axis or the
centre there. So h is at most a fraction of that, the smaller the less fields may be off: rays that
pass by far from both are not cut at all, and those that come near are cut into ever smaller
segments.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import numpy as np

from ...backend import dr
from ..contract import Segment
from .approach import dot
from .order import lesser

# The longest segment, as a part of its distance, where nothing is asked: √(q² + u²) is then off by
# 6e-6 q at most, and a field of white noise by 4e-4 of its range.
_PART = 0.25
# The fourth root of an error times this: white noise is then off by a tenth of the error.
_PER_ROOT = 1.0
_SHORTEST = 0.01
# In ε of the domain: rays count as passing no nearer than that, since places are not known better.
_NEAREST = 64.0
# Slower than this, a ray runs parallel to the axis.
_PARALLEL = 1e-12


class Smoothed:
    """A walk whose segments end where its `smooth` says."""

    smooth: Smooth

    def next(self, track: Any, cursor: Any) -> tuple[Segment, Any]:
        """Return the segment through the present cell, and the cursor in the next one.

        On the axis rays meet half planes all at once: there is nothing in cells between these.
        """
        walk: Any = super()
        segment, there = walk.next(track, cursor)
        return replace(segment, active=segment.active & (segment.length > 0.0)), there

    approximate = True

    def kept_to(self, error: float) -> Any:
        """Return the same walk where fields may be off by less than a part of their range."""
        kept = copy.copy(self)
        kept.smooth = self.smooth.kept_to(error)
        return kept

    def _cut(self, track: Any, cursor: Any, t: Any) -> tuple[Any, Any]:
        """Return where steps to a wall at `t` are to end, and which do before it."""
        return self.smooth.cut(track, cursor.t, t)


class Smooth:
    """Ends segments near the axis, and near the centre of a spherical grid.

    Parameters
    ----------
    centre : bool
        Whether there are coordinates of spheres.
    extent : float
        Distance of the farthest point of the domain, in units of the scale.
    """

    def __init__(self, centre: bool, extent: float, backend: Any) -> None:
        self.centre, self.backend = centre, backend
        self.part = backend.opaque(_PART)
        self.least = backend.opaque(_NEAREST * float(np.finfo(backend.dtype).eps) * extent)

    @classmethod
    def of(cls, grid: Any, backend: Any) -> Smooth:
        """Return what a grid needs."""
        farthest = [float(np.abs(grid.edges[k]).max()) / grid.scale for k in (0, 2)]
        centre = bool(grid.kind == "spherical")
        return cls(centre, farthest[0] if centre else max(farthest), backend)

    def kept_to(self, error: float) -> Smooth:
        """Return the same for fields that are to be off by less than a part of their range."""
        kept = copy.copy(self)
        part = np.clip(_PER_ROOT * error**0.25, _SHORTEST, _PART)
        kept.part = self.backend.opaque(float(part))
        return kept

    def cut(self, track: Any, begin: Any, end: Any) -> tuple[Any, Any]:
        """Return where segments from `begin` to a wall at `end` are to end, and which do before."""
        most = self._near_axis(track, begin)
        if self.centre:
            # Distances count from the closest approach.
            nearest = dr.sqrt(dot(track.point, track.point))
            most = lesser(most, self._longest(nearest, begin))
        stop = self._on_axis(track, begin, begin + most)
        short = stop < end
        return dr.select(short, stop, end), short

    def _on_axis(self, track: Any, begin: Any, end: Any) -> Any:
        turn = track.passage.turn
        return dr.select(track.passage.meets & (begin < turn) & (turn < end), turn, end)

    def _near_axis(self, track: Any, begin: Any) -> Any:
        (x, y), (dx, dy, _) = track.passage.foot, track.direction
        speed = dr.sqrt(dr.fma(dx, dx, dy * dy))
        parallel = speed < _PARALLEL
        inverse = 1.0 / dr.select(parallel, 1.0, speed)
        nearest, away = dr.sqrt(dr.fma(x, x, y * y)), (begin - track.passage.turn) * speed
        longest = self._longest(nearest, away) * inverse
        return dr.select(parallel, dr.inf, longest)

    def _longest(self, nearest: Any, away: Any) -> Any:
        """Return how long segments may be that begin so far behind the closest approach.

        Where it is an axis that the ray meets they are next to nothing: a scheme to which a field
        jumps there sees the jump, and none of what the field does on the segment.
        """
        # On the way there a segment's end is nearest, behind it its beginning is.
        own = dr.select(away < 0.0, -away / (1.0 + self.part), away)
        own = dr.select(own > nearest, own, nearest)
        return self.part * dr.select(own > self.least, own, self.least)
