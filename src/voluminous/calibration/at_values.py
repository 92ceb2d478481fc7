"""Emissivity and extinction of a medium at given values of what it looks at."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..backend import from_host, get_backend
from ..errors import InputError, UnitsError, unknown_name
from ..evaluation import Evaluation
from ..expressions import Expression
from ..fields import split_unit, unit_quantity
from ..media import Context, Isosurface, Medium
from ..media.function import Function
from ..media.sum import with_each
from ..units import is_quantity, parse_unit, unit_name
from .plain import in_plain_numbers


class GivenValues(Evaluation):
    """Arrays of values by the names of fields, or of whole expressions, in place of a volume."""

    coordinates: tuple[str, ...] = ()

    def __init__(self, given: Mapping[str, Any]) -> None:
        self.unit: Any = None
        self._fields: dict[str, np.ndarray] = {}
        self._units: dict[str, Any] = {}
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

    def field_unit(self, name: str) -> Any:
        return self._units[name]

    def check_names(self, expression: Expression) -> None:
        for name in expression.names:
            if name not in self._fields:
                raise unknown_name("field", name, self._fields)

    def given(self, names: Iterable[str]) -> set[str]:
        return set(names) & self._fields.keys()

    def resolved(self, expression: Expression) -> tuple[Expression, Any]:
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

    def evaluate(self, expression: Any, fields: dict[str, Any]) -> Any:
        found = fields.get(getattr(expression, "text", ""))
        return super().evaluate(expression, fields) if found is None else found


def evaluate(medium: Medium, values: Any) -> tuple[Any, Any]:
    """Return j and α at values; see `Medium.__call__`."""
    medium = _per_path_length(medium)
    given = values if isinstance(values, Mapping) else {_only(medium).text: values}
    _check_given(medium, given)
    fields = GivenValues(given)
    fields.unit = _length_unit(medium, fields)
    medium = in_plain_numbers(medium, fields)  # type: ignore[arg-type]
    j, alpha = coefficients(medium, fields.arrays(), fields.unit, fields.expression_unit)
    return tuple(
        array if unit is None else unit_quantity(np.asarray(array), unit)
        for array, unit in zip((j, alpha), units_of(medium, fields), strict=True)
    )  # type: ignore[return-value]


def coefficients(
    medium: Medium, arrays: Mapping[str, np.ndarray], unit: Any, unit_of: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return j (channel, …) and α, (…) if it is grey or (channel, …), in double precision."""
    shape = np.broadcast_shapes(*(np.shape(array) for array in arrays.values()))
    real = get_backend("cpu", "double")
    fields = {
        name: from_host(real.Float, np.broadcast_to(array, shape).ravel())
        for name, array in arrays.items()
    }
    size = int(np.prod(shape))
    if not size:
        return np.zeros((medium.channels, *shape)), np.zeros(
            shape if medium.grey else (medium.channels, *shape)
        )
    found = medium.coefficients(fields, _Given(real.Float, real.opaque, unit, unit_of))
    rows = [np.broadcast_to(np.array(value), size).reshape(shape) for value in found.listed()]
    j, alpha = np.stack(rows[: medium.channels]), np.stack(rows[medium.channels :])
    return j, alpha[0] if medium.grey else alpha


def _only(medium: Medium) -> Expression:
    found = {scalar_of(part) for part in medium.components()}
    expr = found.pop() if len(found) == 1 else None
    if expr is None:
        raise InputError(
            f"this medium looks at {', '.join(medium.names) or 'no field'}: give values by name, "
            f"medium({{{', '.join(f'{name!r}: …' for name in medium.names)}}})"
        )
    return expr


def scalar_of(part: Medium) -> Expression | None:
    """Return what a part is a function of; None of several fields, and of none."""
    if part.scalars():
        return part.scalars()[0]
    return Expression(part.names[0]) if len(part.names) == 1 else None


def _check_given(medium: Medium, given: Mapping[str, Any]) -> None:
    """Refuse values that are not all that a medium looks at, and surfaces without a width."""
    needed: dict[str, None] = {}
    for part in medium.components():
        if isinstance(part, Isosurface) and not part.thick:
            raise InputError(
                "an Isosurface of width 0 has no j and α: a crossing of it shows color times "
                "opacity; medium.plot(volume) draws where it is"
            )
        own = [feature.expr for feature in part.features()]
        own = own or [Expression(name) for name in part.names]
        own += [part.slope] if isinstance(part, Isosurface) else []
        for expr in own:
            needed.update(dict.fromkeys((expr.text,) if expr.text in given else expr.names))
    missing = [name for name in needed if name not in given]
    if missing:
        listed = ", ".join(f"{name!r}: …" for name in (*given, *missing))
        raise InputError(
            f"this medium also looks at {', '.join(missing)}: give values of all, "
            f"medium({{{listed}}})"
        )


def _per_path_length(medium: Medium) -> Medium:
    """Return a medium with 1 for its path lengths, if all are still to be measured."""
    lengths = [p.path_length for p in medium.components() if not isinstance(p, Isosurface)]
    open_ones = [isinstance(length, str) for length in lengths]
    if not any(open_ones):
        return medium
    if not all(open_ones):
        raise InputError(
            "path_length is 'auto' in one part of this medium and a length in others: give "
            "medium.calibrated(volume) values"
        )
    return with_each(medium, one_path_length)


def _length_unit(medium: Medium, fields: GivenValues) -> Any:
    parts = medium.components()
    found = [p.path_length.unit for p in parts if is_quantity(p.path_length)]
    for part in parts:
        own = part.formulas() if isinstance(part, Function) and part.units is None else part
        units = [fields.expression_unit(e) for e in getattr(own, "extinction", ())]
        units += [part.units[1]] if isinstance(part, Function) and part.units else []
        # What is no inverse length is refused where there is a unit of length.
        lengths = (unit**-1 for unit in units if unit is not None)
        found += [u if u.physical_type == "length" else parse_unit("cm") for u in lengths]
    plain_ones = [p for p in parts if isinstance(p.path_length, float)]
    if found and plain_ones:
        raise UnitsError(
            f"path_length={plain_ones[0].path_length:g} has no unit, as other lengths of this "
            "medium have; give it one, such as '0.1 pc'"
        )
    return parse_unit(found[0]) if found else None


def units_of(medium: Medium, fields: Any) -> tuple[Any, Any]:
    """Return the units of j and of α."""
    per_length = None if fields.unit is None else parse_unit(fields.unit**-1)
    own = medium.intensity_unit(Context(float, float, fields.unit, fields.expression_unit))
    if own is None:
        return per_length, per_length
    return (own if fields.unit is None else parse_unit(own / fields.unit)), per_length


def one_path_length(part: Any) -> Any:
    """Return a part whose colours and opacities are those per unit of length."""
    return part if part.path_length is None else part.changed(path_length=1.0)
