"""Surfaces of some width between two of their sides: means of samples.

Panels end where the scalar enters and leaves a surface (`Isosurface.edges`), so that one of them is
inside all along, or outside. There the density goes with the slope of the scalar, the polynomial
through five values; times what varies, that is at the five places of Lobatto's rule, which is exact
up to degree seven (Abramowitz & Stegun 1964, 25.4.32).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.functions import precision_of, unit_interval
from .contract import Coefficients
from .modulation import Factors
from .sampled import FIVE, WEIGHTS_OF_FIVE, Sampled
from .sampled_products import UNKNOWN, dot, unseen
from .stretch import extremes

if TYPE_CHECKING:
    from .context import Context
    from .isosurface import Isosurface
    from .stretch import Stretch

# Values at the five places to the slopes of their polynomial there.
_POWERS = np.vander(FIVE, increasing=True)
_SLOPES = (np.arange(len(FIVE)) * np.roll(_POWERS, 1, axis=1)) @ np.linalg.inv(_POWERS)
_WEIGHTS = np.array(WEIGHTS_OF_FIVE)
# A panel in which a scalar goes back by more than this part of a surface must be narrower.
_BACK = {"single": 1e-4, "double": 1e-9}
# With a change of less than this, in widths, a panel is in a surface if its middle is.
_LEVEL = 1e-5


def sampled(surface: Isosurface, stretch: Stretch, context: Context) -> Sampled:
    """Return the means of j and α over a stretch without edges; see `Medium.sampled`."""
    x = [stretch.scalar(surface.expr, s) for s in FIVE]
    ways = [context.narrow((v - x[0]) / surface.numbers(context).width) for v in x]
    dense, unsure = _density(surface, stretch, ways, context)
    shares = _shares(surface, x, ways, context)
    unsure &= extremes(shares)[1] > 0.0  # outside of all it may turn as it likes
    total, doubt = dot(_WEIGHTS, dense), unseen(dense)
    columns = []
    for values in _factors(surface, stretch, context):
        found = [a * b for a, b in zip(dense, values, strict=True)]
        low, high = extremes(values)
        # A crossing has as much as its ends tell of what is the same all along.
        share = high - low
        if surface.density == "gradient":
            share = extremes([dr.abs(low), dr.abs(high)])[1]
        wrong = UNKNOWN * dr.fma(unseen(values), total, doubt * share)
        off = dr.select(unsure, dr.inf, wrong)
        columns.append([dot(_WEIGHTS, found), found[0], found[-1], off])
    rows = (
        [Factors([s * v for v in paint], s * gate) for s in shares]
        for *paint, gate in zip(*columns, strict=True)
    )
    zero = stretch.length * 0.0
    result = Sampled(*(surface.in_colors(row, zero, context) for row in rows))
    result.off.emissivity = [dr.abs(j) for j in result.off.emissivity]
    return result


def _shares(surface: Isosurface, x: list[Any], ways: list[Any], context: Context) -> list[Any]:
    """Return what part of a stretch is in each surface.

    By how far its ends are in it: so what panels have of a surface adds up to all of it, though
    these end somewhat behind its sides.
    """
    own = surface.numbers(context)
    rise = dr.abs(ways[-1])
    flat, shares = rise < _LEVEL, []
    for level in own.levels:
        first, last = (unit_interval((v - level) / own.width + 0.5) for v in (x[0], x[-1]))
        inside = dr.select(dr.abs(x[2] - level) <= 0.5 * own.width, type(rise)(1.0), 0.0)
        part = context.narrow(dr.abs(last - first)) / dr.select(flat, 1.0, rise)
        # Not a quotient of what is rounding where a ray passes along a sheet.
        all_in = (first > 0.0) & (first < 1.0) & (last > 0.0) & (last < 1.0)
        shares.append(dr.select(all_in, 1.0, dr.select(flat, inside, part)))
    return shares


def roughly(surface: Isosurface, stretch: Stretch, context: Context) -> Sampled:
    """Return about how dense surfaces are on any stretch; what that is off by is not known."""
    own = surface.numbers(context)
    ends = [stretch.scalar(surface.expr, s) for s in (0.0, 1.0)]
    zero, per_length = stretch.length * 0.0, stretch.panel(0.0, 1.0).per_length
    extinction = [zero] * len(own.depths[0])
    for level, depths in zip(own.levels, own.depths, strict=True):
        first, last = (unit_interval((x - level) / own.width + 0.5) for x in ends)
        way = per_length * context.narrow(dr.abs(last - first))
        extinction = [t + d * way for t, d in zip(extinction, depths, strict=True)]
    nothing, unknown = (
        Coefficients([zero + v] * surface.channels, [zero + v] * len(extinction))
        for v in (0.0, dr.inf)
    )
    return Sampled(Coefficients(nothing.emissivity, extinction), nothing, nothing, unknown)


def _density(
    surface: Isosurface, stretch: Stretch, ways: list[Any], context: Context
) -> tuple[list[Any], Any]:
    """Return how much of a surface of depth one there is per length, and where that is unsure."""
    rises = [dot(row, ways) for row in _SLOPES]
    up, down = (
        dot(_WEIGHTS, [dr.select(way * r > 0.0, way * r, 0.0) for r in rises]) for way in (1, -1)
    )
    back = dr.select(up < down, up, down)
    unsure = (back > _BACK[precision_of(type(back))]) | ~dr.isfinite(ways[-1])
    per_length = stretch.panel(0.0, 1.0).per_length
    dense = [per_length * dr.abs(r) for r in rises]
    if surface.density == "gradient":
        width = surface.numbers(context).width
        for k, s in enumerate(FIVE):
            steep = context.narrow(surface.steepness(stretch.fields(s), context) / width)
            dense[k] = dr.select(steep > dense[k], steep, dense[k])
    return dense, unsure


def _factors(surface: Isosurface, stretch: Stretch, context: Context) -> list[list[Any]]:
    """Return what multiplies each channel's emission, and then extinction, at five places."""
    rows = []
    for s in FIVE:
        if surface.modulation.fixed:
            gate, paint = type(stretch.length)(1.0), []
        else:
            gate, *paint = surface.modulation.at_node(stretch, s, context)
        light = surface.lamp.light(stretch.fields(s), stretch, context)
        own = paint or [gate] * surface.channels
        rows.append([*(light * p for p in own), gate])
    return [list(column) for column in zip(*rows, strict=True)]
