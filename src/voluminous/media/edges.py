"""Edges: places on a ray where a medium jumps, or where a surface without width is.

Where a gate opens inside of a panel no samples tell how much of it is on which side. Panels that
end at the place where the ray passes the edge (`passing`) have one medium each. Before, they were
halved down to 2^-14 of a segment: a shell behind a hard gate took five times the time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..backend import dr
from .crossings import passes
from .passing import passing

if TYPE_CHECKING:
    from ..expressions import Expression, Margin
    from .stretch import Stretch


# By how much more closely fields are to be known where media jump, or look something up where they
# cross a level (`Medium.sensitivity`). On curvilinear grids 2.5 to 7 % of the pixels of white noise
# were beyond their error behind conditions and for densities that go with the slope; with 10 0.5 %,
# in 1 to 1.2 of the time.
SENSITIVITY = 10.0


@dataclass
class Edge:
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


def edges_ahead(stretch: Stretch, edges: Sequence[Edge]) -> tuple[Any, Any]:
    """Return how many edges are passed on a stretch, and where there may be more.

    As many as its ends and its middle show.
    """
    count, hidden = None, stretch.length < 0.0
    for edge in edges:
        possible, shown = passes(stretch, edge.expr, edge.level)
        hidden |= possible > shown
        count = shown if count is None else count + shown
    return count, hidden


def first_edge(stretch: Stretch, edges: Sequence[Edge]) -> Any:
    """Return where the first of those edges is passed, from 0 to 1; 1 where none is."""
    found = type(stretch.length)(1.0)
    for own in _by_expression(edges):
        level, passed = _first_level(stretch, own)
        place = stretch.context.narrow(passing(stretch, own[0].expr, level))
        found = dr.select(passed & (place < found), place, found)
    return found


def _by_expression(edges: Sequence[Edge]) -> list[list[Edge]]:
    found: dict[str, list[Edge]] = {}
    for edge in edges:
        found.setdefault(edge.expr.text, []).append(edge)
    return list(found.values())


def _first_level(stretch: Stretch, edges: Sequence[Edge]) -> tuple[Any, Any]:
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
