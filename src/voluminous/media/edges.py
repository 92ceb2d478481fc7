"""Edges: places on a ray where a medium jumps, or where a surface without width is.

Where a gate opens inside of a panel no samples tell how much of it is on which side. Panels that
end at the place where the ray passes the edge (`passing`) have one medium each. Before, they were
halved down to 2^-14 of a segment: a shell behind a hard gate took five times the time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from ..backend import Int, dr
from ..backend.functions import horner, precision_of, unit_interval
from ..backend.types import Float, Mask
from ..expressions.taylor import TracedJet, TracedJetOps
from ..expressions.traced_interval import TracedInterval
from .context import completed
from .stretch import may_turn

if TYPE_CHECKING:
    from ..expressions import Expression, Margin
    from .stretch import Cubic, Stretch


# What rounding may do to a value near a level, as a fraction of it.
NOISE = {"single": 2e-6, "double": 1e-14}


def passes(stretch: Stretch, expr: Expression | Margin, level: Int) -> tuple[Float, Float]:
    """Return how often an expression may pass a level on a stretch, and how often nodes show it.

    Once more than that where it may turn: smaller panels tell.
    """
    found, shown = stretch.turning(expr), _sign_changes(stretch.nodes(expr), level)
    possible = shown
    if not may_turn(expr, stretch.context):
        possible = _sign_changes(stretch.controls(expr), level)
    turns = (found.apart > 0.0) & (found.low <= level) & (found.high >= level)
    return dr.select(turns, shown + 1, possible), shown


def way_within(values: list[Float], level: Int, width: Float) -> Float:
    """Return how far a sequence goes up and down within a surface, in its widths."""
    ends = [unit_interval((x - level) / width + 0.5) for x in values]
    return sum((dr.abs(b - a) for a, b in pairwise(ends)), 0.0 * width)


def _sign_changes(values: list[Float], level: Int) -> Float:
    """Return how often a sequence passes a level.

    Bézier control points do at least as often as their curve, and more by an even number (Farin
    2002, section 5.3). Those between the ends count only if rounding cannot have put them there.
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


# Steps of the search at most: cubics take three or four, a tenth root that begins at its pole six.
_STEPS = 24
# After so many steps that moved the same end the next one halves: behind one edge, where a scalar
# hardly rises before it falls, twelve steps missed the next by a hundredth of the way.
_ONE_SIDED = 2.0
# It ends where the scalar is so near, as a part of what it changes by: Newton's step leaves about
# the square of that.
_NEAR = {"single": 2e-5, "double": 1e-7}


@dataclass
class _Search:
    """Two places between which a level is passed, and how far the scalar is from it there.

    `here` is the latest of them, and `value` what there is; `side` tells whether that has become
    the lower (> 0) or the upper end (< 0), and for how many steps that has been so. `leaving` and
    `arriving` are where the lower or the upper end is on the level itself, as behind one passage or
    before the next: what is near that is not the one between.
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


def on_chord(stretch: Stretch, expr: Expression, level: Int) -> Float:
    """Return where a line through both ends passes a level, from 0 to 1."""
    return _root(*(stretch.scalar(expr, s) - level for s in (0.0, 1.0)))


def passing(stretch: Stretch, expr: Expression | Margin, level: Int) -> Float:
    """Return where the first half of a stretch that shows it passes a level, from 0 to 1.

    Anywhere in it where neither half does.
    """
    end = _searched(stretch, expr, level)
    value, slope = _with_slope(stretch, expr, end.here)
    known = dr.isfinite(slope) & (slope != 0.0)
    onward = end.here + (level - value) / dr.select(known, slope, 1.0)
    inside = known & (onward >= end.low) & (onward <= end.high)
    return dr.select(inside, onward, end.here)


def slope_at(stretch: Stretch, expr: Expression | Margin, place: Float) -> Float:
    """Return the derivative of an expression by the place, at one.

    Kinks and jumps have none: there it is that of a line through both ends.
    """
    _, slope = _with_slope(stretch, expr, stretch.context.real(place))
    chord = stretch.scalar(expr, 1.0) - stretch.scalar(expr, 0.0)
    return dr.select(dr.isfinite(slope) & (slope != 0.0), slope, chord)


def _searched(stretch: Stretch, expr: Expression | Margin, level: Int) -> _Search:
    """Return the search for a place near that at which a level is passed, at its end.

    Secants; an end that stays while the other comes nearer counts the less, the nearer that comes
    (Anderson & Björck 1973, *BIT* 13, 253).
    """
    first, middle, last = (x - level for x in stretch.nodes(expr))
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
        value = stretch.context.evaluate(expr, stretch.fields(here)) - level
        onward = (value < 0.0) == (state.below < 0.0)
        off = dr.abs(value) > close
        way = dr.select(onward, real(1.0), -1.0)
        again = way * state.side > 0.0
        side = dr.select(again & ~even, state.side + way, way)
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

    (end,) = dr.while_loop((start,), going_on, step, label="passage")
    return end


def _root(first: Float, last: Float) -> Float:
    """Return where a line passes zero that has these values at 0 and 1; between these."""
    way = first - last
    f = first / dr.select(way == 0.0, 1.0, way)
    f = dr.select(dr.isfinite(f), f, 0.5)
    return dr.select(f > 0.0, dr.select(f < 1.0, f, 1.0), 0.0)


def _with_slope(stretch: Stretch, expr: Expression | Margin, place: Float) -> tuple[Float, Float]:
    """Return an expression and its derivative by the place, where there is one."""
    context = stretch.context
    ops = TracedJetOps(context.real, context.kept_number)
    jets = {name: _jet(cubic, place) for name, cubic in stretch.cubics.items()}
    found = ops.number(expr.evaluate(ops, completed(ops, jets, context)))
    if found.first is None:
        return found.value.lo, 0.0 * place
    return found.value.lo, 0.5 * (found.first.lo + found.first.hi)


def _jet(cubic: Cubic, place: Float) -> TracedJet:
    slope = [k * c for k, c in enumerate(cubic)][1:]
    return TracedJet(*(TracedInterval.constant(horner(place, own)) for own in (cubic, slope)))


# By how much more closely fields are to be known where media jump, or look something up where they
# cross a level (`Medium.sensitivity`). On curvilinear grids 2.5 to 7 % of the pixels of white noise
# were beyond their error behind conditions and for densities that go with the slope; with 10 0.5 %,
# in 1 to 1.2 of the time.
SENSITIVITY = 10.0


@dataclass
class Level:
    """Where an expression passes a level, and the medium jumps or has a surface.

    Attributes
    ----------
    expr : Expression or Margin
        The expression.
    level : array
        The level, a number of a kernel.
    """

    expr: Expression | Margin
    level: Any


def edges_ahead(stretch: Stretch, edges: Sequence[Level]) -> tuple[Float, Float]:
    """Return how many edges are passed on a stretch, and where there may be more.

    As many as its ends and its middle show.
    """
    count, hidden = None, stretch.length < 0.0
    for edge in edges:
        possible, shown = passes(stretch, edge.expr, edge.level)
        hidden |= possible > shown
        count = shown if count is None else count + shown
    return count, hidden


def first_edge(stretch: Stretch, edges: Sequence[Level]) -> Float:
    """Return where the first of those edges is passed, from 0 to 1; 1 where none is."""
    found = type(stretch.length)(1.0)
    for own in _by_expression(edges):
        level, passed = _first_level(stretch, own)
        place = stretch.context.narrow(passing(stretch, own[0].expr, level))
        found = dr.select(passed & (place < found), place, found)
    return found


def _by_expression(edges: Sequence[Level]) -> list[list[Level]]:
    found: dict[str, list[Level]] = {}
    for edge in edges:
        found.setdefault(edge.expr.text, []).append(edge)
    return list(found.values())


def _first_level(stretch: Stretch, edges: Sequence[Level]) -> tuple[Float, Float]:
    """Return which level of one expression is passed first, and where one is.

    Between nodes that show all there is the scalar goes one way: the first level is the nearest. So
    there is one search, however many levels there are.
    """
    expr, level = edges[0].expr, edges[0].level
    first, middle, last = stretch.nodes(expr)
    passed, nearest = stretch.length < 0.0, first * 0.0
    for edge in edges:
        _, shown = passes(stretch, expr, edge.level)
        early = (first < edge.level) ^ (middle < edge.level)
        there = (shown > 0) & (early | ((middle < edge.level) ^ (last < edge.level)))
        late = dr.abs(middle - first) + dr.abs(edge.level - middle)
        way = dr.select(early, dr.abs(edge.level - first), late)
        here = there & (~passed | (way < nearest))
        level, nearest = dr.select(here, edge.level, level), dr.select(here, way, nearest)
        passed = passed | there
    return level, passed
