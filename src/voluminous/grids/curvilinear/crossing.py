"""When a straight ray meets a wall: one formula for all kinds of walls.

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
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ...backend import Float, dr
from ..box_walk import NEVER

# A coefficient that is zero for all rays is None.
Form = Sequence[Any]


@dataclass
class RayLines:
    """The coefficients for one family of walls.

    Attributes
    ----------
    top, bottom : three arrays, numbers or None
        n0, n1, n2 and d0, d1, d2.
    offset : two arrays, or None
        What is subtracted from a positive v, and from another; None where s is v.
    least : array or float
        Where the denominator is not above it the wall is not met: it lies before the ray's
        beginning, if met before the turning point, or beyond its end.
    straight : array of Bool or None
        Lanes where s is v although there are offsets, for a choice among families.
    start : array or None
        The distance from which t counts; zero where it is None.
    """

    top: Form
    bottom: Form
    offset: Form | None = None
    least: Any = 0.0
    straight: Any = None
    start: Any = None


def meet(lines: RayLines, wall: Sequence[Any], inward: Any) -> Any:
    """Return the distance at which rays meet a wall, before their turning point or after it."""
    c, v = wall
    s = v if lines.offset is None else _root(lines, v, inward)
    bottom = _linear(lines.bottom, c, s)
    met = bottom > lines.least
    t = _linear(lines.top, c, s) / dr.select(met, bottom, 1.0)
    t = t if lines.start is None else t + lines.start
    return dr.select(met, t, dr.select(inward, -NEVER, type(v)(NEVER)))


def _root(lines: RayLines, v: Float, inward: Any) -> Any:
    positive, other = lines.offset or ()
    square = v - (positive if other is positive else dr.select(v > 0.0, positive, other))
    root = dr.sqrt(dr.select(square > 0.0, square, 0.0))
    root = dr.select(inward, -root, root)
    return root if lines.straight is None else dr.select(lines.straight, v, root)


def _linear(form: Form, c: Any, s: Float) -> Any:
    constant, by_c, by_s = form
    total = constant
    for coefficient, value in ((by_c, c), (by_s, s)):
        if coefficient is not None:
            total = value * coefficient if total is None else dr.fma(value, coefficient, total)
    return total


def choose(through: list[Any], families: list[RayLines], zero: Any) -> RayLines:
    """Return the coefficients of the family that each lane is going through."""
    if len(families) == 1:
        return families[0]
    bent = [lines.offset is not None for lines in families]
    offset = straight = None
    if any(bent):
        offsets = [lines.offset or (zero, zero) for lines in families]
        offset = tuple(pick(through, [o[k] for o in offsets], zero) for k in range(2))
        straight = (
            None if all(bent) else _any([m for m, b in zip(through, bent, strict=True) if not b])
        )
    return RayLines(
        [pick(through, [lines.top[k] for lines in families], zero) for k in range(3)],
        [pick(through, [lines.bottom[k] for lines in families], zero) for k in range(3)],
        offset,
        pick(through, [lines.least for lines in families], zero),
        straight,
        pick(through, [lines.start for lines in families], zero),
    )


def pick(through: list[Any], values: list[Any], zero: Any) -> Any:
    """Return for each lane the value of the family it goes through; None if all are."""
    if all(value is None for value in values):
        return None
    filled = [zero if value is None else value for value in values]
    if all(isinstance(value, float) and value == filled[0] for value in filled):
        return filled[0]
    chosen = zero + filled[-1]
    for mask, value in zip(through[-2::-1], filled[-2::-1], strict=True):
        chosen = dr.select(mask, value, chosen)
    return chosen


def _any(masks: list[Any]) -> Any:
    found = masks[0]
    for mask in masks[1:]:
        found = found | mask
    return found


def either(a: Float, b: Float) -> Any:
    """Return where one of two holds."""
    return a | b


def both(a: Float, b: Float) -> Any:
    """Return where both of two hold."""
    return a & b


def later(a: Float, b: Float) -> Any:
    """Return the larger of two numbers that are no NaN."""
    return dr.select(a > b, a, b)


def lesser(a: Float, b: Float) -> Any:
    """Return the smaller of two numbers that are no NaN."""
    return dr.select(a < b, a, b)


def nearest(ways: list[Any]) -> list[Any]:
    """Return for each family whether its wall is the nearest; the first one where several are."""
    through, taken = [], None
    for k, way in enumerate(ways[:-1]):
        first = functools.reduce(both, [way <= other for other in ways[k + 1 :]])
        first = first if taken is None else first & ~taken
        taken = first if taken is None else taken | first
        through.append(first)
    return [*through, ~taken] if taken is not None else [ways[0] == ways[0]]
