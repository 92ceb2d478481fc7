"""The unit of an expression, found by evaluating it on quantities of size one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .ops import NumpyOps, Ops


class UnitOps(NumpyOps):
    """Evaluation that leaves the values' units alone; NumPy's functions know astropy's quantities.

    Raises astropy's ``UnitsError`` (or TypeError) where a unit has no meaning, as in the logarithm
    of a density or the sum of a length and a mass.
    """

    def prepare(self, values: Mapping[str, Any]) -> tuple[Ops, dict[str, Any]]:
        """Return this evaluator and the values as they are."""
        return self, dict(values)

    def number(self, value: Any) -> Any:
        """Return the value as it is."""
        return value
