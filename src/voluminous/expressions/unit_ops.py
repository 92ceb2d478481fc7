"""The unit of an expression, found by evaluating it on quantities of size one."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..errors import UnitsError
from ..units import parse_unit, unit_name
from .expression import Expression
from .ops import NumpyOps, Ops
from .tree import Steps


class _MixedUnitsError(Exception):
    """Numbers of one kind in different units, which an expression would take as they are."""


def unit_of(expression: Expression, units: tuple[Any, ...]) -> Any:
    """Return the unit of an expression, None where it has none.

    An expression that takes a number out of a unit (``log10(density)``) has none: its value is what
    the fields' own units make it. So has what a function computes with plain numbers.

    Parameters
    ----------
    expression : Expression
    units : tuple of astropy unit or None
        Those of the fields in it, in the order of its `names`.

    Raises
    ------
    UnitsError
        If numbers of one kind, but in different units, are added or compared: the fields would be
        taken as plain numbers.
    """
    if isinstance(expression.tree, Steps) or not any(unit is not None for unit in units):
        return None
    return _found(expression, units)


@functools.lru_cache(maxsize=256)
def _found(expression: Expression, units: tuple[Any, ...]) -> Any:
    from astropy import units as u

    ones = {
        name: u.Quantity(1.0, unit if unit is not None else u.dimensionless_unscaled)
        for name, unit in zip(expression.names, units, strict=True)
    }
    try:
        value = expression.evaluate(UnitOps(), ones)
    except _MixedUnitsError as error:
        named = ", ".join(
            f"{name} in {unit_name(unit)}"
            for name, unit in zip(expression.names, units, strict=True)
            if unit is not None
        )
        raise UnitsError(
            f"{expression.text!r} adds or compares {error}, and expressions compute with plain "
            f"numbers in the units of their fields ({named}); convert one of them first: "
            "volume[name] = volume[name].to(unit)"
        ) from None
    except (u.UnitsError, TypeError, ValueError, UnitsError):
        return None
    return parse_unit(getattr(value, "unit", None))


def _alike(operation: Callable[..., Any]) -> Any:
    """Return an operation that refuses numbers of one kind in different units."""

    def checked(left: Any, right: Any) -> Any:
        _check_alike(left, right)
        return operation(left, right)

    return staticmethod(checked)


def _check_alike(left: Any, right: Any) -> None:
    first, second = (getattr(value, "unit", None) for value in (left, right))
    if first is None or second is None or first == second or not first.is_equivalent(second):
        return
    raise _MixedUnitsError(f"numbers in {unit_name(first)} and numbers in {unit_name(second)}")


class UnitOps(NumpyOps):
    """Evaluation that leaves the values' units alone; NumPy's functions know astropy's quantities.

    Raises astropy's ``UnitsError`` (or TypeError) where a unit has no meaning, as in the logarithm
    of a density or the sum of a length and a mass; an error of our own where numbers would have to
    be converted.
    """

    add = _alike(operator.add)
    subtract = _alike(operator.sub)
    less = _alike(operator.lt)
    less_equal = _alike(operator.le)
    greater = _alike(operator.gt)
    greater_equal = _alike(operator.ge)
    equal = _alike(operator.eq)
    minimum = _alike(NumpyOps.minimum)
    maximum = _alike(NumpyOps.maximum)
    remainder = _alike(NumpyOps.remainder)
    floor_divide = _alike(NumpyOps.floor_divide)
    atan2 = _alike(NumpyOps.atan2)

    def prepare(self, values: Mapping[str, Any]) -> tuple[Ops, dict[str, Any]]:
        """Return this evaluator and the values as they are."""
        return self, dict(values)

    def number(self, value: Any) -> Any:
        """Return the value as it is."""
        return value

    def where(self, condition: Any, chosen: Any, otherwise: Any) -> Any:  # type: ignore[override]
        """Return what NumPy does, of numbers in the same unit."""
        _check_alike(chosen, otherwise)
        return np.where(condition, chosen, otherwise)
