"""Where a straight ray passes the axis, from one azimuth to the opposite one.

Fields that are linear in azimuth jump on the axis. A ray that meets it would find them, by rounding
alone, on this side or that, or go round by all azimuths in between. So places near the axis are
counted from where a ray passes it, and one that passes it by no more than rounding meets it
exactly: all half planes at once, and before and behind that azimuth is what the ray's direction
tells. The same holds at the centre, where the polar angle jumps too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...backend import dr
from .approach import PARALLEL, ROUNDING, Approach, along, dot

# How far from the axis limits at the axis itself are taken, in ε of the unit of length.
_BESIDE = 2.0**-6


@dataclass
class Passage:
    """The nearest point to the axis, lengths in units of the scale.

    Attributes
    ----------
    turn : array
        Its distance along the ray.
    foot : list of two arrays
        Its x and y.
    meets : array of Bool
        Rays that go through the axis, or begin or end there: the foot is zero.
    """

    turn: Any
    foot: list[Any]
    meets: Any

    def narrow(self, Float: Any) -> Passage:
        """Return the same in the precision of the walk."""
        return Passage(Float(self.turn), [Float(f) for f in self.foot], self.meets)

    def beside(self, t: Any, end: Any) -> tuple[Any, Any]:
        """Return a distance on a segment that ends at `end`, and how far it is from the turn.

        On rays that meet the axis never on it, nor (by rounding) on its other side: what a field is
        at the segment's end there is the limit along the segment.
        """
        least, away = _BESIDE * dr.epsilon(type(t)), t - self.turn
        beside = dr.select(end > self.turn, dr.maximum(away, least), dr.minimum(away, -least))
        return (
            dr.select(self.meets, self.turn + beside, t),
            dr.select(self.meets, beside, away),
        )


def pass_axis(approach: Approach, origin: list[Any], begin: Any, end: Any) -> Passage:
    """Return where rays pass the axis, of which some begin or end at a distance."""
    across, direction = approach.point[:2], approach.direction[:2]
    square = _dot(direction, direction)
    parallel = square < PARALLEL**2
    turn = dr.select(parallel, 0.0, -_dot(across, direction) / dr.select(parallel, 1.0, square))
    foot = along(across, direction, turn)
    rounding = (ROUNDING * dr.epsilon(type(turn))) ** 2 * dot(origin, origin)
    meets = _dot(foot, foot) <= rounding
    for limit in (begin, end):
        # A ray that begins on the axis does not come from its other side.
        near = (limit - turn) * (limit - turn) * square <= rounding
        turn = dr.select(meets & ~parallel & near, limit, turn)
    # Along the axis there is no azimuth: zero is taken.
    aside = [dr.select(parallel, PARALLEL, 0.0), 0.0]
    foot = [dr.select(meets, a, f) for a, f in zip(aside, foot, strict=True)]
    return Passage(turn, foot, meets)


def _dot(a: list[Any], b: list[Any]) -> Any:
    return dr.fma(a[0], b[0], a[1] * b[1])
