"""Media that are a function of one scalar: a shape times a colour and an opacity per path length.

A component is T(x) = h / path_length · shape(x), with h each entry of `color` for the emissivity
and of `opacity` for the extinction: seen through one path length of its peak, it shows its colour.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..backend import dr
from ..backend.types import Float, Mask
from ..expressions import Expression, NumpyOps, Ops
from ..expressions.interval import Interval
from ..units import Unit, plain
from .arguments import (
    channel_values,
    check_extinction,
    check_positive,
    given_path_length,
    length_in,
    named,
    scalar,
)
from .context import Context, Feature, MediumSample
from .contract import Medium
from .modulation import Modulation, modulated
from .panel import Middle, Panel, Straight, extremes, kept, middle_of, slope_factor
from .shading import given_shade

# Control points that exceed a panel's ends by this many widths need smaller panels.
_DOUBT = 0.1


@dataclass
class ShapeNumbers:
    """Kernel constants: lengths in x, `reach` in widths, the others in the units of means."""

    center: Float
    narrowness: Float
    reach: Float
    per_length: Float
    color: list[Float]
    opacity: list[Float]


class Shaped(Medium):
    """Common part of `Gaussian` and `Rectangle`.

    Attributes
    ----------
    width_name : str
        The name of its width.
    profile_places : array
        Distances from the centre, in widths, between which the shape is nearly linear.
    """

    width_name = ""
    profile_places: np.ndarray
    modulation: Modulation

    def __init__(
        self,
        expr: Any,
        center: Any,
        width: Any,
        color: Any,
        opacity: Any,
        path_length: Any = "auto",
        *,
        where: Any = None,
        shading: float = 0.0,
        lights: Any = None,
    ) -> None:
        self.expr = Expression(expr)
        self.center = scalar(center, "center")
        self.width = scalar(width, self.width_name)
        setattr(self, self.width_name, self.width)
        self.color, self.modulation = modulated(
            color, where, given_shade(self.expr, shading, lights)
        )
        self.opacity = channel_values(opacity, "opacity")
        self.path_length = given_path_length(path_length)
        check_extinction(self.opacity, len(self.color), "opacity")
        check_positive(self.width, self.width_name)
        if len(set(self.opacity)) == 1:  # the same for all channels: grey
            self.opacity = self.opacity[:1]
        self.channels = len(self.color)
        self.grey = len(self.opacity) == 1
        self.sensitivity = self.modulation.sensitivity
        self.order = 4 if self.expr.smooth else 2  # at kinks the scalar is taken as linear
        self.names = self.used_names()

    @property
    def mixes(self) -> bool:
        """Whether all channels are the same function of x, times numbers."""
        return self.grey and self.modulation.fixed

    @property
    def constant_source_function(self) -> bool:
        return not self.modulation.painted

    # --- the shape ------------------------------------------------------------------------------

    def shape(self, ops: Ops, offset: Float, width: Float) -> Float:
        """Return the shape at a distance from the centre; one at its peak."""
        raise NotImplementedError

    def mean_shape(self, first: Float, last: Float, faint: float) -> Float:
        """Return the mean of the shape between two distances from the centre, in widths.

        Below `faint`, as a fraction of the peak, it does not matter.
        """
        raise NotImplementedError

    def middle(self, first: Float, last: Float, mean: Float) -> Middle:
        """Return centre of mass and variance of the shape between two distances, in widths.

        `mean` is the result of `mean_shape` for them. Default: spread evenly.
        """
        return middle_of(0.0 * mean, 1.0 / 3.0)

    def reach(self, faint: float) -> float:
        """Return the distance from the centre, in widths, where the shape falls below `faint`."""
        raise NotImplementedError

    # --- numbers --------------------------------------------------------------------------------

    def plain_numbers(self, context: Context) -> tuple[float, float, float]:
        """Return centre, width and path length as plain numbers, in the units of a volume."""
        return (*self._center_and_width(context), length_in(self.path_length, context.unit))

    def _center_and_width(self, context: Context) -> tuple[float, float]:
        unit = context.unit_of(self.expr)
        center = float(plain(self.center, unit, "center"))
        return center, float(plain(self.width, unit, self.width_name))

    def numbers(self, context: Context) -> ShapeNumbers:
        """Return all numbers as kernel constants."""

        def make() -> ShapeNumbers:
            center, width, length = self.plain_numbers(context)
            narrow = context.narrow_number
            return ShapeNumbers(
                center=context.number(center),
                narrowness=narrow(1.0 / width),
                reach=narrow(self.reach(context.faint)),
                per_length=narrow(context.scale / length),
                color=[narrow(h / context.radiance) for h in self.color],
                opacity=[narrow(h) for h in self.opacity],
            )

        return context.keep(id(self), make)

    def features(self) -> tuple[Feature, ...]:
        return (Feature(self.expr, self.width, scalar=True), *self.modulation.features())

    def emission_range(self) -> tuple[float, float]:
        return min(self.color), max(self.color)

    def strongest(self) -> tuple[float, float]:
        return max(map(abs, self.color)), max(self.opacity)

    def shape_key(self) -> tuple[Any, ...]:
        """Return a key of all that `per_length` depends on, including units."""
        numbers = map(named, (self.center, self.width, self.path_length))
        return (type(self).__name__, self.expr.text, *numbers)

    def visible_key(self) -> Any:
        return (*self.shape_key()[:-1], self.modulation.gate_key())

    def key(self) -> Any:
        return (*self.shape_key(), self.color, self.opacity, self.modulation.key())

    # --- at places ------------------------------------------------------------------------------

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        shape = self.per_length(fields, context)
        sample = self.split([context.number(h) * shape for h in (*self.color, *self.opacity)])
        return self.modulation.coefficients(sample, fields, context)

    def per_length(self, fields: dict[str, Any], context: Context) -> Float:
        """Return the shape per path length: the factor of colour and opacity."""
        center, width, length = self.plain_numbers(context)
        x = context.evaluate(self.expr, fields)
        shape = self.shape(context.ops, x - context.number(center), context.number(width))
        return context.number(1.0 / length) * shape

    def ranges(self, fields: dict[str, Interval], context: Context) -> MediumSample:
        return self.coefficients(fields, context)

    def visible_in(self, fields: dict[str, Interval], context: Context) -> Mask:
        center, width = self._center_and_width(context)
        reach = self.reach(context.faint) * width
        x = context.evaluate(self.expr, fields)
        seen = x.nan | ((x.lo <= center + reach) & (x.hi >= center - reach))
        return seen & self.modulation.visible_in(fields, context)

    def prominence(self, x: Float, context: Context) -> Float:
        center, width = (context.kept_number(v) for v in self._center_and_width(context))
        return self.shape(context.ops, x - center, width)

    def profile(
        self, unit: Unit, extent: Callable[[], tuple[float, float]]
    ) -> tuple[np.ndarray, np.ndarray]:
        center = plain(self.center, unit, "center")
        width = plain(self.width, unit, self.width_name)
        offsets = width * self.profile_places
        return center + offsets, np.asarray(self.shape(NumpyOps(), offsets, width))

    # --- on panels ------------------------------------------------------------------------------

    def means(self, panel: Panel, context: Context) -> MediumSample:
        shape, own = self.mean_per_length(panel, context), self.numbers(context)
        sample = self.split([h * shape for h in (*own.color, *own.opacity)])
        if self.modulation.fixed:
            return sample
        first, last = self._offsets(panel.ends(self.expr), context)
        middle = self.middle(first, last, self.mean_shape(first, last, context.faint))
        return self.modulation.means(sample, panel, context, middle)

    def mean_per_length(self, panel: Panel, context: Context) -> Float:
        """Return the mean of the shape per path length."""
        return self.numbers(context).per_length * self._mean(panel, context)

    def _mean(self, panel: Panel, context: Context) -> Float:
        """Return the mean of the shape; computed once."""

        def make() -> Float:
            if not isinstance(panel, Straight):
                return self.curved_mean(
                    self._offsets(panel.nodes(self.expr), context), panel, context
                )
            ends = self._offsets(panel.ends(self.expr), context)
            # Of several shells a ray is mostly in one: a branch for each.
            return self._if_seen(
                ends, context, lambda ends: self.mean_shape(ends[0], ends[1], context.faint)
            )

        return kept(panel, (id(self), "mean"), make)

    def _if_seen(
        self, offsets: list[Float], context: Context, mean: Callable[[list[Float]], Float]
    ) -> Float:
        seen = self._seen(*extremes(offsets), context)
        found: Float = dr.if_stmt((offsets,), seen, mean, _nothing)
        return found

    def curved_mean(self, nodes: list[Float], panel: Panel, context: Context) -> Float:
        """Return the mean of the shape for x a parabola through three distances, in widths."""

        def found(nodes: list[Float]) -> Float:
            first, _, last = nodes
            mean = self.mean_shape(first, last, context.faint)
            place = self.middle(first, last, mean).place
            return mean * slope_factor(panel, self.expr, place)

        return self._if_seen(nodes, context, found)

    def _offsets(self, values: Iterable[Float], context: Context) -> list[Float]:
        """Return distances from the centre in widths."""
        own = self.numbers(context)
        return [context.narrow(x - own.center) * own.narrowness for x in values]

    def _seen(self, low: Float, high: Float, context: Context) -> Mask:
        """Return where it is not neglected between two distances; where there is NaN, it shows."""
        reach = self.numbers(context).reach
        return ~((low > reach) | (high < -reach))

    def visible(self, panel: Panel, context: Context) -> tuple[Mask, Mask]:
        own = self.numbers(context)
        reach = own.reach
        nodes = panel.range(self.expr)
        below, above, low, high = self._offsets((*nodes, *panel.hull(self.expr)), context)
        seen = self._seen(low, high, context)
        over = (high > above + _DOUBT) & (above < reach) & (high > -reach)
        under = (low < below - _DOUBT) & (below > -reach) & (low < reach)
        # Between log10 of zero and a value there is all of the shell, and ends show none of it.
        endless = dr.isinf(below) | dr.isinf(above)
        hidden = over | under | (seen & endless)
        return self.modulation.visible(panel, context, seen, hidden)


def _nothing(offsets: list[Float]) -> Float:
    return type(offsets[0])(0.0)
