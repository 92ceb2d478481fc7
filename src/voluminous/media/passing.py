"""Where along a stretch of ray a scalar passes a level, and how fast it does there.

What is found is the place on the interpolated fields themselves, to rounding: panels need only be
so narrow that each has one passage. Before, places on lines through panels' ends were compared with
those on halves: where a ray grazes a surface both were wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..backend.functions import horner
from ..expressions.traced_interval import TracedInterval
from ..expressions.traced_jet import TracedJet
from ..expressions.traced_jet_ops import TracedJetOps
from .course import completed

if TYPE_CHECKING:
    from ..expressions import Expression
    from .stretch import Cubic, Stretch

# Steps of the search: a parabola takes five, and a tenth root that starts at its pole ten.
_STEPS = 12
# Where it ends, as a part of the stretch: what is left Newton's step takes away.
_NEAR = 1e-4


@dataclass
class Passing:
    """Where a scalar passes a level.

    Attributes
    ----------
    place : array
        Where in the stretch, from 0 to 1.
    slope : array
        Its derivative there, by the place.
    """

    place: Any
    slope: Any


@dataclass
class _Bracket:
    """Two places between which a level is passed, and how far the scalar is from it there."""

    low: Any
    high: Any
    below: Any
    above: Any
    count: Any


def on_chord(stretch: Stretch, expr: Expression, level: Any) -> Passing:
    """Return where a line through both ends passes a level."""
    first, last = (stretch.scalar(expr, s) - level for s in (0.0, 1.0))
    return Passing(_root(first, last), last - first)


def on_fields(stretch: Stretch, expr: Expression, level: Any) -> Passing:
    """Return where the first half of a stretch that shows it passes a level.

    Anywhere in it where neither half does.
    """
    place = _found(stretch, expr, level)
    value, slope = _with_slope(stretch, expr, place)
    # Kinks and jumps have no slope: a line through what is near is all there is.
    known = dr.isfinite(slope) & (slope != 0.0)
    chord = stretch.scalar(expr, 1.0) - stretch.scalar(expr, 0.0)
    onward = (level - value) / dr.select(known, slope, 1.0)
    place = dr.select(known & (dr.abs(onward) < _NEAR), place + onward, place)
    return Passing(place, dr.select(known, slope, chord))


def _found(stretch: Stretch, expr: Expression, level: Any) -> Any:
    """Return a place near that at which a level is passed.

    By the Illinois method (Dowell & Jarratt 1971): secants, the end that stays counting half.
    """
    first, middle, last = (x - level for x in stretch.nodes(expr))
    early = (first < 0.0) ^ (middle < 0.0)
    real = type(first)
    start = _Bracket(
        low=dr.select(early, real(0.0), 0.5),
        high=dr.select(early, real(0.5), 1.0),
        below=dr.select(early, first, middle),
        above=dr.select(early, middle, last),
        count=dr.select((first < 0.0) ^ (last < 0.0) | early, real(0.0), _STEPS),
    )

    def going_on(state: _Bracket) -> Any:
        return (state.count < _STEPS) & (state.high - state.low > _NEAR)

    def step(state: _Bracket) -> tuple[_Bracket]:
        part = _root(state.below, state.above)
        # Not at an end: what is nearly passed there would be passed nowhere else.
        part = dr.clip(part, 0.5 * _NEAR, 1.0 - 0.5 * _NEAR)
        here = dr.fma(part, state.high - state.low, state.low)
        value = stretch.context.evaluate(expr, stretch.fields(here)) - level
        onward = (value < 0.0) == (state.below < 0.0)
        stayed = dr.select(onward, state.above, state.below)
        return (
            _Bracket(
                low=dr.select(onward, here, state.low),
                high=dr.select(onward, state.high, here),
                below=dr.select(onward, value, 0.5 * stayed),
                above=dr.select(onward, 0.5 * stayed, value),
                count=state.count + 1.0,
            ),
        )

    (end,) = dr.while_loop((start,), going_on, step, label="passage")
    return dr.fma(_root(end.below, end.above), end.high - end.low, end.low)


def _root(first: Any, last: Any) -> Any:
    """Return where a line passes zero that has these values at 0 and 1; between these."""
    way = first - last
    f = first / dr.select(way == 0.0, 1.0, way)
    f = dr.select(dr.isfinite(f), f, 0.5)
    return dr.select(f > 0.0, dr.select(f < 1.0, f, 1.0), 0.0)


def _with_slope(stretch: Stretch, expr: Expression, place: Any) -> tuple[Any, Any]:
    """Return an expression and its derivative by the place, where there is one."""
    context = stretch.context
    ops = TracedJetOps(context.real, context.kept_number)
    jets = {name: _jet(cubic, place) for name, cubic in stretch.cubics.items()}
    found = ops.number(expr.evaluate(ops, completed(ops, jets, context)))
    if found.first is None:
        return found.value.lo, 0.0 * place
    return found.value.lo, 0.5 * (found.first.lo + found.first.hi)


def _jet(cubic: Cubic, place: Any) -> TracedJet:
    """Return a polynomial and its slope at a place."""
    slope = [k * c for k, c in enumerate(cubic)][1:]
    return TracedJet(*(TracedInterval.constant(horner(place, own)) for own in (cubic, slope)))
