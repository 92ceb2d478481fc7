"""Shells of constant coefficients."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.functions import precision_of
from ..expressions import Ops
from .context import Context
from .crossings import passes
from .edges import Edge
from .modulation import Middle
from .sampled import Sampled
from .sampled_shapes import SampledShaped
from .shape_means import box_mean
from .shape_middles import box_middle

if TYPE_CHECKING:
    from ..expressions.traced_interval import TracedInterval
    from .stretch import Stretch


class Rectangle(SampledShaped):
    """A shell of constant coefficients: T = h/path_length up to `half_width` from the centre.

    Parameters
    ----------
    expr : str
        Expression x of the fields.
    center, half_width : float or Quantity
        Where the shell is, and half how wide, in x.
    color, opacity, path_length, where, shading, lights
        As in `Gaussian`.

    Notes
    -----
    The rectangle function of Peters, *The physics of volume rendering* (2014), section 4.
    """

    width_name = "half_width"
    profile_places = np.array([-1.0, 1.0])

    def __init__(
        self,
        expr: Any,
        center: Any,
        half_width: Any,
        color: Any,
        opacity: Any,
        path_length: Any = "auto",
        *,
        where: Any = None,
        shading: Any = 0.0,
        lights: Any = None,
    ) -> None:
        super().__init__(
            expr, center, half_width, color, opacity, path_length, where, shading, lights
        )

    def shape(self, ops: Ops, offset: Any, width: Any) -> Any:
        box = ops.number(abs(offset) <= width)
        return ops.where(offset == offset, box, offset)

    def mean_shape(self, first: Any, last: Any, faint: float) -> Any:
        return box_mean(first, last)

    def edges(self, context: Context) -> list[Edge]:
        """Return both sides in double precision, and what the gate has.

        With their places panels have all digits: compared with halves 3 % of the pixels of noise
        were beyond their error at a tolerance of 1e-4, 16 % at 1e-8. In single precision places are
        rounded more than thin slabs allow, and pictures take 1.2 to 1.6 times as long.
        """
        center, width, _ = self.plain_numbers(context)
        sides = [context.kept_number(center + way * width) for way in (-1.0, 1.0)]
        single = precision_of(type(context.narrow(sides[0]))) == "single"
        own = [] if single else [Edge(self.expr, side) for side in sides]
        return [*own, *super().edges(context)]

    def sample(self, offset: Any) -> Any:
        return type(offset)(1.0)

    def sampled_shape(
        self, nodes: list[Any], ends: list[Any], derivatives: list[Any], *, fine: bool
    ) -> Sampled:
        one = type(ends[0])(1.0)
        inside = _within(*ends)
        return Sampled(one, one, one, dr.select(inside, 0.0 * one, dr.inf))

    def mean_bounds(
        self, first: Any, last: Any, off: Any, farthest: Any, z: TracedInterval
    ) -> TracedInterval:
        from .mean_bounds import box_bounds

        return box_bounds(first, last, farthest)

    def middle(self, first: Any, last: Any, mean: Any) -> Middle:
        return box_middle(first, last)

    def visible(self, stretch: Stretch, context: Context) -> tuple[Any, Any]:
        seen, hidden = super().visible(stretch, context)
        center, narrowness, _ = self._kept(context)
        for edge in (center - 1.0 / narrowness, center + 1.0 / narrowness):
            possible, shown = passes(stretch, self.expr, edge)
            hidden |= seen & (possible > shown)
        return seen, hidden

    def sharpness(self, stretch: Stretch, context: Context) -> tuple[Any, Any]:
        low, high = self._offsets(stretch.hull(self.expr), context)
        thin, off = super().sharpness(stretch, context)
        edge = (low <= 1.0) & (high >= -1.0) & ~_within(low, high)
        return dr.select(edge, type(thin)(1.0), 0.0), dr.select(edge, off, 0.0)

    def is_thin(self, extent: Any) -> Any:
        return extent >= 0.0

    def reach(self, faint: float) -> float:
        return 1.0


def _within(low: Any, high: Any) -> Any:
    return (low >= -1.0) & (high <= 1.0)
