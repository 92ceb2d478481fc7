"""Half planes of constant azimuth, which end at the axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr, from_host
from ...backend.functions import first_true
from ...backend.types import Float, Int, Mask
from .approach import PARALLEL, Approach
from .arithmetic import NUMBERS, Arithmetic
from .crossing import RayLines
from .edges import ANGLE_ROUNDING, FULL_CIRCLE, is_closed
from .surfaces import Running, RunningTrack

if TYPE_CHECKING:
    from ...backend.device import Backend

# Half planes nearer than this (in roundings) to a ray's direction are met at either end of it.
_PARALLEL = 64


@dataclass
class HalfPlaneTrack:
    """Where a ray passes the axis, and its direction across it, mirrored so that azimuth increases.

    Distances count from there, from `turn`. Half planes that it nears more slowly than `slowest`
    (per distance from the axis) are parallel.
    """

    x: Any
    y: Any
    dx: Any
    dy: Any
    turn: Any
    slowest: Any


class HalfPlanes(Running):
    """Half planes of constant azimuth; the last cell, or an empty wedge, joins up with the first.

    With w the unit vector in a half plane and n normal to it, ``t = -n·P/n·d``, counted from the
    point P where the ray passes the axis: on the axis itself all are met at t = 0. In the sense in
    which azimuth increases a ray meets the half plane, not its other half, if ``n·d > 0``.

    A ray could meet all walls of a wedge, or all but those of a wide cell, and would come to the
    first one again. A half plane through whatever is wider than half a circle stands in between.

    Parameters
    ----------
    edges : array
        Azimuths of the cells' walls.
    """

    def __init__(self, edges: np.ndarray, backend: Backend) -> None:
        self.has_gaps = not is_closed(edges)
        self.angles, halved = _with_wide_halved(edges if self.has_gaps else edges[:-1])
        self.halves_cell = halved < len(edges) - 1
        self.halved = dr.opaque(backend.Int, halved)
        walls = len(self.angles)
        once = _directions(self.angles)
        mirrored = once[::-1] * [1.0, -1.0]
        table = np.concatenate([once, once, once[:1], mirrored, mirrored, mirrored[:1]])
        super().__init__(table, walls, len(edges) - 1, backend)
        self.mirrored_start = dr.opaque(backend.Int, 2 * walls + 1)
        self.first_angle = backend.wide(self.angles[0])
        # Azimuths of walls from the first one on, for either sense.
        up = self.angles - self.angles[0]
        down = self.angles[-1] - self.angles[::-1]
        self.order = from_host(backend.Float, np.concatenate([up, down]))
        self.extent = backend.wide(self.angles[-1] - self.angles[0])
        kind = backend.dtype
        self.lower = from_host(backend.Float, _directions(edges[:-1]).reshape(-1))
        self.inverse_width = from_host(backend.Float, 1.0 / np.diff(edges))
        self.widest = float(np.diff(edges).max())
        self.rounding = _PARALLEL * float(np.finfo(kind).eps)

    def track(self, approach: Approach) -> RunningTrack:
        Float, Int = self.backend.Float, self.backend.Int
        (x, y), (dx, dy, _) = approach.passage.foot, approach.direction
        # A ray parallel to the axis stays where it is.
        parallel = dr.fma(dx, dx, dy * dy) < PARALLEL**2
        dx, dy = dr.select(parallel, 0.0, dx), dr.select(parallel, 0.0, dy)
        down = dr.fma(x, dy, -y * dx) < 0
        angle = Float(
            self._angle_after_first_wall(
                dr.select(parallel, x, -dx), dr.select(parallel, y, -dy), down
            )
        )
        table = dr.select(down, self.wall_count, 0)
        first = first_true(
            self.walls,
            self.backend.UInt,
            lambda k: dr.gather(type(angle), self.order, self.backend.UInt(table) + k) > angle,
        )
        sign = dr.select(down, Float(-1), 1)
        slowest = Float(self.rounding * dr.sqrt(dr.fma(dx, dx, dy * dy)))
        turn = Float(approach.passage.turn)
        surface = HalfPlaneTrack(
            Float(x), Float(y) * sign, Float(dx), Float(dy) * sign, turn, slowest
        )
        start = self.first + dr.select(down, self.mirrored_start, 0)
        slot = self._around(Int(first))
        c, s = self.wall_at(start + slot)
        # Rounding may put a wall ahead that the ray comes from: half a circle would be lost.
        pace = dr.fma(c, surface.dy, -s * surface.dx)
        away = dr.fma(c, surface.dx, s * surface.dy)
        behind = (dr.abs(pace) <= slowest) & (away < 0.0)
        slot = self._around(dr.select(behind, slot + 1, slot))
        return RunningTrack(surface, self.lines(surface), start, start + slot, down)

    def _angle_after_first_wall(self, x: Float, y: Float, down: Mask) -> Any:
        """Return the azimuth from the first wall (of either sense) on, below a full circle."""
        angle = dr.atan2(y, x) - self.first_angle
        angle = dr.select(down, self.extent - angle, angle)
        return angle - FULL_CIRCLE * dr.floor(angle * (1.0 / FULL_CIRCLE))

    def place(self, surface: HalfPlaneTrack, t: Float) -> tuple[Any, Any]:
        away = t - surface.turn
        return dr.fma(away, surface.dx, surface.x), dr.fma(away, surface.dy, surface.y)

    def is_ahead(self, surface: HalfPlaneTrack, wall: list[Any], here: Float) -> Any:
        (c, s), (x, y) = wall, here
        met = dr.fma(c, surface.dy, -s * surface.dx) > surface.slowest
        return ~met | (dr.fma(c, y, -s * x) < 0.0)

    def lines(self, surface: HalfPlaneTrack) -> RayLines:
        """Return when rays meet the half planes."""
        top = (None, -surface.y, surface.x)
        bottom = (None, surface.dy, -surface.dx)
        return RayLines(top, bottom, least=surface.slowest, start=surface.turn)

    def cell(self, track: RunningTrack, count: Int) -> Any:
        """Return the number of the cell along this axis; the one after the last for the gap."""
        slot = self._slot(track, count)
        down = self.wall_count - 1 - slot
        up = dr.select(slot == 0, self.wall_count, slot) - 1
        return self._of_grid(dr.select(track.down, down, up))

    def _slot(self, track: RunningTrack, count: Int) -> Any:
        return self._around(track.slot - track.start + count)

    def _around(self, slot: Any) -> Any:
        return dr.select(slot >= self.wall_count, slot - self.wall_count, slot)

    def in_gap(self, track: RunningTrack, count: Int) -> Any:
        return self.cell(track, count) > self.last_cell

    def vertex(self, track: RunningTrack, count: Int) -> Any:
        """Return the number of the vertices on the wall that is met next."""
        return self._of_grid(self._wall(track, count))

    def in_cell(self, track: RunningTrack, count: Int) -> Any:
        """Return the lanes of which the wall that is met next is in the middle of a cell."""
        return self._wall(track, count) == self.halved + 1

    def _wall(self, track: RunningTrack, count: Int) -> Any:
        slot = self._slot(track, count)
        return dr.select(track.down, self.wall_count - 1 - slot, slot)

    def _of_grid(self, number: Int) -> Any:
        """Return the number of a cell, or of a wall, without the half plane inside a cell."""
        return dr.select(number > self.halved, number - 1, number) if self.halves_cell else number

    def fraction(self, cell: Int, point: list[Any], own: Arithmetic = NUMBERS) -> Any:
        (x, y, _), cell = point, self.backend.UInt(cell)
        c, s = dr.gather(self.backend.packet(2), self.lower, cell)
        left, along = own.mixed(y, c, x, -s), own.mixed(x, c, y, s)
        if self.sharp:
            angle = own.angle(left, along, own.length(x, y))
        else:
            angle = own.upward(own.angle(left, along))
        return own.part(angle, 0.0, dr.gather(self.backend.Float, self.inverse_width, cell))


def _with_wide_halved(angles: np.ndarray) -> tuple[np.ndarray, int]:
    """Return azimuths of walls with one more in the middle of what is wider than half a circle.

    And the number of the space between walls that it halves: there is one at most. Where there is
    none, a number beyond all.
    """
    widths = np.diff(angles, append=angles[0] + FULL_CIRCLE)
    widest = len(widths) - 1 - int(np.argmax(widths[::-1]))  # of two halves rather the empty one
    if widths[widest] < np.pi - ANGLE_ROUNDING:
        return angles, len(angles)
    return np.insert(angles, widest + 1, angles[widest] + 0.5 * widths[widest]), widest


def _directions(angles: np.ndarray) -> np.ndarray:
    pair = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.where(np.abs(pair) < 1e-15, 0.0, pair)
