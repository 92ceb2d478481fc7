"""Tables on a stretch of ray: where they show, and what panels may not show of them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..backend.functions import precision_of
from .bends import bend, thinness
from .cores import core
from .crossings import NOISE, passes
from .front_light import extent_of
from .looked_up import LookedUp
from .stretch import extremes
from .table_structure import jumps, structures, visible_range

if TYPE_CHECKING:
    from .context import Context
    from .stretch import Stretch
    from .table import Table

# Control points that stick out by this part of a structure's width call for smaller panels.
_DOUBT = 0.25
# What is left of that where x only just reaches what shows.
_REACHED = 2.0**-8
# A structure is a ramp up and one down.
_RAMPS = 2.0


@dataclass
class _Parts:
    """What a table shows, as numbers of a kernel.

    Attributes
    ----------
    first, last : array
        Between which x it may be noticeable.
    begin, end : array
        Between which x it varies.
    structures : list of three arrays
        Of each: by how much x may go unseen, and between which x it is; the narrowest first.
    jumps : list of arrays
        Where entries jump.
    """

    first: Any
    last: Any
    begin: Any
    end: Any
    structures: list[list[Any]]
    jumps: list[Any]


def visible(table: Table, stretch: Stretch, context: Context) -> tuple[Any, Any]:
    """Return where an entry may be noticeable, and where a panel's ends may not show that."""
    low, high = (context.narrow(x) for x in stretch.hull(table.expr))
    below, above = extremes([context.narrow(x) for x in stretch.nodes(table.expr)])
    parts = _parts(table, context, type(low))
    seen = ~((low > parts.last) | (high < parts.first))  # where there is NaN, it must show
    # Between log10 of nothing and a value there is all of the table, and ends show none of it.
    endless = dr.isinf(below) | dr.isinf(above)
    hidden = seen & endless & (high > parts.begin) & (low < parts.end)
    for doubt, begin, end in parts.structures:
        hidden |= (high > above + doubt) & (above < end) & (high > begin)
        hidden |= (low < below - doubt) & (below > begin) & (low < end)
        hidden |= (low < end) & (high > begin) & stretch.turns(table.expr, doubt)
    if parts.structures:
        hidden |= seen & _entered(table, parts, stretch)
        if not table.modulation.fixed:
            found = _looked_up(table, parts, stretch, context)
            hidden |= seen & found.lost(table.modulation, stretch, context)
    for edge in parts.jumps:
        # However little it goes beyond a jump, what is there counts.
        possible, shown = passes(stretch, table.expr, edge)
        hidden |= seen & (possible > shown)
    return table.modulation.visible(stretch, context, seen, hidden)


def sharpness(table: Table, stretch: Stretch, context: Context) -> tuple[Any, Any]:
    """Return how thin the narrowest structure is, and what bends of x may do to it."""
    real = type(context.narrow(stretch.scalar(table.expr, 0.0)))
    parts = _parts(table, context, real)
    if not parts.structures:  # the same everywhere
        return stretch.length * 0.0, stretch.length * 0.0
    narrowness = _DOUBT / parts.structures[0][0]
    off = bend(stretch, table.expr, narrowness, context.narrow, parts.first, parts.last)
    if not table.modulation.fixed:
        found = _looked_up(table, parts, stretch, context)
        off = off + found.error(table.modulation, stretch, context)
    return thinness(stretch, table.expr, narrowness, context.narrow), off


def cores(table: Table, stretch: Stretch, context: Context) -> list[Any]:
    """Return how many structures are in each half; of several classes of width the most."""
    nodes = [context.narrow(x) for x in stretch.nodes(table.expr)]
    parts = _parts(table, context, type(nodes[0]))
    counts = []
    for low, high in map(extremes, pairwise(nodes)):
        count = stretch.length * 0.0
        for doubt, first, last in parts.structures:
            narrow = _DOUBT * (high - low) > doubt
            own = core((low < last) & (high > first), narrow, not table.even, count)
            count = extremes([count, own])[1]
        counts.append(count)
    return counts


def _parts(table: Table, context: Context, real: Any) -> _Parts:
    def make() -> _Parts:
        nodes, shape = table.nodes(context), table.shape
        first, last = visible_range(nodes, shape, context.faint)
        found = structures(nodes, shape)
        return _Parts(
            dr.opaque(real, first),
            dr.opaque(real, last),
            dr.opaque(real, float(nodes[0])),
            dr.opaque(real, float(nodes[-1])),
            [[dr.opaque(real, v) for v in (_DOUBT * w, low, high)] for w, low, high in found],
            [context.number(x) for x in jumps(nodes, shape)],
        )

    return context.keep((id(table), "parts"), make)


def _entered(table: Table, parts: _Parts, stretch: Stretch) -> Any:
    """Return where x reaches what shows, and no end does: of an opaque table little is much."""
    low, high = stretch.hull(table.expr)
    below, above = extremes(stretch.nodes(table.expr))
    noise = NOISE[precision_of(type(low))] * extremes([dr.abs(low), dr.abs(high)])[1]
    least = _REACHED * parts.structures[0][0] + noise
    return ((above <= parts.first) & (high > parts.first + least)) | (
        (below >= parts.last) & (low < parts.last - least)
    )


def _looked_up(table: Table, parts: _Parts, stretch: Stretch, context: Context) -> LookedUp:
    """Return the narrowest structure as a shell in which colours and a gate are looked up."""
    doubt, low, high = parts.structures[0]
    narrowness = _DOUBT / doubt
    extent = extent_of([context.narrow(x) for x in stretch.nodes(table.expr)], _RAMPS / narrowness)
    way = 0.5 * stretch.length * dr.select(extent < 1.0, extent, 1.0)
    return LookedUp(
        expr=table.expr,
        ranges=[(low, high)],
        thin=thinness(stretch, table.expr, narrowness, context.narrow),
        extent=extent,
        depth=extremes(table.heights(context)[table.channels :])[1] * way,
    )
