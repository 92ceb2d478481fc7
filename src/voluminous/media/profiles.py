"""Media that are a function of one scalar: a shape times a colour and an opacity per path length.

A component is T(x) = h / path_length · shape(x), with h each entry of `color` for the emissivity
and of `opacity` for the extinction: seen through one path length of its peak, it shows its colour.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.functions import branch
from ..backend.types import Float, Mask
from ..expressions import Expression, NumpyOps, Ops
from ..expressions.interval import Interval
from ..expressions.traced_interval import TracedInterval
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
from .bound import Binding, BoundMedium
from .context import Context, Feature, Halves, MediumSample
from .contract import Medium
from .details import Colors
from .jumps import Jump
from .modulation import Modulation, modulated
from .panel import Middle, Panel, extremes, kept, middle_of, third_differences
from .quadrature import doubled, inverse_slope
from .shading import given_shade

if TYPE_CHECKING:
    from ..bounds.enclosure import EnclosedPanel, Enclosure, EnclosureContext, PanelBounds

# Control points that exceed a panel's ends by this many widths need smaller panels.
_DOUBT = 0.1
# Error of the mean by kinks at the walls of cells, as a part of the second difference in widths.
_KINKS = 0.2


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

    def change(self, low: Float, high: Float) -> Float:
        """Return by how much the shape changes between two distances from the centre, in widths."""
        return dr.select(low < high, type(low)(1.0), 0.0)

    def reach(self, faint: float) -> float:
        """Return the distance from the centre, in widths, where the shape falls below `faint`."""
        raise NotImplementedError

    def halves(self, nodes: list[Float], faint: float) -> list[Float]:
        """Return the means of the shape over both halves, and their error, from five distances.

        Default: from lines through quarters, compared with lines through the halves.
        """
        quarters = [self.mean_shape(a, b, faint) for a, b in pairwise(nodes)]
        lines = [self.mean_shape(a, b, faint) for a, b in pairwise(nodes[::2])]
        first, last = (0.5 * (quarters[k] + quarters[k + 1]) for k in (0, 2))
        return list(doubled(0.5 * (lines[0] + lines[1]), first, last, 2, nodes[0] != nodes[0]))

    def by_centers(self, nodes: list[Float], faint: float) -> list[Float]:
        """Return the same where centres of mass are known, for scalars that are cubics.

        With x(s) the scalar along a half of the panel and Φ the integral of the shape over x, the
        mean over s is ∫ Φ'(x) / x'(s) dx. For a line x' is constant, and the mean is ΔΦ / Δx. For
        a cubic that is multiplied by the mean of Δx / x' with the shape as its weight:
        `inverse_slope` expands 1/x' around the shape's centre of mass, to the order of its
        variance. Where x(s) turns, the error is the whole change of the shape.
        """
        cubics = third_differences(nodes)
        quartic, means, errors = cubics[1] - cubics[0], [], []
        rows = self.centers(nodes, faint)
        for half, cubic, (mean, center) in zip((nodes[:3], nodes[2:]), cubics, rows, strict=True):
            deviation = dr.sqrt(center.spread * center.place * (1.0 - center.place))
            factor, error, good = inverse_slope(half, cubic, quartic, center.place, deviation)
            change = self.change(*extremes(half))
            good &= change > 0.0
            means.append(mean * dr.select(good, factor, 1.0))
            error = mean * error
            errors.append(dr.select(good & (error < change), error, change))
        return [*means, 0.5 * (errors[0] + errors[1])]

    def centers(self, nodes: list[Float], faint: float) -> list[tuple[Float, Middle]]:
        """Return mean and centre of mass over both halves for distances linear on each."""
        found = []
        for first, last in ((nodes[0], nodes[2]), (nodes[2], nodes[4])):
            mean = self.mean_shape(first, last, faint)
            found.append((mean, self.middle(first, last, mean)))
        return found

    def mean_bounds(
        self, enclosure: Enclosure, center: float, width: float, context: EnclosureContext
    ) -> TracedInterval:
        """Return an interval, from 0 to 1, of the mean of the shape: by default, of its values."""
        found: TracedInterval = self.shape(
            context.ops, enclosure.values - context.number(center), context.number(width)
        )
        return found

    # --- the recipe -----------------------------------------------------------------------------

    def bind(self, binding: Binding) -> BoundShaped:
        return BoundShaped(self, binding)

    def features(self) -> tuple[Feature, ...]:
        shell = Colors((self.center,), (self.color,), self.width)
        scalar = Feature(self.expr, self.width, scalar=True, colors=shell)
        return (scalar, *self.modulation.features())

    def peak(self) -> tuple[float, float, float]:
        return min(self.color), max(self.color), max(self.opacity)

    def shape_key(self) -> tuple[Any, ...]:
        """Return a key of all that the shape per path length depends on, including units."""
        numbers = map(named, (self.center, self.width, self.path_length))
        return (type(self).__name__, self.expr.text, *numbers)

    def visible_key(self) -> Any:
        return (*self.shape_key()[:-1], self.modulation.gate_key())

    def key(self) -> Any:
        return (*self.shape_key(), self.color, self.opacity, self.modulation.key())

    def profile(
        self, unit: Unit, extent: Callable[[], tuple[float, float]]
    ) -> tuple[np.ndarray, np.ndarray]:
        center = plain(self.center, unit, "center")
        width = plain(self.width, unit, self.width_name)
        offsets = width * self.profile_places
        return center + offsets, np.asarray(self.shape(NumpyOps(), offsets, width))


@dataclass
class ShapeNumbers:
    """Kernel constants: lengths in x, `reach` in widths, the others in the kernel's units."""

    center: Float
    narrowness: Float
    reach: Float
    per_length: Float
    color: list[Float]
    opacity: list[Float]


class BoundShaped(BoundMedium):
    """The numbers of a `Shaped` medium: centre and width in the unit of x.

    Attributes
    ----------
    form : Shaped
        The mathematics of the shape.
    per_length : float
        Path lengths per unit of length.
    """

    def __init__(self, medium: Shaped, binding: Binding) -> None:
        self.form, self.expr, self._part = medium, medium.expr, binding.part
        self.center = binding.number(medium.center, self.expr, "center")
        self.width = binding.number(medium.width, self.expr, medium.width_name)
        self.per_length = binding.length / length_in(medium.path_length, binding.unit)
        self.color = binding.in_units(medium.color)
        self.opacity = binding.some(medium.opacity)
        self.modulation = medium.modulation.bind(binding)

    def numbers(self, context: Context) -> ShapeNumbers:
        """Return all numbers as kernel constants."""

        def make() -> ShapeNumbers:
            narrow = context.narrow_number
            return ShapeNumbers(
                center=context.number(self.center),
                narrowness=narrow(1.0 / self.width),
                reach=narrow(self.form.reach(context.faint)),
                per_length=narrow(self.per_length),
                color=[narrow(h) for h in self.color],
                opacity=[narrow(h) for h in self.opacity],
            )

        return context.keep((self._part, "numbers"), make)

    # --- at places ------------------------------------------------------------------------------

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        shape, number = self.shape(fields, context), context.number
        sample = MediumSample(
            [number(h) * shape for h in self.color], [number(h) * shape for h in self.opacity]
        )
        return self.modulation.coefficients(sample, fields, context)

    def shape(self, fields: dict[str, Any], context: Context) -> Float:
        """Return the shape per path length: the factor of colour and opacity."""
        offset = context.evaluate(self.expr, fields) - context.number(self.center)
        shape = self.form.shape(context.ops, offset, context.number(self.width))
        return context.number(self.per_length) * shape

    def may_show(self, ranges: dict[str, Interval], context: Context) -> Mask:
        reach = self.form.reach(context.faint) * self.width
        x = context.evaluate(self.expr, ranges)
        seen = x.nan | ((x.lo <= self.center + reach) & (x.hi >= self.center - reach))
        return seen & self.modulation.may_show(ranges, context)

    def prominence(self, x: Float, context: Context) -> Float:
        """Return the shape at a value of x: steps may be wide where it is small."""
        center, width = (context.kept_number(v) for v in (self.center, self.width))
        return self.form.shape(context.ops, x - center, width)

    # --- on panels ------------------------------------------------------------------------------

    def mean(self, panel: Panel) -> MediumSample:
        sample = self._times(self.mean_shape(panel), panel.context)
        if self.modulation.fixed:
            return sample
        first, last = self._offsets(panel.ends(self.expr), panel.context)
        mean = self.form.mean_shape(first, last, panel.context.faint)
        return self.modulation.mean(sample, panel, self.form.middle(first, last, mean))

    def halves(self, panel: Panel) -> Halves:
        shapes = self.half_shapes(panel)
        found = Halves(*(self._times(shape, panel.context) for shape in shapes))
        if self.modulation.fixed:
            return found
        nodes = self._offsets(panel.known(self.expr), panel.context)
        middles = [middle for _, middle in self.form.centers(nodes, panel.context.faint)]
        return self.modulation.halves(found, panel, middles)

    def _times(self, shape: Float, context: Context) -> MediumSample:
        numbers = self.numbers(context)
        return MediumSample(
            [h * shape for h in numbers.color], [h * shape for h in numbers.opacity]
        )

    def half_shapes(self, panel: Panel) -> list[Float]:
        """Return the means of the shape over both halves per path length, and their error."""
        context = panel.context

        def halves(nodes: list[Float]) -> list[Float]:
            return self.form.halves(nodes, context.faint)

        def make() -> list[Float]:
            nodes = self._offsets(panel.known(self.expr), context)
            seen = self._seen(*extremes(nodes), context)
            found = branch((nodes,), seen, halves, _none)
            # Where the scalar has kinks, at walls of cells or in the expression, nodes show them.
            triples = zip(nodes, nodes[1:], nodes[2:], strict=False)
            kinks = extremes([dr.abs(a - 2.0 * b + c) for a, b, c in triples])[1]
            mean, kinked = 0.5 * (found[0] + found[1]), panel.many | (not self.expr.smooth)
            found[2] = found[2] + dr.select(kinked, _KINKS * kinks * mean, 0.0)
            # Where there is no value there is nothing; beside that panels are narrow.
            usable, nowhere = (
                functools.reduce(how, map(test, nodes))
                for how, test in ((operator.and_, dr.isfinite), (operator.and_, dr.isnan))
            )
            error = dr.select(usable, found[2], dr.select(nowhere, 0.0, 1.0))
            found = [*(dr.select(dr.isfinite(mean), mean, 0.0) for mean in found[:2]), error]
            return [self.numbers(context).per_length * value for value in found]

        return kept(panel, (id(self), "halves"), make)

    def mean_shape(self, panel: Panel) -> Float:
        """Return the mean of the shape per path length; computed once."""
        context = panel.context

        def mean(first: Float, last: Float) -> Float:
            return self.form.mean_shape(first, last, context.faint)

        def make() -> Float:
            ends = self._offsets(panel.ends(self.expr), context)
            # Of several shells a ray is mostly in one: a branch for each.
            found = branch(tuple(ends), self._seen(*extremes(ends), context), mean, _nothing)
            return self.numbers(context).per_length * found

        return kept(panel, (id(self), "mean"), make)

    def _offsets(self, values: Iterable[Float], context: Context) -> list[Float]:
        numbers = self.numbers(context)
        return [context.narrow(x - numbers.center) * numbers.narrowness for x in values]

    def _seen(self, low: Float, high: Float, context: Context) -> Mask:
        """Return where it is not neglected between two distances; where there is NaN, it shows."""
        reach = self.numbers(context).reach
        return ~((low > reach) | (high < -reach))

    def visible(self, panel: Panel) -> tuple[Mask, Mask]:
        context = panel.context
        reach = self.numbers(context).reach
        nodes = panel.range(self.expr)
        below, above, low, high = self._offsets((*nodes, *panel.hull(self.expr)), context)
        seen = self._seen(low, high, context)
        over = (high > above + _DOUBT) & (above < reach) & (high > -reach)
        under = (low < below - _DOUBT) & (below > -reach) & (low < reach)
        # Between log10 of zero and a value there is all of the shell, and ends show none of it.
        endless = dr.isinf(below) | dr.isinf(above)
        unresolved = over | under | (seen & endless)
        if self.modulation.fixed:
            return seen, unresolved
        return self.modulation.visible(panel, seen, unresolved)

    def jumps(self) -> list[Jump]:
        return self.modulation.jumps()

    def panel_bounds(self, panel: EnclosedPanel, context: EnclosureContext) -> list[PanelBounds]:
        number, form = context.number, self.form
        shape = form.mean_bounds(panel.enclosure(self.expr), self.center, self.width, context)
        shape = shape * number(self.per_length)
        means = MediumSample(
            [number(h) * shape for h in self.color], [number(h) * shape for h in self.opacity]
        )
        ranged = self.shape(panel.fields, context)
        opacities = [*self.opacity] * (len(self.color) if len(self.opacity) == 1 else 1)
        sources = [
            number(h / o) if o > 0 else None for h, o in zip(self.color, opacities, strict=True)
        ]
        emission = [number(h) * ranged for h in self.color]
        return self.modulation.panel_bounds(self, emission, means, sources, panel, context)


def _nothing(first: Float, last: Float) -> Float:
    return type(first)(0.0)


def _none(offsets: list[Float]) -> list[Float]:
    return [type(offsets[0])(0.0)] * 3
