"""How often, and how far, a scalar passes a level along a stretch of ray."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..backend.functions import precision_of, unit_interval
from .turning import may_turn

if TYPE_CHECKING:
    from ..expressions import Expression, Margin
    from .stretch import Stretch

# What rounding may do to a value near a level, as a fraction of it.
NOISE = {"single": 2e-6, "double": 1e-14}


def passes(stretch: Stretch, expr: Expression | Margin, level: Any) -> tuple[Any, Any]:
    """Return how often an expression may pass a level on a stretch, and how often nodes show it.

    Once more than that where it may turn: smaller panels tell.
    """
    found, shown = stretch.turning(expr), _sign_changes(stretch.nodes(expr), level)
    possible = shown
    if not may_turn(expr, stretch.context):
        possible = _sign_changes(stretch.controls(expr), level)
    turns = (found.apart > 0.0) & (found.low <= level) & (found.high >= level)
    return dr.select(turns, shown + 1, possible), shown


def way_within(values: list[Any], level: Any, width: Any) -> Any:
    """Return how far a sequence goes up and down within a surface, in its widths."""
    ends = [unit_interval((x - level) / width + 0.5) for x in values]
    return sum((dr.abs(b - a) for a, b in pairwise(ends)), 0.0 * width)


def _sign_changes(values: list[Any], level: Any) -> Any:
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
