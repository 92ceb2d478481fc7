"""Expressions on the cells of a volume; the base of `Volume`, which has the fields."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from .derivatives import component_of_cells, is_component
from .errors import UnitsError, UnknownNameError, unknown_name
from .expressions import (
    DerivedField,
    Expression,
    NumpyOps,
    components,
    has_units,
    required_names,
    resolve,
)
from .fields import coordinates, is_angle
from .geometry import CARTESIAN
from .units import Unit, parse_unit

# Cells evaluated at once: temporary arrays stay small beside the fields.
_CHUNK = 1 << 20


class Evaluation(ABC):
    """Values, names and units of expressions of a volume's fields and coordinates."""

    grid: Any
    unit: Unit
    coordinates: Any
    _fields: Any
    _units: dict[str, Unit]
    array: Callable[[str], np.ndarray]
    field_unit: Callable[[str], Unit]
    given: Callable[[Iterable[str]], set[str]]
    refresh: Callable[[], None]
    seen_by: Callable[[Any], Evaluation]
    _derived: Callable[[str], DerivedField | None]

    @abstractmethod
    def __contains__(self, name: object) -> bool:
        """Return True for fields, and for what can be made of fields and coordinates."""

    def evaluate(self, expression: Any, *, camera: Any = None) -> np.ndarray:
        """Return an expression of fields and coordinates on all cells, as a plain array.

        Parameters
        ----------
        expression : str or Expression
            May use the coordinates ``x, y, z`` of the cell centres and their distance ``r`` from
            the origin, in the volume's unit; and the grid's own, such as ``theta`` and ``phi``.
            Numbers may have units: ``"velocity_z / (5 km/s)"``.
        camera : camera, optional
            From where it is seen, for components along the line of sight such as
            ``los("velocity")``; positive away from the observer.

        Returns
        -------
        array, of the grid's shape, or (3, …)
            Three components of a vector such as ``grad(density)``, which only text can be.
        """
        if camera is not None:
            return self.seen_by(camera).evaluate(expression)
        parts = tuple(self.without_units(part) for part in components(expression))
        self.refresh()
        if len(parts) == 1:
            return self._evaluate_whole(parts[0])
        return np.stack([self._evaluate_whole(part) for part in parts])

    def _evaluate_whole(self, expression: Expression) -> np.ndarray:
        size, out = self.grid.size, None
        for first in range(0, size, _CHUNK):
            last = min(first + _CHUNK, size)
            result = self.evaluate_cells(expression, first, last)
            if out is None:
                kind = np.float32 if result.dtype == np.float32 else np.float64
                out = np.empty(size, dtype=kind)
            out[first:last] = result
        assert out is not None
        return np.asarray(out.reshape(self.grid.shape))

    def evaluate_cells(
        self, expression: Expression, first: int, last: int, *, double: bool = False
    ) -> np.ndarray:
        """Return an expression on the cells with flat numbers from `first` to `last`.

        Computed in double precision whatever the fields are, if `double` is true: for sums.
        """
        expression = self.without_units(expression)
        others = [n for n in expression.names if n in self.coordinates and n not in self._fields]
        values = coordinates(self.grid, others, first, last) if others else {}
        for name in expression.names:
            if name not in values:
                own = self._cells(name, first, last)
                values[name] = own.astype(np.float64) if double else own
        result = np.asarray(expression.evaluate(NumpyOps(), values))
        return np.broadcast_to(result, (last - first,))  # a constant has no axes

    def _cells(self, name: str, first: int, last: int) -> np.ndarray:
        derived = self._derived(name)
        if derived is not None and is_component(derived):
            return component_of_cells(self, derived, first, last)  # not kept: it is quickly made
        return self.array(name).reshape(-1)[first:last]

    def check_names(self, expression: Expression) -> None:
        """Raise the error that names the nearest field if an expression uses an unknown one."""
        known = (*self._fields, *self.coordinates)
        for name in required_names(expression):
            if name in known or name in self:
                continue
            stem, _, axis = name.rpartition("_")
            if axis not in CARTESIAN or stem not in known:
                raise unknown_name("field", name, known)
            needed = ", ".join(f"{stem}_{a}" for a in CARTESIAN)
            raise UnknownNameError(
                f"unknown field {name!r}: {stem!r} is a number in every cell, and no vector, which "
                f"is three fields {needed}"
            )

    def without_units(self, expression: Expression) -> Expression:
        """Return an expression in plain numbers of the fields' units."""
        return self.resolved(expression)[0]

    def expression_unit(self, expression: Expression) -> Unit:
        """Return the unit of an expression (astropy), None for a plain number."""
        return self.resolved(expression)[1]

    def resolved(self, expression: Expression) -> tuple[Expression, Any]:
        """Return the results of `without_units` and of `expression_unit`."""
        expression = Expression(expression).among((*self._fields, *self.coordinates))
        self.check_names(expression)
        try:
            return resolve(expression, tuple(map(self._unit_in_expressions, expression.names)))
        except UnitsError:
            if has_units(expression) or any(self._units[n] for n in self.given(expression.names)):
                raise
            return expression, None  # of coordinates alone, such as exp(-r**2)

    def _unit_in_expressions(self, name: str) -> Any:
        """Return the unit of a field; radian of the grid's angles, which lengths may multiply."""
        angle = is_angle(name) and name in self.coordinates
        return parse_unit("rad") if angle else self.field_unit(name)
