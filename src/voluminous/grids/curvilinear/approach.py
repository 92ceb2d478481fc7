"""Where a straight ray passes the axis, from one azimuth to the opposite one.

Fields that are linear in azimuth jump on the axis. A ray that meets it would find them, by rounding
alone, on this side or that, or go round by all azimuths in between. So places near the axis are
counted from where a ray passes it, and one that passes it by no more than rounding meets it
exactly: all half planes at once, and before and behind that azimuth is what the ray's direction
tells. The same holds at the centre, where the polar angle jumps too.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ...backend import dr
from ...backend.types import Float, Mask
from ..box_walk import NEVER

# Of a type of numbers; Dr.Jit's own has no types.
_epsilon: Any = dr.epsilon
# Slower than this (per unit of distance), a ray runs parallel to an axis or a plane.
PARALLEL = 1e-15
# What passes the centre or the axis within so many ε of the distance of a ray's origin, meets it.
ROUNDING = 32.0


@dataclass
class Approach:
    """Rays in `Wide`, in units of the grid's scale, as ``point + t direction``.

    `point`, `direction`: where the distance t is zero, and the unit direction; `offset`: how far
    that point is from the ray's origin; `arrive`, `leave`: the t at which rays enter and leave the
    surface around everything; `hits`: lanes that do; `passage`: where they pass the axis.
    """

    point: list[Float]
    direction: list[Any]
    offset: Float
    arrive: Float
    leave: Float
    hits: Mask
    passage: Passage = field(init=False)


@dataclass
class CentreApproach(Approach):
    """Also the distance from the centre and the unit vector to the point, normal to the ray."""

    radius: Float
    normal: list[Float]


@dataclass
class AxisApproach(Approach):
    """Also `side`: 0 if the point is the closest approach of the whole line.

    It is 1 if the chord begins there, beyond the closest approach, and -1 if it ends there, before.
    """

    side: Float


def approach_centre(origin: list[Float], direction: list[Float], outer: Float) -> CentreApproach:
    """Return rays counted from where they come nearest to the origin; all lengths scaled."""
    first = -dot(origin, direction)
    near = along(origin, direction, first)
    # The first point is off along the ray by the rounding of a far origin: once more.
    more = -dot(near, direction)
    point = along(near, direction, more)
    square = dot(point, point)
    radius = dr.sqrt(square)
    # What is left of a point that was rounding along the ray has no direction.
    rounding = (ROUNDING * _epsilon(type(radius))) ** 2 * dot(origin, origin)
    central = (square <= 1e-4 * dot(near, near)) | (square <= rounding) | (radius < 1e-30)
    radius = dr.select(central, 0.0, radius)
    inverse = 1.0 / dr.select(central, 1.0, radius)
    across = _horizontal_normal(direction)
    normal = [dr.select(central, a, p * inverse) for a, p in zip(across, point, strict=True)]
    point = [dr.select(central, 0.0, p) for p in point]
    half = dr.sqrt(dr.maximum((outer - radius) * (outer + radius), 0.0))
    return CentreApproach(point, direction, first + more, -half, half, half > 0, radius, normal)


def _horizontal_normal(direction: list[Float]) -> list[Float]:
    """Return a unit vector normal to the direction with z = 0."""
    x, y, z = direction
    across = dr.sqrt(x * x + y * y)
    polar = across < PARALLEL
    inverse = 1.0 / dr.select(polar, 1.0, across)
    return [dr.select(polar, 1.0, y * inverse), dr.select(polar, 0.0, -x * inverse), 0.0 * z]


def approach_axis(
    origin: list[Float], direction: list[Float], outer: Float, low: Float, high: Float
) -> AxisApproach:
    """Return rays counted from the point of their chord that is nearest to the z axis.

    The chord, in the cylinder of radius `outer` between `low` and `high`, has ends of its own: a
    ray that is nearly parallel to the axis may come nearest to it far beyond them.
    """
    (x, y, z), (dx, dy, dz) = origin, direction
    Wide = type(z)
    square = dx * dx + dy * dy
    parallel = square < PARALLEL**2
    inverse = 1.0 / dr.select(parallel, 1.0, square)
    nearest = dr.select(parallel, 0.0, -dr.fma(x, dx, y * dy) * inverse)
    nx, ny = dr.fma(nearest, dx, x), dr.fma(nearest, dy, y)
    inner = outer * outer - dr.fma(nx, nx, ny * ny)
    half = dr.sqrt(dr.maximum(inner, 0.0) * inverse)
    half = dr.select(parallel, dr.select(inner > 0, Wide(NEVER), -NEVER), half)
    arrive, leave = _between(z, dz, low, high)
    arrive, leave = dr.maximum(arrive, nearest - half), dr.minimum(leave, nearest + half)
    hits = arrive < leave
    t = dr.select(hits, dr.clip(nearest, arrive, leave), 0.0)
    t = dr.select(parallel & hits, 0.5 * (arrive + leave), t)
    still = [dr.select(parallel, 0.0, dx), dr.select(parallel, 0.0, dy), dz]
    side = dr.select(t == nearest, 0.0, dr.select(t > nearest, Wide(1), -1))
    side = dr.select(parallel, 0.0, side)
    return AxisApproach(along(origin, still, t), still, t, arrive - t, leave - t, hits, side)


def _between(z: Float, dz: Any, low: Float, high: Float) -> tuple[Float, Float]:
    """Return the distances at which rays are between two planes; in the wrong order if never."""
    Wide = type(z)
    parallel = dr.abs(dz) < PARALLEL
    pace = 1.0 / dr.select(parallel, 1.0, dz)
    a, b = (low - z) * pace, (high - z) * pace
    within = dr.select((z >= low) & (z <= high), Wide(-NEVER), NEVER)
    arrive = dr.select(parallel, within, dr.minimum(a, b))
    return arrive, dr.select(parallel, Wide(NEVER), dr.maximum(a, b))


def dot(a: list[Float], b: list[Float]) -> Float:
    """Return the scalar product of two vectors."""
    return dr.fma(a[0], b[0], dr.fma(a[1], b[1], a[2] * b[2]))


def along(origin: list[Float], direction: list[Float], t: Float) -> list[Float]:
    """Return the point at a distance."""
    return [dr.fma(t, d, o) for o, d in zip(origin, direction, strict=True)]


# How far from the axis limits at the axis itself are taken, in ε of the unit of length.
_BESIDE = 2.0**-6


@dataclass
class Passage:
    """The nearest point to the axis, lengths in units of the scale.

    `turn`: its distance along the ray; `foot`: its x and y; `meets`: rays that go through the axis,
    or begin or end there: the foot is zero.
    """

    turn: Float
    foot: list[Float]
    meets: Mask

    def narrow(self, Float: Any) -> Passage:
        """Return the same in the precision of the walk."""
        return Passage(Float(self.turn), [Float(f) for f in self.foot], self.meets)

    def beside(self, t: Float, end: Float) -> tuple[Float, Float]:
        """Return a distance on a segment that ends at `end`, and how far it is from the turn.

        On rays that meet the axis never on it, nor (by rounding) on its other side: what a field is
        at the segment's end there is the limit along the segment.
        """
        least, away = _BESIDE * _epsilon(type(t)), t - self.turn
        beside = dr.select(end > self.turn, dr.maximum(away, least), dr.minimum(away, -least))
        return (
            dr.select(self.meets, self.turn + beside, t),
            dr.select(self.meets, beside, away),
        )


def pass_axis(approach: Approach, origin: list[Float], begin: Float, end: Float) -> Passage:
    """Return where rays pass the axis, of which some begin or end at a distance."""
    across, direction = approach.point[:2], approach.direction[:2]
    square = _dot(direction, direction)
    parallel = square < PARALLEL**2
    turn = dr.select(parallel, 0.0, -_dot(across, direction) / dr.select(parallel, 1.0, square))
    foot = along(across, direction, turn)
    rounding = (ROUNDING * _epsilon(type(turn))) ** 2 * dot(origin, origin)
    meets = _dot(foot, foot) <= rounding
    for limit in (begin, end):
        # A ray that begins on the axis does not come from its other side.
        near = (limit - turn) * (limit - turn) * square <= rounding
        turn = dr.select(meets & ~parallel & near, limit, turn)
    # Along the axis there is no azimuth: zero is taken.
    aside = [dr.select(parallel, PARALLEL, 0.0), 0.0]
    foot = [dr.select(meets, a, f) for a, f in zip(aside, foot, strict=True)]
    return Passage(turn, foot, meets)


def _dot(a: list[Float], b: list[Float]) -> Float:
    return dr.fma(a[0], b[0], a[1] * b[1])
