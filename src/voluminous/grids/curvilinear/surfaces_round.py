"""Spheres around the centre, and cylinders around the axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr, from_host
from ...backend.types import Float, Int
from ..box_walk import NEVER
from .approach import PARALLEL, AxisApproach, CentreApproach
from .arithmetic import NUMBERS, Arithmetic
from .crossing import RayLines
from .surfaces import TurningPoint, TurningTrack

if TYPE_CHECKING:
    from ...backend.device import Backend


class Round(TurningPoint):
    """Surfaces of constant radius.

    Inside the innermost one, unless that has no radius at all, is a cavity: no cell.

    Parameters
    ----------
    edges : array
        Radii of the cells' walls, in units of the grid's scale.
    """

    encloses = True

    def __init__(self, edges: np.ndarray, backend: Backend) -> None:
        self.has_gaps = bool(edges[0] > 0)
        radii = edges if self.has_gaps else edges[1:]
        # Beyond the last wall one more, so that rays that have left read something finite.
        square = np.append(radii, 2 * radii[-1]) ** 2
        table = np.stack([self.first_number(square), square], axis=1)
        super().__init__(table, len(radii), len(edges) - 1, backend)
        self.skipped = int(self.has_gaps)
        self.lower = from_host(backend.Float, edges[:-1])
        self.inverse_width = from_host(backend.Float, 1.0 / np.diff(edges))

    def first_number(self, square: np.ndarray) -> np.ndarray:
        """Return c of walls of given squared radius."""
        raise NotImplementedError

    def is_met(self, surface: Any, wall: list[Any]) -> Any:
        return wall[1] > surface.nearest

    def is_above(self, wall: list[Any], here: Float) -> Any:
        return wall[1] > here

    def enter(self, track: TurningTrack, t: Float) -> Any:
        most = track.reach - 1
        return dr.clip(super().enter(track, t), -most, most)

    def leave(self, track: TurningTrack) -> Any:
        """Return the distance at which rays leave the outermost surface."""
        last = track.reach - 1
        return dr.select(last < 0, -NEVER, self.time(track, dr.maximum(last, 0)))

    def cell(self, track: TurningTrack, count: Int) -> Any:
        """Return the number of the cell along this axis."""
        return self.number(track, count) - self.skipped

    def rises(self, track: TurningTrack, count: Int) -> Any:
        """Return where the number of the cell grows with that of the walls below the ray."""
        return self.backend.Bool(True)

    def in_gap(self, track: TurningTrack, count: Int) -> Any:
        return (track.turn | count) == 0

    def vertex(self, track: TurningTrack, count: Int) -> Any:
        """Return the number of the vertices on the wall that is met next."""
        return self.wall(track, count) + (1 - self.skipped)

    def _fraction(self, cell: Int, radius: Float, own: Arithmetic) -> Any:
        lower = dr.gather(self.backend.Float, self.lower, self.backend.UInt(cell))
        inverse = dr.gather(self.backend.Float, self.inverse_width, self.backend.UInt(cell))
        return own.part(radius, lower, inverse)


@dataclass
class ShellTrack:
    """Square of the distance at which a ray passes the centre."""

    nearest: Any


class Shells(Round):
    """Spheres; distances count from the closest approach b to the centre: t² = r² - b²."""

    def surface(self, approach: CentreApproach) -> tuple[ShellTrack, None, None]:
        return ShellTrack(self.backend.Float(approach.radius * approach.radius)), None, None

    def place(self, surface: ShellTrack, t: Float) -> tuple[Any, Any]:
        return dr.fma(t, t, surface.nearest), t < 0.0

    def lines(self, surface: ShellTrack) -> RayLines:
        return RayLines((None, None, 1.0), (None, 1.0, None), (surface.nearest, surface.nearest))

    def first_number(self, square: np.ndarray) -> np.ndarray:
        return np.ones_like(square)

    def fraction(self, cell: Int, point: list[Any], own: Arithmetic = NUMBERS) -> Any:
        return self._fraction(cell, own.length(*point), own)


@dataclass
class TubeTrack:
    """How a ray runs past the axis.

    Attributes
    ----------
    nearest : array
        Square of the distance from the axis at t = 0, the nearest point of the chord.
    passing : array
        Square of the distance at which the whole line passes the axis.
    bias : array
        Size of the part of the first that is along the line; zero unless the chord ends there.
    side : array
        1 if the chord begins beyond the closest approach, -1 if it ends before, 0 if it has it.
    pace : array
        Distance along the ray per distance across the axis.
    """

    nearest: Any
    passing: Any
    bias: Any
    side: Any
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

    def place(self, surface: TubeTrack, t: Float) -> tuple[Any, Any]:
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

    def fraction(self, cell: Int, point: list[Any], own: Arithmetic = NUMBERS) -> Any:
        x, y, _ = point
        return self._fraction(cell, own.length(x, y), own)
