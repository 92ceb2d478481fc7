"""Surfaces without width: how dense each is where a ray crosses it, and how bright."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from ..backend import dr
from .modulation import Factors, kept
from .passing import on_chord, slope_at

if TYPE_CHECKING:
    from .context import Context
    from .isosurface import Isosurface
    from .stretch import Panel, Stretch


def part(surface: Isosurface, panel: Panel, context: Context, level: Any) -> Factors:
    """Return what a panel has of a surface, per length: seen through its gate, and lit.

    All of it where a line through the panel's ends passes the level.
    """
    stretch = panel.stretch
    crossed = dr.select(_between(panel.ends(surface.expr), level), panel.per_length, 0.0)
    if not surface.looks_inside:
        return Factors([crossed] * surface.channels, crossed)

    def make() -> list[Any]:
        place = on_chord(stretch, surface.expr, level)
        slope = stretch.scalar(surface.expr, 1.0) - stretch.scalar(surface.expr, 0.0)
        return _looked_up(surface, stretch, stretch.fields(place), slope, context)

    return _times(crossed, kept(stretch, (id(surface), id(level)), make))


def layers(surface: Isosurface, stretch: Stretch, context: Context, place: Any) -> list[Factors]:
    """Return what is seen of each surface that is crossed on a stretch, which is at a place."""
    one = type(stretch.length)(1.0)
    ends = [stretch.scalar(surface.expr, s) for s in (0.0, 1.0)]
    levels = surface.numbers(context).levels
    crossed = [dr.select(_between(ends, level), one, 0.0) for level in levels]
    if not surface.looks_inside:
        return [Factors([c] * surface.channels, c) for c in crossed]
    slope = slope_at(stretch, surface.expr, place) if surface.density == "gradient" else one
    shown = _looked_up(surface, stretch, stretch.fields(place), slope, context)
    return [_times(c, shown) for c in crossed]


def _between(ends: Iterable[Any], level: Any) -> Any:
    first, last = (x < level for x in ends)
    return first ^ last


def _times(crossed: Any, shown: list[Any]) -> Factors:
    gate, *paint = shown
    return Factors([crossed * f for f in paint], crossed * gate)


def _looked_up(
    surface: Isosurface, stretch: Stretch, fields: dict[str, Any], slope: Any, context: Context
) -> list[Any]:
    """Return how dense a surface is at a place with these fields, and how bright each channel.

    `slope` is what the scalar grows by there, per length of the stretch.
    """
    dense = type(stretch.length)(1.0)
    if surface.density == "gradient":
        dense = _obliquity(surface, fields, stretch.length, slope, context)
    gate, *shown = surface.modulation.at_place(fields, context)
    light = surface.lamp.light(fields, stretch, context)
    return [gate * dense, *(f * dense * light for f in shown)]


def _obliquity(
    surface: Isosurface, fields: dict[str, Any], length: Any, slope: Any, context: Context
) -> Any:
    """Return |∇x| over |∂x/∂s|, at least one; `slope` is what x grows by per `length`."""
    steepest = length * surface.steepness(fields, context)
    along = dr.abs(slope)
    ratio = context.narrow(steepest / dr.select(along > 0.0, along, 1.0))
    return dr.select(ratio > 1.0, ratio, 1.0)
