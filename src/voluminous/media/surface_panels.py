"""Surfaces on a stretch of ray: where they show, and what panels may not show of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..backend.functions import precision_of
from ..expressions.analysis import Monotonicity
from .bends import bend
from .cores import core
from .crossings import NOISE, passes, way_within
from .front_light import extent_of
from .looked_up import LookedUp
from .stretch import extremes
from .turning import may_turn

if TYPE_CHECKING:
    from .context import Context
    from .isosurface import Isosurface
    from .stretch import Stretch

# Turns within a surface of some width that nodes do not show: what may be lost, in crossings and in
# optical depth, of the tolerance. A panel and its halves agree about them, so that no error tells.
_FOLD = 0.1
_MOST_FOLDED = 1e-4
# How many times the third difference of a function of the fields at their control points its cubic
# part is: on a line these are evenly spaced, and it is 27/6 of that; 1 for sums of fields.
_OF_FUNCTIONS = 4.5
# One over the width of what is thinner than all panels.
_THIN = 1e18


def visible(surface: Isosurface, stretch: Stretch, context: Context) -> tuple[Any, Any]:
    """Return where a level may be crossed, and where more often than a panel's ends show."""
    if _beyond(surface, stretch):
        nowhere = stretch.length < 0.0
        return nowhere, nowhere
    own = surface.numbers(context)
    nodes = stretch.nodes(surface.expr)
    seen = dr.isnan(nodes[1])  # where there is NaN, it must show
    hidden = stretch.length < 0.0
    for low, high in own.ranges:
        for edge in (low, high) if surface.thick else (low,):
            possible, shown = passes(stretch, surface.expr, edge)
            seen |= possible > 0
            hidden |= possible > shown
    if surface.thick:
        for level in own.levels:
            seen |= dr.abs(nodes[0] - level) <= 0.5 * own.width
            hidden |= _folded(surface, stretch, context, level)
    if not surface.thick:  # looked at where it is crossed, whatever is beside it
        return surface.modulation.open(stretch, seen), hidden
    hidden |= seen & surface.lamp.turns(stretch, context)
    if not surface.modulation.fixed:
        hidden |= _looked_up(surface, stretch, context).lost(surface.modulation, stretch, context)
    return surface.modulation.visible(stretch, context, seen, hidden)


def sharpness(surface: Isosurface, stretch: Stretch, context: Context) -> tuple[Any, Any]:
    """Return one: surfaces are thinner than all panels; crossings are counted exactly.

    In a surface of some width little is known of a density that goes with the gradient where the
    slope bends, and of light where the normal turns.
    """
    zero = stretch.length * 0.0
    if _beyond(surface, stretch):
        return zero, zero
    if not surface.thick:
        return zero + 1.0, zero
    off = surface.lamp.off(stretch, context)
    if surface.density == "gradient":
        off = extremes([off, *_bends(surface, stretch, context)])[1]
    lit = surface.shading > 0
    if lit or not surface.modulation.fixed:
        found = _looked_up(surface, stretch, context)
        off = off + found.error(surface.modulation, stretch, context)
        if lit:
            off = off + surface.lamp.across(stretch, context, found.extent, found.depth)
    return zero + 1.0, off


def cores(surface: Isosurface, stretch: Stretch, context: Context) -> list[Any]:
    """Return how many surfaces are crossed in each half."""
    if _beyond(surface, stretch):
        return [stretch.length * 0.0] * 2
    own = surface.numbers(context)
    nodes = stretch.nodes(surface.expr)
    varies = surface.thick and surface.modulation.color is not None
    counts = []
    for pair in (nodes[:2], nodes[1:]):
        low, high = extremes(pair)
        total = stretch.length * 0.0
        for first, last in own.ranges:
            there = (low <= last) & (high >= first)
            total += core(there, high - low > own.width, varies, total)
        counts.append(total)
    return counts


def _beyond(surface: Isosurface, stretch: Stretch) -> bool:
    """Return whether surfaces without width are at the ends of a stretch, and none is in it."""
    return surface.hollow and stretch.edgeless


def _folded(surface: Isosurface, stretch: Stretch, context: Context, level: Any) -> Any:
    """Return where it may go further up and down within a thick surface than nodes show."""
    expr, width = surface.expr, surface.numbers(context).width
    found = stretch.turning(expr)
    near = (found.low <= level + 0.5 * width) & (found.high >= level - 0.5 * width)
    noise = NOISE[precision_of(type(width))] * dr.abs(level) / width
    deep = _deepest(surface, context)
    few = min(_FOLD * context.tolerance, _MOST_FOLDED)
    least = context.keep(("folded", few), lambda: context.narrow_number(few))
    least = least / dr.select(deep > 1.0, deep, 1.0)
    hidden = near & (context.narrow(found.apart / width - noise) > least)
    if may_turn(expr, stretch.context):
        return hidden
    ways = [way_within(xs, level, width) for xs in (stretch.controls(expr), stretch.nodes(expr))]
    return hidden | (context.narrow(ways[0] - ways[1] - noise) > least)


def _deepest(surface: Isosurface, context: Context) -> Any:
    return extremes([d for row in surface.numbers(context).depths for d in row])[1]


def _bends(surface: Isosurface, stretch: Stretch, context: Context) -> list[Any]:
    own = surface.numbers(context)
    near = context.narrow(0.5 * own.width)
    names = ("r", *context.coordinates)
    more = _OF_FUNCTIONS if surface.expr.kind(names) > Monotonicity.SUM else 1.0
    return [
        more
        * bend(
            stretch,
            surface.expr,
            _THIN,
            lambda x, level=level: context.narrow(x - level),
            -near,
            near,
        )
        for level in own.levels
    ]


def _looked_up(surface: Isosurface, stretch: Stretch, context: Context) -> LookedUp:
    """Return surfaces of some width as shells: a colour varies within one, where it ends."""
    own = surface.numbers(context)
    nodes = [context.narrow(x) for x in stretch.nodes(surface.expr)]
    low, high = stretch.hull(surface.expr)
    ends = stretch.length < 0.0
    for edge in (edge for pair in own.ranges for edge in pair):
        ends |= (low <= edge) & (high >= edge)
    return LookedUp(
        expr=surface.expr,
        ranges=own.ranges,
        thin=1.0,
        extent=extent_of(nodes, context.narrow(own.width)),
        depth=dr.select(ends, _deepest(surface, context), 0.0),
    )
