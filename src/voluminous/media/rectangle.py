"""Shells of constant coefficients."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.types import Float, Mask
from ..expressions import Ops
from ..expressions.traced_interval import TracedInterval
from .bound import Binding
from .jumps import Jump, passes
from .panel import Middle, middle_of
from .profiles import BoundShaped, Shaped

if TYPE_CHECKING:
    from ..bounds.enclosure import Enclosure, EnclosureContext
    from .panel import Panel


class Rectangle(Shaped):
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
    The rectangle function of Peters, *The physics of volume rendering* (2014), section 2; the form
    with h and w, section 5.
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
        shading: float = 0.0,
        lights: Any = None,
    ) -> None:
        options: dict[str, Any] = {"where": where, "shading": shading, "lights": lights}
        super().__init__(expr, center, half_width, color, opacity, path_length, **options)

    def shape(self, ops: Ops, offset: Float, width: Any) -> Float:
        box = ops.number(abs(offset) <= width)
        return ops.where(offset == offset, box, offset)

    def mean_shape(self, first: Float, last: Float, faint: float) -> Float:
        return box_mean(first, last)

    def bind(self, binding: Binding) -> BoundRectangle:
        return BoundRectangle(self, binding)

    def halves(self, nodes: list[Float], faint: float) -> list[Float]:
        return self.by_centers(nodes, faint)

    def change(self, low: Float, high: Float) -> Float:
        same = (low > 1.0) | (high < -1.0) | ((low >= -1.0) & (high <= 1.0))
        return dr.select(same, 0.0, type(low)(1.0))

    def middle(self, first: Float, last: Float, mean: Float) -> Middle:
        return box_middle(first, last)

    def mean_bounds(
        self, enclosure: Enclosure, center: float, width: float, context: EnclosureContext
    ) -> TracedInterval:
        """Return bounds of the fraction of a panel with |z| < 1, from limits moved in and out."""
        ends = enclosure.in_widths(context.plain(center), context.plain(width))
        first, last, _, farthest = ends
        inner, outer = 1.0 - farthest, 1.0 + farthest
        some = dr.select(inner > 0.0, inner, 1.0)
        least = dr.select(inner > 0.0, box_mean(first / some, last / some), 0.0)
        most = box_mean(first / outer, last / outer)
        return enclosure.around(0.5 * (least + most), 0.5 * (most - least))

    def reach(self, faint: float) -> float:
        return 1.0


class BoundRectangle(BoundShaped):
    """The numbers of a `Rectangle`."""

    def __init__(self, medium: Rectangle, binding: Binding) -> None:
        super().__init__(medium, binding)
        self._sides = [self.center + sign * self.width for sign in (-1.0, 1.0)]
        self._single = binding.precision == "single"

    def jumps(self) -> list[Jump]:
        """Return both sides in double precision, and the jumps of the gate.

        Halved panels instead left 3 % of the pixels of noise beyond their error at a tolerance of
        1e-4, 16 % at 1e-8. In single precision places are rounded more than thin slabs allow, and
        pictures take 1.2 to 1.6 times as long.
        """
        sides = [] if self._single else [Jump(self.expr, side) for side in self._sides]
        return [*sides, *super().jumps()]

    def visible(self, panel: Panel) -> tuple[Mask, Mask]:
        seen, unresolved = super().visible(panel)
        numbers = self.numbers(panel.context)
        half_width = 1.0 / numbers.narrowness
        for edge in (numbers.center - half_width, numbers.center + half_width):
            possible, shown = passes(panel, self.expr, edge)
            unresolved |= seen & (possible > shown)
        return seen, unresolved


def box_mean(first: Any, last: Float) -> Float:
    """Return the mean of a shape that is one where |z| <= 1 and zero elsewhere."""
    low, high = dr.select(first < last, first, last), dr.select(first < last, last, first)
    inside = dr.select(high < 1.0, high, 1.0) - dr.select(low > -1.0, low, -1.0)
    width = high - low
    flat = dr.select(dr.abs(first) <= 1.0, 1.0, 0.0)
    mean = dr.select(inside > 0.0, inside, 0.0) / dr.select(width > 0.0, width, 1.0)
    return dr.select(width > 0.0, mean, flat * 1.0)


def box_middle(first: Float, last: Float) -> Middle:
    """Return where the part of the panel is in which z is from -1 to 1; exact."""
    low, high = _part_within(first, last)
    half = 0.5 * (last - first)
    per_half = dr.select(half == 0.0, 0.0, 1.0 / half)
    extent = dr.select(half == 0.0, 1.0, 0.5 * (high - low) * per_half)
    center = 0.5 * (low + high) - 0.5 * (first + last)
    return middle_of(center * per_half, extent * extent / 3.0)


def box_extent(first: Float, last: Float) -> Float:
    """Return what part of the panel it is in which z is from -1 to 1."""
    low, high = _part_within(first, last)
    width = dr.abs(last - first)
    inside = dr.select((first >= -1.0) & (first <= 1.0), type(width)(1), 0.0)
    return dr.select(width == 0.0, inside, (high - low) / dr.select(width == 0.0, 1.0, width))


def _part_within(first: Float, last: Float) -> tuple[Float, Float]:
    low, high = dr.select(first < last, first, last), dr.select(first < last, last, first)
    return _clipped(low), _clipped(high)


def _clipped(z: Float) -> Float:
    return dr.select(z < -1.0, -1.0, dr.select(z > 1.0, 1.0, z))
