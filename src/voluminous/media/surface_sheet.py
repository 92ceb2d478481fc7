"""Surfaces of some width on a panel of a ray: how much of each it has, and in which colours."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..backend.functions import unit_interval
from .bends import slope_factor
from .modulation import Factors, Middle
from .shape_middles import box_extent, box_middle

if TYPE_CHECKING:
    from .context import Context
    from .isosurface import Isosurface
    from .stretch import Panel


def part(surface: Isosurface, panel: Panel, context: Context, level: Any) -> Factors:
    """Return what a panel has of a surface, per length: seen through its gate, and lit."""
    width = surface.numbers(context).width
    ends = [x - level for x in panel.ends(surface.expr)]
    in_halves = [context.narrow(2.0 * x / width) for x in ends]
    middle = box_middle(*in_halves)
    first, last = (unit_interval(x / width + 0.5) for x in ends)
    dense = panel.per_length * context.narrow(dr.abs(last - first))
    if surface.density == "gradient":
        dense = _in_sheet(surface, panel, context, dense, box_extent(*in_halves), middle)
    light = surface.lamp.shade(panel, context, middle)
    if surface.modulation.fixed:
        return Factors([dense * light] * surface.channels, dense)
    factors = surface.modulation.factors(panel, context, middle)
    return Factors([f * dense * light for f in factors.emission], factors.gate * dense)


def _in_sheet(
    surface: Isosurface, panel: Panel, context: Context, dense: Any, inside: Any, middle: Middle
) -> Any:
    """Return how much of a sheet of the same thickness everywhere a panel has, per length.

    By the part of the panel that is `inside`: along the sheet nothing is crossed.
    """
    slope = surface.steepness(panel.fields(middle.place), context)
    # Not over the mean slope of the panel, but over that at the place.
    turned = slope_factor(panel, surface.expr, middle.place, context.narrow)
    found = inside * turned * context.narrow(slope / surface.numbers(context).width)
    return dr.select(found > dense, found, dense)
