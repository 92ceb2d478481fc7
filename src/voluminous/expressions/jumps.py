"""Where expressions jump, which is where two sides of a comparison are equal; or not at all."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from .monotone import Kind, kind_of
from .ops import Ops
from .steps import in_steps
from .tree import (
    Call,
    Comparison,
    Constant,
    Earlier,
    Field,
    IntegerPower,
    Interpolation,
    Logic,
    Node,
    Steps,
    Where,
    nodes,
)

_ARITHMETIC = ("add", "subtract", "multiply", "divide", "negative", "positive")
_PEAKED = frozenset(
    ("divide", "exp", "power", "tanh", "sin", "cos", "tan", "atan2", "remainder", "floor_divide")
)
_PARTIAL = frozenset(
    ("divide", "power", "log", "log10", "sqrt", "tan", "remainder", "floor_divide")
)
_ORDER = frozenset(("less", "less_equal", "greater", "greater_equal"))
_SMOOTH = frozenset((*_ARITHMETIC, "log10", "log", "exp", "sqrt", "power", "tanh"))


@dataclass(frozen=True)
class Margin:
    """The difference of two sides of a comparison, evaluated like an `Expression`."""

    text: str
    names: tuple[str, ...]
    left: Node
    right: Node

    @property
    def smooth(self) -> bool:
        """Whether both sides are."""
        return is_smooth(self.left) and is_smooth(self.right)

    @property
    def partial(self) -> bool:
        """Whether one of the sides may be undefined, infinite or either of two values."""
        return is_partial(self.left) or is_partial(self.right)

    def kind(self, curved: Collection[str] = ()) -> Kind:
        """Return what is known of the difference; see `Expression.kind`."""
        return kind_of(Call("subtract", (self.left, self.right)), curved)

    def evaluate(self, ops: Ops, values: Mapping[str, Any]) -> Any:
        """Return the difference; it is zero where the comparison changes."""
        fitted, fields = ops.prepare({name: values[name] for name in self.names})
        return fitted.subtract(self.left.number(fitted, fields), self.right.number(fitted, fields))


def margins(tree: Node, text: str) -> tuple[Margin, ...]:
    """Return the margins of all comparisons in an expression."""
    found: list[Margin] = []
    before = tree.steps if isinstance(tree, Steps) else ()
    for node in nodes(tree):
        if isinstance(node, Comparison):
            for left, right in pairwise(in_steps(before, side) for side in node.operands):
                own = (
                    n.name for side in (left, right) for n in nodes(side) if isinstance(n, Field)
                )
                names = tuple(dict.fromkeys(own))
                found.append(Margin(f"{text}: margin {len(found)}", names, left, right))
    return tuple(found)


def is_smooth(tree: Node) -> bool:
    """Return whether there is nothing in an expression that jumps, bends sharply or oscillates."""
    return all(
        isinstance(node, (Constant, Field, Earlier, Steps, IntegerPower))
        or (isinstance(node, Call) and node.operation in _SMOOTH)
        for node in nodes(tree)
    )


def is_stepped(tree: Node) -> bool:
    """Return whether a tree is true or false by what is larger than what, and nothing else."""
    if isinstance(tree, Logic):
        return all(map(is_stepped, tree.arguments))
    return (
        isinstance(tree, Comparison)
        and _ORDER.issuperset(tree.operations)
        and not any(
            isinstance(node, (Comparison, Where)) for side in tree.operands for node in nodes(side)
        )
    )


def is_partial(tree: Node) -> bool:
    """Return whether an expression may be undefined, infinite or either of two values somewhere."""
    return any(
        isinstance(node, Comparison)
        or (isinstance(node, Call) and node.operation in _PARTIAL)
        or (isinstance(node, IntegerPower) and node.exponent < 0)
        for node in nodes(tree)
    )


def may_peak(tree: Node) -> bool:
    """Return whether there may be peaks in an expression that are narrower than what its fields do.

    Products and roots of fields bend no more than these.
    """
    return any(
        (isinstance(node, Call) and node.operation in _PEAKED)
        or isinstance(node, (Where, Interpolation))
        or (isinstance(node, IntegerPower) and not 0 < node.exponent < 4)
        for node in nodes(tree)
    )
