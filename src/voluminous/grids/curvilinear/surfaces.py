"""Families of surfaces that a straight ray meets in an order known beforehand.

Along a straight line the radius falls to its least value and rises again, cos θ rises to its
greatest and falls (or the other way round), azimuth and height only rise or only fall. A ray
therefore meets the spheres r = const (and cones, cylinders, half planes, planes) in a fixed order,
and its place among them is ONE integer: how many it has met, or how many it is before or after the
turning point. Which surface is next, and which of its two crossings, follows from that integer: the
crossing a ray came in through is never found again by arithmetic, and no ray leaks.

A family knows its walls and which of them is next (`TurningPoint`, `Running`); its subclasses
(`families`) know where a ray is among them, and when it meets them.

A wall is two numbers (c, v). The distance at which a ray meets it is a quotient of linear forms,

    t = (n0 + n1 c + n2 s)/(d0 + d1 c + d2 s),

where s is v itself for planes, and ``∓ sqrt(v - offset)`` for surfaces that a ray meets twice,
before and after its turning point. Half planes count t from where the ray passes the axis. The
coefficients belong to a ray and a family of walls. So a walk computes ONE crossing per step, that
of the family which was crossed: with three it would fetch three walls from memory, which takes
longer than all the rest.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr, from_host
from ...backend.functions import first_true, sharp_angle, unit_interval
from ...backend.types import Float, Int, Mask
from ..box_walk import NEVER
from ..contract import Grid

if TYPE_CHECKING:
    from ...backend.device import Backend
    from .approach import Approach


FULL_CIRCLE, MIDPLANE = 2 * np.pi, 0.5 * np.pi
# Azimuths and polar angles in single precision end where they should to this.
ANGLE_ROUNDING = 1e-6


def is_closed(edges: np.ndarray) -> bool:
    """Return True if azimuths span a full circle."""
    return bool(abs(edges[-1] - edges[0] - FULL_CIRCLE) < 1e-9)


class SurfaceGrid(Grid):
    """A grid of cells between families of surfaces: `edges` are their walls."""

    edges: tuple[np.ndarray, ...]

    def families(
        self, edges: tuple[np.ndarray, ...], backend: Backend
    ) -> tuple[list[Surfaces], Callable[..., Approach]]:
        """Return the families of surfaces with these walls, and what makes a ray's `Approach`."""
        raise NotImplementedError


# A coefficient that is zero for all rays is None.
Form = Sequence[Float]


@dataclass
class RayLines:
    """The coefficients for one family of walls.

    `top`, `bottom`: n0, n1, n2 and d0, d1, d2; `offset`: what is subtracted from a positive v, and
    from another; None where s is v; `least`: where the denominator is not above it the wall is not
    met: it lies before the ray's beginning, if met before the turning point, or beyond its end;
    `straight`: lanes where s is v although there are offsets, for a choice among families; `start`:
    the distance from which t counts; zero where it is None.
    """

    top: Form
    bottom: Form
    offset: Form | None = None
    least: Float = 0.0
    straight: Mask = None
    start: Float = None


def meet(lines: RayLines, wall: Sequence[Float], inward: Mask) -> Float:
    """Return the distance at which rays meet a wall, before their turning point or after it."""
    c, v = wall
    s = v
    if lines.offset is not None:
        positive, other = lines.offset
        square = v - (positive if other is positive else dr.select(v > 0.0, positive, other))
        root = dr.sqrt(dr.select(square > 0.0, square, 0.0))
        s = dr.select(inward, -root, root)
        s = s if lines.straight is None else dr.select(lines.straight, v, s)
    bottom = _linear(lines.bottom, c, s)
    met = bottom > lines.least
    t = _linear(lines.top, c, s) / dr.select(met, bottom, 1.0)
    t = t if lines.start is None else t + lines.start
    return dr.select(met, t, dr.select(inward, -NEVER, type(v)(NEVER)))


def _linear(form: Form, c: Float, s: Float) -> Float:
    total = form[0]
    for coefficient, value in ((form[1], c), (form[2], s)):
        if coefficient is not None:
            total = value * coefficient if total is None else dr.fma(value, coefficient, total)
    return total


def choose(through: list[Mask], families: list[RayLines], zero: Float) -> RayLines:
    """Return the coefficients of the family that each lane is going through."""
    if len(families) == 1:
        return families[0]

    def picked(values: list[Float]) -> Float:
        return pick_any(through, values, zero)

    bent = [lines.offset is not None for lines in families]
    offset = straight = None
    if any(bent):
        offsets = [lines.offset or (zero, zero) for lines in families]
        offset = tuple(picked([o[k] for o in offsets]) for k in range(2))
        planes = [m for m, b in zip(through, bent, strict=True) if not b]
        straight = functools.reduce(operator.or_, planes) if planes else None
    return RayLines(
        [picked([lines.top[k] for lines in families]) for k in range(3)],
        [picked([lines.bottom[k] for lines in families]) for k in range(3)],
        offset,
        picked([lines.least for lines in families]),
        straight,
        picked([lines.start for lines in families]),
    )


def pick_any(through: list[Mask], values: list[Float], zero: Float) -> Float:
    """Return for each lane the value of the family it goes through, zero for None; or None."""
    if all(value is None for value in values):
        return None
    filled = [zero if value is None else value for value in values]
    if all(isinstance(value, float) and value == filled[0] for value in filled):
        return filled[0]
    chosen = zero + filled[-1]
    for mask, value in zip(through[-2::-1], filled[-2::-1], strict=True):
        chosen = dr.select(mask, value, chosen)
    return chosen


class Arithmetic:
    """What the formulas of own coordinates are computed with: plain numbers.

    Where a point is between the walls of its cell is written once (`Surfaces.fraction`); guaranteed
    bounds evaluate the same formulas with intervals and their derivatives (`bounds.curved`), in a
    subclass. Other operands are numbers of the kernel.
    """

    def length(self, x: Float, y: Float, z: Float = None) -> Float:
        square = y * y if z is None else dr.fma(y, y, z * z)
        return dr.sqrt(dr.fma(x, x, square))

    def mixed(self, a: Float, p: Float, b: Float, q: Float) -> Float:
        """Return a p + b q, of coordinates a and b and numbers p and q."""
        return dr.fma(a, p, b * q)

    def angle(self, y: Float, x: Float, length: Float = None) -> Float:
        """Return the angle of a vector from the x axis, from -π to π.

        Its length is given where the angle is at most π/4 in size.
        """
        return dr.atan2(y, x) if length is None else sharp_angle(y, x, length)

    def magnitude(self, a: Float) -> Float:
        """Return a coordinate without its sign."""
        return dr.abs(a)

    def part(self, value: Float, lower: Float, inverse: Float) -> Float:
        """Return where between two walls a coordinate is, from 0 to 1."""
        return unit_interval((value - lower) * inverse)

    def stretched(self, part: Float, factor: Float) -> Float:
        """Return a part times a number, one at most."""
        return unit_interval(part * factor)

    def upward(self, angle: Float) -> Float:
        """Return an angle from a wall, which the point is above: from 0 to 2π."""
        # Rounding puts points a hair below their wall.
        return dr.select(angle < -1e-3, angle + FULL_CIRCLE, angle)


NUMBERS = Arithmetic()


@dataclass
class TurningTrack:
    """Rays and a family of surfaces they meet downwards, then upwards.

    `surface`: how a ray runs through them; `lines`: when it meets them; `slot`: place in the table
    of the first wall that is met at all; `turn`, `reach`: number of that wall, and of the walls
    that are met (each of them twice, at most); `down`: lanes that see the family mirrored.
    """

    surface: Any
    lines: RayLines
    slot: Int
    turn: Int
    reach: Int
    down: Mask = None


@dataclass
class RunningTrack:
    """Rays and a family of surfaces they meet in ascending order (mirrored where `down`).

    `start` is where their walls start in the table, `slot` the first one that is ahead.
    """

    surface: Any
    lines: RayLines
    start: Int
    slot: Int
    down: Mask


class Surfaces:
    """What all families share; `track` is a `TurningTrack` or a `RunningTrack`.

    `has_gaps`: there is space between these surfaces that belongs to no cell; `encloses`: beyond
    the outermost one is nothing at all: it has `leave`; `halves_cell`: one of the walls is inside a
    cell, where there are no vertices: it has `in_cell`.
    """

    has_gaps = False
    encloses = False
    halves_cell = False

    def __init__(self, table: np.ndarray, walls: int, edges: np.ndarray, backend: Backend) -> None:
        self.backend, self.walls, self.cells = backend, walls, len(edges) - 1
        self.inverse_width = from_host(backend.Float, 1.0 / np.diff(edges))
        self.widest = float(np.diff(edges).max())
        self.own_table = table
        self.last_cell = dr.opaque(backend.Int, self.cells - 1)
        self.wall_count = dr.opaque(backend.Int, walls)

    def share(self, table: Float, first: int) -> None:
        """Take the table that holds the walls of all families; its own begin at `first`."""
        self.table, self.first = table, dr.opaque(self.backend.Int, first)

    def wall_at(self, slot: Int) -> list[Float]:
        """Return the numbers of a wall of the table."""
        return list(dr.gather(self.backend.packet(2), self.table, self.backend.UInt(slot)))

    def per_width(self, cell: Int) -> Float:
        return dr.gather(self.backend.Float, self.inverse_width, self.backend.UInt(cell))

    @property
    def sharp(self) -> bool:
        """Whether no cell is wider than π/4; of angles."""
        return self.widest <= 0.25 * np.pi + ANGLE_ROUNDING

    def time(self, track: Any, count: Int) -> Float:
        """Return the distance of the next crossing."""
        return meet(track.lines, self.wall_at(ahead(track.slot, count)), count < 0)

    def track(self, approach: Approach) -> Float:
        """Return how rays see this family."""
        raise NotImplementedError

    def enter(self, track: Any, t: Float) -> Int:
        """Return the count at a distance, from where the ray is there."""
        raise NotImplementedError

    def leave(self, track: Any) -> Float:
        """Return the distance at which rays leave the outermost surface."""
        raise NotImplementedError

    def cell(self, track: Any, count: Int) -> Int:
        """Return the number of the cell along this axis; outside the cells for lanes in a gap."""
        raise NotImplementedError

    def rises(self, track: Any, count: Int) -> Mask:
        """Return where the number of the cell grows with that of the walls below the ray."""
        raise NotImplementedError

    def vertex(self, track: Any, count: Int) -> Int:
        """Return the number of the vertices on the wall that is met next."""
        raise NotImplementedError

    def in_cell(self, track: Any, count: Int) -> Mask:
        """Return the lanes of which the wall that is met next is in the middle of a cell."""
        raise NotImplementedError

    def in_gap(self, track: Any, count: Int) -> Mask:
        """Return the lanes between walls that hold no cell."""
        raise NotImplementedError

    def fraction(self, cell: Int, point: list[Float], own: Arithmetic = NUMBERS) -> Float:
        """Return where between the walls of its cell a point is, from 0 to 1."""
        raise NotImplementedError


class TurningPoint(Surfaces):
    """Surfaces that are met downwards, then upwards.

    ``count`` is negative before the turning point and counts the crossings that remain until there;
    afterwards it counts those since. The cell is ``turn + |count|``.
    """

    def track(self, approach: Any) -> TurningTrack:
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

    def surface(self, approach: Any) -> tuple[Any, Mask, Int]:
        """Return how rays run, which lanes see the family mirrored, and where its table starts."""
        raise NotImplementedError

    def lines(self, surface: Any) -> RayLines:
        """Return when rays meet the surfaces."""
        raise NotImplementedError

    def is_met(self, surface: Any, values: list[Float]) -> Mask:
        """Return True for walls from the first one on that the ray gets to."""
        raise NotImplementedError

    def enter(self, track: TurningTrack, t: Float) -> Int:
        """Return the count at a distance.

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

    def place(self, surface: Any, t: Float) -> tuple[Any, Mask]:
        """Return where rays are, as `is_above` wants it, and which are before the turning point."""
        raise NotImplementedError

    def is_above(self, values: list[Float], here: Any) -> Mask:
        """Return True for walls from the first one on that is not below a place."""
        raise NotImplementedError

    def number(self, track: TurningTrack, count: Int) -> Int:
        """Return how many walls lie below the ray."""
        number = track.turn + dr.abs(count)
        if track.down is None:
            return number
        return dr.select(track.down, self.wall_count - number, number)

    def wall(self, track: TurningTrack, count: Int) -> Int:
        """Return the number of the wall that is met next."""
        wall = ahead(track.turn, count)
        if track.down is None:
            return wall
        return dr.select(track.down, self.wall_count - 1 - wall, wall)


class Running(Surfaces):
    """Surfaces that are met one after the other; ``count`` is how many have been."""

    def enter(self, track: RunningTrack, t: Float) -> Int:
        here = self.place(track.surface, t)
        met = first_true(
            self.walls,
            self.backend.UInt,
            lambda k: self.is_ahead(
                track.surface, self.wall_at(track.slot + self.backend.Int(k)), here
            ),
        )
        return self.backend.Int(met)

    def rises(self, track: RunningTrack, count: Int) -> Mask:
        return ~track.down

    def place(self, surface: Any, t: Float) -> Float:
        """Return where rays are, as `is_ahead` wants it."""
        raise NotImplementedError

    def is_ahead(self, surface: Any, values: list[Float], here: Any) -> Mask:
        """Return True for walls from the first one on that a ray has not met."""
        raise NotImplementedError


def ahead(turn: Int, count: Int) -> Int:
    """Return the wall ahead, from that at the turning point: -count - 1 on, if that is negative."""
    return turn + (count ^ (count >> 31))
