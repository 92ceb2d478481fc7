"""The walk of rays through cells between surfaces of constant coordinates.

Where a ray is, is one integer for each family of surfaces (`surfaces`); the next crossing of
each is computed afresh from its integer, and distances count from where the ray comes nearest to
the centre or the axis.
"""

from __future__ import annotations

import functools
import operator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr, from_host
from ...backend.functions import branch, loop
from ...backend.types import Float, Int, Mask
from ..box_walk import NEVER
from ..contract import Corners, Landing, Ray, Segment, Skip, Walk
from ..lanes import greater, least, lesser, nearest
from .approach import Passage, dot, pass_axis
from .surfaces import SurfaceGrid, Surfaces, ahead, choose, meet, pick_any

if TYPE_CHECKING:
    from ...backend.device import Backend

# Counts beyond a wall, the next walls' distances, the one there, and the number of its family.
Step = tuple[list[Int], list[Float], Float, Int]
# RADMC-3D's default of camera_maxdphi, the largest turn around the centre in a sub-step.
_LARGEST_TURN = 0.1


@dataclass
class SurfaceTrack:
    """What is constant along a ray.

    `axes`: one for each family of surfaces; `point`, `direction`: where distances count from, and
    the direction: lengths in units of the scale; `arrive`, `leave`: where the ray enters the
    domain, and where it leaves it or ends; `bounded`: rays may end inside a cell; `entry`: from the
    ray's origin to where it enters the domain; `passage`: where it passes the axis.
    """

    axes: list[Float]
    point: list[Float]
    direction: list[Float]
    arrive: Float
    leave: Float
    bounded: bool
    entry: Float
    passage: Passage


@dataclass
class SurfaceCursor:
    """Where a ray is: for each family its count and the distance of its next wall; its own."""

    count: list[Int]
    ahead: list[Float]
    t: Float
    inside: Mask


@dataclass
class SurfaceExit:
    """How a segment leaves its cell.

    `family`: number of the family through whose wall; -1 where it ends inside the cell; `count`:
    counts of the families before that wall; `t`: distance.
    """

    family: Int
    count: list[Int]
    t: Float


class CurvilinearWalk(Walk):
    """Rays through a curvilinear grid; see `grids.contract.Walk`.

    Space between surfaces that belongs to no cell (a cavity, open cones at the poles, an empty
    wedge) is crossed in one step: a ray leaves it through that wall of its family which is next,
    and where it is then among the walls of the others is looked up, as where it enters the domain.
    The lanes of a vector do that together: when one comes to a gap, it waits until the others have
    come to one, or are out (when each did at once, discs took a tenth longer).

    `families`: the families of walls that there are; an axis with a single cell all around has
    none; `axes`: the axis that each of them divides; `strides`, `vertex_strides`: what a step along
    each of them adds to the flat number of a cell, and of a vertex.
    """

    def __init__(
        self,
        grid: SurfaceGrid,
        edges: tuple[np.ndarray, ...],
        backend: Backend,
        stepped: bool = False,
    ) -> None:
        self.grid, self.backend, self.stepped = grid, backend, stepped
        families, self.approach = grid.families(edges, backend)
        self.axes = [a for a, f in enumerate(families) if f.encloses or f.has_gaps or f.cells > 1]
        self.families: list[Surfaces] = [families[a] for a in self.axes]
        counts = [len(e) - 1 for e in edges]
        self.strides = self._strides(counts)
        self.vertex_strides = self._strides([n + 1 for n in counts])
        self.scale, self.to_scale = backend.wide(grid.scale), backend.wide(1.0 / grid.scale)
        self.has_gaps = any(family.has_gaps for family in self.families)
        self.stops_inside = stepped or any(family.halves_cell for family in self.families)
        # The walls of all families in one table: one crossing is computed per step. One more: of
        # rays that leave through the last wall of all the next is looked up, too.
        tables, first = [family.own_table for family in self.families], 0
        rows = np.concatenate([*tables, tables[-1][-1:]])
        shared = from_host(backend.Float, rows.reshape(-1))
        for family, table in zip(self.families, tables, strict=True):
            family.share(shared, first)
            first += len(table)

    def _strides(self, counts: list[int]) -> list[Int]:
        strides = (counts[1] * counts[2], counts[2], 1)
        return [dr.opaque(self.backend.Int, strides[a]) for a in self.axes]

    def enter(self, ray: Ray) -> tuple[SurfaceTrack, SurfaceCursor]:
        Float = self.backend.Float
        origin = [o * self.to_scale for o in ray.origin]
        approach = self.approach(origin, list(ray.direction))
        begin, end = approach.arrive, approach.leave
        if ray.first is not None:
            begin = dr.maximum(begin, dr.fma(ray.first, self.to_scale, -approach.offset))
        if ray.last is not None:
            end = dr.minimum(end, dr.fma(ray.last, self.to_scale, -approach.offset))
        inside = approach.hits & (begin < end)
        if ray.active is not None:
            inside &= ray.active
        approach.passage = pass_axis(approach, origin, begin, end)
        tracks = [family.track(approach) for family in self.families]
        point, direction = ([Float(c) for c in v] for v in (approach.point, approach.direction))
        # A crossing itself, computed alike: a ray never steps beyond the last cell.
        leave = least(
            [f.leave(a) for f, a in zip(self.families, tracks, strict=True) if f.encloses]
        )
        bounded = ray.last is not None
        leave = lesser(leave, Float(end)) if bounded else leave
        entry = approach.offset + approach.arrive
        arrive, passage = Float(approach.arrive), approach.passage.narrow(Float)
        track = SurfaceTrack(tracks, point, direction, arrive, leave, bounded, entry, passage)
        t = Float(dr.select(inside, begin, 0.0))
        count = [f.enter(a, t) for f, a in zip(self.families, tracks, strict=True)]
        return track, self._standing(track, count, t, inside & (t < track.leave))

    def _standing(
        self, track: SurfaceTrack, count: list[Int], t: Float, inside: Mask
    ) -> SurfaceCursor:
        return SurfaceCursor(count, self._times(track, count), t, inside)

    def next(self, track: SurfaceTrack, cursor: SurfaceCursor) -> tuple[Segment, SurfaceCursor]:
        count, ahead, t, family = self._step(track, cursor)
        active = self._in_cell(track, cursor)
        cell = self.backend.UInt(flat(self._cells(track, cursor.count), self.strides))
        if self.has_gaps:
            cell = dr.select(active, cell, 0)
        begin, end = cursor.t - track.arrive, t - track.arrive
        leaving = SurfaceExit(family, cursor.count, t)
        segment = Segment(cell, t - cursor.t, begin, end, active, leaving)
        return segment, SurfaceCursor(count, ahead, t, cursor.inside & (t < track.leave))

    def _step(self, track: SurfaceTrack, cursor: SurfaceCursor) -> Step:
        through = nearest(cursor.ahead)
        # Rounding may put a wall behind the ray: it has been crossed.
        t = lesser(greater(least(cursor.ahead), cursor.t), track.leave)
        count = _beyond(cursor.count, through)
        lines = choose(through, [axis.lines for axis in track.axes], self.backend.Float(0))
        slot = pick_any(through, [axis.slot for axis in track.axes], self.backend.Int(0))
        number = pick_any(through, count, self.backend.Int(0))
        following = meet(lines, self.families[0].wall_at(ahead(slot, number)), number < 0)
        times = [
            dr.select(own, following, distance)
            for own, distance in zip(through, cursor.ahead, strict=True)
        ]
        family = self._number(through)
        if not self.stepped:
            return count, times, t, family
        part, short = self._cut(track, cursor, t)
        return (
            dr.select(short, cursor.count, count),
            dr.select(short, cursor.ahead, times),
            dr.select(short, part, t),
            dr.select(short, -1, family),
        )

    def _cut(self, track: SurfaceTrack, cursor: SurfaceCursor, t: Float) -> tuple[Float, Mask]:
        """Return where steps to a wall at `t` that turn too far are to end, and which do.

        Interpolation along a straight line between two walls is poor where the line turns by a
        large angle around the centre. RADMC-3D 2.0 therefore ends a step inside its cell where the
        line, from distance r at closest approach b, has turned by about ``camera_maxdphi``.
        """
        length, closest = t - cursor.t, self._closest(track)
        radius = norm(self.point(track, cursor.t))
        turn = closest * length / (radius * (radius + length))
        short = turn > _LARGEST_TURN
        return dr.fma(length, _LARGEST_TURN / dr.select(short, turn, 1.0), cursor.t), short

    def _closest(self, track: SurfaceTrack) -> Float:
        return norm(self.point(track, 0.0))

    def _number(self, through: list[Mask]) -> Int:
        number = self.backend.Int(0)
        for k, crossed in enumerate(through[1:]):
            number = dr.select(crossed, k + 1, number)
        return number

    def _times(self, track: SurfaceTrack, count: list[Int]) -> list[Float]:
        return [f.time(a, k) for f, a, k in zip(self.families, track.axes, count, strict=True)]

    def _cells(self, track: SurfaceTrack, count: list[Int]) -> list[Int]:
        """Return the number of the cell along each axis; beyond its ends where there is none."""
        return [f.cell(a, k) for f, a, k in zip(self.families, track.axes, count, strict=True)]

    def cells_near(self, track: SurfaceTrack, count: list[Int]) -> list[Int]:
        """Return the number of the cell along each axis, or of the nearest one."""
        cells = self._cells(track, count)
        return [dr.clip(i, 0, f.last_cell) for i, f in zip(cells, self.families, strict=True)]

    def point(self, track: SurfaceTrack, t: Float, away: Float = None) -> list[Float]:
        """Return where rays are at a distance, from the centre, in units of the scale.

        How far that is from where they pass the axis may be known better (`Passage.beside`).
        """
        away = t - track.passage.turn if away is None else away
        *across, dz = track.direction
        x, y = (dr.fma(away, d, f) for f, d in zip(track.passage.foot, across, strict=True))
        return [x, y, dr.fma(t, dz, track.point[2])]

    def _gaps(self, track: SurfaceTrack, count: list[Int]) -> list[Mask]:
        return [
            family.in_gap(a, k) if family.has_gaps else self.backend.Bool(False)
            for family, a, k in zip(self.families, track.axes, count, strict=True)
        ]

    def in_gap(self, track: SurfaceTrack, count: list[Int]) -> Mask:
        """Return the lanes that are in no cell."""
        return functools.reduce(operator.or_, self._gaps(track, count))

    def _in_cell(self, track: SurfaceTrack, cursor: Any) -> Mask:
        if not self.has_gaps:
            return cursor.inside
        return cursor.inside & ~self.in_gap(track, cursor.count)

    def skipper(self, track: SurfaceTrack, bricks: Any = None) -> Skip | None:
        def skip(cursor: Any) -> Landing:
            gap = cursor.inside & self.in_gap(track, cursor.count)

            def in_gap(count: list[Int], t: Float) -> Mask:
                return gap & (t < track.leave) & self.in_gap(track, count)

            def jump(count: list[Int], t: Float) -> tuple[list[Int], Float]:
                return self._jump(track, count, t)

            def beyond(cursor: Any) -> tuple[Any]:
                count, t = loop((cursor.count, cursor.t), in_gap, jump, label="gap")
                return (self._standing(track, count, t, cursor.inside & (t < track.leave)),)

            def stay(cursor: Any) -> tuple[Any]:
                return (cursor,)

            (there,) = branch((cursor,), gap, beyond, stay)
            return Landing(there, gap, lambda later: ~self.in_gap(track, later.count))

        return skip if self.has_gaps else None

    def _jump(self, track: SurfaceTrack, count: list[Int], t: Float) -> tuple[list[Int], Float]:
        gaps, ahead = self._gaps(track, count), self._times(track, count)
        ends = [dr.select(g, -wall, NEVER) for g, wall in zip(gaps, ahead, strict=True)]
        through = nearest(ends)
        end = lesser(greater(-least(ends), t), track.leave)

        def passed(count: list[Int], through: list[Mask], end: Float) -> list[Int]:
            # All walls of the other families before it have been crossed.
            return [
                dr.select(own, k, dr.maximum(k, family.enter(a, end)))
                for own, k, family, a in zip(through, count, self.families, track.axes, strict=True)
            ]

        def as_they_are(count: list[Int], through: list[Mask], end: Float) -> list[Int]:
            return count  # rays leave the domain: searching took a tenth of a disc's picture

        count = branch((count, through, end), end < track.leave, passed, as_they_are)
        return _beyond(count, through), end

    def entry_corners(self, track: SurfaceTrack, cursor: SurfaceCursor) -> Corners:
        standing = SurfaceExit(self.backend.Int(-1), cursor.count, cursor.t)
        return self._cell_corners(track, standing)

    def exit_corners(self, track: SurfaceTrack, segment: Segment) -> Corners:
        """Return the vertices around the end of a segment: those of the wall it leaves through.

        Interpolation is linear in each of the grid's own coordinates, as in RADMC-3D.
        """
        leaving, families = segment.exit, self.families
        if track.bounded or self.stops_inside:
            family = self._family_with_vertices(track, leaving)
            return self._cell_corners(track, SurfaceExit(family, leaving.count, leaving.t))
        index, fractions = self._places(track, leaving)
        base: Int = 0
        for a, (family, stride) in enumerate(zip(families, self.vertex_strides, strict=True)):
            vertex = dr.clip(
                family.vertex(track.axes[a], leaving.count[a]), 0, family.last_cell + 1
            )
            base += dr.select(leaving.family == a, vertex, index[a]) * stride
        chosen, strides = [], []
        for k in range(1, len(index)):
            # The k-th of the other axes: those before the wall's own come first.
            own = leaving.family >= k
            chosen.append(dr.select(own, fractions[k - 1], fractions[k]))
            strides.append(dr.select(own, self.vertex_strides[k - 1], self.vertex_strides[k]))
        return self._multilinear(base, chosen, strides)

    def _family_with_vertices(self, track: SurfaceTrack, leaving: SurfaceExit) -> Int:
        """Return the family whose wall, with its vertices, rays have come to; -1 inside cells."""
        number = leaving.family
        if track.bounded:  # where a ray ends it has not come to the wall ahead
            number = dr.select(leaving.t < track.leave, number, -1)
        for n, (family, axis) in enumerate(zip(self.families, track.axes, strict=True)):
            if family.halves_cell:
                inside = (number == n) & family.in_cell(axis, leaving.count[n])
                number = dr.select(inside, -1, number)
        return number

    def _cell_corners(self, track: SurfaceTrack, leaving: SurfaceExit) -> Corners:
        """Return the vertices of a cell and weights where a ray is.

        If that is on a wall, its coordinate there is the wall's, exactly.
        """
        index, fractions = self._places(track, leaving)
        for a, family in enumerate(self.families):
            crossed = leaving.family == a
            vertex = family.vertex(track.axes[a], leaving.count[a])
            last = vertex > family.last_cell  # it has no cell above
            end = dr.select(last, self.backend.Float(1), 0)
            fractions[a] = dr.select(crossed, end, fractions[a])
            index[a] = dr.select(crossed, dr.select(last, family.last_cell, vertex), index[a])
        return self._multilinear(flat(index, self.vertex_strides), fractions, self.vertex_strides)

    def _places(self, track: SurfaceTrack, leaving: SurfaceExit) -> tuple[list[Int], list[Float]]:
        index, point = self.cells_near(track, leaving.count), self.point(track, leaving.t)
        return index, [f.fraction(i, point) for f, i in zip(self.families, index, strict=True)]

    def _multilinear(self, base: Int, fractions: list[Float], strides: list[Int]) -> Corners:
        vertices, weights = [base], [self.backend.Float(1)]
        for f, stride in zip(fractions, strides, strict=True):
            vertices += [v + stride for v in vertices]
            upper = [w * f for w in weights]
            weights = [w - u for w, u in zip(weights, upper, strict=True)] + upper
        return Corners(vertices, weights)


def flat(index: list[Int], strides: list[Int]) -> Int:
    """Return a flat number from indices."""
    return functools.reduce(operator.add, [i * s for i, s in zip(index, strides, strict=True)])


def _beyond(count: list[Int], through: list[Mask]) -> list[Int]:
    return [dr.select(own, k + 1, k) for own, k in zip(through, count, strict=True)]


def norm(vector: list[Float]) -> Float:
    """Return the length of a vector."""
    return dr.sqrt(dot(vector, vector))
