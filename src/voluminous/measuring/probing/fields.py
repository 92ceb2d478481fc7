"""What the fields and the expressions of a medium are in the segments of a ray."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...expressions import Expression, NumpyOps
from ...units import unit_name
from ..quantity import Quantity


def looked_at(medium: Any) -> tuple[list[Expression], list[Expression]]:
    """Return a medium's fields, and its expressions that are more than a field."""
    fields = [Expression(name) for name in medium.names]
    known = [expr for expr, _ in medium.known_expressions()]
    texts = {expr.text for expr in fields}
    more = {e.text: e for e in known if e.text not in texts and e.names}
    return fields, list(more.values())


def in_cells(volume: Any, expr: Expression, cells: np.ndarray) -> np.ndarray:
    """Return an expression in some cells; NaN where their number is negative."""
    known = {c: volume.evaluate_cells(expr, c, c + 1)[0] for c in np.unique(cells) if c >= 0}
    return np.array([known.get(c, np.nan) for c in cells], dtype=np.float64)


def on_the_ray(expr: Expression, recorded: dict[str, np.ndarray]) -> np.ndarray:
    """Return an expression of fields that were interpolated."""
    with np.errstate(all="ignore"):
        values = expr.evaluate(NumpyOps(), {name: recorded[name] for name in expr.names})
    count = len(next(iter(recorded.values())))
    return np.broadcast_to(np.asarray(values, dtype=np.float64), (count,))


def wanted(volume: Any, expressions: Any) -> list[Expression]:
    """Return expressions that a user asks for.

    Raises
    ------
    InputError, UnknownNameError
        If one is no expression, or names a field that does not exist.
    """
    several = isinstance(expressions, (list, tuple))
    listed = list(expressions) if several else [expressions]
    quantities = [Quantity.of(volume, expr, "also") for expr in listed]
    return [Expression.of_tree(q.expression.tree, q.expression.names, q.text) for q in quantities]


def units_of(volume: Any, expressions: list[Expression]) -> dict[str, str]:
    """Return the names of the expressions' units."""
    return {e.text: unit_name(volume.expression_unit(e)) for e in expressions}
