"""Expressions that may turn within a stretch of ray: between which values they stay there.

What grows or falls with a sum of fields is between its values at the fields' Bézier control points.
Of all others intervals of the value and of its derivatives tell: where the slope has one sign both
ends say everything, elsewhere nothing is farther from the chord than the bow lets it be. As
`media.course`, in the precision of the picture, for schemes that estimate errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..expressions import Expression, Margin
from ..expressions.analysis import Monotonicity
from ..expressions.taylor import Derivative, TracedJet, TracedJetOps
from ..expressions.traced_interval import TracedInterval, extremes
from ..expressions.traced_interval_ops import TracedIntervalOps
from ..expressions.traced_rounding import larger, smaller
from .course import completed

if TYPE_CHECKING:
    from .context import Context
    from .stretch import Stretch

# Intervals tell something of a stretch if they tell of one place so much more.
_LESS = 0.25
# Of powers of a place it is 0.5 for squares, 0.75 for cubes and nearly one for large ones.
_LOPSIDED = 0.85


@dataclass
class Turning:
    """Where an expression is on a stretch.

    Attributes
    ----------
    low, high : array
        The least and the greatest value it may have; infinite where it is undefined in parts.
    apart : array
        How far it may be from a line through its ends; zero where its slope has one sign, since
        then both ends show what is between them, unless nearly all of that is in one half.
    slope, bend : array
        Bounds of its first and second derivative by the place.
    """

    low: Any
    high: Any
    apart: Any
    slope: Any
    bend: Any


def may_turn(expr: Expression | Margin, context: Context) -> bool:
    """Return whether control points of the fields do not enclose an expression."""
    return _kind(expr, context) == Monotonicity.ANY


def enclosed(stretch: Stretch, expr: Expression | Margin) -> Turning:
    """Return where an expression is on a stretch."""
    if not may_turn(expr, stretch.context):
        return _by_controls(stretch, expr)
    return _by_ranges(stretch, expr) if stretch.rough else _by_derivatives(stretch, expr)


def is_cubic(expr: Expression | Margin, context: Context) -> bool:
    """Return whether an expression is a cubic along a stretch, as fields are."""
    return _kind(expr, context) <= Monotonicity.SUM


def _kind(expr: Expression | Margin, context: Context) -> Monotonicity:
    return expr.kind(("r", *context.coordinates))


def _by_controls(stretch: Stretch, expr: Expression | Margin) -> Turning:
    controls = stretch.controls(expr)
    low, high = extremes(controls)
    apart = stretch.length * 0.0
    if _kind(expr, stretch.context) == Monotonicity.MONOTONIC:
        partly = _partly([dr.isnan(b) for b in controls])
        low, high = dr.select(partly, -dr.inf, low), dr.select(partly, dr.inf, high)
        apart = dr.select(partly, dr.inf, apart if stretch.rough else _lopsided(stretch, expr))
    return Turning(low, high, apart, *_of_cubic(controls))


def _partly(missing: list[Any]) -> Any:
    """Return where some of several values are undefined: between them may be anything."""
    every, some = missing[0], missing[0]
    for one in missing[1:]:
        every, some = every & one, some | one
    return some & ~every


def _by_ranges(stretch: Stretch, expr: Expression | Margin) -> Turning:
    """Return where any expression is, from the ranges of fields alone: a third of the work.

    What has no waves, kinks or jumps goes about as a cubic through its values does, unless it may
    go further.
    """
    found = within(stretch, expr)
    low, high = _seen_if_undecided(stretch, expr, found.lo, found.hi, found.hi - found.lo)
    apart = high - low
    slope, bend = _of_cubic(stretch.controls(expr))
    slope = larger(slope, apart)
    if not expr.smooth:
        slope = bend = apart + dr.inf
    return Turning(low, high, apart, slope, bend)


def _of_cubic(controls: list[Any]) -> tuple[Any, Any]:
    """Return bounds of the first two derivatives of a cubic with these control points.

    Differences of them bound the second (Farin 2002, section 5.3), and half of that is how far the
    first departs from its mean.
    """
    b0, b1, b2, b3 = controls
    rise, middle, last = b1 - b0, b2 - b1, b3 - b2
    start, end = middle - rise, last - middle
    bend = 3.0 * (dr.abs(start + end) + dr.abs(end - start))
    return dr.fma(bend, 0.5, dr.abs(b3 - b0)), bend


def _by_derivatives(stretch: Stretch, expr: Expression | Margin) -> Turning:
    """Return where any expression is, from intervals of its value and its derivatives."""
    found = _derived(stretch, expr)
    first, last = stretch.scalar(expr, 0.0), stretch.scalar(expr, 1.0)
    slope, bow = _interval(found.first, first), _interval(found.second, first).size
    least, largest = extremes([first, last])
    value = found.value
    sag = 0.125 * bow
    low, high = larger(value.lo, least - sag), smaller(value.hi, largest + sag)
    one_way = ((slope.lo >= 0.0) | (slope.hi <= 0.0)) & ~value.nan
    low, high = dr.select(one_way, least, low), dr.select(one_way, largest, high)
    # Where a part of it is undefined the rest may be anything; where all of it is, nothing shows.
    nowhere = dr.isnan(first) & dr.isnan(stretch.scalar(expr, 0.5)) & dr.isnan(last)
    partly = value.nan & ~nowhere
    low, high = dr.select(partly, -dr.inf, low), dr.select(partly, dr.inf, high)
    low, high = _seen_if_undecided(stretch, expr, low, high, value.hi - value.lo)
    apart = dr.select(one_way, _lopsided(stretch, expr), smaller(sag, high - low))
    return Turning(low, high, apart, slope.size, bow)


def spread(stretch: Stretch, expr: Expression) -> tuple[Any, Any, Any]:
    """Return how far an expression may go on a stretch, and bounds of its first two derivatives.

    All may be infinite: the second is at kinks, the first at jumps.
    """
    found, zero = _derived(stretch, expr), stretch.length
    slope, bow = (_interval(d, zero).size for d in (found.first, found.second))
    return found.value.hi - found.value.lo, slope, bow


def _derived(stretch: Stretch, expr: Expression | Margin) -> TracedJet:
    context = stretch.context
    ops = TracedJetOps(context.real, context.kept_number)
    jets = {name: _jet(stretch.field_points(name)) for name in stretch.cubics}
    return ops.number(expr.evaluate(ops, completed(ops, jets, context)))


def within(stretch: Stretch, expr: Expression | Margin) -> TracedInterval:
    """Return all values that an expression has while fields are between their control points.

    Wider than where it is (`enclosed`), in a third of the time.
    """
    ranges = {name: TracedInterval(*ends) for name, ends in stretch.ranges().items()}
    return _in_box(stretch, expr, ranges)


def at_places(stretch: Stretch, expr: Expression | Margin) -> list[TracedInterval]:
    """Return what intervals tell of both ends and the middle, each by itself."""
    return [
        _in_box(stretch, expr, {name: TracedInterval(value) for name, value in place.items()})
        for place in stretch.places()
    ]


def _in_box(stretch: Stretch, expr: Expression | Margin, fields: dict[str, Any]) -> TracedInterval:
    """Return all values that an expression has while fields are in intervals."""
    context = stretch.context
    ops = TracedIntervalOps(context.real, context.kept_number)
    found: TracedInterval = ops.number(expr.evaluate(ops, completed(ops, fields, context)))
    return found


def _lopsided(stretch: Stretch, expr: Expression | Margin) -> Any:
    """Return how far an expression is from its chord where most of its way is in one half.

    Beside a vacuum ``temperature/density`` rises to nearly infinite in the last part of a cell: a
    line through places on it passes shells in no time, and panels and halves agree about nothing.
    """
    first, middle, last = stretch.nodes(expr)
    off = dr.abs(first - 2.0 * middle + last)
    return dr.select(off > _LOPSIDED * dr.abs(last - first), 0.5 * off, 0.0)


def undecided(stretch: Stretch, expr: Expression | Margin, width: Any) -> Any:
    """Return where intervals say as little of single places as of all: of 1/n where n is zero.

    Nothing is learned from narrower panels there: in a vacuum these were all as narrow as can be,
    and a picture of 64 x 64 pixels took 20 to 40 s. At both ends and in the middle: beside a vacuum
    one of them tells more.

    Parameters
    ----------
    width : array
        How far the expression may go on the stretch, by intervals.
    """
    if not expr.partial:
        return stretch.length < 0.0
    vain = width > 0.0
    for found in at_places(stretch, expr):
        vain &= ~(found.hi - found.lo < _LESS * width)
    return vain


def _seen_if_undecided(
    stretch: Stretch, expr: Expression | Margin, low: Any, high: Any, width: Any
) -> tuple[Any, Any]:
    """Return ends of a range; where intervals tell nothing, those of what is seen."""
    least, largest = extremes(stretch.nodes(expr))
    vain = undecided(stretch, expr, width)
    return dr.select(vain, least, low), dr.select(vain, largest, high)


def _jet(points: list[Any]) -> TracedJet:
    """Return a cubic and its derivatives, from its control points (Farin 2002, section 5.3)."""
    rises = [3.0 * (b - a) for a, b in pairwise(points)]
    bends = [2.0 * (b - a) for a, b in pairwise(rises)]
    return TracedJet(*(TracedInterval(*extremes(v)) for v in (points, rises, bends)))


def _interval(derivative: Derivative, like: Any) -> TracedInterval:
    if derivative is None:
        return TracedInterval.constant(like * 0.0)
    return derivative.unknown_where(derivative.nan, False)
