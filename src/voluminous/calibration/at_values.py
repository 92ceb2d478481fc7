"""Emissivity and extinction of a medium at given values of its expressions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from ..backend import from_host, get_backend
from ..errors import InputError, UnitsError, unknown_name
from ..evaluation import Evaluation
from ..expressions import Expression
from ..fields import split_unit, unit_quantity
from ..media import Context, Medium
from ..media.bound import Binding
from ..media.sum import with_each
from ..units import Unit, parse_unit, unit_name
from .open_numbers import colors_of, in_plain_numbers, scalar_of


class GivenValues(Evaluation):
    """Arrays of values by the names of fields, or of whole expressions, in place of a volume."""

    coordinates: tuple[str, ...] = ()

    def __init__(self, given: Mapping[str, Any]) -> None:
        self.unit: Unit = None
        self._fields: dict[str, np.ndarray] = {}
        self._units: dict[str, Unit] = {}
        for name, value in given.items():
            values, unit = split_unit("nothing" if value is None else value)
            try:
                self._fields[name] = np.asarray(values, dtype=np.float64)
            except (TypeError, ValueError) as error:
                raise InputError(f"values of {name} must be numbers, got {value!r}") from error
            self._units[name] = unit
            if name.startswith("log") and unit is not None and "dex" not in str(unit):
                raise InputError(
                    f"values of {name} are plain numbers, got some in {unit_name(unit)}; for those "
                    "of its fields give a dict: medium({'density': …})"
                )

    def __contains__(self, name: object) -> bool:
        return name in self._fields

    def field_unit(self, name: str) -> Unit:
        return self._units[name]

    def check_names(self, expression: Expression) -> None:
        for name in expression.names:
            if name not in self._fields:
                raise unknown_name("field", name, self._fields)

    def given(self, names: Iterable[str]) -> set[str]:
        return set(names) & self._fields.keys()

    def resolved(self, expression: Expression) -> tuple[Expression, Unit]:
        if expression.text in self._fields:
            return expression, self._units[expression.text]
        return super().resolved(expression)

    def arrays(self) -> dict[str, np.ndarray]:
        try:
            return dict(zip(self._fields, np.broadcast_arrays(*self._fields.values()), strict=True))
        except ValueError:
            shapes = ", ".join(f"{name} {array.shape}" for name, array in self._fields.items())
            raise InputError(f"values must have one shape, got {shapes}") from None


class _Given(Context):
    """Evaluates expressions; those that are given as a whole are looked up."""

    def evaluate(self, expression: Expression, fields: dict[str, Any]) -> Any:
        found = fields.get(expression.text)
        return super().evaluate(expression, fields) if found is None else found


def evaluate(medium: Medium, values: Any) -> tuple[Any, ...]:
    """Return j and α at values; see `Medium.__call__`."""
    is_open = [isinstance(c.path_length, str) for c in medium.components() if not is_surface(c)]
    if any(is_open):
        if not all(is_open):
            raise InputError(
                "path_length is 'auto' in one component of this medium and a length in others: "
                "give medium.calibrated(volume) values"
            )
        medium = with_each(medium, one_path_length)
    given = values if isinstance(values, Mapping) else {_only_scalar(medium).text: values}
    _check_given(medium, given)
    fields = GivenValues(given)
    fields.unit = _length_unit(medium, fields)
    medium = in_plain_numbers(medium, fields)
    both = coefficients(medium, fields.arrays(), fields.unit, fields.expression_unit)
    return tuple(
        array if unit is None else unit_quantity(np.asarray(array), unit)
        for array, unit in zip(both, units_of(medium, fields), strict=True)
    )


def coefficients(
    medium: Medium,
    arrays: Mapping[str, np.ndarray],
    unit: Unit,
    unit_of: Callable[[Expression], Unit],
) -> tuple[np.ndarray, np.ndarray]:
    """Return j (channel, …) and α, (…) if it is grey or (channel, …), in double precision."""
    shape = np.broadcast_shapes(*(np.shape(array) for array in arrays.values()))
    rows = np.zeros((medium.channels + (1 if medium.grey else medium.channels), *shape))
    if rows.size:
        real = get_backend("cpu", "double")
        fields = {
            name: from_host(real.Float, np.broadcast_to(array, shape).ravel())
            for name, array in arrays.items()
        }
        bound = medium.bind(Binding(unit, unit_of))
        sample = bound.coefficients(fields, _Given(real.Float, real.opaque))
        for k, value in enumerate(sample.listed()):
            rows[k] = np.broadcast_to(np.array(value), rows[k].size).reshape(shape)
    j, alpha = rows[: medium.channels], rows[medium.channels :]
    return j, alpha[0] if medium.grey else alpha


def _only_scalar(medium: Medium) -> Expression:
    scalars = {scalar_of(component) for component in medium.components()}
    expr = scalars.pop() if len(scalars) == 1 else None
    if expr is None:
        raise InputError(
            f"this medium looks at {', '.join(medium.names) or 'no field'}: give values by name, "
            f"medium({{{', '.join(f'{name!r}: …' for name in medium.names)}}})"
        )
    return expr


def is_surface(component: Medium) -> bool:
    """Return whether it shows surfaces, of which a crossing has an opacity."""
    colors = colors_of(component)
    return colors is not None and colors.opacities is not None


def _check_given(medium: Medium, given: Mapping[str, Any]) -> None:
    needed: dict[str, None] = {}
    for component in medium.components():
        exprs = [feature.expr for feature in component.features()]
        for expr in exprs:
            needed |= dict.fromkeys((expr.text,) if expr.text in given else expr.names)
        seen = {name for expr in exprs for name in expr.names}
        needed |= {name: None for name in component.names if name not in seen}
    missing = [name for name in needed if name not in given]
    if missing:
        listed = ", ".join(f"{name!r}: …" for name in (*given, *missing))
        raise InputError(
            f"this medium also looks at {', '.join(missing)}: give values of all, "
            f"medium({{{listed}}})"
        )


def _length_unit(medium: Medium, fields: GivenValues) -> Unit:
    components = medium.components()
    units = [component.length_unit(fields.expression_unit) for component in components]
    # An extinction in another unit is refused later, where there is a unit of length.
    spatial = ("length", "angle")
    lengths = [u if u.physical_type in spatial else parse_unit("cm") for u in units if u]
    numbers = [c.path_length for c in components if isinstance(c.path_length, float)]
    if lengths and numbers:
        raise UnitsError(
            f"path_length={numbers[0]:g} has no unit, as other lengths of this medium have; "
            "give it one, such as '0.1 pc'"
        )
    return parse_unit(lengths[0]) if lengths else None


def units_of(medium: Medium, fields: Evaluation) -> tuple[Unit, Unit]:
    """Return the units of j and of α."""
    per_length = None if fields.unit is None else parse_unit(fields.unit**-1)
    emission = medium.emission_unit(fields.expression_unit)
    return (per_length if emission is None else parse_unit(emission)), per_length


def one_path_length(component: Medium) -> Medium:
    """Return a component whose colours and opacities are those per unit of length."""
    return component if component.path_length is None else component.changed(path_length=1.0)
