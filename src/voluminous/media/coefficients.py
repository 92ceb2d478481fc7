"""Media given by expressions for j and α, and bounds of their hidden peaks from derivatives."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.types import Float, Mask
from ..errors import InputError, UnitsError
from ..expressions import Expression
from ..expressions.expression import ComparisonField, on_one_side
from ..expressions.interval import Interval
from ..expressions.traced_interval import larger
from ..units import Unit, parse_unit, unit_name
from .context import Context, Feature, MediumSample
from .contract import Medium, Sampling
from .edges import SENSITIVITY, Level
from .sampled import FIVE, Sampled, compared
from .stretch import extremes, kept, may_turn, undecided, within

if TYPE_CHECKING:
    from .stretch import Stretch


# A peak counts as hidden if it exceeds the values at the nodes by this factor.
_MORE = 0.25
# A stretch is too wide for samples if the bounds of the second and the first derivative, with its
# length as unit, exceed these multiples of the sampled values. Without this test 3 to 18 % of the
# pixels of noise exceeded their error estimate behind peaks and steps a hundredth of the noise
# wide, by up to 0.06 of the maximum; now 0 to 0.5 %, by less than the tolerance, in 1 to 1.4 of
# the time.
_BENT, _STEEP = 64.0, 4.0
_FAR = 0.5
# From this second derivative on step doubling has no order of convergence.
_SHARP = 16.0
# Error of the mean by a kink at which a slope of 1 changes sign, as far from an end of a panel as
# the nearest Gauss-Legendre node of its halves: no node lies beyond the kink.
_BLIND = (0.5 * (0.5 - math.sqrt(0.15))) ** 2


def sharpness(stretch: Stretch, expr: Expression) -> Float:
    """Return the relative curvature of an expression, from 0 (straight) to 1 (a kink)."""
    _, _, bow = stretch.spread(expr)
    size = _SHARP * _size(stretch, expr)
    return dr.select(bow < size, bow / size, dr.select(bow > 0.0, 1.0, 0.0))


def unseen_kink(stretch: Stretch, expr: Expression) -> Float:
    """Return the relative error of means by a kink beside an end of a stretch.

    Step doubling does not detect it. `may_peak` covers steeper changes.
    """
    _, slope, bow = stretch.spread(expr)
    size = _size(stretch, expr)
    kinked = ~(bow < dr.inf) & (slope <= _STEEP * size) & (size > 0.0) & (size < dr.inf)
    return dr.select(kinked, _BLIND * slope / dr.select(kinked, size, 1.0), 0.0)


def _size(stretch: Stretch, expr: Expression) -> Float:
    return extremes([dr.abs(x) for x in stretch.nodes(expr)])[1]


def may_peak(stretch: Stretch, expr: Expression, least: Float) -> Mask:
    """Return where an expression may have peaks or steps, above `least`, that samples miss."""
    if stretch.rough:
        # From bounds that are fast to compute, but wide.
        if may_turn(expr, stretch.context):
            found = within(stretch, expr)
            low, high = found.lo, found.hi
        else:
            low, high = stretch.hull(expr)
        below, above = extremes(stretch.nodes(expr))
        size = dr.fma(_MORE, extremes([dr.abs(below), dr.abs(above)])[1], least)
        peaks, width = (high - above > size) | (below - low > size), high - low
    else:
        width, slope, bow = stretch.spread(expr)
        size = larger(_size(stretch, expr), least)
        calm = (bow <= _BENT * size) | (slope <= _STEEP * size)
        # Without bounds of derivatives, as of ``n % 0.3``, its range must be small.
        calm |= ~(slope < dr.inf) & (width <= _FAR * size)
        peaks = ~(calm | (width <= least))
    return peaks & ~undecided(stretch, expr, width)


# Relative to one over the scale of length; smaller peaks of a coefficient are ignored.
_FAINT = 1e-4
# Most comparisons for which crossings are searched: each adds to every kernel.
_MOST_EDGES = 8


class Coefficients(Medium):
    """j and α as expressions of the fields, per unit length.

    Parameters
    ----------
    emissivity : sequence of str (or one str)
        One expression per channel.
    extinction : str or sequence of str
        One expression (grey) or one per channel: inverse lengths, or plain numbers per unit length
        of the volume.

    For the integral of a field along rays, such as a column density, take `voluminous.column` or
    `voluminous.measure`: an extinction absorbs, and a density needs an opacity to be one.

    Raises
    ------
    InputError
        If the numbers of expressions do not fit.
    UnitsError
        When rendering, if an expression has no unit, an extinction one that is not an inverse
        length, or emissivities have units of different kinds.

    Notes
    -----
    To see how much there is of a field along each ray, with α = ρ in mind, use `voluminous.column`;
    for its sum `voluminous.measure`.
    """

    def __init__(self, emissivity: Any, extinction: Any) -> None:
        self.emissivity = _expressions(emissivity, "emissivity")
        self.extinction = _expressions(extinction, "extinction")
        self.channels = len(self.emissivity)
        count = len(self.extinction)
        if self.channels == 1 and count > 1:
            words = {2: "two", 3: "three", 4: "four"}.get(count, str(count))
            example = ", ".join([repr(self.emissivity[0].text)] * count)
            raise InputError(
                f"one emissivity goes with one extinction, got {count}: give {words} emissivities, "
                f"one per channel, such as [{example}]"
            )
        if count not in (1, self.channels):
            raise InputError(
                f"extinction must be one expression (grey) or {self.channels} (one per channel), "
                f"got {len(self.extinction)}"
            )
        self.grey = len(self.extinction) == 1
        every = (*self.emissivity, *self.extinction)
        self._margins = tuple(margin for e in every for margin in _margins(e))
        self.sensitivity = SENSITIVITY if self._margins else 1.0
        self.names = self.used_names()

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        return MediumSample(
            [context.evaluate(e, fields) for e in self.emissivity],
            [
                context.number(
                    per_length(context.unit_of(e), context.unit, f"extinction {e.text!r}")
                )
                * context.evaluate(e, fields)
                for e in self.extinction
            ],
        )

    def emission_range(self) -> tuple[float, float] | None:
        return (0.0, 0.0) if all(e == Expression(0) for e in self.emissivity) else None

    def features(self) -> tuple[Feature, ...]:
        return tuple(map(Feature, (*self.emissivity, *self.extinction)))

    @property
    def _sides(self) -> tuple[ComparisonField, ...]:
        return _on_one_side((*self.emissivity, *self.extinction))[1]

    def discontinuities(self, context: Context) -> list[Level]:
        zero = context.kept_number(0.0)
        return [Level(m, zero) for side in self._sides for m in side.condition.margins()]

    @property
    def sampling(self) -> Sampling:
        smooth = all(e.smooth for e in (*self.emissivity, *self.extinction))
        return Sampling(smooth=smooth)

    def sampled(self, stretch: Stretch, context: Context, *, fine: bool = False) -> Sampled:
        values = [self.in_units(stretch.fields(s), context) for s in FIVE]
        found = [compared(list(own)) for own in zip(*values, strict=True)]
        _, hidden = self.visible(stretch, context)
        for one in found:
            one.off = dr.select(hidden, dr.inf, one.off)
        return Sampled(*(self.split(list(own)) for own in zip(*found, strict=True)))

    def visible(self, stretch: Stretch, context: Context) -> tuple[Mask, Mask]:
        """Return True everywhere, and where an expression may jump: panels must be narrow there.

        Samples on both sides of a jump do not show its place.
        """
        seen, hidden = super().visible(stretch, context)
        for margin in () if self._decided(stretch) else self._margins:
            low, high = stretch.hull(margin)
            # It is constant where the scalar is zero throughout, as ``density > 0`` in a vacuum.
            hidden = hidden | ((low <= 0.0) & (high >= 0.0) & (low < high))
        return seen, hidden | self._peaks(stretch, context)

    def sharpness(self, stretch: Stretch, context: Context) -> tuple[Float, Float]:
        """Return the relative curvature of the coefficients, and the error by unseen kinks.

        At a kink step doubling has no order of convergence.
        """
        sharp = off = stretch.length * 0.0
        stretch, (emissivity, extinction) = self._on_one_side(stretch, context)
        for expr in filter(_restless, (*emissivity, *extinction)):
            sharp = larger(sharp, context.narrow(sharpness(stretch, expr)))
            off = larger(off, context.narrow(unseen_kink(stretch, expr)))
        return sharp, off

    def _peaks(self, stretch: Stretch, context: Context) -> Float:
        """Return where a coefficient may have peaks or steps that samples do not show."""
        units = (context.radiance / context.scale, 1.0 / context.scale)
        found = stretch.length < 0.0
        stretch, coefficients = self._on_one_side(stretch, context)
        for every, unit in zip(coefficients, units, strict=True):
            for expr, own in zip(every, np.broadcast_to(unit, len(every)), strict=True):
                if _restless(expr):
                    found = found | may_peak(stretch, expr, context.number(_FAINT * float(own)))
        return found

    def _decided(self, stretch: Stretch) -> bool:
        """Return whether all comparisons have the same result as in the middle of the stretch."""
        return stretch.edgeless and bool(self._sides)

    def _on_one_side(self, stretch: Stretch, context: Context) -> tuple[Stretch, tuple[Any, Any]]:
        """Return a stretch, with emissivity and extinction for the comparisons fixed on it.

        The original expressions if there are no fixed ones.
        """
        if not self._decided(stretch):
            return stretch, (self.emissivity, self.extinction)
        k = self.channels

        def make() -> Stretch:
            middle = stretch.fields(0.5)
            return stretch.with_constants(
                {side.name: context.evaluate(side.condition, middle) for side in self._sides}
            )

        pieces, _ = _on_one_side((*self.emissivity, *self.extinction))
        return kept(stretch, (id(self), "side"), make), (pieces[:k], pieces[k:])

    def ranges(self, fields: dict[str, Interval], context: Context) -> MediumSample:
        return self.coefficients(fields, context)

    def block(self, first: int, last: int) -> Coefficients:
        part = slice(first, last)
        extinction = self.extinction if self.grey else self.extinction[part]
        return self.replace(emissivity=self.emissivity[part], extinction=extinction)

    def intensity_unit(self, context: Context) -> Any:
        units = (context.unit_of(e) for e in self.emissivity)
        unit = next((unit for unit in units if unit is not None), None)
        return unit if unit is None or context.unit is None else unit * context.unit

    def key(self) -> Any:
        return (
            "Coefficients",
            *(e.text for e in self.emissivity),
            "|",
            *(e.text for e in self.extinction),
        )


def _expressions(value: Float, what: str) -> tuple[Expression, ...]:
    single = isinstance(value, (str, bytes, Real, Expression)) or getattr(value, "ndim", 1) == 0
    parts = (value,) if single else tuple(value) if isinstance(value, Iterable) else ()
    if not parts:
        raise InputError(f"{what} must be an expression or a list of them, got {value!r}")
    return tuple(Expression(part) for part in parts)


@functools.lru_cache(maxsize=1 << 13)  # blocks of channels are made for each picture
def _margins(expression: Expression) -> tuple[Expression, ...]:
    return tuple(expression.margins())


@functools.lru_cache(maxsize=64)
def _on_one_side(
    expressions: tuple[Expression, ...],
) -> tuple[tuple[Expression, ...], tuple[ComparisonField, ...]]:
    """Return expressions with fixed comparisons, and the comparisons, unless these are too many.

    They are not stored in the medium: expressions without text cannot be pickled.
    """
    pieces, sides = on_one_side(expressions)
    count = sum(len(side.condition.margins()) for side in sides)
    return (pieces, sides) if count <= _MOST_EDGES else (expressions, ())


def _restless(expr: Expression) -> bool:
    return expr.peaked or not expr.smooth


def per_length(unit: Unit, length: Unit, subject: str) -> float:
    """Return the factor from the unit of an extinction to an inverse length, or refuse it."""
    if unit is None:
        return 1.0
    from astropy import units as u

    wanted = (u.dimensionless_unscaled if length is None else length) ** -1
    try:
        return float(unit.to(wanted))
    except u.UnitConversionError as error:
        if length is None:
            expected = (
                "a plain number, since the grid has no unit of length; give it one: unit='cm'"
            )
        else:
            expected = (
                f"an inverse length such as {unit_name(parse_unit(wanted))}; multiply densities by "
                "an opacity, an area per mass or per particle, as in 'density * (0.1 cm2/g)'; for "
                "columns and totals of a field use vm.column and vm.measure"
            )
        raise UnitsError(f"{subject} is in {unit_name(unit)}, expected {expected}") from error
