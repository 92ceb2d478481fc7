"""Shading of media: emission modulated by the angle between gradient and light.

Not radiative transfer but an illustration, as in direct volume rendering (Levoy 1988): the emission
is multiplied with ``1 - s + s Σ w |n·l|``, n the direction of the gradient, l the lights, Σ w = 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import Int, dr
from ..backend.types import Float, Mask
from ..errors import InputError
from ..expressions import Expression
from ..expressions.interval import Interval
from ..expressions.traced_interval import TracedInterval, positive
from .arguments import fraction
from .panel import NODES, Middle, extremes, kept

if TYPE_CHECKING:
    from ..bounds.enclosure import EnclosedPanel, EnclosureContext
    from .context import Context
    from .panel import Panel


HEADLIGHT = "headlight"
# Light that changes by more than this within a panel may be wrong by as much.
_DOUBT = 0.25
Light = tuple[Any, float]


def given_lights(lights: Any) -> tuple[Light, ...]:
    """Return lights as (direction or "headlight", weight); the weights add up to one."""
    if not isinstance(lights, (list, tuple, type(None))):
        raise InputError(f"lights must be a list, got {lights!r}")
    rows = [_light(one) for one in ([HEADLIGHT] if lights is None else lights)]
    total = sum(weight for _, weight in rows)
    if not total > 0.0:
        raise InputError("lights must hold at least one light of positive intensity")
    return tuple((direction, weight / total) for direction, weight in rows)


def _light(given: Any) -> Light:
    direction, weight = given, 1.0
    if isinstance(given, (list, tuple)) and len(given) == 2:
        direction, weight = given
    try:
        weight = float(weight)
        if isinstance(direction, str):
            size = 1.0 if direction == HEADLIGHT else math.nan
        else:
            direction = [float(v) for v in direction]
            size = math.hypot(*direction) if len(direction) == 3 else math.nan
    except (TypeError, ValueError):
        size = math.nan
    if not (0.0 < size < math.inf and 0.0 <= weight < math.inf):
        raise InputError(
            "lights must be a list of 'headlight', directions (x, y, z) towards a light, or pairs "
            f"of one of these and its intensity, got {given!r}"
        )
    if isinstance(direction, str):
        return direction, weight
    return tuple(v / size for v in direction), weight


def given_shade(expr: Expression, shading: Any, lights: Any) -> Shade | None:
    """Return the shading of an expression; None if there is none."""
    share = fraction(shading, "shading")
    rows = given_lights(lights)
    if lights is not None and share == 0.0:
        raise InputError("lights need shading, such as shading=0.7")
    return Shade(expr, share, rows) if share > 0.0 else None


class Shade:
    """The brightness of a place by the direction of a gradient, the normal.

    A `share` of the emission depends on the lights, given by directions towards them in coordinates
    of the volume; the rest is ambient. If `on_rays`, only `seen` is used, which needs no field of
    all cells for each camera.
    """

    def __init__(
        self, expr: Expression, share: float, lights: tuple[Light, ...], *, on_rays: bool = False
    ) -> None:
        self.expr, self.share, self.lights = expr, share, lights
        self.normal = [Expression(f"grad({expr.text}).{a}") for a in "xyz"]
        self.head = any(direction == HEADLIGHT for direction, _ in lights)
        self.sight = Expression(f"los(grad({expr.text}))") if self.head and not on_rays else None
        used = [*(n for e in self.expressions() for n in e.names), *("xyz" if self.head else "")]
        self.names = tuple(dict.fromkeys(used))

    def on_rays(self) -> Shade:
        """Return the shading for `seen` alone, which needs no field of all cells."""
        return Shade(self.expr, self.share, self.lights, on_rays=True)

    def expressions(self) -> list[Expression]:
        """Return the components of the gradient, along the line of sight too if that matters."""
        return [*self.normal, *([self.sight] if self.sight else [])]

    def factor(self, fields: dict[str, Any], context: Context) -> Float:
        """Return the factor of the emission at places; or an interval that holds it."""
        values = [context.evaluate(e, fields) for e in self.expressions()]
        if isinstance(values[0], Interval):
            where: Any = dr.select if isinstance(values[0], TracedInterval) else np.where
            anywhere = values[0].lo == values[0].lo
            low = where(anywhere, 1.0 - self.share, 1.0 - self.share)
            return type(values[0])(low, where(anywhere, 1.0, 1.0))
        return self._lit(values, context.number, context.kept_number(self.share))

    def seen(self, fields: dict[str, Any], panel: Panel) -> Float:
        """Return the factor on a ray, in the type that integrals are computed with.

        With the direction of the ray: near an observer inside the volume that to a cell's middle is
        another one.
        """
        context = panel.context
        values = [context.evaluate(e, fields) for e in self.normal]
        if self.head:
            ray = list(panel.ahead or ())
            most = extremes([dr.abs(w) for w in ray])[1]
            ray = [w / dr.select(most > 0.0, most, 1.0) for w in ray]
            along = sum(v * w for v, w in zip(values, ray, strict=True))
            size = dr.sqrt(sum(w * w for w in ray))
            values.append(along / dr.select(size > 0.0, size, 1.0))
        return context.narrow(self._lit(values, context.number, context.kept_number(self.share)))

    def _lit(self, values: list[Float], number: Int, share: Any) -> Float:
        """Return the factor from the gradient's components; ambient where they vanish."""
        x, y, z = (abs(v) for v in values[:3])
        ops = dr if not isinstance(values[0], (np.ndarray, float)) else np
        most = ops.maximum(x, ops.maximum(y, z))
        where = dr.select if ops is dr else np.where
        there = (most > 0.0) & (most < math.inf)
        # Squares of gradients in g/cm⁴ underflow.
        g = [where(there, v / where(there, most, 1.0), 0.0) for v in values]
        size = ops.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2])
        lit = 0.0 * size
        for direction, weight in self.lights:
            if direction == HEADLIGHT:
                along = abs(g[3])
            else:
                along = abs(sum(number(n) * v for n, v in zip(direction, g[:3], strict=True)))
            lit = lit + number(weight) * along
        cosine = where(there, lit / where(size > 0.0, size, 1.0), 0.0)
        return (1.0 - share) + share * ops.minimum(cosine, 1.0)

    def turned(self, panel: Panel) -> Float:
        """Return by what the light changes, where that is so much that places do not show how."""
        low, high = extremes([self.seen(panel.fields(s), panel) for s in NODES])
        return dr.select(high - low > _DOUBT, high - low, 0.0)

    def key(self) -> tuple[Any, ...]:
        """Return the expression and all numbers."""
        return ("Shade", self.normal[0].text, self.share, self.lights)


# Largest change of the cosine between ray and normal within a panel.
_TURN = 0.1


@dataclass(frozen=True)
class Lamp:
    """The light on surfaces, whose normals are gradients, as in `Shade`."""

    normal: Sequence[Expression]
    shading: float
    lights: tuple[Light, ...] = ((HEADLIGHT, 1.0),)

    def shade(self, panel: Panel, middle: Middle) -> Any:
        """Return the light factor of a surface of finite width on a panel.

        It is the mean of two Gauss-Legendre nodes within the surface, in which the normal turns
        even if the surface fills only a small part of the panel.
        """
        if self.shading == 0:
            return 1.0
        share = self._share(panel.context)
        deviation = dr.sqrt(middle.spread * middle.place * (1.0 - middle.place))
        first, last = (
            self._cosine(panel.fields(f), panel)
            for f in (middle.place - deviation, middle.place + deviation)
        )
        return 1.0 - share + 0.5 * share * (first + last)

    def light(self, fields: dict[str, Any], panel: Panel) -> Float:
        """Return the light factor of the surface at a place of a panel, with these fields."""
        if self.shading == 0:
            return 1.0
        share = self._share(panel.context)
        return 1.0 - share + share * self._cosine(fields, panel)

    def panel_light(self, panel: EnclosedPanel, context: EnclosureContext) -> TracedInterval:
        one: TracedInterval = context.number(1.0)
        if self.shading == 0:
            return one
        if self.lights != ((HEADLIGHT, 1.0),):
            raise InputError("bounds=True is for a headlight alone; leave lights= out")
        normal = [panel.enclosure(e).values for e in self.normal]
        ahead = [panel.enclosure(Expression(axis)).slope for axis in "xyz"]
        along, across, length = (
            _dot(a, b) for a, b in ((normal, ahead), (normal, normal), (ahead, ahead))
        )
        cosine = abs(along) / context.ops.sqrt(across * length)
        size = dr.select(cosine.hi < 1.0, cosine.hi, 1.0)
        # A normal that may vanish counts as facing the camera.
        limited = TracedInterval(positive(dr.select(cosine.lo > 1.0, 1.0, cosine.lo)), size)
        share: TracedInterval = context.number(self.shading)
        return (one - share) + share * limited

    def turns(self, panel: Panel) -> Mask:
        """Return where the normal turns by so much that a few places do not show how."""
        if self.shading == 0:
            return panel.length < 0.0
        low, high = extremes(self._lit(panel))
        return high - low > _TURN

    def _share(self, context: Context) -> Float:
        return context.keep(("shading", self.shading), lambda: context.narrow_number(self.shading))

    def _lit(self, panel: Panel) -> list[Float]:
        """Return the cosine of ray and normal at both ends and in the middle; computed once."""
        return kept(
            panel,
            ("lit", self.normal[0].text, self.lights),
            lambda: [self._cosine(panel.fields(s), panel) for s in NODES],
        )

    def _cosine(self, fields: dict[str, Any], panel: Panel) -> Float:
        context = panel.context
        across = _scaled([context.evaluate(e, fields) for e in self.normal], context)
        found = 0.0
        for direction, weight in self.lights:
            if direction == HEADLIGHT:
                towards = _scaled(list(panel.ahead or ()), context)
            else:
                towards = [context.narrow_number(d) for d in direction]
            size = dr.sqrt(_dot(across, across) * _dot(towards, towards))
            cosine = dr.abs(_dot(across, towards)) / dr.select(size > 0.0, size, 1.0)
            cosine = dr.select(size > 0.0, cosine, 1.0)  # where there is no normal
            one = self.lights == ((HEADLIGHT, 1.0),)
            found = cosine if one else found + context.narrow_number(weight) * cosine
        return found


def _scaled(vector: list[Any], context: Context) -> list[Float]:
    """Return a vector over its largest component: squares of gradients in g/cm⁴ underflow."""
    x, y, z = (dr.abs(v) for v in vector)
    most = dr.maximum(x, dr.maximum(y, z))
    return [context.narrow(v / dr.select(most > 0.0, most, 1.0)) for v in vector]


def _dot(a: list[Float], b: list[Float]) -> Float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
