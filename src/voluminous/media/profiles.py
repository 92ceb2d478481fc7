"""Media that are a function of one scalar: a shape times a colour and an opacity per path length.

A component is T(x) = h / path_length · shape(x), with h each entry of `color` for the emissivity
and of `opacity` for the extinction: seen through one path length of its peak, it shows its colour.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ..backend import dr
from ..backend.functions import branch
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
from .contract import Medium, Sampling
from .modulation import Modulation, modulated
from .sampled import EIGHT, FIVE, PLACES, Sampled, products
from .shading import given_shade
from .stretch import Middle, Panel, Straight, Stretch, extremes, kept, middle_of
from .unresolved import LookedUp, bend, core, extent_of, slope_factor, thinness

# Control points that exceed a panel's ends by this many widths need smaller panels.
_DOUBT = 0.25
# Most of a shell is within this many widths of its centre.
_CORE = 4.0
# The width of a slab that holds as much of a Gaussian, and spreads it as far; a rectangle's is 2.
_THICKNESS = 3.5


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

    def is_thin(self, extent: Float) -> Mask:
        """Return where a shell that fills this part of a half may be in one half only."""
        return extent < 2.0

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
        middle = self.middle(first, last, self._mean(panel, context))
        return self.modulation.means(sample, panel, context, middle)

    def mean_per_length(self, panel: Panel, context: Context) -> Float:
        """Return the mean of the shape per path length, exact if x is linear over the panel."""
        per_length, mean = self.numbers(context).per_length, self._mean(panel, context)
        if isinstance(panel.stretch, Straight):
            return mean * per_length
        first, last = self._offsets(panel.ends(self.expr), context)
        place = self.middle(first, last, mean).place
        return mean * per_length * slope_factor(panel, self.expr, place)

    def _mean(self, panel: Panel, context: Context) -> Float:
        """Return the mean of the shape for x linear over the panel; computed once."""

        def make() -> Float:
            first, last = self._offsets(panel.ends(self.expr), context)
            if not isinstance(panel.stretch, Straight):
                return self.mean_shape(first, last, context.faint)
            # Of several shells a ray is mostly in one: a branch for each.
            return branch(
                args=(first, last),
                cond=self._seen(*extremes((first, last)), context),
                true_fn=functools.partial(self.mean_shape, faint=context.faint),
                false_fn=_nothing,
            )

        return kept(panel.stretch, (id(self), "mean", panel.first, panel.last), make)

    def _offsets(self, values: Iterable[Float], context: Context) -> list[Float]:
        """Return distances from the centre in widths."""
        own = self.numbers(context)
        return [context.narrow(x - own.center) * own.narrowness for x in values]

    def _seen(self, low: Float, high: Float, context: Context) -> Mask:
        """Return where it is not neglected between two distances; where there is NaN, it shows."""
        reach = self.numbers(context).reach
        return ~((low > reach) | (high < -reach))

    def visible(self, stretch: Stretch, context: Context) -> tuple[Mask, Mask]:
        own = self.numbers(context)
        reach = own.reach
        nodes = extremes(stretch.nodes(self.expr))
        below, above, low, high = self._offsets((*nodes, *stretch.hull(self.expr)), context)
        seen = self._seen(low, high, context)
        over = (high > above + _DOUBT) & (above < reach) & (high > -reach)
        under = (low < below - _DOUBT) & (below > -reach) & (low < reach)
        # Between log10 of zero and a value there is all of the shell, and ends show none of it.
        endless = dr.isinf(below) | dr.isinf(above)
        turns = seen & stretch.turns(self.expr, _DOUBT / own.narrowness)
        hidden = over | under | turns | (seen & endless)
        if not self.modulation.fixed:
            hidden |= seen & self._looked_up(stretch, context).lost(stretch, context)
        return self.modulation.visible(stretch, context, seen, hidden)

    def sharpness(self, stretch: Stretch, context: Context) -> tuple[Float, Float]:
        own = self.numbers(context)
        low, high = -own.reach / own.narrowness, own.reach / own.narrowness
        ends = [context.narrow(x - own.center) for x in stretch.hull(self.expr)]
        seen = (ends[0] <= high) & (ends[1] >= low)
        thin = thinness(stretch, self.expr, own.narrowness)
        off = bend(stretch, self.expr, own.narrowness, own.center, low, high)
        if not self.modulation.fixed:
            off = off + self._looked_up(stretch, context).error(stretch, context)
        return dr.select(seen, thin, 0.0), dr.select(seen, off, 0.0)

    def cores(self, stretch: Stretch, context: Context) -> list[Float]:
        counts, varies = [], not self.constant_source_function
        for pair in pairwise(self._offsets(stretch.nodes(self.expr), context)):
            low, high = extremes(pair)
            there = (low < _CORE) & (high > -_CORE)
            counts.append(core(there, high - low > 1.0, varies, stretch.length))
        return counts

    def _looked_up(self, stretch: Stretch, context: Context) -> LookedUp:
        own = self.numbers(context)
        reach = own.reach / own.narrowness
        extent = extent_of(self._offsets(stretch.nodes(self.expr), context), _THICKNESS)
        way = 0.5 * stretch.length * dr.select(extent < 1.0, extent, 1.0)
        depth = extremes(own.opacity)[1] * own.per_length * way
        return LookedUp(
            expr=self.expr,
            ranges=[(own.center - reach, own.center + reach)],
            thin=thinness(stretch, self.expr, own.narrowness),
            extent=extent,
            depth=dr.select(self.is_thin(extent), depth, 0.0),
            factors=self.modulation.at_nodes(stretch, context),
        )


def _nothing(first: Float, last: Float) -> Float:
    return type(first)(0.0)


class SampledShaped(Shaped):
    """Common part of `Gaussian` and `Rectangle` for means from samples."""

    def sample(self, offset: Float) -> Float:
        """Return the shape at a distance from the centre in widths, on a ray."""
        raise NotImplementedError

    def sampled_shape(
        self, nodes: list[Float], ends: list[Float], derivatives: list[Float], *, fine: bool
    ) -> Sampled:
        """Return the mean of the shape over a stretch from samples.

        From distances from the centre, in widths: `nodes` at `sampled.PLACES` or, if `fine`,
        `EIGHT`; `ends`, their least and greatest value; and bounds of three derivatives.
        """
        raise NotImplementedError

    @property
    def sampling(self) -> Sampling:
        return Sampling(smooth=self.expr.smooth, quick=self.modulation.even)

    def sampled(self, stretch: Stretch, context: Context, *, fine: bool = False) -> Sampled:
        if not self.expr.smooth:
            return super().sampled(stretch, context)
        if not self.modulation.even:
            return self._sampled_modulated(stretch, context)
        shape = self.sampled_per_length(stretch, context, fine=fine)
        gate, unsure = self.modulation.switched(stretch, context)
        shape.off = dr.select(unsure & (shape.off + shape.mean > 0.0), dr.inf, shape.off)
        factors = [gate] * (self.channels + 1)
        return self._in_colors([(value, factors) for value in shape], context)

    def _in_colors(self, rows: list[tuple[Float, list[Float]]], context: Context) -> Sampled:
        """Return coefficients for shapes and factors: of the mean, the ends and the error."""
        own, results = self.numbers(context), []
        for shape, (*paint, gate) in rows:
            emission = [h * f * shape for h, f in zip(own.color, paint, strict=True)]
            results.append(MediumSample(emission, [h * gate * shape for h in own.opacity]))
        results[-1].emissivity = [dr.abs(off) for off in results[-1].emissivity]
        return Sampled(*results)

    def _on(
        self, stretch: Stretch, places: tuple[float, ...], context: Context
    ) -> tuple[list[Float], list[Float], list[Float]]:
        """Return the arguments of `sampled_shape` on a stretch."""
        nodes = self._offsets([stretch.scalar(self.expr, s) for s in places], context)
        narrowness = self.numbers(context).narrowness
        slopes = [narrowness * context.narrow(d) for d in stretch.derivatives(self.expr)]
        return nodes, self._offsets(stretch.hull(self.expr), context), slopes

    def _sampled_modulated(self, stretch: Stretch, context: Context) -> Sampled:
        """Return the same with a gate, or in the colours of another expression.

        It takes eight samples of the shape, and five of the factors. Trying five of both first
        gained nothing: in turbulent fields it cost a tenth of the time.
        """
        per_length = self.numbers(context).per_length
        nodes, ends, slopes = self._on(stretch, EIGHT, context)
        seen, unsure = self.modulation.visible(
            stretch, context, self._seen(ends[0], ends[1], context), stretch.length < 0.0
        )
        off = per_length * self.sampled_shape(nodes, ends, slopes, fine=True).off
        rows = [self.modulation.at_node(stretch, s, context) for s in FIVE]
        gate, *paint = (list(column) for column in zip(*rows, strict=True))
        factors = [*(paint or [gate] * self.channels), gate]
        shape = [dr.select(seen, per_length * self.sample(z), 0.0) for z in nodes]
        found = products(shape, dr.select(unsure, dr.inf, dr.select(seen, off, 0.0)), factors)
        one = type(off)(1.0)
        return self._in_colors([(one, list(own)) for own in zip(*found, strict=True)], context)

    def sampled_per_length(
        self, stretch: Stretch, context: Context, *, fine: bool = False
    ) -> Sampled:
        """Return the mean of the shape per path length from samples; zero where neglected.

        Of several shells a ray is mostly in one: a branch for each.
        """
        low, high = self._offsets(stretch.hull(self.expr), context)
        seen, zero = self._seen(low, high, context), type(low)(0.0)
        if not self.expr.smooth:
            return Sampled(zero, zero, zero, dr.select(seen, dr.inf, zero))
        found = branch(
            args=self._on(stretch, EIGHT if fine else PLACES, context),
            cond=seen,
            true_fn=functools.partial(self.sampled_shape, fine=fine),
            false_fn=_nothing_sampled,
        )
        per_length = self.numbers(context).per_length
        return Sampled(*(per_length * value for value in found))


def _nothing_sampled(nodes: list[Float], ends: list[Float], derivatives: list[Float]) -> Sampled:
    zero = type(nodes[0])(0.0)
    return Sampled(zero, zero, zero, zero)
