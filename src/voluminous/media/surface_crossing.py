"""Surfaces without width on a panel of a ray: how dense each is where it is crossed, how bright.

All of that is looked up once on a stretch, where it passes the level (`passing`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..backend import dr
from .modulation import Factors, kept

if TYPE_CHECKING:
    from .context import Context
    from .isosurface import Isosurface
    from .stretch import Panel, Stretch


def part(surface: Isosurface, panel: Panel, context: Context, level: Any) -> Factors:
    """Return what a panel has of a surface, per length: seen through its gate, and lit."""
    first, last = (x < level for x in panel.ends(surface.expr))
    crossed = dr.select(first ^ last, panel.per_length, 0.0)
    if not surface.looks_inside:
        return Factors([crossed] * surface.channels, crossed)
    gate, *shown = kept(
        panel.stretch,
        (id(surface), id(level)),
        lambda: _where_crossed(surface, panel.stretch, context, level),
    )
    return Factors([crossed * f for f in shown], crossed * gate)


def _where_crossed(
    surface: Isosurface, stretch: Stretch, context: Context, level: Any
) -> list[Any]:
    """Return how dense a surface is where a stretch crosses it, and how bright each channel."""
    found = stretch.passing(surface.expr, level)
    fields = stretch.fields(found.place)
    dense = type(stretch.length)(1.0)
    if surface.density == "gradient":
        dense = _obliquity(surface, fields, stretch.length, found.slope, context)
    gate, *shown = surface.modulation.at_place(fields, context)
    light = surface.lamp.light(fields, stretch, context)
    return [gate * dense, *(f * dense * light for f in shown)]


def _obliquity(
    surface: Isosurface, fields: dict[str, Any], length: Any, slope: Any, context: Context
) -> Any:
    """Return |∇x| over |∂x/∂s|, at least one; `slope` is what x grows by per `length`."""
    scale = context.keep((id(surface), "scale"), lambda: context.number(context.scale))
    steepest = scale * length * context.evaluate(surface.slope, fields)
    along = dr.abs(slope)
    ratio = context.narrow(steepest / dr.select(along > 0.0, along, 1.0))
    return dr.select(ratio > 1.0, ratio, 1.0)
