"""Discontinuities on a ray: jumps of the medium, and surfaces without width.

If a gate opens inside a panel, samples do not show which part of the panel is on which side.
Panels therefore end where the ray crosses the discontinuity (`passing`). Before, they were halved
down to 2^-14 of a segment: a shell behind a hard gate took five times the time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from ..backend import Int, dr
from ..backend.functions import loop, precision_of
from ..backend.types import Float, Mask
from .panel import may_turn

if TYPE_CHECKING:
    from ..expressions import Expression
    from .panel import Panel


# Relative rounding error of a value near a level.
NOISE = {"single": 2e-6, "double": 1e-14}


def passes(panel: Panel, expr: Expression, level: Int) -> tuple[Float, Float]:
    """Return the possible number of crossings of a level on a panel, and the number at nodes.

    The first is larger where there may be more: smaller panels decide.
    """
    nodes = panel.nodes(expr)
    shown = _sign_changes(nodes, level)
    if not may_turn(expr, panel.context) and panel.between is not None:
        controls = panel.controls(expr)
        possible = _sign_changes(controls, level)
        for a, b in pairwise(controls) if expr.partial else ():
            # Beside a negative field its root is zero before it is above the level.
            hidden = (dr.isnan(a) ^ dr.isnan(b)) & ~((a < level) | (b < level))
            possible += dr.select(hidden, 2, 0)
        return possible, shown
    (low, high), (least, largest) = panel.hull(expr), panel.range(expr)
    outside = ((high >= level) & (largest < level)) | ((low <= level) & (least >= level))
    turns = (panel.beyond(expr) > 0.0) & (low <= level) & (high >= level)
    return dr.select(outside | turns, shown + 1, shown), shown


def _sign_changes(values: list[Float], level: Int) -> Float:
    """Return the number of times a sequence crosses a level.

    Inner values count only if they differ by more than rounding.
    """
    first, *inner, last = values
    size = dr.select(dr.isfinite(last), dr.abs(last), dr.select(dr.isfinite(first), first, 0.0))
    noise = NOISE[precision_of(type(first))] * (dr.abs(level) + dr.abs(size))
    below, count = first < level, dr.int32_array_t(type(first))(0)
    for value in inner:
        now = (value < level - noise) | ((value < level + noise) & below)
        count += dr.select(below ^ now, 1, 0)
        below = now
    return count + dr.select(below ^ (last < level), 1, 0)


# Half the distance of two places that tell a slope.
_BESIDE = 2.0**-8
# Most steps of the root search: cubics take three or four, a tenth root from its pole six.
_STEPS = 24
# After this many steps that moved the same end the next one bisects: behind a jump where a scalar
# hardly rises before it falls, twelve steps missed the next jump by a hundredth of the interval.
_ONE_SIDED = 2.0
# The search ends at this distance from the level, relative to the change of the scalar: a Newton
# step leaves about the square of that.
_NEAR = {"single": 2e-5, "double": 1e-9}


@dataclass
class _Search:
    """A bracket of a crossing, and the distances of the scalar from the level at its ends.

    `here` is the latest place, and `value` the distance there. The sign of `side` says whether it
    became the lower (> 0) or the upper end (< 0), its size for how many steps. `leaving` and
    `arriving` are masks: the lower or the upper end lies on the level itself, behind one crossing
    or before the next, and is not the root that is searched for.
    """

    low: Float
    high: Float
    below: Float
    above: Float
    here: Float
    value: Any
    side: Any
    leaving: Mask
    arriving: Mask
    count: Float


def on_chord(panel: Panel, expr: Expression, level: Int) -> Float:
    """Return the place s where the chord crosses a level, from 0 to 1."""
    return _root(*(panel.scalar(expr, s) - level for s in (0.0, 1.0)))


def passing(panel: Panel, expr: Expression, level: Int) -> Float:
    """Return the place s of the crossing of a level, in the first half that shows one.

    An arbitrary place from 0 to 1 if neither half shows one.
    """
    end = _searched(panel, expr, level)
    # The last secant step, which is not tried.
    onward = dr.fma(_root(end.below, end.above), end.high - end.low, end.low)
    return dr.select(end.leaving | end.arriving, end.here, onward)


def slope_at(panel: Panel, expr: Expression, place: Float) -> Float:
    """Return the derivative of an expression by s at one place, from two values beside it."""
    context = panel.context
    place = context.real(place)
    first = dr.select(place > _BESIDE, place - _BESIDE, 0.0)
    last = dr.select(place < 1.0 - _BESIDE, place + _BESIDE, 1.0)
    values = [context.evaluate(expr, panel.fields(s)) for s in (first, last)]
    slope = (values[1] - values[0]) / (last - first)
    chord = panel.scalar(expr, 1.0) - panel.scalar(expr, 0.0)
    return dr.select(dr.isfinite(slope) & (slope != 0.0), slope, chord)


def _searched(panel: Panel, expr: Expression, level: Int) -> _Search:
    """Return the final state of the search for a crossing, near an initial place.

    Secant steps; the value at an end that stays is reduced as the other end approaches the root
    (Anderson & Björck 1973, *BIT* 13, 253).
    """
    first, middle, last = (x - level for x in panel.nodes(expr))
    early = (first < 0.0) ^ (middle < 0.0)
    passes = early | ((first < 0.0) ^ (last < 0.0))
    below, above = dr.select(early, first, middle), dr.select(early, middle, last)
    real = type(first)
    close = _NEAR[precision_of(real)] * dr.abs(above - below)
    start = _Search(
        low=dr.select(early, real(0.0), 0.5),
        high=dr.select(early, real(0.5), 1.0),
        below=below,
        above=above,
        here=dr.select(early, real(0.0), 0.5),
        value=below,
        side=real(0.0),
        leaving=dr.abs(below) <= close,
        arriving=dr.abs(above) <= close,
        count=dr.select(passes, real(0.0), _STEPS),
    )

    def going_on(state: _Search) -> Any:
        found = (dr.abs(state.value) <= close) & ~(state.leaving | state.arriving)
        return (state.count < _STEPS) & ~found

    def step(state: _Search) -> tuple[_Search]:
        even = state.leaving | state.arriving | (dr.abs(state.side) >= _ONE_SIDED)
        part = dr.select(even, 0.5, _root(state.below, state.above))
        here = dr.fma(part, state.high - state.low, state.low)
        value = panel.context.evaluate(expr, panel.fields(here)) - level
        onward = (value < 0.0) == (state.below < 0.0)
        off = dr.abs(value) > close
        sign = dr.select(onward, real(1.0), -1.0)
        again = sign * state.side > 0.0
        side = dr.select(again & ~even, state.side + sign, sign)
        less = 1.0 - value / dr.select(onward, state.below, state.above)
        less = dr.select(again, dr.select(less > 0.0, less, 0.5), 1.0)
        return (
            _Search(
                low=dr.select(onward, here, state.low),
                high=dr.select(onward, state.high, here),
                below=dr.select(onward, value, state.below * less),
                above=dr.select(onward, state.above * less, value),
                here=here,
                value=value,
                side=side,
                leaving=state.leaving & ~(onward & off),
                arriving=state.arriving & (onward | ~off),
                count=state.count + 1.0,
            ),
        )

    end: _Search
    (end,) = loop((start,), going_on, step, label="passage")
    return end


def _root(first: Float, last: Float) -> Float:
    """Return the root, limited to [0, 1], of a line with these values at 0 and 1."""
    fall = first - last
    f = first / dr.select(fall == 0.0, 1.0, fall)
    f = dr.select(dr.isfinite(f), f, 0.5)
    return dr.select(f > 0.0, dr.select(f < 1.0, f, 1.0), 0.0)


# Factor on the accuracy of the fields where media jump, or evaluate something where they cross a
# level (`Medium.sensitivity`). On curvilinear grids 2.5 to 7 % of white-noise pixels exceeded their
# error estimate behind conditions and for densities proportional to the slope; with 10, 0.5 % do,
# in 1 to 1.2 of the time.
SENSITIVITY = 10.0


@dataclass
class Jump:
    """A level of an expression at which the medium jumps or has a surface."""

    expr: Expression
    level: float


def jumps_ahead(panel: Panel, jumps: Sequence[Jump]) -> tuple[Float, Float]:
    """Return the number of jumps crossed, as nodes show it, and where there may be more."""
    count, unresolved = dr.int32_array_t(type(panel.length))(0), panel.length < 0.0
    for jump in jumps:
        possible, shown = passes(panel, jump.expr, panel.context.kept_number(jump.level))
        unresolved |= possible > shown
        count += shown
    return count, unresolved


def first_jump(panel: Panel, jumps: Sequence[Jump]) -> Float:
    """Return the place s of the first jump crossed; 1 where there is none."""
    found = type(panel.length)(1.0)
    groups: dict[str, list[Jump]] = {}
    for jump in jumps:
        groups.setdefault(jump.expr.text, []).append(jump)
    for group in groups.values():
        level, passed = _first_level(panel, group)
        place = panel.context.narrow(passing(panel, group[0].expr, level))
        found = dr.select(passed & (place < found), place, found)
    return found


def _first_level(panel: Panel, jumps: Sequence[Jump]) -> tuple[Float, Float]:
    """Return the level of one expression that is crossed first, and a mask: where there is one.

    Between nodes that show all crossings the scalar is monotonic, so the first level is the
    nearest. One search is sufficient for any number of levels.
    """
    expr, levels = jumps[0].expr, [panel.context.kept_number(jump.level) for jump in jumps]
    first, middle, last = panel.nodes(expr)
    level, passed, nearest = levels[0], panel.length < 0.0, first * 0.0
    for one in levels:
        _, shown = passes(panel, expr, one)
        early = (first < one) ^ (middle < one)
        there = (shown > 0) & (early | ((middle < one) ^ (last < one)))
        late = dr.abs(middle - first) + dr.abs(one - middle)
        distance = dr.select(early, dr.abs(one - first), late)
        here = there & (~passed | (distance < nearest))
        level, nearest = dr.select(here, one, level), dr.select(here, distance, nearest)
        passed = passed | there
    return level, passed
