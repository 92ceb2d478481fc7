"""The contract of bound media: what kernels evaluate. Numbers only: no unit, no volume.

`Medium.bind` makes one of a recipe, a volume's units and a kernel's. Methods compute with Dr.Jit's
arrays while a kernel is traced, and with intervals (`RangeContext`), by the same formulas.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.types import Float, Mask
from ..expressions import Expression
from ..expressions.interval import Interval
from ..units import Unit, plain
from .context import Context, Halves, MediumSample
from .panel import NODES, PLACES, Panel, kept
from .quadrature import doubled, simpson, with_values

if TYPE_CHECKING:
    from ..bounds.enclosure import EnclosedPanel, EnclosureContext, PanelBounds
    from ..evaluation import Evaluation
    from .jumps import Jump


def no_unit(expression: Expression) -> None:
    """Return None: the unit of an expression is unknown."""


@dataclass(frozen=True)
class Binding:
    """Everything outside a medium on which its numbers depend.

    Attributes
    ----------
    unit : astropy unit or None
        The volume's unit of length.
    unit_of : callable
        Returns the unit of an `Expression`, or None if it has none or is unknown.
    length : float
        The kernel's unit of length, in the volume's unit.
    radiance : float or array
        The emission that counts as one in kernels; one per channel of a spectrum.
    channels : slice
        The channels that are drawn together.
    precision : {"single", "double"}
        Of integrals along rays.
    part : tuple of int
        Which part of a sum is bound: a tape knows its numbers by that.
    """

    unit: Unit = None
    unit_of: Callable[[Expression], Unit] = no_unit
    length: float = 1.0
    radiance: Any = 1.0
    channels: slice = field(default_factory=lambda: slice(None))
    precision: str = "double"
    part: tuple[int, ...] = ()

    @classmethod
    def to(cls, volume: Evaluation, length: float = 1.0, precision: str = "double") -> Binding:
        """Return the binding to a volume's units."""
        return cls(volume.unit, volume.expression_unit, length, precision=precision)

    def number(self, value: Any, expr: Expression, what: str) -> float:
        """Return a value of an expression as a number in the expression's unit."""
        return float(plain(value, self.unit_of(expr), what))

    def some(self, values: Any) -> Any:
        """Return those of the channels that are drawn together; of a single one, itself."""
        return values if len(values) == 1 else values[self.channels]

    def units(self, count: int) -> list[float]:
        """Return the emission that counts as one in each of a number of channels."""
        return [float(unit) for unit in np.broadcast_to(self.radiance, count)]

    def shared(self, number: Callable[[float], Any], values: Sequence[float]) -> list[Any]:
        """Return numbers of channels as run-time data: one for all, but for a spectrum.

        How many there are must not depend on their values, which would compile other kernels.
        """
        if np.ndim(self.radiance):
            return [number(value) for value in values]
        return [number(values[0])] * len(values)

    def in_units(self, colors: Sequence[float]) -> list[float]:
        """Return the emission of the channels that are drawn, in the kernel's unit."""
        some = colors[self.channels]
        return [h / unit for h, unit in zip(some, self.units(len(some)), strict=True)]


class BoundMedium:
    """j and α of a medium in a kernel's units: j times length over radiance, and α times length.

    Only `coefficients` is required. `panel.context` has a kernel's number types and functions.
    Fields are numbers: one for each channel, such as scattered light, would be a list of them.
    """

    @property
    def parts(self) -> Sequence[BoundMedium]:
        """The media that this is the sum of."""
        return (self,)

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        """Return j and α for values of the fields, or intervals that hold them."""
        raise NotImplementedError

    def may_show(self, ranges: dict[str, Interval], context: Context) -> Mask:
        """Return where it may be noticeable while the fields stay in ranges (NumPy, a mask).

        Default: where its coefficients may be other than zero.
        """
        values = self.coefficients(ranges, context).listed()
        return functools.reduce(operator.or_, (v.nan | (v.size > 0.0) for v in values))

    def mean(self, panel: Panel) -> MediumSample:
        """Return the means of j and α over a panel of a ray.

        Default: Simpson's rule, exact for polynomials of degree three.
        """
        rows = (self._at(panel, s) for s in NODES)
        return MediumSample.of(lambda *values: simpson(*with_values(values)), *rows)

    def halves(self, panel: Panel) -> Halves:
        """Return the means over both halves of a panel, and the error of the mean over it.

        Default: Simpson's rule for the panel and for its halves.
        """

        def solved(*values: Float) -> tuple[Float, ...]:
            a, b, c, d, e = with_values(values)
            sums = simpson(a, c, e), simpson(a, b, c), simpson(c, d, e)
            return doubled(*sums, self._order, panel.many)

        return Halves.of(MediumSample.of(solved, *(self._at(panel, s) for s in PLACES)))

    # The order of convergence of `mean` in the length of panels; the part of `Binding`.
    _order = 4
    _part: tuple[int, ...] = ()

    def _at(self, panel: Panel, s: float) -> MediumSample:
        with panel.context.requests_of((self._part, "coefficients")):
            found = self.coefficients(panel.fields(s), panel.context)
        return self._usable(found, panel.context)

    @staticmethod
    def _usable(sample: MediumSample, context: Context) -> MediumSample:
        """Return coefficients as panels add them up: a negative extinction becomes NaN."""
        # Even where the mean would hide it.
        usable = [dr.select(a >= 0.0, a, math.nan) for a in sample.extinction]
        return MediumSample.of(context.narrow, MediumSample(sample.emissivity, usable))

    def visible(self, panel: Panel) -> tuple[Mask, Mask]:
        """Return (visible, unresolved), two masks.

        Visible: lanes on which the medium may contribute. Unresolved: those on which structure
        between the nodes may be missed, so that the panel must be halved. On a `culling_only` panel
        gates do not count.
        """
        active = panel.length >= 0.0
        return active, active & False

    def jumps(self) -> list[Jump]:
        """Return the levels at which the medium jumps or has a surface without width.

        Panels end there: `mean` is called for panels without a discontinuity inside
        (`Panel.without_jumps`).
        """
        return []

    def sheet(self, panel: Panel, place: Float) -> MediumSample | None:
        """Return emission and depth of the infinitely thin surfaces crossed; None if it has none.

        In the units of `mean` times length, without absorption; evaluated at a place s, 0 to 1.
        """
        return None

    def panel_bounds(self, panel: EnclosedPanel, context: EnclosureContext) -> list[PanelBounds]:
        """Return guaranteed bounds on a panel, of each of its parts.

        Default: from the ranges of the coefficients, whose width falls with the length of the
        panel; the means of most media have narrower bounds, which fall with its square.
        """
        values = self.coefficients(panel.fields, context)
        return [panel.bounds(values, values)]

    def source_range(self, panel: Panel) -> SourceRange | None:
        """Return between what the source function is on a panel; None if that is unknown."""
        return None


@dataclass
class SourceRange:
    """Least and largest temperature of what emits on a panel, and hν/k of each channel in K."""

    low: Float
    high: Float
    exponents: list[Float]

    def spread(self) -> list[Float]:
        """Return the largest relative change of the source function B_ν(T), per channel.

        (T₂ - T₁)/T₁ (1 + hν/kT₁): d ln B/d ln T = x/(1 - e^-x) is at most 1 + x.
        """
        cold = 1.0 / dr.select(self.low > 0.0, self.low, 1.0)
        change = dr.select(self.low > 0.0, (self.high - self.low) * cold, 1e6)
        return [change * dr.fma(x, cold, 1.0) for x in self.exponents]


def integrated(medium: BoundMedium, panel: Panel) -> Halves:
    """Return the integrals of a medium over both halves of a panel; computed once."""
    return kept(panel, (id(medium), "integrated"), lambda: medium.halves(panel))


class Wrapped(BoundMedium):
    """A medium whose own coefficients are per unit of the volume's length, of all its channels.

    Its `factors` bring the emissivities of the drawn channels to the kernel's units.
    """

    def __init__(self, medium: Any, binding: Binding) -> None:
        self.medium, self.binding, self._part = medium, binding, binding.part
        count = len(range(medium.channels)[binding.channels])
        self.factors = [binding.length / unit for unit in binding.units(count)]

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        found = self.medium.ranges if context.encloses else self.medium.coefficients
        return self._some(found(fields, context), context)

    def _some(self, sample: MediumSample, context: Context) -> MediumSample:
        """Return those of the channels that are drawn, in the kernel's units."""
        binding = self.binding
        emissivity, extinction = (
            sample.emissivity[binding.channels],
            binding.some(sample.extinction),
        )
        if context.encloses and {binding.length, *self.factors} == {1.0}:
            return MediumSample(emissivity, extinction)

        def make() -> tuple[list[Any], Any]:
            return binding.shared(context.number, self.factors), context.number(binding.length)

        bright, dense = context.keep((self._part, "factors"), make)
        return MediumSample(
            [f * j for f, j in zip(bright, emissivity, strict=True)],
            [dense * a for a in extinction],
        )
