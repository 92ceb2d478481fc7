"""Where along a stretch of ray a scalar passes a level, and how fast it does there.

What is found is the place on the interpolated fields themselves, to rounding: panels need only be
so narrow that each has one passage. Before, places on lines through panels' ends were compared with
those on halves: where a ray grazes a surface both were wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..backend.functions import horner, precision_of
from ..expressions.taylor import TracedJet, TracedJetOps
from ..expressions.traced_interval import TracedInterval
from .course import completed

if TYPE_CHECKING:
    from ..expressions import Expression, Margin
    from .stretch import Cubic, Stretch

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

    low: Any
    high: Any
    below: Any
    above: Any
    here: Any
    value: Any
    side: Any
    leaving: Any
    arriving: Any
    count: Any


def on_chord(stretch: Stretch, expr: Expression, level: Any) -> Any:
    """Return where a line through both ends passes a level, from 0 to 1."""
    return _root(*(stretch.scalar(expr, s) - level for s in (0.0, 1.0)))


def passing(stretch: Stretch, expr: Expression | Margin, level: Any) -> Any:
    """Return where the first half of a stretch that shows it passes a level, from 0 to 1.

    Anywhere in it where neither half does.
    """
    end = _searched(stretch, expr, level)
    value, slope = _with_slope(stretch, expr, end.here)
    known = dr.isfinite(slope) & (slope != 0.0)
    onward = end.here + (level - value) / dr.select(known, slope, 1.0)
    inside = known & (onward >= end.low) & (onward <= end.high)
    return dr.select(inside, onward, end.here)


def slope_at(stretch: Stretch, expr: Expression | Margin, place: Any) -> Any:
    """Return the derivative of an expression by the place, at one.

    Kinks and jumps have none: there it is that of a line through both ends.
    """
    _, slope = _with_slope(stretch, expr, stretch.context.real(place))
    chord = stretch.scalar(expr, 1.0) - stretch.scalar(expr, 0.0)
    return dr.select(dr.isfinite(slope) & (slope != 0.0), slope, chord)


def _searched(stretch: Stretch, expr: Expression | Margin, level: Any) -> _Search:
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


def _root(first: Any, last: Any) -> Any:
    """Return where a line passes zero that has these values at 0 and 1; between these."""
    way = first - last
    f = first / dr.select(way == 0.0, 1.0, way)
    f = dr.select(dr.isfinite(f), f, 0.5)
    return dr.select(f > 0.0, dr.select(f < 1.0, f, 1.0), 0.0)


def _with_slope(stretch: Stretch, expr: Expression | Margin, place: Any) -> tuple[Any, Any]:
    """Return an expression and its derivative by the place, where there is one."""
    context = stretch.context
    ops = TracedJetOps(context.real, context.kept_number)
    jets = {name: _jet(cubic, place) for name, cubic in stretch.cubics.items()}
    found = ops.number(expr.evaluate(ops, completed(ops, jets, context)))
    if found.first is None:
        return found.value.lo, 0.0 * place
    return found.value.lo, 0.5 * (found.first.lo + found.first.hi)


def _jet(cubic: Cubic, place: Any) -> TracedJet:
    slope = [k * c for k, c in enumerate(cubic)][1:]
    return TracedJet(*(TracedInterval.constant(horner(place, own)) for own in (cubic, slope)))
