"""Media given by expressions for j and α."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Sequence
from numbers import Real
from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..backend.types import Float, Mask
from ..errors import InputError, UnitsError
from ..expressions import Expression, times
from ..expressions.expression import ComparisonField, on_one_side
from ..units import Unit, parse_unit, unit_name
from .bound import Binding, BoundMedium
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
        jumps = any(_margins(e) for e in (*self.emissivity, *self.extinction))
        self.sensitivity = SENSITIVITY if jumps else 1.0
        self.names = self.used_names()

    def bind(self, binding: Binding) -> BoundCoefficients:
        factors = [
            per_length(binding.unit_of(e), binding.unit, f"extinction {e.text!r}")
            for e in self.extinction
        ]
        return BoundCoefficients(self, binding, factors)

    def emission_unit(self, unit_of: Callable[[Expression], Unit]) -> Unit:
        units = (unit_of(e) for e in self.emissivity)
        return next((unit for unit in units if unit is not None), None)

    def peak(self) -> tuple[float, float, float] | None:
        return (0.0, 0.0, 0.0) if all(e == Expression(0) for e in self.emissivity) else None

    def features(self) -> tuple[Feature, ...]:
        return tuple(map(Feature, (*self.emissivity, *self.extinction)))

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

    def key(self) -> Any:
        return (
            "Coefficients",
            *(e.text for e in self.emissivity),
            "|",
            *(e.text for e in self.extinction),
        )


class BoundCoefficients(BoundMedium):
    """Expressions for j and α of some channels, and their factors to the kernel's units."""

    def __init__(self, medium: Coefficients, binding: Binding, factors: Sequence[float]) -> None:
        self.emissivity = medium.emissivity[binding.channels]
        self.extinction = binding.some(medium.extinction)
        self.expressions = (*self.emissivity, *self.extinction)
        units = binding.units(len(self.emissivity))
        self._emission = [binding.length / unit for unit in units]
        self._lengths = [binding.length * f for f in binding.some(factors)]
        # Mostly all are the unit of length; how many numbers there are must depend on units alone.
        self._one_length, self._binding = len(set(factors)) == 1, binding
        every, self._part = (*medium.emissivity, *medium.extinction), binding.part
        self._order = 4 if all(e.smooth for e in every) else 1  # at kinks and jumps
        self._margins = tuple(margin for e in self.expressions for margin in _margins(e))
        self._quotients = tuple(quotient for e in self.expressions for quotient in e.quotients())

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        return self._scaled([context.evaluate(e, fields) for e in self.expressions], context)

    def _scaled(self, values: list[Any], context: Context) -> MediumSample:
        """Return values of the expressions in the kernel's units."""
        count = len(self.emissivity)
        if context.encloses and {*self._emission, *self._lengths} == {1.0}:
            return MediumSample(values[:count], values[count:])

        def make() -> list[Any]:
            number, lengths = context.number, self._lengths
            alike = [number(lengths[0])] * len(lengths) if self._one_length else None
            bright = self._binding.shared(number, self._emission)
            return [*bright, *(alike or map(number, lengths))]

        factors = context.keep((self._part, "factors"), make)
        values = [f * v for f, v in zip(factors, values, strict=True)]
        return MediumSample(values[:count], values[count:])

    def _at(self, panel: Panel, s: float) -> MediumSample:
        """Return coefficients at a place, with all comparisons as in the middle if these hold."""
        if not self._decided(panel):
            return super()._at(panel, s)
        pieces, sides = _on_one_side(self.expressions)
        context = panel.context

        def decided() -> dict[str, Any]:
            middle = panel.fields(0.5)
            return {side.name: context.evaluate(side.condition, middle) for side in sides}

        fields = panel.fields(s) | kept(panel, (id(self), "sides"), decided)
        values = [context.evaluate(e, fields) for e in pieces]
        return self._usable(self._scaled(values, context), context)

    @property
    def _sides(self) -> tuple[ComparisonField, ...]:
        return _on_one_side(self.expressions)[1]

    def jumps(self) -> list[Jump]:
        return [Jump(m, 0.0) for side in self._sides for m in side.condition.margins()]

    def visible(self, panel: Panel) -> tuple[Mask, Mask]:
        """Return True everywhere, and where a comparison changes: panels must be narrow there.

        Where all comparisons are fixed, panels end at their jumps instead.
        """
        seen, unresolved = super().visible(panel)
        if panel.culling_only:
            return seen, unresolved
        for margin in () if self._decided(panel) else self._margins:
            low, high = panel.hull(margin)
            # It is constant where the scalar is zero throughout, as ``density > 0`` in a vacuum.
            unresolved = unresolved | ((low <= 0.0) & (high >= 0.0) & (low < high))
        for quotient in self._quotients:
            low, high = panel.hull(quotient)
            unresolved = unresolved | (low < high)
        return seen, unresolved | self._peaks(panel)

    def _peaks(self, panel: Panel) -> Mask:
        found, context = panel.length < 0.0, panel.context
        factors = [*self._emission, *self._lengths]
        for expr, factor in zip(self.expressions, factors, strict=True):
            if not expr.peaked and expr.smooth:
                continue
            size = extremes([dr.abs(x) for x in panel.nodes(expr)])[1]
            least = dr.fma(_PEAK, size, context.number(_FAINT / factor))
            most = in_box(panel, expr).size
            found |= (most > least) & dr.isfinite(most)
        return found

    def panel_bounds(self, panel: EnclosedPanel, context: EnclosureContext) -> list[PanelBounds]:
        means = self._scaled([panel.enclosure(e).mean for e in self.expressions], context)
        ranges = self.coefficients(panel.fields, context)
        return [panel.bounds(ranges, means)]

    def _decided(self, panel: Panel) -> bool:
        return panel.without_jumps and bool(self._sides)


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


def _times(expression: Expression, factor: float, given: Unit, unit: Unit) -> Expression:
    change = parse_unit((unit or 1) / (given or 1))
    return expression if change is None else times(expression, factor, change)


def _emission_in(expression: Expression, given: Unit, unit: Unit) -> Expression:
    if given == unit or expression == Expression(0):
        return expression
    from astropy import units as u

    plain = u.dimensionless_unscaled
    try:
        return _times(expression, float((given or plain).to(unit or plain)), given, unit)
    except (u.UnitsError, TypeError) as error:
        raise UnitsError(
            f"emissivity {expression.text!r} is in {unit_name(given) or 'plain numbers'}, expected "
            f"{unit_name(unit) or 'a plain number'}; emissivities of all channels need units of "
            "one kind"
        ) from error


def _extinction_in(expression: Expression, given: Unit, length: Unit) -> Expression:
    unit = None if length is None else parse_unit(length**-1)
    if given is None or given == unit or expression == Expression(0):
        return expression
    factor = per_length(given, length, f"extinction {expression.text!r}")
    return _times(expression, factor, given, unit)


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
