"""Expressions on one side of all that they compare: where no comparison changes.

``where(a > 1, b, c)`` is b or c there, both of which may be smooth. Each comparison becomes a field
that is one or zero.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from .expression import Expression
from .steps import in_steps
from .tree import Comparison, Field, Node, Steps, nodes


@dataclass(frozen=True)
class Side:
    """A comparison, and the field that tells whether it holds."""

    name: str
    condition: Expression


def on_one_side(
    expressions: Iterable[Expression],
) -> tuple[tuple[Expression, ...], tuple[Side, ...]]:
    """Return expressions without comparisons, and what these were, each once."""
    sides: dict[Node, Side] = {}
    found = tuple(_decided(expression, sides) for expression in expressions)
    return found, tuple(sides.values())


def _decided(expression: Expression, sides: dict[Node, Side]) -> Expression:
    tree = expression.tree
    before = tree.steps if isinstance(tree, Steps) else ()

    def side_of(node: Comparison) -> Field:
        own = in_steps(before, node)
        if own not in sides:
            name = f"%side {len(sides)}"
            condition = Expression.of_tree(own, _fields(own), f"{expression.text}: {name}")
            sides[own] = Side(name, condition)
        return Field(sides[own].name)

    new = _replaced(tree, side_of)
    return Expression.of_tree(new, _fields(new), f"{expression.text}: on one side")


def _fields(tree: Node) -> tuple[str, ...]:
    return tuple(dict.fromkeys(node.name for node in nodes(tree) if isinstance(node, Field)))


def _replaced(node: Any, side_of: Any) -> Any:
    if isinstance(node, tuple):
        return tuple(_replaced(part, side_of) for part in node)
    if isinstance(node, Comparison):
        return side_of(node)
    if not isinstance(node, Node) or isinstance(node, Field):
        return node
    parts = {f.name: getattr(node, f.name) for f in dataclasses.fields(node)}  # type: ignore[arg-type]
    return type(node)(**{name: _replaced(value, side_of) for name, value in parts.items()})
