"""One axis of a rectilinear grid, seen by rays that run upwards or downwards along it.

Along an axis that a ray runs down, positions and cells are counted from the far end ("mirrored"),
so every ray runs upwards: the loop needs neither the sign of the step nor two limits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import Int, dr, from_host
from ..backend.functions import first_true, unit_interval
from ..backend.types import Float, Mask
from ..geometry import is_uniform
from .contract import Ray, Walk

if TYPE_CHECKING:
    from ..backend.device import Backend

# Later than any crossing, in units of the grid's scale: when a ray that runs parallel to a wall
# meets it.
NEVER = 1e30
# Slower than this (walls per cell width), a ray runs parallel to the walls.
_PARALLEL = 1e-20


@dataclass
class Side:
    """One axis of rays in `Wide`: their coordinate, and when they are between the outer walls.

    `pace` is one over `speed`, and zero where rays run parallel to the walls.
    """

    origin: Float
    direction: Float
    position: Float
    speed: Float
    pace: Float
    parallel: Mask
    down: Mask
    arrive: Float
    leave: Float


@dataclass
class AxisTrack:
    """What is constant for one axis along a ray (lane arrays).

    ``position + t speed`` is the mirrored coordinate; a wall at mirrored coordinate w is met at
    ``t = w pace + lead``. `table` tells where the edges of the ray's sense start.
    """

    position: Float
    speed: Float
    pace: Float
    lead: Float
    table: Int = None


class Axis:
    """What both kinds of axis share: where rays enter, and in which cell.

    `unit`: length of one unit of mirrored coordinates.
    """

    def __init__(self, edges: np.ndarray, unit: float, scale: float, backend: Backend) -> None:
        self.backend = backend
        self.count = len(edges) - 1
        self.edges = from_host(backend.Wide, edges)
        self.low = backend.wide(edges[0])
        self.high = backend.wide(edges[-1])
        self.inverse_unit = backend.wide(1.0 / unit)
        self.speed_unit = backend.wide(scale / unit)
        self.last_cell = dr.opaque(backend.Int, self.count - 1)

    def side(self, origin: Float, direction: Float) -> Side:
        """Return how rays see this axis: mirrored where they run down it."""
        Wide = self.backend.Wide
        down = direction < 0
        position = dr.select(down, self.high - origin, origin - self.low) * self.inverse_unit
        speed = dr.abs(direction) * self.speed_unit
        parallel = speed < _PARALLEL
        speed = dr.select(parallel, 0.0, speed)
        pace = dr.select(parallel, 0.0, 1.0 / dr.select(parallel, 1.0, speed))
        between = (origin >= self.low) & (origin <= self.high)
        extent = (self.high - self.low) * self.inverse_unit
        never = dr.select(between, Wide(-NEVER), Wide(NEVER))
        arrive = dr.select(parallel, never, -position * pace)
        leave = dr.select(parallel, Wide(NEVER), (extent - position) * pace)
        return Side(origin, direction, position, speed, pace, parallel, down, arrive, leave)

    def cell(self, side: Side, coordinate: Float) -> Int:
        """Return the number of the cell that a ray at `coordinate` is about to cross.

        It is compared with the edges themselves: a ray that runs within rounding of a wall stays
        on its side. On a wall it is the cell the ray heads into; parallel to it, the upper one.
        """
        wall = self._wall_near(side, coordinate)
        edge = dr.gather(self.backend.Wide, self.edges, self.backend.UInt(wall))
        below = (coordinate < edge) | ((coordinate == edge) & side.down)
        return dr.clip(dr.select(below, wall - 1, wall), 0, self.last_cell)

    def _wall_near(self, side: Side, coordinate: Float) -> Int:
        raise NotImplementedError

    def _narrowed(
        self, position: Float, speed: Float, pace: Float, lead: Float, table: Int = None
    ) -> AxisTrack:
        Float = self.backend.Float
        return AxisTrack(Float(position), Float(speed), Float(pace), Float(lead), table)


class UniformAxis(Axis):
    """Cells of equal width; mirrored coordinates are counted in cells, so edge i is at i."""

    def __init__(self, edges: np.ndarray, scale: float, backend: Backend) -> None:
        super().__init__(edges, (edges[-1] - edges[0]) / (len(edges) - 1), scale, backend)

    def _wall_near(self, side: Side, coordinate: Float) -> Int:
        cells = dr.round((coordinate - self.low) * self.inverse_unit)
        return dr.clip(self.backend.Int(cells), 0, self.last_cell + 1)

    def track(self, side: Side, position: Float) -> AxisTrack:
        """Return the track of rays that are at mirrored `position` where distances start."""
        # Cell i is left at wall i + 1: the one is part of the lead, so a crossing is one FMA.
        lead = dr.select(side.parallel, NEVER, (1.0 - position) * side.pace)
        return self._narrowed(position, side.speed, side.pace, lead)

    def crossing(self, track: AxisTrack, index: Int) -> Float:
        """Return the distance at which the ray leaves mirrored cell `index`."""
        return dr.fma(index, track.pace, track.lead)

    def cell_at(self, track: AxisTrack, t: Float) -> Float:
        """Return the mirrored cell where the ray is at distance `t`; it may be outside."""
        return dr.floor(dr.fma(t, track.speed, track.position))

    def fraction(self, track: AxisTrack, index: Int, t: Float) -> Float:
        """Return where in mirrored cell `index` the ray is at distance `t`, between 0 and 1."""
        return unit_interval(dr.fma(t, track.speed, track.position) - index)


class RectilinearAxis(Axis):
    """Cells of any width; mirrored coordinates are counted in units of the grid's scale."""

    def __init__(self, edges: np.ndarray, scale: float, backend: Backend) -> None:
        super().__init__(edges, scale, scale, backend)
        up, down = (edges - edges[0]) / scale, (edges[-1] - edges[::-1]) / scale
        # One more: of rays that have left downwards the next wall is looked up, too.
        self.mirrored = from_host(backend.Float, np.concatenate([up, down, down[-1:]]))
        widths = np.concatenate([np.diff(up), [1.0], np.diff(down), [1.0]])
        self.inverse_width = from_host(backend.Float, 1.0 / widths)
        self.down_table = dr.opaque(backend.UInt, self.count + 1)

    def _wall_near(self, side: Side, coordinate: Float) -> Int:
        above = first_true(
            self.count,
            self.backend.UInt,
            lambda k: dr.gather(self.backend.Wide, self.edges, k) > coordinate,
        )
        return dr.maximum(self.backend.Int(above) - 1, 0)

    def track(self, side: Side, position: Float) -> AxisTrack:
        lead = dr.select(side.parallel, NEVER, -position * side.pace)
        table = dr.select(side.down, self.down_table, 0)
        return self._narrowed(position, side.speed, side.pace, lead, table)

    def crossing(self, track: AxisTrack, index: Int) -> Float:
        slot = track.table + self.backend.UInt(index) + 1
        return dr.fma(dr.gather(self.backend.Float, self.mirrored, slot), track.pace, track.lead)

    def cell_at(self, track: AxisTrack, t: Float) -> Float:
        Float, place = self.backend.Float, dr.fma(t, track.speed, track.position)
        above = first_true(
            self.count,
            self.backend.UInt,
            lambda k: dr.gather(Float, self.mirrored, track.table + k) > place,
        )
        return Float(self.backend.Int(above) - 1)

    def fraction(self, track: AxisTrack, index: Int, t: Float) -> Float:
        slot = track.table + self.backend.UInt(index)
        lower = dr.gather(self.backend.Float, self.mirrored, slot)
        inverse = dr.gather(self.backend.Float, self.inverse_width, slot)
        return unit_interval((dr.fma(t, track.speed, track.position) - lower) * inverse)


def make_axis(edges: np.ndarray, scale: float, backend: Backend) -> UniformAxis | RectilinearAxis:
    """Return the faster kind of axis that the edges allow."""
    kind = UniformAxis if is_uniform(edges) else RectilinearAxis
    return kind(edges, scale, backend)


class BoxWalk(Walk):
    """Rays through a box between planes of x, y and z, however it is divided into cells.

    `axes`; `scale`, `to_scale`: the unit of distances in the volume's unit, and one over it.
    """

    backend: Backend
    axes: list[Float]
    to_scale: Float

    def enter(self, ray: Ray) -> tuple[Float, Float]:
        Wide = self.backend.Wide
        sides = [
            axis.side(o, d) for axis, o, d in zip(self.axes, ray.origin, ray.direction, strict=True)
        ]
        arrive = dr.maximum(dr.maximum(sides[0].arrive, sides[1].arrive), sides[2].arrive)
        leave = dr.minimum(dr.minimum(sides[0].leave, sides[1].leave), sides[2].leave)
        first = None if ray.first is None else ray.first * self.to_scale
        last = None if ray.last is None else ray.last * self.to_scale
        start = arrive if first is None else dr.maximum(arrive, first)
        inside = start < (leave if last is None else dr.minimum(leave, last))
        if ray.active is not None:
            inside &= ray.active
        # A ray that misses starts somewhere finite, so that no lane computes with infinities.
        arrive = dr.select(inside, arrive, Wide(0))
        begin = dr.select(inside, start, Wide(0)) - arrive
        bound = None if last is None else self.backend.Float(dr.minimum(last - arrive, NEVER))
        started: tuple[Any, Any] = self._start(sides, arrive, begin, inside, bound)
        return started

    def _start(self, sides: Any, arrive: Float, begin: Float, inside: Mask, bound: Float) -> Any:
        """Return track and cursor of rays that reach the box, and start `begin` later."""
        raise NotImplementedError
