"""The families of surfaces: spheres, cylinders, cones, half planes and planes.

They are made of the walls of cells: lengths in units of the grid's scale, angles in radian.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...backend import dr, from_host
from ...backend.functions import first_true
from ...backend.types import Float, Int, Mask
from ..box_walk import NEVER
from .approach import PARALLEL, Approach, AxisApproach, CentreApproach
from .surfaces import (
    ANGLE_ROUNDING,
    FULL_CIRCLE,
    NUMBERS,
    Arithmetic,
    RayLines,
    Running,
    RunningTrack,
    TurningPoint,
    TurningTrack,
    is_closed,
)

if TYPE_CHECKING:
    from ...backend.device import Backend

# Half planes nearer than this (in roundings) to a ray's direction are met at either end of it.
_PARALLEL = 64


class Round(TurningPoint):
    """Surfaces of constant radius.

    Inside the innermost one, unless that has no radius at all, is a cavity: no cell.
    """

    encloses = True

    def __init__(self, edges: np.ndarray, backend: Backend) -> None:
        self.has_gaps = bool(edges[0] > 0)
        radii = edges if self.has_gaps else edges[1:]
        # Beyond the last wall one more, so that rays that have left read something finite.
        square = np.append(radii, 2 * radii[-1]) ** 2
        table = np.stack([self.first_number(square), square], axis=1)
        super().__init__(table, len(radii), edges, backend)
        self.skipped = int(self.has_gaps)
        self.lower = from_host(backend.Float, edges[:-1])

    def first_number(self, square: np.ndarray) -> np.ndarray:
        """Return c of walls of given squared radius."""
        raise NotImplementedError

    def is_met(self, surface: ShellTrack | TubeTrack, wall: list[Float]) -> Mask:
        return wall[1] > surface.nearest

    def is_above(self, wall: list[Float], here: Float) -> Mask:
        return wall[1] > here

    def enter(self, track: TurningTrack, t: Float) -> Int:
        most = track.reach - 1
        return dr.clip(super().enter(track, t), -most, most)

    def leave(self, track: TurningTrack) -> Float:
        last = track.reach - 1
        return dr.select(last < 0, -NEVER, self.time(track, dr.maximum(last, 0)))

    def cell(self, track: TurningTrack, count: Int) -> Int:
        return self.number(track, count) - self.skipped

    def rises(self, track: TurningTrack, count: Int) -> Mask:
        return self.backend.Bool(True)

    def in_gap(self, track: TurningTrack, count: Int) -> Mask:
        return (track.turn | count) == 0

    def vertex(self, track: TurningTrack, count: Int) -> Int:
        return self.wall(track, count) + (1 - self.skipped)

    def _fraction(self, cell: Int, radius: Float, own: Arithmetic) -> Float:
        lower = dr.gather(self.backend.Float, self.lower, self.backend.UInt(cell))
        return own.part(radius, lower, self.per_width(cell))


@dataclass
class ShellTrack:
    """Square of the distance at which a ray passes the centre."""

    nearest: Float


class Shells(Round):
    """Spheres; distances count from the closest approach b to the centre: t² = r² - b²."""

    def surface(self, approach: CentreApproach) -> tuple[ShellTrack, None, None]:
        return ShellTrack(self.backend.Float(approach.radius * approach.radius)), None, None

    def place(self, surface: ShellTrack, t: Float) -> tuple[Float, Float]:
        return dr.fma(t, t, surface.nearest), t < 0.0

    def lines(self, surface: ShellTrack) -> RayLines:
        return RayLines((None, None, 1.0), (None, 1.0, None), (surface.nearest, surface.nearest))

    def first_number(self, square: np.ndarray) -> np.ndarray:
        return np.ones_like(square)

    def fraction(self, cell: Int, point: list[Float], own: Arithmetic = NUMBERS) -> Float:
        return self._fraction(cell, own.length(*point), own)


@dataclass
class TubeTrack:
    """How a ray runs past the axis.

    `nearest`: square of the distance from the axis at t = 0, the nearest point of the chord;
    `passing`: square of the distance at which the whole line passes the axis; `bias`: size of the
    part of the first that is along the line; zero unless the chord ends there; `side`: 1 if the
    chord begins beyond the closest approach, -1 if it ends before, 0 if it has it; `pace`: distance
    along the ray per distance across the axis.
    """

    nearest: Float
    passing: Float
    bias: Float
    side: Float
    pace: Float


class Tubes(Round):
    """Cylinders; distances count from the chord's closest approach to the axis.

    With Q the point at t = 0, d the unit vector of the ray across the axis and s the distance
    across, ``s² + 2 s Q·d = R² - Q²``. If Q is the closest approach of the whole line, s is plus or
    minus ``sqrt(R² - Q²)``. If it is an end of the chord, only the root beyond Q is on the chord,
    which is, without cancellation, ``(R² - Q²)/(|Q·d| + sqrt(R² - (Q x d)²))``.
    """

    def surface(self, approach: AxisApproach) -> tuple[TubeTrack, None, None]:
        Float = self.backend.Float
        (x, y, _), (dx, dy, _) = approach.point, approach.direction
        speed = dr.sqrt(dx * dx + dy * dy)
        parallel = speed < PARALLEL
        pace = 1.0 / dr.select(parallel, 1.0, speed)
        nearest = dr.fma(x, x, y * y)
        passing = (x * dy - y * dx) * pace
        # At the closest approach itself both squares are the same number.
        closest = approach.side == 0
        passing = dr.select(closest, nearest, passing * passing)
        bias = dr.select(closest, 0.0, dr.fma(x, dx, y * dy) * pace)
        pace = dr.select(parallel, NEVER, pace)
        numbers = (nearest, passing, dr.abs(bias), approach.side, pace)
        return TubeTrack(*(Float(number) for number in numbers)), None, None

    def place(self, surface: TubeTrack, t: Float) -> tuple[Float, Float]:
        across = dr.abs(t) / surface.pace
        return dr.fma(across, dr.fma(2.0, surface.bias, across), surface.nearest), t < 0.0

    def lines(self, surface: TubeTrack) -> RayLines:
        side, pace = surface.side, surface.pace
        passes = 1.0 - dr.abs(side)
        top = (-side * pace * surface.nearest, side * pace, passes * pace)
        return RayLines(
            top, (surface.bias + passes, None, side), (surface.passing, surface.passing)
        )

    def first_number(self, square: np.ndarray) -> np.ndarray:
        return square

    def fraction(self, cell: Int, point: list[Float], own: Arithmetic = NUMBERS) -> Float:
        x, y, _ = point
        return self._fraction(cell, own.length(x, y), own)


@dataclass
class ConeTrack:
    """How a ray runs through the cones, mirrored so that its nearest point is above the midplane.

    `rise`: the z component of the direction; `height`: the z component of the unit vector to the
    closest approach; not negative; `radius`: distance of the closest approach; `tilt`: square of
    the z component of the normal of the plane through the ray and the centre; `steepest`: minus the
    square of the greatest cos θ on the ray: ``tilt - 1``; `point`, `direction`: the closest
    approach, and the direction, across the axis.
    """

    rise: Float
    height: Float
    radius: Float
    tilt: Float
    steepest: Float
    point: list[Float]
    direction: list[Float]


class Cones(TurningPoint):
    """Cones θ = const of a spherical grid; θ = π/2 is a plane like any other cone.

    Let ψ be the angle in the plane of ray and centre, counted from the closest approach, so that
    ``t = b tan ψ``. Then ``cos θ = h cos ψ + u sin ψ`` with u and h the z components of the
    direction and of the unit vector to the closest approach: a cosine with its greatest value
    ``μ = sqrt(h² + u²)`` at ``tan ψ* = u/h``. A cone ``cos θ = c`` is met at ``ψ* ∓ arccos(c/μ)``::

        t = b (u c ∓ h s)/(h c ± u s),    s = sqrt(μ² - c²),

    if the denominator, ``μ² cos ψ``, is positive: else before the ray began, or never.
    """

    def __init__(self, edges: np.ndarray, mirrored: bool, backend: Backend) -> None:
        self.mirrored = mirrored
        every = np.concatenate([edges, np.pi - edges[-2::-1]]) if mirrored else edges
        self.above, self.below = bool(every[0] > 0), bool(every[-1] < np.pi)
        self.has_gaps = self.above or self.below
        angles = every[0 if self.above else 1 : len(every) if self.below else -1]
        # Of sin² θ near the axis and -cos² θ near the midplane a difference keeps its digits.
        cosine, sine = _directions(angles).T
        square = np.where(cosine**2 > 0.5, sine**2, -(cosine**2))
        table = np.stack([cosine, square], axis=1)
        # One more beyond the last, that is never met; and all of them seen from below.
        beyond = np.array([[-2.0, -4.0]])
        both = np.concatenate([table, beyond, table[::-1] * [-1.0, 1.0], beyond])
        super().__init__(both, len(angles), edges, backend)
        self.mirrored_start = dr.opaque(backend.Int, len(angles) + 1)
        self.lower = from_host(backend.Float, _directions(edges[:-1]).reshape(-1))

    def surface(self, approach: CentreApproach) -> tuple[ConeTrack, Mask, Int]:
        Float = self.backend.Float
        (hx, hy, hz), (dx, dy, dz) = approach.normal, approach.direction
        down = hz < 0
        rise = dr.select(down, -dz, dz)
        tilt = hx * dy - hy * dx
        track = ConeTrack(
            Float(rise),
            Float(dr.abs(hz)),
            Float(approach.radius),
            Float(tilt * tilt),
            Float(-dr.fma(hz, hz, dz * dz)),
            [Float(p) for p in approach.point[:2]],
            [Float(dx), Float(dy)],
        )
        return track, down, dr.select(down, self.mirrored_start, 0)

    def is_met(self, surface: ConeTrack, wall: list[Float]) -> Mask:
        c, square = wall
        highest = dr.select(square > 0.0, surface.tilt, surface.steepest)
        return (square > highest) | (c < 0.0)

    def place(self, surface: ConeTrack, t: Float) -> tuple[Float, Float]:
        height = dr.fma(surface.rise, t, surface.height * surface.radius)
        radius = dr.sqrt(dr.fma(t, t, surface.radius * surface.radius))
        x, y = (dr.fma(t, d, p) for p, d in zip(surface.point, surface.direction, strict=True))
        central = radius == 0.0
        height = dr.select(central, surface.rise, height)
        dx, dy = surface.direction
        across = dr.select(central, dr.fma(dx, dx, dy * dy), dr.fma(x, x, y * y))
        # Through the centre, in whose plane u is the greatest cos θ: it rises all the way.
        inward = t * surface.height < dr.maximum(surface.radius, 1e-30) * surface.rise
        return (height, dr.select(central, 1.0, radius), across), inward

    def is_above(self, wall: list[Float], here: Float) -> Mask:
        (c, v), (height, radius, across) = wall, here
        # Near the axis cos θ would lose digits: sin² θ is what counts.
        north, wide = height > 0.0, v * radius * radius
        steep = dr.select(c > 0.0, north & (across < wide), north | (across > wide))
        return dr.select(v > 0.0, steep, c * radius < height)

    def lines(self, surface: ConeTrack) -> RayLines:
        rise, height, radius = surface.rise, surface.height, surface.radius
        return RayLines(
            (None, rise * radius, height * radius),
            (None, height, -rise),
            (surface.tilt, surface.steepest),
        )

    def cell(self, track: TurningTrack, count: Int) -> Int:
        return self._fold(self.number(track, count) - int(self.above), 2 * self.cells - 1)

    def rises(self, track: TurningTrack, count: Int) -> Mask:
        up = ~track.down
        if not self.mirrored:
            return up
        number = self.number(track, count) - int(self.above)
        return up ^ (number > self.last_cell)

    def in_gap(self, track: TurningTrack, count: Int) -> Mask:
        number = self.number(track, count)
        north, south = number == 0, number == self.wall_count
        if self.above and self.below:
            return north | south
        return north if self.above else south

    def vertex(self, track: TurningTrack, count: Int) -> Int:
        return self._fold(self.wall(track, count) + int(not self.above), 2 * self.cells)

    def _fold(self, number: Int, most: int) -> Int:
        if not self.mirrored:
            return number
        other = dr.opaque(self.backend.Int, most) - number
        return dr.select(number < other, number, other)

    def fraction(self, cell: Int, point: list[Float], own: Arithmetic = NUMBERS) -> Float:
        x, y, z = point
        z = own.magnitude(z) if self.mirrored else z
        across, cell = own.length(x, y), self.backend.UInt(cell)
        cosine, sine = dr.gather(self.backend.packet(2), self.lower, cell)
        length = own.length(*point) if self.sharp else None
        left, along = own.mixed(across, cosine, z, -sine), own.mixed(z, cosine, across, sine)
        angle = own.angle(left, along, length)
        return own.part(angle, 0.0, self.per_width(cell))


@dataclass
class HalfPlaneTrack:
    """Where a ray passes the axis, and its direction across it, mirrored so that azimuth increases.

    Distances count from there, from `turn`. Half planes that it nears more slowly than `slowest`
    (per distance from the axis) are parallel.
    """

    x: Float
    y: Float
    dx: Float
    dy: Float
    turn: Float
    slowest: Float


class HalfPlanes(Running):
    """Half planes of constant azimuth; the last cell, or an empty wedge, joins up with the first.

    With w the unit vector in a half plane and n normal to it, ``t = -n·P/n·d``, counted from the
    point P where the ray passes the axis: on the axis itself all are met at t = 0. In the sense in
    which azimuth increases a ray meets the half plane, not its other half, if ``n·d > 0``.

    A ray could meet all walls of a wedge, or all but those of a wide cell, and would come to the
    first one again. A half plane through whatever is wider than half a circle stands in between.
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
        super().__init__(table, walls, edges, backend)
        self.mirrored_start = dr.opaque(backend.Int, 2 * walls + 1)
        self.first_angle = backend.wide(self.angles[0])
        # Azimuths of walls from the first one on, for either sense.
        up = self.angles - self.angles[0]
        down = self.angles[-1] - self.angles[::-1]
        self.order = from_host(backend.Float, np.concatenate([up, down]))
        self.extent = backend.wide(self.angles[-1] - self.angles[0])
        kind = backend.dtype
        self.lower = from_host(backend.Float, _directions(edges[:-1]).reshape(-1))
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

    def _angle_after_first_wall(self, x: Float, y: Float, down: Mask) -> Float:
        """Return the azimuth from the first wall (of either sense) on, below a full circle."""
        angle = dr.atan2(y, x) - self.first_angle
        angle = dr.select(down, self.extent - angle, angle)
        return angle - FULL_CIRCLE * dr.floor(angle * (1.0 / FULL_CIRCLE))

    def place(self, surface: HalfPlaneTrack, t: Float) -> tuple[Float, Float]:
        away = t - surface.turn
        return dr.fma(away, surface.dx, surface.x), dr.fma(away, surface.dy, surface.y)

    def is_ahead(self, surface: HalfPlaneTrack, wall: list[Float], here: Float) -> Mask:
        (c, s), (x, y) = wall, here
        met = dr.fma(c, surface.dy, -s * surface.dx) > surface.slowest
        return ~met | (dr.fma(c, y, -s * x) < 0.0)

    def lines(self, surface: HalfPlaneTrack) -> RayLines:
        top = (None, -surface.y, surface.x)
        bottom = (None, surface.dy, -surface.dx)
        return RayLines(top, bottom, least=surface.slowest, start=surface.turn)

    def cell(self, track: RunningTrack, count: Int) -> Int:
        slot = self._slot(track, count)
        down = self.wall_count - 1 - slot
        up = dr.select(slot == 0, self.wall_count, slot) - 1
        return self._of_grid(dr.select(track.down, down, up))

    def _slot(self, track: RunningTrack, count: Int) -> Int:
        return self._around(track.slot - track.start + count)

    def _around(self, slot: Int) -> Int:
        return dr.select(slot >= self.wall_count, slot - self.wall_count, slot)

    def in_gap(self, track: RunningTrack, count: Int) -> Mask:
        return self.cell(track, count) > self.last_cell

    def vertex(self, track: RunningTrack, count: Int) -> Int:
        return self._of_grid(self._wall(track, count))

    def in_cell(self, track: RunningTrack, count: Int) -> Mask:
        return self._wall(track, count) == self.halved + 1

    def _wall(self, track: RunningTrack, count: Int) -> Int:
        slot = self._slot(track, count)
        return dr.select(track.down, self.wall_count - 1 - slot, slot)

    def _of_grid(self, number: Int) -> Int:
        return dr.select(number > self.halved, number - 1, number) if self.halves_cell else number

    def fraction(self, cell: Int, point: list[Float], own: Arithmetic = NUMBERS) -> Float:
        (x, y, _), cell = point, self.backend.UInt(cell)
        c, s = dr.gather(self.backend.packet(2), self.lower, cell)
        left, along = own.mixed(y, c, x, -s), own.mixed(x, c, y, s)
        if self.sharp:
            angle = own.angle(left, along, own.length(x, y))
        else:
            angle = own.upward(own.angle(left, along))
        return own.part(angle, 0.0, self.per_width(cell))


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
    """Return cosines and sines, shape (n, 2); exactly zero on axes and midplane."""
    pair = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.where(np.abs(pair) < 1e-15, 0.0, pair)


@dataclass
class PlaneTrack:
    """Mirrored height of a ray, and distance along it per height."""

    height: Float
    pace: Float
    parallel: Mask


class Planes(Running):
    """Planes across the axis."""

    encloses = True

    def __init__(self, edges: np.ndarray, backend: Backend) -> None:
        beyond = [2 * edges[-1] - edges[0]], [edges[-1] - 2 * edges[0]]
        heights = np.concatenate([edges, beyond[0], -edges[::-1], beyond[1]])
        table = np.stack([heights, np.zeros_like(heights)], axis=1)
        super().__init__(table, len(edges), edges, backend)
        self.mirrored_start = dr.opaque(backend.Int, len(edges) + 1)
        self.lower = from_host(backend.Float, edges[:-1])

    def track(self, approach: Approach) -> RunningTrack:
        Float = self.backend.Float
        z, dz = approach.point[2], approach.direction[2]
        down, parallel = dz < 0, dr.abs(dz) < PARALLEL
        pace = 1.0 / dr.select(parallel, 1.0, dr.abs(dz))
        surface = PlaneTrack(Float(dr.select(down, -z, z)), Float(pace), parallel)
        start = self.first + dr.select(down, self.mirrored_start, 0)
        return RunningTrack(surface, self.lines(surface), start, start, down)

    def place(self, surface: PlaneTrack, t: Float) -> Float:
        rise = dr.select(surface.parallel, 0.0, t / surface.pace)
        return surface.height + rise

    def is_ahead(self, surface: PlaneTrack, wall: list[Float], here: Float) -> Mask:
        return wall[0] > here

    def lines(self, surface: PlaneTrack) -> RayLines:
        pace = dr.select(surface.parallel, 0.0, surface.pace)
        lead = dr.select(surface.parallel, NEVER, -surface.height * surface.pace)
        return RayLines((lead, pace, None), (1.0, None, None))

    def enter(self, track: RunningTrack, t: Float) -> Int:
        return dr.clip(super().enter(track, t), 1, self.last_cell + 1)

    def leave(self, track: RunningTrack) -> Float:
        return self.time(track, self.last_cell + 1)

    def cell(self, track: RunningTrack, count: Int) -> Int:
        return dr.select(track.down, self.wall_count - 1 - count, count - 1)

    def vertex(self, track: RunningTrack, count: Int) -> Int:
        return dr.select(track.down, self.wall_count - 1 - count, count)

    def fraction(self, cell: Int, point: list[Float], own: Arithmetic = NUMBERS) -> Float:
        lower = dr.gather(self.backend.Float, self.lower, self.backend.UInt(cell))
        return own.part(point[2], lower, self.per_width(cell))
