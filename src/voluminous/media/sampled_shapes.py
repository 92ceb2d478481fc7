"""Shapes that a few samples show, where they are wider than the way along which they are taken."""

from __future__ import annotations

import functools
from typing import Any

from ..backend import dr
from .context import Context
from .contract import Coefficients
from .sampled import EIGHT, FIVE, PLACES, Sampled
from .sampled_products import products
from .shaped import Shaped
from .stretch import Stretch


class SampledShaped(Shaped):
    """Common part of `Gaussian` and `Rectangle` where these are sampled."""

    @property
    def smooth(self) -> bool:
        return self.expr.smooth

    @property
    def quick(self) -> bool:
        return self.modulation.even

    def sampled(self, stretch: Stretch, context: Context, *, fine: bool = False) -> Sampled:
        if not self.smooth:
            return super().sampled(stretch, context)
        if not self.modulation.even:
            return self._sampled_modulated(stretch, context)
        shape = self.sampled_per_length(stretch, context, fine=fine)
        gate, unsure = self.modulation.switched(stretch, context)
        shape.off = dr.select(unsure & (shape.off + shape.mean > 0.0), dr.inf, shape.off)
        factors = [gate] * (self.channels + 1)
        return self._in_colors([(value, factors) for value in shape], context)

    def _in_colors(self, rows: list[tuple[Any, list[Any]]], context: Context) -> Sampled:
        """Return coefficients for shapes and factors: of mean, ends, and what may be off."""
        found = Sampled(*(self._painted(shape, factors, context) for shape, factors in rows))
        found.off.emissivity = [dr.abs(off) for off in found.off.emissivity]
        return found

    def _painted(self, shape: Any, factors: list[Any], context: Context) -> Coefficients:
        """Return coefficients for a shape per path length, times factors of each channel and α."""
        color, opacity = context.keep((id(self), "color"), lambda: self._colors(context))
        *own, gate = factors
        return Coefficients(
            [h * f * shape for h, f in zip(color, own, strict=True)],
            [h * gate * shape for h in opacity],
        )

    def _sampled_modulated(self, stretch: Stretch, context: Context) -> Sampled:
        """Return the same with a gate, or in the colours of another expression.

        Eight samples of the shape, and five of what multiplies it. Five of both before these gained
        nothing: in turbulent fields a tenth of the time was lost.
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
        if not self.smooth:
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

    def sample(self, offset: Any) -> Any:
        """Return the shape at a distance from the centre in widths, on a ray."""
        raise NotImplementedError

    def sampled_shape(
        self, nodes: list[Any], ends: list[Any], derivatives: list[Any], *, fine: bool
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


def _nothing_sampled(nodes: list[Any], ends: list[Any], derivatives: list[Any]) -> Sampled:
    zero = type(nodes[0])(0.0)
    return Sampled(zero, zero, zero, zero)
