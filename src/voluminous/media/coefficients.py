"""Media given by expressions for j and α."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Sequence
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.types import Float, Mask
from ..errors import InputError, UnitsError
from ..expressions import Expression, times
from ..expressions.expression import ComparisonField, on_one_side
from ..expressions.interval import Interval
from ..units import Unit, parse_unit, unit_name
from .context import Context, Feature, MediumSample
from .contract import Medium
from .jumps import SENSITIVITY, Jump
from .panel import extremes, in_box, kept

if TYPE_CHECKING:
    from ..bounds.enclosure import EnclosedPanel, EnclosureContext, PanelBounds
    from ..evaluation import Evaluation
    from .panel import Panel


# A coefficient that may be larger than at the nodes by this factor has a peak between them, unless
# it is below a fraction of one over the scale of length.
_PEAK, _FAINT = 2.0, 1e-4
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
        if not all(e.smooth for e in (*self.emissivity, *self.extinction)):
            self.order = 1  # at kinks and jumps
        every = (*self.emissivity, *self.extinction)
        self._margins = tuple(margin for e in every for margin in _margins(e))
        self.sensitivity = SENSITIVITY if self._margins else 1.0
        self.names = self.used_names()

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        return self._evaluated(
            (*self.emissivity, *self.extinction), lambda e: context.evaluate(e, fields), context
        )

    def _evaluated(
        self,
        expressions: Sequence[Expression],
        value: Callable[[Expression], Any],
        context: Context,
    ) -> MediumSample:
        sample = self.split(list(map(value, expressions)))
        sample.extinction = [
            context.number(per_length(context.unit_of(e), context.unit, f"extinction {e.text!r}"))
            * value
            for e, value in zip(self.extinction, sample.extinction, strict=True)
        ]
        return sample

    def at(self, panel: Panel, s: float, context: Context) -> list[Float]:
        """Return coefficients at a place, with all comparisons as in the middle if these hold."""
        if not self._decided(panel):
            return super().at(panel, s, context)
        pieces, sides = _on_one_side((*self.emissivity, *self.extinction))

        def decided() -> dict[str, Any]:
            middle = panel.fields(0.5)
            return {side.name: context.evaluate(side.condition, middle) for side in sides}

        fields = panel.fields(s) | kept(panel, (id(self), "sides"), decided)
        sample = self._evaluated(pieces, lambda e: context.evaluate(e, fields), context)
        return self.in_units(sample, context)

    def panel_bounds(self, panel: EnclosedPanel, context: EnclosureContext) -> list[PanelBounds]:
        every = (*self.emissivity, *self.extinction)
        means = self._evaluated(every, lambda e: panel.enclosure(e).mean, context)
        return [panel.bounds(self.ranges(panel.fields, context), means)]

    def emission_range(self) -> tuple[float, float] | None:
        return (0.0, 0.0) if all(e == Expression(0) for e in self.emissivity) else None

    def features(self) -> tuple[Feature, ...]:
        return tuple(map(Feature, (*self.emissivity, *self.extinction)))

    @property
    def _sides(self) -> tuple[ComparisonField, ...]:
        return _on_one_side((*self.emissivity, *self.extinction))[1]

    def jumps(self, context: Context) -> list[Jump]:
        zero = context.kept_number(0.0)
        return [Jump(m, zero) for side in self._sides for m in side.condition.margins()]

    def visible(self, panel: Panel, context: Context) -> tuple[Mask, Mask]:
        """Return True everywhere, and where a comparison changes: panels must be narrow there.

        Where all comparisons are fixed, panels end at their jumps instead.
        """
        seen, unresolved = super().visible(panel, context)
        if panel.culling_only:
            return seen, unresolved
        for margin in () if self._decided(panel) else self._margins:
            low, high = panel.hull(margin)
            # It is constant where the scalar is zero throughout, as ``density > 0`` in a vacuum.
            unresolved = unresolved | ((low <= 0.0) & (high >= 0.0) & (low < high))
        return seen, unresolved | self._peaks(panel, context)

    def _peaks(self, panel: Panel, context: Context) -> Mask:
        found = panel.length < 0.0
        units = (context.radiance / context.scale, 1.0 / context.scale)
        for every, unit in zip((self.emissivity, self.extinction), units, strict=True):
            for expr, own in zip(every, np.broadcast_to(unit, len(every)), strict=True):
                if not expr.peaked and expr.smooth:
                    continue
                size = extremes([dr.abs(x) for x in panel.nodes(expr)])[1]
                least = dr.fma(_PEAK, size, context.number(_FAINT * float(own)))
                most = in_box(panel, expr).size
                found |= (most > least) & dr.isfinite(most)
        return found

    def _decided(self, panel: Panel) -> bool:
        return panel.without_jumps and bool(self._sides)

    def ranges(self, fields: dict[str, Interval], context: Context) -> MediumSample:
        return self.coefficients(fields, context)

    def group(self, first: int, last: int) -> Coefficients:
        part = slice(first, last)
        extinction = self.extinction if self.grey else self.extinction[part]
        return self.replace(emissivity=self.emissivity[part], extinction=extinction)

    def plain(self, volume: Evaluation, emission: Unit = None) -> Coefficients:
        resolved = [volume.resolved(e) for e in self.emissivity]
        units = (emission, *(unit for _, unit in resolved))
        wanted = next((unit for unit in units if unit is not None), None)
        j = [_emission_in(e, unit, wanted) for e, unit in resolved]
        alpha = [_extinction_in(*volume.resolved(e), volume.unit) for e in self.extinction]
        before = (*self.emissivity, *self.extinction)
        same = all(new is old for new, old in zip((*j, *alpha), before, strict=True))
        return self if same else self.replace(emissivity=j, extinction=alpha)

    def length_unit(self, unit_of: Callable[[Expression], Unit]) -> Unit:
        units = (unit_of(e) for e in self.extinction)
        unit = next((unit for unit in units if unit is not None), None)
        return None if unit is None else unit**-1

    def scaled(self, factor: float) -> Coefficients:
        j, alpha = ([f"{factor!r} * ({e.text})" for e in every] for every in self._expressions())
        return Coefficients(j, alpha)

    def _expressions(self) -> tuple[tuple[Expression, ...], tuple[Expression, ...]]:
        return self.emissivity, self.extinction

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


@functools.lru_cache(maxsize=1 << 13)  # groups of channels are made for each picture
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


def _times(expression: Expression, factor: float, own: Unit, unit: Unit) -> Expression:
    change = parse_unit((unit or 1) / (own or 1))
    return expression if change is None else times(expression, factor, change)


def _emission_in(expression: Expression, own: Unit, unit: Unit) -> Expression:
    if own == unit or expression == Expression(0):
        return expression
    from astropy import units as u

    plain = u.dimensionless_unscaled
    try:
        return _times(expression, float((own or plain).to(unit or plain)), own, unit)
    except (u.UnitsError, TypeError) as error:
        raise UnitsError(
            f"emissivity {expression.text!r} is in {unit_name(own) or 'plain numbers'}, expected "
            f"{unit_name(unit) or 'a plain number'}; emissivities of all channels need units of "
            "one kind"
        ) from error


def _extinction_in(expression: Expression, own: Unit, length: Unit) -> Expression:
    unit = None if length is None else parse_unit(length**-1)
    if own is None or own == unit or expression == Expression(0):
        return expression
    factor = per_length(own, length, f"extinction {expression.text!r}")
    return _times(expression, factor, own, unit)


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
