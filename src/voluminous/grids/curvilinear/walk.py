"""The walk of rays through cells between surfaces of constant coordinates.

Where a ray is, is one integer for each family of surfaces (`surfaces`); the next crossing of
each is computed afresh from its integer, and distances count from where the ray comes nearest to
the centre or the axis. Space between the surfaces that belongs to no cell (a cavity, open cones, an
empty wedge) is crossed in one step (`gaps`).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr, from_host
from ...backend.types import Float, Mask
from ..contract import Corners, Ray, Segment
from .approach import Passage, pass_axis
from .corners import cell_corners, wall_corners
from .crossing import choose, later, lesser, meet, nearest, pick
from .gaps import GapCrossing, beyond
from .surfaces import ahead

if TYPE_CHECKING:
    from ...backend.device import Backend

# Counts beyond a wall, the next walls' distances, the one there, and the number of its family.
Step = tuple[list[Any], list[Any], Any, Any]


@dataclass
class SurfaceTrack:
    """What is constant along a ray.

    Attributes
    ----------
    axes : list of tracks
        One for each family of surfaces.
    point, direction : list of three arrays
        Where distances count from, and the direction: lengths in units of the scale.
    arrive, leave : array
        Where the ray enters the domain, and where it leaves it or ends.
    bounded : bool
        Rays may end inside a cell.
    entry : array
        From the ray's origin to where it enters the domain.
    passage : Passage
        Where it passes the axis.
    """

    axes: list[Any]
    point: list[Any]
    direction: list[Any]
    arrive: Float
    leave: Float
    bounded: bool
    entry: Float
    passage: Passage


@dataclass
class SurfaceCursor:
    """Where a ray is: for each family its count and the distance of its next wall; its own."""

    count: list[Any]
    ahead: list[Any]
    t: Float
    inside: Mask


@dataclass
class SurfaceExit:
    """How a segment leaves its cell.

    Attributes
    ----------
    family : array of Int
        Number of the family through whose wall; -1 where it ends inside the cell.
    count : list of arrays of Int
        Counts of the families before that wall.
    t : array
        Distance.
    """

    family: Any
    count: list[Any]
    t: Float


class CurvilinearWalk(GapCrossing):
    """Rays through a curvilinear grid; see `grids.contract.Walk`.

    Parameters
    ----------
    families : list of Surfaces
        The families of walls that there are; an axis with a single cell all around has none.
    strides, vertex_strides : list of int
        What a step along each of them adds to the flat number of a cell, and of a vertex.
    approach : callable
        Returns a ray's `Approach` from origin and direction, in units of the scale.
    """

    stops_inside = False  # segments may end inside a cell

    def __init__(
        self,
        families: list[Any],
        strides: list[int],
        vertex_strides: list[int],
        approach: Any,
        scale: float,
        backend: Backend,
    ) -> None:
        self.backend, self.families, self.approach = backend, families, approach
        self.scale, self.to_scale = backend.wide(scale), backend.wide(1.0 / scale)
        self.strides = [dr.opaque(backend.Int, s) for s in strides]
        self.vertex_strides = [dr.opaque(backend.Int, s) for s in vertex_strides]
        self.has_gaps = any(family.has_gaps for family in families)
        self.stops_inside |= any(family.halves_cell for family in families)
        self._share_tables()

    def _share_tables(self) -> None:
        """Put the walls of all families into one table: one crossing is computed per step."""
        tables, first = [family.own_table for family in self.families], 0
        # One more: of rays that leave through the last wall of all the next is looked up, too.
        rows = np.concatenate([*tables, tables[-1][-1:]])
        shared = from_host(self.backend.Float, rows.reshape(-1))
        for family, table in zip(self.families, tables, strict=True):
            family.share(shared, first)
            first += len(table)

    def enter(self, ray: Ray) -> tuple[SurfaceTrack, SurfaceCursor]:
        Float = self.backend.Float
        origin = [o * self.to_scale for o in ray.origin]
        approach = self.approach(origin, list(ray.direction))
        begin, end = approach.arrive, approach.leave
        if ray.first is not None:
            begin = dr.maximum(begin, dr.fma(ray.first, self.to_scale, -approach.way))
        if ray.last is not None:
            end = dr.minimum(end, dr.fma(ray.last, self.to_scale, -approach.way))
        inside = approach.hits & (begin < end)
        if ray.active is not None:
            inside &= ray.active
        approach.passage = pass_axis(approach, origin, begin, end)
        tracks = [family.track(approach) for family in self.families]
        point, direction = ([Float(c) for c in v] for v in (approach.point, approach.direction))
        ends = [f.leave(a) for f, a in zip(self.families, tracks, strict=True) if f.encloses]
        # A crossing itself, computed alike: a ray never steps beyond the last cell.
        leave = functools.reduce(lesser, ends)
        bounded = ray.last is not None
        leave = lesser(leave, Float(end)) if bounded else leave
        entry = approach.way + approach.arrive
        arrive, passage = Float(approach.arrive), approach.passage.narrow(Float)
        track = SurfaceTrack(tracks, point, direction, arrive, leave, bounded, entry, passage)
        t = Float(dr.select(inside, begin, 0.0))
        count = [f.enter(a, t) for f, a in zip(self.families, tracks, strict=True)]
        return track, self._standing(track, count, t, inside & (t < track.leave))

    def _standing(
        self, track: SurfaceTrack, count: list[Any], t: Float, inside: Mask
    ) -> SurfaceCursor:
        return SurfaceCursor(count, self._times(track, count), t, inside)

    def next(self, track: SurfaceTrack, cursor: SurfaceCursor) -> tuple[Segment, SurfaceCursor]:
        count, ahead, t, family = self._step(track, cursor)
        segment = Segment(
            self.backend.UInt(self._flat(self._cells(track, cursor.count), self.strides)),
            t - cursor.t,
            cursor.t - track.arrive,
            t - track.arrive,
            cursor.inside,
            SurfaceExit(family, cursor.count, t),
        )
        return segment, SurfaceCursor(count, ahead, t, cursor.inside & (t < track.leave))

    def _step(self, track: SurfaceTrack, cursor: SurfaceCursor) -> Step:
        """Return where rays meet the next wall, and of which family, whatever space it bounds."""
        through = nearest(cursor.ahead)
        # Rounding may put a wall behind the ray: it has been crossed.
        end = lesser(later(functools.reduce(lesser, cursor.ahead), cursor.t), track.leave)
        count = beyond(cursor.count, through)
        following = self._next_wall(track, count, through)
        times = [
            dr.select(own, following, way) for own, way in zip(through, cursor.ahead, strict=True)
        ]
        return count, times, end, self._number(through)

    def _next_wall(self, track: SurfaceTrack, count: list[Any], through: list[Any]) -> Any:
        zero = self.backend.Float(0)
        lines = choose(through, [axis.lines for axis in track.axes], zero)
        slot = pick(through, [axis.slot for axis in track.axes], self.backend.Int(0))
        number = pick(through, count, self.backend.Int(0))
        wall = self.families[0].wall_at(ahead(slot, number))
        return meet(lines, wall, number < 0)

    def _number(self, through: list[Any]) -> Any:
        number = self.backend.Int(0)
        for k, crossed in enumerate(through[1:]):
            number = dr.select(crossed, k + 1, number)
        return number

    def _cells(self, track: SurfaceTrack, count: list[Any]) -> list[Any]:
        """Return the number of the cell along each axis; beyond its ends where there is none."""
        return [f.cell(a, k) for f, a, k in zip(self.families, track.axes, count, strict=True)]

    def cells_near(self, track: SurfaceTrack, count: list[Any]) -> list[Any]:
        """Return the number of the cell along each axis, or of the nearest one."""
        found = self._cells(track, count)
        return [dr.clip(i, 0, f.last_cell) for i, f in zip(found, self.families, strict=True)]

    def _flat(self, index: list[Any], strides: list[Any]) -> Any:
        total = index[0] * strides[0]
        for i, stride in zip(index[1:], strides[1:], strict=True):
            total += i * stride
        return total

    def entry_corners(self, track: SurfaceTrack, cursor: SurfaceCursor) -> Corners:
        standing = SurfaceExit(self.backend.Int(-1), cursor.count, cursor.t)
        return cell_corners(self, track, standing)

    def exit_corners(self, track: SurfaceTrack, segment: Segment) -> Corners:
        leaving = segment.exit
        if track.bounded or self.stops_inside:
            family = self._family_with_vertices(track, leaving)
            return cell_corners(self, track, SurfaceExit(family, leaving.count, leaving.t))
        return wall_corners(self, track, leaving)

    def _family_with_vertices(self, track: SurfaceTrack, leaving: SurfaceExit) -> Any:
        """Return the family whose wall, with its vertices, rays have come to; -1 inside cells."""
        number = leaving.family
        if track.bounded:  # where a ray ends it has not come to the wall ahead
            number = dr.select(leaving.t < track.leave, number, -1)
        for n, (family, axis) in enumerate(zip(self.families, track.axes, strict=True)):
            if family.halves_cell:
                inside = (number == n) & family.in_cell(axis, leaving.count[n])
                number = dr.select(inside, -1, number)
        return number

    def point(self, track: SurfaceTrack, t: Float, away: Any = None) -> list[Any]:
        """Return where rays are at a distance, from the centre, in units of the scale.

        How far that is from where they pass the axis may be known better (`Passage.beside`).
        """
        away = t - track.passage.turn if away is None else away
        *across, dz = track.direction
        x, y = (dr.fma(away, d, f) for f, d in zip(track.passage.foot, across, strict=True))
        return [x, y, dr.fma(t, dz, track.point[2])]
