"""Conditions: in which cells something is measured."""

from __future__ import annotations

from typing import Any

from .quantity import Quantity


def condition(volume: Any, text: Any, what: str = "where") -> Quantity:
    """Return a condition, an expression that is zero where it does not hold.

    Raises
    ------
    UnitsError
        If a number's unit does not fit what it is compared with.
    ExpressionError, UnknownNameError
        If it cannot be understood.
    """
    return Quantity.of(volume, text, what)


def holds(volume: Any, what: Quantity, first: int, last: int) -> Any:
    """Return in which cells a condition holds; not where it has no value."""
    values = volume.evaluate_cells(what.expression, first, last)
    return (values != 0) & (values == values)
