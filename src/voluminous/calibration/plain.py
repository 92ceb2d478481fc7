"""Media in plain numbers: each expression in the units of a volume's fields, or refused.

``exp(-20 K/temperature)`` has a number for 20 K; emissivities that add up are in one unit, and
extinctions per unit length of the volume.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..errors import UnitsError
from ..evaluation import Evaluation
from ..expressions import Expression, times, without_unit
from ..media import Coefficients, ColorBy, Medium
from ..media.coefficients import per_length
from ..media.function import Formulas, Function
from ..media.sum import with_each
from ..units import Unit, parse_unit, unit_name
from ..value import Value

_UNITS_OF_FUNCTIONS = (
    "{} gets plain numbers in the units of its fields; say what it returns: "
    "from_function(..., units=('erg/(s cm3)', '1/cm')), the units of emissivity and extinction"
)


def in_plain_numbers(medium: Medium, volume: Evaluation) -> Medium:
    """Return a medium whose expressions are plain numbers of a volume's fields.

    Components without a unit to convert are returned themselves.
    """
    medium = with_each(medium, lambda part: _plain_part(part, volume))
    units = {id(part): _emission_unit(part, volume) for part in medium.components()}
    wanted = next((unit for unit in units.values() if unit is not None), None)

    def convert(part: Medium) -> Medium:
        own = units[id(part)]
        if own == wanted or part.emission_range() == (0.0, 0.0):
            return part
        if isinstance(part, Coefficients) and not isinstance(part, Formulas):
            j = [_emission_in(e, volume.expression_unit(e), wanted) for e in part.emissivity]
            return part.replace(emissivity=j)
        raise UnitsError(
            f"the parts of this medium emit in {unit_name(wanted)} and in "
            f"{unit_name(own) or 'plain numbers'} ({part!r}), which cannot be added; draw them "
            "apart, or give all of them emissivities of one kind"
        )

    return medium if wanted is None else with_each(medium, convert)


def _emission_unit(part: Medium, volume: Evaluation) -> Unit:
    if isinstance(part, Coefficients):
        units = (volume.expression_unit(e) for e in part.emissivity)
        return next((unit for unit in units if unit is not None), None)
    return part.units[0] if isinstance(part, Function) and part.units is not None else None


def _plain_part(part: Medium, volume: Evaluation) -> Medium:
    if isinstance(part, Function):
        return _plain_function(part, volume)
    if isinstance(part, Coefficients):
        return _plain_coefficients(part, volume)
    result: Medium = _with_plain_arguments(part, volume)
    return result


def _with_plain_arguments(thing: Value, volume: Evaluation) -> Any:
    """Return a medium or a `ColorBy` with plain expressions among its arguments."""
    changes = {}
    for name, given in thing.arguments().items():
        if isinstance(given, ColorBy):
            new: Any = _with_plain_arguments(given, volume)
        elif name in ("expr", "where") and given is not None:
            given = Expression(given)
            new = volume.without_units(given)
        else:
            continue
        if new is not given:
            changes[name] = new
    return thing.replace(**changes) if changes else thing


def _plain_coefficients(medium: Coefficients, volume: Evaluation) -> Coefficients:
    emissivity = [volume.resolved(e) for e in medium.emissivity]
    wanted = next((unit for _, unit in emissivity if unit is not None), None)
    j = [_emission_in(e, unit, wanted) for e, unit in emissivity]
    alpha = [_extinction_in(*volume.resolved(e), volume.unit) for e in medium.extinction]
    before = (*medium.emissivity, *medium.extinction)
    same = all(new is old for new, old in zip((*j, *alpha), before, strict=True))
    return medium if same else medium.replace(emissivity=j, extinction=alpha)


def _plain_function(function: Function, volume: Evaluation) -> Medium:
    inputs, units = zip(*(volume.resolved(e) for e in function.inputs), strict=True)
    if any(new is not old for new, old in zip(inputs, function.inputs, strict=True)):
        function = function.replace(fields=inputs)
    if function.units is not None:
        return _with_declared_units(function, inputs, units, volume)
    if all(unit is None for unit in units):
        return function
    formulas = function.formulas()
    try:
        if formulas is not None:
            return _plain_coefficients(formulas, volume)
    except UnitsError as error:
        raise UnitsError(f"{error}; {_UNITS_OF_FUNCTIONS.format(function.title)}") from error
    raise UnitsError(
        f"{function.title} cannot be read, so the units of what it returns are not known; "
        + _UNITS_OF_FUNCTIONS.format("it")
    )


def _with_declared_units(
    function: Function, inputs: Sequence[Expression], units: Sequence[Unit], volume: Evaluation
) -> Function:
    emission, own = function.units or (None, None)
    factor = per_length(own, volume.unit, f"the extinction of {function.title}")
    return function.replace(
        fields=[without_unit(e, unit, e.text) for e, unit in zip(inputs, units, strict=True)],
        function=_Scaled(function.function, factor),
        units=(emission, None),
    )


class _Scaled:
    """A function whose extinction is multiplied by a number."""

    def __init__(self, function: Any, factor: float) -> None:
        self.function, self.factor = function, factor
        self.__name__ = getattr(function, "__name__", "given")
        self.__qualname__ = getattr(function, "__qualname__", repr(function))

    def __call__(self, *values: Any, **parameters: Any) -> Any:
        result = self.function(*values, **parameters)
        if not isinstance(result, tuple) or len(result) != 2:
            return result  # which is refused
        j, alpha = result
        if isinstance(alpha, (list, tuple)):
            return j, [a * self.factor for a in alpha]
        return j, alpha * self.factor


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
