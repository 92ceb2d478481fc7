"""Media that are a function of one scalar: a shape times a colour and an opacity per path length.

A component is T(x) = h / path_length · shape(x), with h each entry of `color` for the emissivity
and of `opacity` for the extinction: seen through one path length of its peak, it shows its colour.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable
from typing import Any

import numpy as np

from ..backend import dr
from ..backend.types import Float, Mask
from ..expressions import Expression, NumpyOps, Ops
from ..expressions.interval import Interval
from ..units import plain
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

    def shape(self, ops: Ops, offset: Float, width: Float) -> Float:
        """Return the shape at a distance from the centre; one at its peak."""
        raise NotImplementedError

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        shape = self.per_length(fields, context)
        found = MediumSample(
            [context.number(h) * shape for h in self.color],
            [context.number(h) * shape for h in self.opacity],
        )
        return self.modulation.coefficients(found, fields, context)

    def per_length(self, fields: dict[str, Any], context: Context) -> Float:
        """Return the shape per path length: the factor of colour and opacity."""
        center, width, length = self.plain_numbers(context)
        x = context.evaluate(self.expr, fields)
        shape = self.shape(context.ops, x - context.number(center), context.number(width))
        return context.number(1.0 / length) * shape

    def features(self) -> tuple[Feature, ...]:
        return (Feature(self.expr, self.width, scalar=True), *self.modulation.features())

    def emission_range(self) -> tuple[float, float]:
        return min(self.color), max(self.color)

    def strongest(self) -> tuple[float, float]:
        return max(map(abs, self.color)), max(self.opacity)

    def means(self, panel: Panel, context: Context) -> MediumSample:
        shape = self.mean_per_length(panel, context)
        color, opacity = context.keep((id(self), "color"), lambda: self._colors(context))
        found = MediumSample([h * shape for h in color], [h * shape for h in opacity])
        if self.modulation.fixed:
            return found
        middle = self.middle(*self._ends(panel, context), self._mean(panel, context))
        return self.modulation.means(found, panel, context, middle)

    def mean_per_length(self, panel: Panel, context: Context) -> Float:
        """Return the mean of the shape per path length, exact if x is linear over the panel."""
        _, _, per_length = self._kept(context)
        mean = self._mean(panel, context)
        if isinstance(panel.stretch, Straight):
            return mean * per_length
        place = self.middle(*self._ends(panel, context), mean).place
        return mean * per_length * slope_factor(panel, self.expr, place, context.narrow)

    def _mean(self, panel: Panel, context: Context) -> Float:
        """Return the mean of the shape for x linear over the panel; computed once."""
        ends = self._ends(panel, context)
        key = (id(self), "mean", panel.first, panel.last)
        if isinstance(panel.stretch, Straight):
            return kept(panel.stretch, key, lambda: self._mean_where_seen(*ends, context))
        return kept(panel.stretch, key, lambda: self.mean_shape(*ends, context.faint))

    def _mean_where_seen(self, first: Float, last: Float, context: Context) -> Float:
        """Return the mean of the shape; zero where it is neglected.

        Of several shells a ray is mostly in one: a branch for each.
        """
        return dr.if_stmt(
            args=(first, last),
            cond=self._seen(*extremes((first, last)), context),
            true_fn=functools.partial(self.mean_shape, faint=context.faint),
            false_fn=_nothing,
        )

    def sharpness(self, stretch: Stretch, context: Context) -> tuple[Float, Float]:
        center, narrowness, _ = self._kept(context)
        reach = self._reach(context)

        def offset(x: Float) -> Float:
            return context.narrow(x - center)

        low, high = -reach / narrowness, reach / narrowness
        hull = [offset(x) for x in stretch.hull(self.expr)]
        seen = (hull[0] <= high) & (hull[1] >= low)
        thin = thinness(stretch, self.expr, narrowness, context.narrow)
        off = bend(stretch, self.expr, narrowness, offset, low, high)
        if not self.modulation.fixed:
            off = off + self._looked_up(stretch, context).error(self.modulation, stretch, context)
        return dr.select(seen, thin, 0.0), dr.select(seen, off, 0.0)

    def _looked_up(self, stretch: Stretch, context: Context) -> LookedUp:
        center, narrowness, per_length = self._kept(context)
        _, opacity = context.keep((id(self), "color"), lambda: self._colors(context))
        reach = self._reach(context) / narrowness
        extent = extent_of(self._offsets(stretch.nodes(self.expr), context), _THICKNESS)
        way = 0.5 * stretch.length * dr.select(extent < 1.0, extent, 1.0)
        depth = extremes(opacity)[1] * per_length * way
        return LookedUp(
            expr=self.expr,
            ranges=[(center - reach, center + reach)],
            thin=thinness(stretch, self.expr, narrowness, context.narrow),
            extent=extent,
            depth=dr.select(self.is_thin(extent), depth, 0.0),
        )

    def is_thin(self, extent: Float) -> Mask:
        """Return where a shell that fills this part of a half may be in one half only."""
        return extent < 2.0

    def _ends(self, panel: Panel, context: Context) -> tuple[Float, Float]:
        first, last = self._offsets(panel.ends(self.expr), context)
        return first, last

    def _seen(self, low: Float, high: Float, context: Context) -> Mask:
        """Return where it is not neglected between two distances; where there is NaN, it shows."""
        reach = self._reach(context)
        return ~((low > reach) | (high < -reach))

    def _offsets(self, values: Iterable[Any], context: Context) -> list[Float]:
        center, narrowness, _ = self._kept(context)
        return [context.narrow(x - center) * narrowness for x in values]

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

    def visible(self, stretch: Stretch, context: Context) -> tuple[Mask, Mask]:
        reach = self._reach(context)
        nodes = extremes(stretch.nodes(self.expr))
        below, above, low, high = self._offsets((*nodes, *stretch.hull(self.expr)), context)
        seen = self._seen(low, high, context)
        over = (high > above + _DOUBT) & (above < reach) & (high > -reach)
        under = (low < below - _DOUBT) & (below > -reach) & (low < reach)
        # Between log10 of nothing and a value there is all of the shell, and ends show none of it.
        endless = dr.isinf(below) | dr.isinf(above)
        _, narrowness, _ = self._kept(context)
        turns = seen & stretch.turns(self.expr, _DOUBT / narrowness)
        hidden = over | under | turns | (seen & endless)
        if not self.modulation.fixed:
            found = self._looked_up(stretch, context)
            hidden |= seen & found.lost(self.modulation, stretch, context)
        return self.modulation.visible(stretch, context, seen, hidden)

    @property
    def constant_source_function(self) -> bool:
        return not self.modulation.painted

    def cores(self, stretch: Stretch, context: Context) -> list[Float]:
        nodes = self._offsets(stretch.nodes(self.expr), context)
        counts = []
        for pair in (nodes[:2], nodes[1:]):
            low, high = extremes(pair)
            there = (low < _CORE) & (high > -_CORE)
            counts.append(
                core(there, high - low > 1.0, not self.constant_source_function, stretch.length)
            )
        return counts

    def prominence(self, x: Float, context: Context) -> Float:
        center, width = (context.kept_number(v) for v in self._plain_shape(context))
        return self.shape(context.ops, x - center, width)

    def profile(self, unit: Any, extent: Float) -> tuple[np.ndarray, np.ndarray]:
        center = plain(self.center, unit, "center")
        width = plain(self.width, unit, self.width_name)
        offsets = width * self.profile_places
        return center + offsets, np.asarray(self.shape(NumpyOps(), offsets, width))

    def visible_in(self, fields: dict[str, Interval], context: Context) -> Mask:
        center, width = self._plain_shape(context)
        reach = self.reach(context.faint) * width
        x = context.evaluate(self.expr, fields)
        seen = x.nan | ((x.lo <= center + reach) & (x.hi >= center - reach))
        return seen & self.modulation.visible_in(fields, context)

    def visible_key(self) -> Any:
        return (*self.shape_key()[:-1], self.modulation.gate_key())

    def plain_numbers(self, context: Context) -> tuple[float, float, float]:
        """Return centre, width and path length as plain numbers, in the units of a volume."""
        return (*self._plain_shape(context), length_in(self.path_length, context.unit))

    def _plain_shape(self, context: Context) -> tuple[float, float]:
        """Return centre and width alone: the path length may not have been measured."""
        unit = context.unit_of(self.expr)
        return (
            float(plain(self.center, unit, "center")),
            float(plain(self.width, unit, self.width_name)),
        )

    def _kept(self, context: Context) -> tuple[Any, Any, Any]:
        """Return centre, 1/width and scale/length as cached kernel constants."""

        def make() -> tuple[Any, Any, Any]:
            center, width, length = self.plain_numbers(context)
            narrowness, per_length = (
                context.narrow_number(v) for v in (1.0 / width, context.scale / length)
            )
            return context.number(center), narrowness, per_length

        return context.keep(id(self), make)

    def _colors(self, context: Context) -> tuple[list[Any], list[Any]]:
        color, opacity = (
            [context.narrow_number(h / unit) for h in values]
            for values, unit in ((self.color, context.radiance), (self.opacity, 1.0))
        )
        return color, opacity

    def _reach(self, context: Context) -> Float:
        """Return the distance, in widths, beyond which the shape is neglected, as a constant."""
        return context.keep(
            (id(self), "reach"), lambda: context.narrow_number(self.reach(context.faint))
        )

    def ranges(self, fields: dict[str, Interval], context: Context) -> MediumSample:
        return self.coefficients(fields, context)

    def shape_key(self) -> Any:
        """Return a key of all that `per_length` depends on, including units."""
        numbers = map(named, (self.center, self.width, self.path_length))
        return (type(self).__name__, self.expr.text, *numbers)

    def key(self) -> Any:
        return (*self.shape_key(), self.color, self.opacity, self.modulation.key())


def _nothing(first: Float, last: Float) -> Float:
    return type(first)(0.0)


class SampledShaped(Shaped):
    """Common part of `Gaussian` and `Rectangle` for means from samples."""

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

    def _in_colors(self, rows: list[tuple[Any, list[Any]]], context: Context) -> Sampled:
        """Return coefficients for shapes and factors: of the mean, the ends and the error."""
        found = Sampled(*(self._painted(shape, factors, context) for shape, factors in rows))
        found.off.emissivity = [dr.abs(off) for off in found.off.emissivity]
        return found

    def _painted(self, shape: Any, factors: list[Float], context: Context) -> MediumSample:
        """Return coefficients for a shape per path length, times factors of each channel and α."""
        color, opacity = context.keep((id(self), "color"), lambda: self._colors(context))
        *own, gate = factors
        return MediumSample(
            [h * f * shape for h, f in zip(color, own, strict=True)],
            [h * gate * shape for h in opacity],
        )

    def _sampled_modulated(self, stretch: Stretch, context: Context) -> Sampled:
        """Return the same with a gate, or in the colours of another expression.

        It takes eight samples of the shape, and five of the factors. Trying five of both first
        gained nothing: in turbulent fields it cost a tenth of the time.
        """
        _, narrowness, per_length = self._kept(context)
        ends = self._offsets(stretch.hull(self.expr), context)
        seen, unsure = self.modulation.visible(
            stretch, context, self._seen(ends[0], ends[1], context), stretch.length < 0.0
        )
        nodes = self._offsets([stretch.scalar(self.expr, s) for s in EIGHT], context)
        slopes = [narrowness * context.narrow(d) for d in stretch.derivatives(self.expr)]
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
        _, narrowness, per_length = self._kept(context)
        low, high = ends = self._offsets(stretch.hull(self.expr), context)
        seen = self._seen(low, high, context)
        if not self.expr.smooth:
            zero = type(low)(0.0)
            return Sampled(zero, zero, zero, dr.select(seen, dr.inf, zero))
        places = EIGHT if fine else PLACES
        nodes = self._offsets([stretch.scalar(self.expr, s) for s in places], context)
        slopes = [narrowness * context.narrow(d) for d in stretch.derivatives(self.expr)]
        found = dr.if_stmt(
            args=(nodes, ends, slopes),
            cond=seen,
            true_fn=functools.partial(self.sampled_shape, fine=fine),
            false_fn=_nothing_sampled,
        )
        return Sampled(*(per_length * value for value in found))

    def sample(self, offset: Float) -> Float:
        """Return the shape at a distance from the centre in widths, on a ray."""
        raise NotImplementedError

    def sampled_shape(
        self, nodes: list[Float], ends: list[Float], derivatives: list[Float], *, fine: bool
    ) -> Sampled:
        """Return the mean of the shape over a stretch from samples.

        Parameters
        ----------
        nodes : four or eight arrays
            Distances from the centre at `sampled.PLACES` or, if `fine`, `EIGHT`, in widths.
        ends : two arrays
            The least and the greatest distance on the stretch.
        derivatives : three arrays
            Bounds of the first three derivatives of that distance.
        """
        raise NotImplementedError


def _nothing_sampled(nodes: list[Float], ends: list[Float], derivatives: list[Float]) -> Sampled:
    zero = type(nodes[0])(0.0)
    return Sampled(zero, zero, zero, zero)
