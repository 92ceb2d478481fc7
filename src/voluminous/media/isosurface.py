"""Isosurfaces: one crossing shows one colour, however steep the field is there.

A shell of fixed extent in the scalar x is thick where x varies slowly, and so brighter there.
Weighted by how fast x varies, emissivity and extinction are

    j = τ₁ color |∂x/∂s| K(x),    α = τ₁ |∂x/∂s| K(x),    ∫ K dx = 1,    τ₁ = -ln(1 - opacity),

so a ray that crosses the level once gathers τ₁, hence color · opacity, and lets 1 - opacity
through: the same at every angle and for every gradient. With |∇x| in place of |∂x/∂s| the surface
is a sheet of constant thickness, and looks denser where it is seen edge-on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, check_name
from ..expressions import Expression
from ..expressions.interval import Interval
from ..units import plain
from . import surface_crossing, surface_panels, surface_sampled, surface_sheet
from .context import Context
from .contract import Coefficients, Medium
from .edges import SENSITIVITY, Edge
from .given import fraction, plain_number
from .given import named as _named
from .given import scalar as _scalar
from .modulation import Factors
from .sampled import Sampled
from .shade import described_lights, given_lights, given_shade
from .shell import Shell
from .surface_given import (
    depth_of,
    given_levels,
    given_opacities,
    modulated_colors,
    plain_opacities,
)
from .surface_light import Lamp

if TYPE_CHECKING:
    from .course import CourseContext, Courses
    from .part_bounds import PartBounds
    from .stretch import Panel, Stretch

DENSITIES = ("crossing", "gradient")


@dataclass
class SurfaceNumbers:
    """Numbers of a kernel: per surface its level, its optical depths and its colour; the width."""

    levels: list[Any]
    width: Any
    depths: list[list[Any]]
    colors: list[list[Any]]

    @property
    def ranges(self) -> list[tuple[Any, Any]]:
        """Between which values each surface is."""
        return [(level - 0.5 * self.width, level + 0.5 * self.width) for level in self.levels]


class Isosurface(Medium):
    """Surfaces where a scalar has given values.

    Parameters
    ----------
    expr : str
        Expression x of the fields.
    level : float, Quantity or sequence of them
        The value of x on the surface, or one for each of several surfaces.
    color : sequence of float, sequence of sequences, str or ColorBy
        What one crossing shows if it is opaque: one value per channel; for several levels one such
        row for each (or its name), or the name of a matplotlib colormap. Where a name is both, it
        is a colour for one level, and a colormap for several.
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
        0: none, which is what radiative transfer gives. 1: emission proportional to the cosine
        between the ray and the normal (Lambert's law for a lamp at the camera); between them a mix.
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

    def __init__(
        self,
        expr: Any,
        level: Any = None,
        color: Any = (1.0, 1.0, 1.0),
        opacity: Any = 0.3,
        width: Any = 0.0,
        *,
        levels: Any = None,
        density: str = "crossing",
        shading: float = 0.0,
        lights: Any = None,
        where: Any = None,
    ) -> None:
        self.expr = Expression(expr)
        self.levels = given_levels(level, levels)
        self.colors, self.modulation = modulated_colors(color, where, len(self.levels))
        self.opacities = given_opacities(opacity, len(self.levels), len(self.colors[0]))
        self.width = _scalar(width, "width")
        if plain_number(self.width) < 0:
            raise InputError(f"width must not be negative, got {width}")
        check_name("density", density, DENSITIES)
        self.density, self.shading = density, fraction(shading, "shading")
        self.lights = given_lights(lights)
        self.shade = given_shade(self.expr, shading, lights)
        self.channels, self.grey = len(self.colors[0]), len(self.opacities[0]) == 1
        self.slope = Expression(f"gradmag({self.expr.text})")
        self.normal = [Expression(f"grad({self.expr.text}).{a}") for a in "xyz"]
        self.names = self.used_names()
        self.sensitivity = SENSITIVITY if self._directions() else self.modulation.sensitivity

    @property
    def color(self) -> tuple[float, ...]:
        """All numbers of the colours: the largest is as bright as a crossing gets."""
        return tuple(h for row in self.colors for h in row)

    @property
    def opacity(self) -> tuple[float, ...]:
        """All numbers of the opacities: the largest is what one crossing takes away at most."""
        return tuple(o for row in self.opacities for o in row)

    def expressions(self) -> tuple[tuple[Expression, Any], ...]:
        others = ((expr, 0.0) for expr in self._directions())
        return ((self.expr, self.width), *others, *self.modulation.expressions())

    @property
    def looks_inside(self) -> bool:
        return not (self._flat and self.modulation.fixed)

    def strongest(self) -> tuple[float, float]:
        return max(map(abs, self.color)), max(self.opacity)

    def edges(self, context: Context) -> list[Edge]:
        """Return the surfaces, if they have no width; else what the gate has.

        And the sides of those in which something varies: how much there is of others is known.
        """
        own = self.numbers(context)
        if not self.thick:
            return [Edge(self.expr, level) for level in own.levels]
        if not self._varies:
            return self.modulation.edges(context)
        sides = context.keep((id(self), "sides"), lambda: [x for pair in own.ranges for x in pair])
        return [*(Edge(self.expr, x) for x in sides), *self.modulation.edges(context)]

    @property
    def _varies(self) -> bool:
        return not (self._flat and self.modulation.even)

    @property
    def _flat(self) -> bool:
        return not self._directions()

    def steepness(self, fields: dict[str, Any], context: Context) -> Any:
        """Return |∇x| at a place with these fields, per unit of length in kernels."""
        return context.kept_number(context.scale) * context.evaluate(self.slope, fields)

    @property
    def hollow(self) -> bool:
        return not self.thick

    @property
    def finer(self) -> bool:
        return self.hollow or (self._varies and self.expr.smooth)

    @property
    def linear(self) -> bool:
        return not self._varies

    def sampled(self, stretch: Stretch, context: Context, *, fine: bool = False) -> Sampled:
        if self.hollow or not self.finer:
            return super().sampled(stretch, context, fine=fine)
        own = surface_sampled.sampled if fine else surface_sampled.roughly
        return own(self, stretch, context)

    def scalars(self) -> tuple[Expression, ...]:
        return (self.expr,)

    def shells(self) -> tuple[Shell, ...]:
        return tuple(
            Shell(self._level(k), _named(level), dark=not any(opacity))
            for k, (level, opacity) in enumerate(zip(self.levels, self.opacities, strict=True))
        )

    def _level(self, k: int) -> Isosurface:
        every = {"levels": self.levels, "colors": self.colors, "opacities": self.opacities}
        return self.changed(**{name: values[k : k + 1] for name, values in every.items()})

    def means(self, panel: Panel, context: Context) -> Coefficients:
        levels = self.numbers(context).levels
        zero = type(panel.length)(0)
        if self.hollow and panel.stretch.edgeless:
            return self.in_colors([], zero, context)
        part = surface_sheet.part if self.thick else surface_crossing.part
        found = [part(self, panel, context, level) for level in levels]
        return self.in_colors(found, zero, context)

    def layer(self, stretch: Stretch, context: Context, place: Any) -> Coefficients | None:
        if self.thick:
            return None
        found = surface_crossing.layers(self, stretch, context, place)
        return self.in_colors(found, stretch.length * 0.0, context)

    def in_colors(self, shown: list[Factors], zero: Any, context: Context) -> Coefficients:
        """Return emission and extinction of surfaces, of each of which so much is shown."""
        own = self.numbers(context)
        emission, extinction = [zero] * self.channels, [zero] * len(own.depths[0])
        for found, color, depths in zip(shown, own.colors, own.depths, strict=False):
            extinction = [t + d * found.gate for t, d in zip(extinction, depths, strict=True)]
            for c, (h, shown) in enumerate(zip(color, found.emission, strict=True)):
                emission[c] = emission[c] + depths[c if len(depths) > 1 else 0] * h * shown
        return Coefficients(emission, extinction)

    def visible(self, stretch: Stretch, context: Context) -> tuple[Any, Any]:
        return surface_panels.visible(self, stretch, context)

    @property
    def steady(self) -> bool:
        return len(self.levels) == 1 and self.modulation.color is None and not self.shading

    def cores(self, stretch: Stretch, context: Context) -> list[Any]:
        return surface_panels.cores(self, stretch, context)

    def sharpness(self, stretch: Stretch, context: Context) -> tuple[Any, Any]:
        return surface_panels.sharpness(self, stretch, context)

    def visible_in(self, fields: dict[str, Interval], context: Context) -> Any:
        levels, width = self.plain_numbers(context)
        x = context.evaluate(self.expr, fields)
        seen = x.nan
        for level in levels:
            seen = seen | ((x.lo <= level + 0.5 * width) & (x.hi >= level - 0.5 * width))
        return seen & self.modulation.visible_in(fields, context)

    def visible_key(self) -> Any:
        numbers = (*map(_named, self.levels), _named(self.width))
        return ("Isosurface", self.expr.text, *numbers, self.modulation.gate_key())

    def coefficients(self, fields: dict[str, Any], context: Context) -> Coefficients:
        """Return j and α per unit length with |∇x| for the slope: that along a ray is not known.

        Raises
        ------
        InputError
            If the width is zero: no cell's centre is likely to lie on the surface.
        """
        if not self.thick:
            raise InputError(
                "an Isosurface of width 0 is drawn with scheme='post-classified'; other schemes "
                "need a width (in the units of its expression)"
            )
        levels, width = self.plain_numbers(context)
        x, slope = context.evaluate(self.expr, fields), context.evaluate(self.slope, fields)
        rows = [[context.number(depth_of(o)) for o in row] for row in self.opacities]
        ops = context.ops
        emission: list[Any] = [0.0 * x] * self.channels
        extinction: list[Any] = [0.0 * x] * len(rows[0])
        for level, color, depths in zip(levels, self.colors, rows, strict=True):
            inside = ops.number(abs(x - context.number(level)) <= context.number(0.5 * width))
            dense = context.number(1.0 / width) * slope * inside
            extinction = [t + d * dense for t, d in zip(extinction, depths, strict=True)]
            for c, h in enumerate(color):
                own = depths[c if len(depths) > 1 else 0]
                emission[c] = emission[c] + context.number(h) * own * dense
        if self.shade is not None:
            light = self.shade.factor(fields, context)
            emission = [j * light for j in emission]
        return self.modulation.coefficients(Coefficients(emission, extinction), fields, context)

    def ranges(self, fields: dict[str, Interval], context: Context) -> Coefficients:
        return self.coefficients(fields, context) if self.thick else super().ranges(fields, context)

    def largest(self, fields: dict[str, Interval], context: Context) -> Coefficients:
        most = np.where(self.visible_in(fields, context), np.inf, 0.0)
        return Coefficients([most] * self.channels, [most] * len(self.opacities[0]))

    def on_panel(self, courses: Courses, context: CourseContext) -> list[PartBounds]:
        from .surface_bounds import surface_parts

        return surface_parts(self, courses, context)

    def key(self) -> Any:
        look = (self.colors, self.opacities, self.density, self.shading, self.lights)
        return (*self.visible_key(), *look, self.modulation.key())

    def describe(self) -> dict[str, Any]:
        one = len(self.levels) == 1
        return {
            "type": "isosurface",
            "expr": self.expr.text,
            "level": _named(self.levels[0]) if one else [_named(v) for v in self.levels],
            "color": list(self.colors[0]) if one else [list(row) for row in self.colors],
            "opacity": plain_opacities(self.opacities),
            "width": _named(self.width),
            "density": self.density,
            "shading": self.shading,
            **described_lights(self.lights),
            **self.modulation.described(),
        }

    @property
    def lamp(self) -> Lamp:
        """The light that surfaces are seen in."""
        return Lamp(self.normal, self.shading, self.lights)

    @property
    def thick(self) -> bool:
        """Whether the surfaces have a width."""
        return plain_number(self.width) > 0

    def _directions(self) -> list[Expression]:
        slope = [self.slope] if self.density == "gradient" else []
        return [*slope, *(self.normal if self.shading > 0 else ())]

    def used_names(self) -> tuple[str, ...]:
        """Return the fields and coordinates it looks at."""
        used = [name for e in (self.expr, *self._directions()) for name in e.names]
        used += self.slope.names if self.thick else ()
        used += self.shade.names if self.shade is not None else ()
        used += self.modulation.names
        return tuple(dict.fromkeys(used))

    def plain_numbers(self, context: Context) -> tuple[list[float], float]:
        """Return levels and width in the unit of the expression."""
        unit = context.unit_of(self.expr)
        levels = [float(plain(level, unit, "level")) for level in self.levels]
        return levels, float(plain(self.width, unit, "width"))

    def numbers(self, context: Context) -> SurfaceNumbers:
        """Return levels, width, optical depths and colours as numbers of a kernel."""

        def make() -> SurfaceNumbers:
            levels, width = self.plain_numbers(context)
            narrow = context.narrow_number
            return SurfaceNumbers(
                levels=[context.number(level) for level in levels],
                width=context.number(width),
                depths=[[narrow(depth_of(o)) for o in row] for row in self.opacities],
                colors=[[narrow(h / context.radiance) for h in row] for row in self.colors],
            )

        return context.keep(id(self), make)
