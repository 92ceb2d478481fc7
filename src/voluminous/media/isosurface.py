"""Isosurfaces: a crossing shows the same colour for every gradient of the field.

A shell of fixed extent in the scalar x is thick where x varies slowly, and so brighter there.
Weighted by how fast x varies, emissivity and extinction are

    j = τ₁ color |∂x/∂s| K(x),    α = τ₁ |∂x/∂s| K(x),    ∫ K dx = 1,    τ₁ = -ln(1 - opacity),

so a ray that crosses the level once gathers τ₁, hence color · opacity, and lets 1 - opacity
through: the same at every angle and for every gradient. With |∇x| in place of |∂x/∂s| the surface
is a sheet of constant thickness, and looks denser where it is seen edge-on.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.functions import unit_interval
from ..backend.types import Float, Mask
from ..errors import InputError, check_name
from ..expressions import Expression
from ..expressions.interval import Interval
from ..expressions.traced_interval import TracedInterval
from .arguments import (
    depth_of,
    fraction,
    given_levels,
    given_opacities,
    named,
    plain_number,
    plain_opacities,
    scalar,
)
from .bound import Binding, BoundMedium
from .context import Context, Feature, Halves, MediumSample
from .contract import Medium
from .details import Colors
from .jumps import SENSITIVITY, Jump, on_chord, passes, slope_at
from .modulation import Factors, Modulation, modulated_colors
from .panel import Panel, extremes, kept, noise_of
from .quadrature import doubled
from .rectangle import box_extent, box_middle
from .shading import Lamp, given_lights, given_shade

if TYPE_CHECKING:
    from ..bounds.enclosure import EnclosedPanel, EnclosureContext, PanelBounds

# A scalar is taken as quadratic only where its slope changes by less than this over a panel.
_MOST_CHANGE = 0.5
# Allowed unresolved extrema of the scalar inside a surface of finite width, in crossings and in
# optical depth, as a fraction of the tolerance; step doubling cannot detect them.
_FOLD = 0.1
_MOST_FOLDED = 1e-4


class Isosurface(Medium):
    """Surfaces where a scalar has given values.

    Parameters
    ----------
    expr : str
        Expression x of the fields.
    level : float, Quantity or sequence of them
        The value of x on the surface, or one for each of several surfaces.
    color : sequence of float, sequence of sequences, str or ColorBy
        Colour of one crossing if it is opaque: one value per channel; for several levels one such
        row for each (or its name), or the name of a matplotlib colormap. A name that is both means
        a colour for one level, and a colormap for several.
    opacity : float, sequence of float or sequence of sequences
        Part of the light from behind that a crossing takes away: one number (grey) or one per
        channel; for several levels one number for all of them, or one for each, or one row of
        channels for each.
    width : float or Quantity
        Extent of the shell in x. 0: a surface without thickness, its crossings counted exactly.
    density : {"crossing", "gradient"}
        Extinction proportional to ``|∂x/∂s|`` along the ray, so that a crossing is equally dense
        at every angle; or to ``|∇x|``, a sheet of the same thickness everywhere, denser edge-on.
    shading : float
        0: none, as in radiative transfer. 1: emission proportional to the cosine between the ray
        and the normal (Lambert's law for a headlight); in between, a mixture.
    lights : list, optional
        As in `Gaussian`: a light at the camera by default.
    where : str, optional
        Only where this expression holds; a number from 0 to 1 makes a soft gate.

    Raises
    ------
    InputError
        If numbers do not fit each other, or are out of range.

    Notes
    -----
    One crossing gives ``color · opacity`` and the transparency ``1 - opacity``.
    """

    modulation: Modulation

    def __init__(
        self,
        expr: Any,
        level: Any = None,
        color: Any = (1.0, 1.0, 1.0),
        opacity: Any = 0.3,
        width: Any = 0.0,
        *,
        density: str = "crossing",
        shading: float = 0.0,
        lights: Any = None,
        where: Any = None,
    ) -> None:
        self.expr = Expression(expr)
        self.levels = given_levels(level)
        self.colors, self.modulation = modulated_colors(color, where, len(self.levels))
        self.opacities = given_opacities(opacity, len(self.levels), len(self.colors[0]))
        self.width = scalar(width, "width")
        if plain_number(self.width) < 0:
            raise InputError(f"width must not be negative, got {width}")
        self.thick = plain_number(self.width) > 0
        check_name("density", density, ("crossing", "gradient"))
        self.density, self.shading = density, fraction(shading, "shading")
        self.lights = given_lights(lights)
        self.shade = given_shade(self.expr, shading, lights)
        self.channels, self.grey = len(self.colors[0]), len(self.opacities[0]) == 1
        self.slope = Expression(f"gradmag({self.expr.text})")
        self.normal = tuple(Expression(f"grad({self.expr.text}).{a}") for a in "xyz")
        slope = [self.slope] if density == "gradient" else []
        self._directions = (*slope, *(self.normal if self.shading > 0 else ()))
        self.lamp = Lamp(self.normal, self.shading, self.lights)
        self.names = self.used_names()
        self.sensitivity = SENSITIVITY if self._directions else self.modulation.sensitivity

    @property
    def level(self) -> Any:
        """The level, or a tuple of several."""
        return self.levels if len(self.levels) > 1 else self.levels[0]

    @property
    def color(self) -> tuple[Any, ...]:
        """The colour of one level, or a tuple of those of several."""
        return self.colors if len(self.levels) > 1 else self.colors[0]

    @property
    def opacity(self) -> Any:
        """The opacity: one number, or as many as needed per channel and level."""
        return plain_opacities(self.opacities)

    @property
    def surface_only(self) -> bool:
        return not self.thick

    @property
    def constant_source_function(self) -> bool:
        return len(self.levels) == 1 and self.modulation.color is None and not self.shading

    def features(self) -> tuple[Feature, ...]:
        others = map(Feature, self._directions)
        opacities = tuple(map(max, self.opacities))
        surfaces = Colors(self.levels, self.colors, 0.5 * self.width, opacities)
        scalar_feature = Feature(self.expr, self.width, scalar=True, colors=surfaces)
        return (scalar_feature, *others, *self.modulation.features())

    def peak(self) -> tuple[float, float, float]:
        colors = [h for row in self.colors for h in row]
        return min(colors), max(colors), max(max(row) for row in self.opacities)

    def bind(self, binding: Binding) -> BoundSurfaces:
        return BoundSurfaces(self, binding)

    def visible_key(self) -> Any:
        numbers = map(named, (*self.levels, self.width))
        return ("Isosurface", self.expr.text, *numbers, self.modulation.gate_key())

    def scaled(self, factor: float) -> Isosurface:
        """Return it with a multiple of the optical depth of a crossing, -ln(1 - opacity)."""
        return self.replace(opacity=(1.0 - (1.0 - np.asarray(self.opacity)) ** factor).tolist())

    def key(self) -> Any:
        look = (self.colors, self.opacities, self.density, self.shading, self.lights)
        return (*self.visible_key(), *look, self.modulation.key())

    def used_names(self) -> tuple[str, ...]:
        used = [name for e in (self.expr, *self._directions) for name in e.names]
        used += self.slope.names if self.thick else ()
        used += self.shade.names if self.shade is not None else ()
        used += self.modulation.names
        return tuple(dict.fromkeys(used))


@dataclass
class SurfaceNumbers:
    """Kernel constants: level, optical depths and colour of each surface, and the common width."""

    levels: list[Float]
    width: Float
    depths: list[list[Float]]
    colors: list[list[Float]]

    @property
    def ranges(self) -> list[tuple[Float, Float]]:
        """(low, high) of the scalar in each surface."""
        return [(level - 0.5 * self.width, level + 0.5 * self.width) for level in self.levels]


class BoundSurfaces(BoundMedium):
    """The numbers of an `Isosurface`: levels and width in the unit of x."""

    def __init__(self, medium: Isosurface, binding: Binding) -> None:
        self.expr, self.slope, self.thick = medium.expr, medium.slope, medium.thick
        self.lamp, self.shade = medium.lamp, medium.shade
        self.gradient = medium.density == "gradient"
        self.modulation = medium.modulation.bind(binding)
        self.levels = [binding.number(level, self.expr, "level") for level in medium.levels]
        self.width = binding.number(medium.width, self.expr, "width")
        self.length, self._part = binding.length, binding.part
        self.colors = [binding.in_units(row) for row in medium.colors]
        self.depths = [[depth_of(o) for o in binding.some(row)] for row in medium.opacities]
        self._looks_inside = medium.looks_inside
        self._varies = bool(medium._directions) or not self.modulation.even

    def numbers(self, context: Context) -> SurfaceNumbers:
        """Return levels, width, optical depths and colours as kernel constants."""

        def make() -> SurfaceNumbers:
            narrow = context.narrow_number
            return SurfaceNumbers(
                levels=[context.number(level) for level in self.levels],
                width=context.number(self.width),
                depths=[[narrow(depth) for depth in row] for row in self.depths],
                colors=[[narrow(h) for h in row] for row in self.colors],
            )

        return context.keep((self._part, "numbers"), make)

    @property
    def channels(self) -> int:
        return self.modulation.channels

    # --- at places ------------------------------------------------------------------------------

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        """Return j and α per unit length with |∇x| instead of the unknown slope along the ray."""
        number, ops = context.number, context.ops
        if context.on_rays or (context.encloses and not self.thick):
            most = np.where(self.may_show(fields, context), np.inf, 0.0)
            return MediumSample(
                [Interval(-most, most)] * self.channels, [Interval(0.0, most)] * len(self.depths[0])
            )
        if not self.thick:  # no cell's centre is likely to lie on a surface
            raise InputError(
                "an Isosurface of width 0 is drawn with scheme='post-classified'; other schemes "
                "need a width (in the units of its expression)"
            )
        x, slope = context.evaluate(self.expr, fields), context.evaluate(self.slope, fields)
        emission: list[Any] = [0.0 * x] * self.channels
        extinction: list[Any] = [0.0 * x] * len(self.depths[0])
        for level, color, row in zip(self.levels, self.colors, self.depths, strict=True):
            depths = [number(depth) for depth in row]
            inside = ops.number(abs(x - number(level)) <= number(0.5 * self.width))
            dense = number(self.length / self.width) * slope * inside
            extinction = [t + d * dense for t, d in zip(extinction, depths, strict=True)]
            for c, h in enumerate(color):
                depth = depths[c if len(depths) > 1 else 0]
                emission[c] = emission[c] + number(h) * depth * dense
        if self.shade is not None:
            light = self.shade.factor(fields, context)
            emission = [j * light for j in emission]
        return self.modulation.coefficients(MediumSample(emission, extinction), fields, context)

    def may_show(self, ranges: dict[str, Interval], context: Context) -> Mask:
        x, half = context.evaluate(self.expr, ranges), 0.5 * self.width
        seen = x.nan
        for level in self.levels:
            seen = seen | ((x.lo <= level + half) & (x.hi >= level - half))
        return seen & self.modulation.may_show(ranges, context)

    def jumps(self) -> list[Jump]:
        """Return surfaces without width; else the sides of those in which colour or density varies.

        The amounts of the others are exact.
        """
        if not self.thick:
            return [Jump(self.expr, level) for level in self.levels]
        half = 0.5 * self.width
        sides = [x for level in self.levels for x in (level - half, level + half)]
        walls = [Jump(self.expr, x) for x in sides] if self._varies else []
        return [*walls, *self.modulation.jumps()]

    def panel_bounds(self, panel: EnclosedPanel, context: EnclosureContext) -> list[PanelBounds]:
        number, plain = context.number, context.plain
        enclosure = panel.enclosure(self.expr)
        light = self.lamp.panel_light(panel, context)
        lights = [light] * self.channels
        if self.modulation.paint is not None:
            paint, _ = self.modulation.paint.panel_colors(panel, context)
            lights = [light * c for c in paint]
        found = []
        for level, color, row in zip(self.levels, self.colors, self.depths, strict=True):
            place, extent = plain(level), plain(self.width)
            crossed, densest = (
                enclosure.layer(place, extent) if self.thick else enclosure.crossings(place)
            )
            if self.gradient:
                steep = panel.enclosure(self.slope).values * panel.length
                crossed = enclosure.oblique(steep, crossed)
                if self.thick:
                    crossed, densest = enclosure.sheet(place, extent, steep, crossed)
            if self.modulation.where is not None:  # both are zero where the gate is closed
                gate = self.modulation.gate(panel.fields, context)
                most, densest = (dr.select(gate.hi > 0.0, v, 0.0) for v in (crossed.hi, densest))
                crossed = TracedInterval(gate.lo * crossed.lo, most)
            anywhere = TracedInterval(type(densest)(0), densest)
            # An amount may be infinite, times a depth of zero.
            extinction, depth = (
                [number(o) * amount if o else number(0.0) for o in row]
                for amount in (anywhere, crossed)
            )
            source = [number(h) * shown for h, shown in zip(color, lights, strict=True)]
            emissivity, emitted = (
                [h * amounts[c if len(amounts) > 1 else 0] for c, h in enumerate(source)]
                for amounts in (extinction, depth)
            )
            found.append(panel.amounts(emissivity, extinction, emitted, depth, source))
        return found

    # --- on panels ------------------------------------------------------------------------------

    def mean(self, panel: Panel) -> MediumSample:
        zero = type(panel.length)(0)
        if self._is_outside(panel):
            return self.in_colors([], zero, panel.context)
        part = self._part_of_shell if self.thick else self._part_at_crossing
        levels = self.numbers(panel.context).levels
        return self.in_colors([part(panel, level) for level in levels], zero, panel.context)

    def sheet(self, panel: Panel, place: Float) -> MediumSample | None:
        if self.thick:
            return None
        one, context = type(panel.length)(1.0), panel.context
        ends = [panel.scalar(self.expr, s) for s in (0.0, 1.0)]
        levels = self.numbers(context).levels
        crossed = [dr.select(_between(ends, level), one, 0.0) for level in levels]
        shown = [one] * (self.channels + 1)
        if self._looks_inside:
            slope = slope_at(panel, self.expr, place) if self.gradient else one
            shown = self._seen_at(panel, panel.fields(place), slope)
        return self.in_colors([_times(c, shown) for c in crossed], panel.length * 0.0, context)

    def in_colors(self, shown: list[Factors], zero: Any, context: Context) -> MediumSample:
        """Return the emission and extinction of surfaces, weighted by the factors `shown`."""
        numbers = self.numbers(context)
        emission, extinction = [zero] * self.channels, [zero] * len(numbers.depths[0])
        for found, color, depths in zip(shown, numbers.colors, numbers.depths, strict=False):
            extinction = [t + d * found.gate for t, d in zip(extinction, depths, strict=True)]
            for c, (h, shown) in enumerate(zip(color, found.emission, strict=True)):
                emission[c] = emission[c] + depths[c if len(depths) > 1 else 0] * h * shown
        return MediumSample(emission, extinction)

    def halves(self, panel: Panel) -> Halves:
        """Return the means over both halves, compared with those over the panel."""

        def solved(whole: Float, first: Float, last: Float) -> tuple[Float, ...]:
            return doubled(whole, first, last, self._order, panel.many)

        means = (self.mean(part) for part in (panel, *panel.halves()))
        return Halves.of(MediumSample.of(solved, *means))

    def visible(self, panel: Panel) -> tuple[Mask, Mask]:
        if self._is_outside(panel):
            nowhere = panel.length < 0.0
            return nowhere, nowhere
        numbers = self.numbers(panel.context)
        nodes = panel.nodes(self.expr)
        seen = dr.isnan(nodes[1])  # where there is NaN, it must show
        unresolved = panel.length < 0.0
        for low, high in numbers.ranges:
            for edge in (low, high) if self.thick else (low,):
                possible, shown = passes(panel, self.expr, edge)
                seen |= possible > 0
                unresolved |= possible > shown
        if self.thick:
            for level in numbers.levels:
                seen |= dr.abs(nodes[0] - level) <= 0.5 * numbers.width
        if panel.culling_only:
            return seen | unresolved, unresolved
        if not self.thick:  # evaluated only where the ray crosses it
            return self.modulation.open(panel, seen), unresolved
        for level in numbers.levels:
            unresolved |= self._folded(panel, level)
        unresolved |= seen & self.lamp.turns(panel)
        return self.modulation.visible(panel, seen, unresolved)

    def _is_outside(self, panel: Panel) -> bool:
        """Return whether no surface without width is inside the panel (only at its ends)."""
        return not self.thick and panel.without_jumps

    def _folded(self, panel: Panel, level: Any) -> Mask:
        context = panel.context
        width = self.numbers(context).width
        low, high = panel.hull(self.expr)
        near = (low <= level + 0.5 * width) & (high >= level - 0.5 * width)
        deep = extremes([d for row in self.numbers(context).depths for d in row])[1]
        few = min(_FOLD * context.tolerance, _MOST_FOLDED)
        least = context.keep(("folded", few), lambda: context.narrow_number(few))
        least = least / dr.select(deep > 1.0, deep, 1.0)
        return near & (context.narrow(panel.beyond(self.expr) / width) > least)

    def _part_at_crossing(self, panel: Panel, level: Any) -> Factors:
        crossed = dr.select(_between(panel.ends(self.expr), level), panel.per_length, 0.0)
        if not self._looks_inside:
            return Factors([crossed] * self.channels, crossed)

        def make() -> list[Float]:
            place = on_chord(panel, self.expr, level)
            slope = panel.scalar(self.expr, 1.0) - panel.scalar(self.expr, 0.0)
            return self._seen_at(panel, panel.fields(place), slope)

        return _times(crossed, kept(panel, (id(self), id(level)), make))

    def _seen_at(self, panel: Panel, fields: dict[str, Any], slope: Float) -> list[Float]:
        """Return the density of a surface at a place with these fields, then each channel's light.

        `slope` is the derivative of the scalar there, per length of the panel.
        """
        dense, context = type(panel.length)(1.0), panel.context
        if self.gradient:  # |∇x| over |∂x/∂s|, at least one
            steepest = panel.length * self.steepness(fields, context)
            along: Float = dr.abs(slope)
            ratio = context.narrow(steepest / dr.select(along > 0.0, along, 1.0))
            dense = dr.select(ratio > 1.0, ratio, 1.0)
        gate, *shown = self.modulation.at_place(fields, context)
        light = self.lamp.light(fields, panel)
        return [gate * dense, *(f * dense * light for f in shown)]

    def _part_of_shell(self, panel: Panel, level: Any) -> Factors:
        context = panel.context
        width = self.numbers(context).width
        ends = [x - level for x in panel.ends(self.expr)]
        in_halves = [context.narrow(2.0 * x / width) for x in ends]
        middle = box_middle(*in_halves)
        first, last = (unit_interval(x / width + 0.5) for x in ends)
        dense = panel.per_length * context.narrow(dr.abs(last - first))
        if self.gradient:
            # Also where the panel is parallel to the sheet, and has no crossing; relative to the
            # slope at the place, not to the mean slope of the panel.
            steep = context.narrow(self.steepness(panel.fields(middle.place), context) / width)
            turned = slope_factor(panel, self.expr, middle.place)
            sheet = box_extent(*in_halves) * turned * steep
            dense = dr.select(sheet > dense, sheet, dense)
        light = self.lamp.shade(panel, middle)
        if self.modulation.fixed:
            return Factors([dense * light] * self.channels, dense)
        factors = self.modulation.factors(panel, middle)
        return Factors([f * dense * light for f in factors.emission], factors.gate * dense)

    def steepness(self, fields: dict[str, Any], context: Context) -> Float:
        """Return |∇x| at a place with these fields, per unit of length in kernels."""
        return context.kept_number(self.length) * context.evaluate(self.slope, fields)


def _between(ends: Iterable[Any], level: Any) -> Mask:
    first, last = ends
    return ((first < level) & (last >= level)) | ((first >= level) & (last < level))


def _times(crossed: Any, shown: list[Any]) -> Factors:
    gate, *paint = shown
    return Factors([crossed * f for f in paint], crossed * gate)


def slope_factor(panel: Panel, expr: Expression, place: Float) -> Float:
    """Return the mean slope of a scalar over its slope at a place in a panel.

    The mean of a shape over a panel is, with x for the variable of integration, that of shape/x';
    with a quadratic through the three nodes of the panel it is that for a line, times this factor
    at the shape's centre of mass. One order more than a line gives, for thin shells and for wide.

    The centre of mass, `place`, is a fraction of the panel.
    """
    if not expr.smooth:
        return type(panel.length)(1.0)
    first, middle, last = panel.nodes(expr)
    narrow = panel.context.narrow
    bow = narrow(2.0 * (first - 2.0 * middle + last))
    bow = dr.select(dr.abs(bow) > narrow(noise_of(first, last)), bow, 0.0)
    ends = panel.ends(expr)
    rise = narrow(ends[1] - ends[0])
    change = 2.0 * bow * (place - 0.5)
    # An infinite rise is that of log10 from where nothing is.
    near = (dr.abs(change) < _MOST_CHANGE * dr.abs(rise)) & dr.isfinite(rise)
    return dr.select(near, rise / dr.select(near, rise + change, 1.0), 1.0)
