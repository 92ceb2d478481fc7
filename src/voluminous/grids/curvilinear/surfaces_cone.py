"""Cones around the axis, with their tips at the centre."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr, from_host
from ...backend.types import Float, Int
from .approach import CentreApproach
from .arithmetic import NUMBERS, Arithmetic
from .crossing import RayLines
from .surfaces import TurningPoint, TurningTrack

if TYPE_CHECKING:
    from ...backend.device import Backend


@dataclass
class ConeTrack:
    """How a ray runs through the cones, mirrored so that its nearest point is above the midplane.

    Attributes
    ----------
    rise : array
        The z component of the direction.
    height : array
        The z component of the unit vector to the closest approach; not negative.
    radius : array
        Distance of the closest approach.
    tilt : array
        Square of the z component of the normal of the plane through the ray and the centre.
    steepest : array
        Minus the square of the greatest cos θ on the ray: ``tilt - 1``.
    point, direction : list of two arrays
        The closest approach, and the direction, across the axis.
    """

    rise: Any
    height: Any
    radius: Any
    tilt: Any
    steepest: Any
    point: list[Any]
    direction: list[Any]


class Cones(TurningPoint):
    """Cones θ = const of a spherical grid; θ = π/2 is a plane like any other cone.

    Let ψ be the angle in the plane of ray and centre, counted from the closest approach, so that
    ``t = b tan ψ``. Then ``cos θ = h cos ψ + u sin ψ`` with u and h the z components of the
    direction and of the unit vector to the closest approach: a cosine with its greatest value
    ``μ = sqrt(h² + u²)`` at ``tan ψ* = u/h``. A cone ``cos θ = c`` is met at ``ψ* ∓ arccos(c/μ)``::

        t = b (u c ∓ h s)/(h c ± u s),    s = sqrt(μ² - c²),

    if the denominator, ``μ² cos ψ``, is positive: else before the ray began, or never.

    Parameters
    ----------
    edges : array
        Angles of the cells' walls from the axis.
    mirrored : bool
        The last edge is the midplane, and the cells are mirrored below it.
    """

    def __init__(self, edges: np.ndarray, mirrored: bool, backend: Backend) -> None:
        self.mirrored = mirrored
        every = np.concatenate([edges, np.pi - edges[-2::-1]]) if mirrored else edges
        self.above, self.below = bool(every[0] > 0), bool(every[-1] < np.pi)
        self.has_gaps = self.above or self.below
        angles = every[0 if self.above else 1 : len(every) if self.below else -1]
        table = cone_table(angles)
        # One more beyond the last, that is never met.
        beyond = np.array([[-2.0, -4.0]])
        both = np.concatenate([table, beyond, mirrored_table(table), beyond])
        super().__init__(both, len(angles), len(edges) - 1, backend)
        self.mirrored_start = dr.opaque(backend.Int, len(angles) + 1)
        self.lower = from_host(backend.Float, _sines(edges[:-1]).reshape(-1))
        self.inverse_width = from_host(backend.Float, 1.0 / np.diff(edges))
        self.widest = float(np.diff(edges).max())

    def surface(self, approach: CentreApproach) -> tuple[ConeTrack, Any, Any]:
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

    def is_met(self, surface: ConeTrack, wall: list[Any]) -> Any:
        c, square = wall
        highest = dr.select(square > 0.0, surface.tilt, surface.steepest)
        return (square > highest) | (c < 0.0)

    def place(self, surface: ConeTrack, t: Float) -> tuple[Any, Any]:
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

    def is_above(self, wall: list[Any], here: Float) -> Any:
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

    def cell(self, track: TurningTrack, count: Int) -> Any:
        """Return the number of the cell along this axis; outside the cells for lanes in a gap."""
        return self._fold(self.number(track, count) - int(self.above), 2 * self.cells - 1)

    def rises(self, track: TurningTrack, count: Int) -> Any:
        """Return where the number of the cell grows with that of the walls below the ray."""
        up = ~track.down
        if not self.mirrored:
            return up
        number = self.number(track, count) - int(self.above)
        return up ^ (number > self.last_cell)

    def in_gap(self, track: TurningTrack, count: Int) -> Any:
        number = self.number(track, count)
        north, south = number == 0, number == self.wall_count
        if self.above and self.below:
            return north | south
        return north if self.above else south

    def vertex(self, track: TurningTrack, count: Int) -> Any:
        """Return the number of the vertices on the wall that is met next."""
        return self._fold(self.wall(track, count) + int(not self.above), 2 * self.cells)

    def _fold(self, number: Int, most: int) -> Any:
        if not self.mirrored:
            return number
        other = dr.opaque(self.backend.Int, most) - number
        return dr.select(number < other, number, other)

    def fraction(self, cell: Int, point: list[Any], own: Arithmetic = NUMBERS) -> Any:
        x, y, z = point
        z = own.magnitude(z) if self.mirrored else z
        across, cell = own.length(x, y), self.backend.UInt(cell)
        cosine, sine = dr.gather(self.backend.packet(2), self.lower, cell)
        length = own.length(*point) if self.sharp else None
        left, along = own.mixed(across, cosine, z, -sine), own.mixed(z, cosine, across, sine)
        angle = own.angle(left, along, length)
        return own.part(angle, 0.0, dr.gather(self.backend.Float, self.inverse_width, cell))


def cone_table(angles: np.ndarray) -> np.ndarray:
    """Return cos θ, and sin² θ near the axis or -cos² θ near the midplane, shape (n, 2).

    Either is what a difference of squares keeps its digits with.
    """
    cosine, sine = _sines(angles).T
    return np.stack([cosine, np.where(cosine**2 > 0.5, sine**2, -(cosine**2))], axis=1)


def mirrored_table(table: np.ndarray) -> np.ndarray:
    """Return the table seen from below."""
    return table[::-1] * [-1.0, 1.0]


def _sines(angles: np.ndarray) -> np.ndarray:
    """Return cosines and sines, shape (n, 2); exactly zero on axes and midplane."""
    pair = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.where(np.abs(pair) < 1e-15, 0.0, pair)
