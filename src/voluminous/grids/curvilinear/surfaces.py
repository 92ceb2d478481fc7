"""Families of surfaces that a straight ray meets in an order known beforehand.

Along a straight line the radius falls to its least value and rises again, cos θ rises to its
greatest and falls (or the other way round), azimuth and height only rise or only fall. A ray
therefore meets the spheres r = const (and cones, cylinders, half planes, planes) in a fixed order,
and its place among them is ONE integer: how many it has met, or how many it is before or after the
turning point. Which surface is next, and which of its two crossings, follows from that integer: the
crossing a ray came in through is never found again by arithmetic, and no ray leaks.

A family knows its walls and which of them is next (`TurningPoint`, `Running`); its subclasses
know where a ray is among them, and the coefficients with which it meets them
(`grids.curvilinear.crossing`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr, from_host
from ...backend.functions import first_true
from ...backend.types import Float, Int, Mask
from ..box_walk import NEVER
from .approach import PARALLEL, Approach
from .arithmetic import NUMBERS, Arithmetic
from .crossing import RayLines, meet
from .edges import ANGLE_ROUNDING

if TYPE_CHECKING:
    from ...backend.device import Backend


@dataclass
class TurningTrack:
    """Rays and a family of surfaces they meet downwards, then upwards.

    Attributes
    ----------
    surface : dataclass of arrays
        How a ray runs through them.
    lines : RayLines
        When it meets them.
    slot : array of Int
        Place in the table of the first wall that is met at all.
    turn, reach : array of Int
        Number of that wall, and of the walls that are met (each of them twice, at most).
    down : array of Bool or None
        Lanes that see the family mirrored.
    """

    surface: Any
    lines: RayLines
    slot: Any
    turn: Any
    reach: Any
    down: Mask = None


@dataclass
class RunningTrack:
    """Rays and a family of surfaces they meet in ascending order (mirrored where `down`).

    `start` is where their walls start in the table, `slot` the first one that is ahead.
    """

    surface: Any
    lines: RayLines
    start: Any
    slot: Any
    down: Mask


class Surfaces:
    """What all families share.

    Parameters
    ----------
    table : array, shape (entries, 2)
        The numbers (c, v) of each wall (`grids.curvilinear.crossing`); mirrored walls may follow.
    walls : int
        Number of walls.
    cells : int
        Number of cells that hold data.
    backend : Backend
        Device and precision.

    Attributes
    ----------
    has_gaps : bool
        There is space between these surfaces that belongs to no cell.
    encloses : bool
        Beyond the outermost one is nothing at all: it has `leave`, the distance of its crossing.
    halves_cell : bool
        One of the walls is inside a cell, where there are no vertices: it has `in_cell`.
    widest : float
        Angle between the walls of a cell, at most.
    """

    has_gaps = False
    encloses = False
    halves_cell = False
    widest = 0.0

    def __init__(self, table: np.ndarray, walls: int, cells: int, backend: Backend) -> None:
        self.backend, self.walls, self.cells = backend, walls, cells
        self.own_table = table
        self.last_cell = dr.opaque(backend.Int, cells - 1)
        self.wall_count = dr.opaque(backend.Int, walls)

    def share(self, table: Any, first: int) -> None:
        """Take the table that holds the walls of all families; its own begin at `first`."""
        self.table, self.first = table, dr.opaque(self.backend.Int, first)

    def wall_at(self, slot: Any) -> list[Any]:
        """Return the numbers of a wall of the table."""
        return list(dr.gather(self.backend.packet(2), self.table, self.backend.UInt(slot)))

    @property
    def sharp(self) -> bool:
        """Whether no cell is wider than π/4."""
        return self.widest <= 0.25 * np.pi + ANGLE_ROUNDING

    def time(self, track: Any, count: Int) -> Any:
        """Return the distance of the next crossing."""
        return meet(track.lines, self.wall_at(ahead(track.slot, count)), count < 0)

    def fraction(self, cell: Int, point: list[Any], own: Arithmetic = NUMBERS) -> Any:
        """Return where between the walls of its cell a point is, from 0 to 1."""
        raise NotImplementedError

    def in_gap(self, track: Any, count: Int) -> Any:
        """Return the lanes between walls that hold no cell."""
        raise NotImplementedError


class TurningPoint(Surfaces):
    """Surfaces that are met downwards, then upwards.

    ``count`` is negative before the turning point and counts the crossings that remain until there;
    afterwards it counts those since. The cell is ``turn + |count|``.
    """

    def track(self, approach: Any) -> TurningTrack:
        """Return how rays see this family."""
        surface, down, mirrored = self.surface(approach)
        start = self.first + (0 if mirrored is None else mirrored)
        turn = first_true(
            self.walls,
            self.backend.UInt,
            lambda k: self.is_met(surface, self.wall_at(self.backend.UInt(start) + k)),
        )
        turn = self.backend.Int(turn)
        reach, lines = self.wall_count - turn, self.lines(surface)
        return TurningTrack(surface, lines, start + turn, turn, reach, down)

    def surface(self, approach: Any) -> tuple[Any, Any, Any]:
        """Return how rays run, which lanes see the family mirrored, and where its table starts."""
        raise NotImplementedError

    def lines(self, surface: Any) -> RayLines:
        """Return when rays meet the surfaces."""
        raise NotImplementedError

    def is_met(self, surface: Any, values: list[Any]) -> Any:
        """Return True for walls from the first one on that the ray gets to."""
        raise NotImplementedError

    def enter(self, track: TurningTrack, t: Float) -> Any:
        """Return the count at a distance, from where the ray is there.

        Where rounding counts a wall too many or too few, the ray is within rounding of it: it is
        crossed in a step of no length, or not at all.
        """
        here, inward = self.place(track.surface, t)
        start = track.slot - track.turn
        below = first_true(
            self.walls,
            self.backend.UInt,
            lambda k: self.is_above(self.wall_at(self.backend.UInt(start) + k), here),
        )
        number = dr.maximum(self.backend.Int(below) - track.turn, 0)
        return dr.select(inward, -number, number)

    def place(self, surface: Any, t: Float) -> tuple[Any, Any]:
        """Return where rays are, as `is_above` wants it, and which are before the turning point."""
        raise NotImplementedError

    def is_above(self, values: list[Any], here: Float) -> Any:
        """Return True for walls from the first one on that is not below a place."""
        raise NotImplementedError

    def number(self, track: TurningTrack, count: Int) -> Any:
        """Return how many walls lie below the ray."""
        number = track.turn + dr.abs(count)
        return (
            number
            if track.down is None
            else dr.select(track.down, self.wall_count - number, number)
        )

    def wall(self, track: TurningTrack, count: Int) -> Any:
        """Return the number of the wall that is met next."""
        wall = ahead(track.turn, count)
        if track.down is None:
            return wall
        return dr.select(track.down, self.wall_count - 1 - wall, wall)


class Running(Surfaces):
    """Surfaces that are met one after the other; ``count`` is how many have been."""

    def track(self, approach: Any) -> RunningTrack:
        """Return how rays see this family."""
        raise NotImplementedError

    def enter(self, track: RunningTrack, t: Float) -> Any:
        """Return the count at a distance: how many of the walls ahead have been met there."""
        here = self.place(track.surface, t)
        met = first_true(
            self.walls,
            self.backend.UInt,
            lambda k: self.is_ahead(
                track.surface, self.wall_at(track.slot + self.backend.Int(k)), here
            ),
        )
        return self.backend.Int(met)

    def rises(self, track: RunningTrack, count: Int) -> Any:
        """Return where the number of the cell grows along the ray."""
        return ~track.down

    def place(self, surface: Any, t: Float) -> Any:
        """Return where rays are, as `is_ahead` wants it."""
        raise NotImplementedError

    def is_ahead(self, surface: Any, values: list[Any], here: Float) -> Any:
        """Return True for walls from the first one on that a ray has not met."""
        raise NotImplementedError


def ahead(turn: Any, count: Int) -> Any:
    """Return the wall ahead, from that at the turning point: -count - 1 on, if that is negative."""
    return turn + (count ^ (count >> 31))


@dataclass
class PlaneTrack:
    """Mirrored height of a ray, and distance along it per height."""

    height: Any
    pace: Float
    parallel: Mask


class Planes(Running):
    """Planes across the axis.

    Parameters
    ----------
    edges : array
        Heights of the cells' walls, in units of the grid's scale.
    """

    encloses = True

    def __init__(self, edges: np.ndarray, backend: Backend) -> None:
        beyond = [2 * edges[-1] - edges[0]], [edges[-1] - 2 * edges[0]]
        heights = np.concatenate([edges, beyond[0], -edges[::-1], beyond[1]])
        table = np.stack([heights, np.zeros_like(heights)], axis=1)
        super().__init__(table, len(edges), len(edges) - 1, backend)
        self.mirrored_start = dr.opaque(backend.Int, len(edges) + 1)
        self.lower = from_host(backend.Float, edges[:-1])
        self.inverse_width = from_host(backend.Float, 1.0 / np.diff(edges))

    def track(self, approach: Approach) -> RunningTrack:
        Float = self.backend.Float
        z, dz = approach.point[2], approach.direction[2]
        down, parallel = dz < 0, dr.abs(dz) < PARALLEL
        pace = 1.0 / dr.select(parallel, 1.0, dr.abs(dz))
        surface = PlaneTrack(Float(dr.select(down, -z, z)), Float(pace), parallel)
        start = self.first + dr.select(down, self.mirrored_start, 0)
        return RunningTrack(surface, self.lines(surface), start, start, down)

    def place(self, surface: PlaneTrack, t: Float) -> Any:
        way = dr.select(surface.parallel, 0.0, t / surface.pace)
        return surface.height + way

    def is_ahead(self, surface: PlaneTrack, wall: list[Any], here: Float) -> Any:
        return wall[0] > here

    def lines(self, surface: PlaneTrack) -> RayLines:
        """Return when rays meet the planes; parallel to them they never meet the one above."""
        pace = dr.select(surface.parallel, 0.0, surface.pace)
        lead = dr.select(surface.parallel, NEVER, -surface.height * surface.pace)
        return RayLines((lead, pace, None), (1.0, None, None))

    def enter(self, track: RunningTrack, t: Float) -> Any:
        return dr.clip(super().enter(track, t), 1, self.last_cell + 1)

    def leave(self, track: RunningTrack) -> Any:
        """Return the distance at which rays leave the outermost plane."""
        return self.time(track, self.last_cell + 1)

    def cell(self, track: RunningTrack, count: Int) -> Any:
        """Return the number of the cell along this axis."""
        return dr.select(track.down, self.wall_count - 1 - count, count - 1)

    def vertex(self, track: RunningTrack, count: Int) -> Any:
        """Return the number of the vertices on the wall that is met next."""
        return dr.select(track.down, self.wall_count - 1 - count, count)

    def fraction(self, cell: Int, point: list[Any], own: Arithmetic = NUMBERS) -> Any:
        cell = self.backend.UInt(cell)
        lower = dr.gather(self.backend.Float, self.lower, cell)
        inverse = dr.gather(self.backend.Float, self.inverse_width, cell)
        return own.part(point[2], lower, inverse)
