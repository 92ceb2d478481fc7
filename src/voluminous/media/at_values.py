"""Emissivity and extinction of a medium at values of what it looks at."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..backend import dr, get_backend
from ..errors import InputError, unknown_name
from ..expressions import Expression, Margin
from ..units import plain, unit_of
from .context import Context
from .contract import Medium


class _Given(Context):
    """Values of an expression in place of those of fields."""

    given: dict[str, Any]

    def evaluate(self, expression: Expression | Margin, fields: dict[str, Any]) -> Any:
        found = self.given.get(getattr(expression, "text", ""))
        return super().evaluate(expression, fields) if found is None else found


def coefficients_at(
    medium: Medium, values: Any, unit: Any = None, unit_of_expression: Any = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return j and α; see `Medium.__call__`. Units are those of the values unless told."""
    scalars = [expr.text for expr in medium.scalars()]
    if isinstance(values, Mapping):
        for name in medium.names:
            if name not in values:
                raise unknown_name("field among the values", name, values)
        given = dict(values)
    elif len(scalars) == 1 and set(medium.names) <= set(medium.scalars()[0].names):
        given = {scalars[0]: values}
    elif not scalars and len(medium.names) == 1:
        given = {medium.names[0]: values}
    else:
        raise InputError(
            f"the medium looks at {', '.join(medium.names)}: give a dict with values of each"
        )
    units = {name: unit_of(value) for name, value in given.items()}
    numbers = {
        name: np.asarray(plain(value, units[name], name), dtype=np.float64)
        for name, value in given.items()
    }
    shape = np.broadcast_shapes(*(array.shape for array in numbers.values()))
    real = get_backend("cpu", "double").Float
    arrays = {
        name: real(np.ascontiguousarray(np.broadcast_to(array, shape)).ravel())
        for name, array in numbers.items()
    }
    lengths = (part.path_length for part in medium.components())
    if unit is None:  # j and α are per this unit
        unit = next((unit_of(v) for v in lengths if not isinstance(v, str) and unit_of(v)), None)
    context = _Given(
        real,
        lambda value: dr.opaque(real, value),
        unit,
        unit_of_expression or (lambda expr: units.get(expr.text)),
    )
    context.given = arrays
    found = medium.coefficients(arrays, context)
    spread = dr.zeros(real, int(np.prod(shape)))
    j, alpha = (
        np.stack([np.asarray((spread + v).numpy()).reshape(shape) for v in every], axis=-1)
        for every in (found.emissivity, found.extinction)
    )
    return j, alpha[..., 0] if medium.grey else alpha
