"""Properties of expressions along a ray: where they jump, are smooth, or monotonic.

An expression jumps where two sides of a comparison are equal. Along a piece of ray fields are
polynomials with Bézier control points. Sums of them have the sums of these, and stay between them
(Farin 2002, section 5.1); so does a monotonic function of a sum.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise
from typing import Any

from .ops import Ops
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
    in_steps,
    nodes,
)


class Monotonicity(IntEnum):
    """What is known of an expression: each includes those before it."""

    CONSTANT = 0
    SUM = 1
    MONOTONIC = 2
    ANY = 3


_SUMS = ("add", "subtract", "negative", "positive")
_MONOTONIC = ("log10", "log", "exp", "sqrt", "tanh")
_LIMITS = ("min", "max", "clip")


def kind_of(
    node: Node, curved: Collection[str] = (), steps: Sequence[Monotonicity] = ()
) -> Monotonicity:
    """Return what is known of an expression.

    Parameters
    ----------
    node : Node
        The tree.
    curved : collection of str
        Names that are no polynomials along rays, such as the radius.
    steps : sequence of Monotonicity
        What is known of the steps before it.
    """
    match node:
        case Constant():
            return Monotonicity.CONSTANT
        case Field(name):
            return Monotonicity.ANY if name in curved else Monotonicity.SUM
        case Earlier(step):
            return steps[step]
        case Steps(own, result):
            kinds: list[Monotonicity] = []
            for one in own:
                kinds.append(kind_of(one, curved, kinds))
            return kind_of(result, curved, kinds)
        case IntegerPower(base, exponent):
            return _whole_power(kind_of(base, curved, steps), exponent)
        case Call("power", (base, Constant(exponent))) if exponent.is_integer():
            return _whole_power(kind_of(base, curved, steps), exponent)
        case Interpolation(argument, _, entries):
            return _table(kind_of(argument, curved, steps), entries)
        case Call(operation, arguments):
            return _call(operation, [kind_of(a, curved, steps) for a in arguments])
    return Monotonicity.ANY


def _call(operation: str, kinds: list[Monotonicity]) -> Monotonicity:
    most, varying = max(kinds), sum(k != Monotonicity.CONSTANT for k in kinds)
    if most == Monotonicity.CONSTANT or (operation in _SUMS and most == Monotonicity.SUM):
        return most
    if varying > 1 or most == Monotonicity.ANY:
        return Monotonicity.ANY
    if operation == "multiply" or (operation == "divide" and kinds[1] == Monotonicity.CONSTANT):
        return most
    # A power has no value for negative numbers, unless its exponent is whole.
    if operation in (*_SUMS, *_MONOTONIC, *_LIMITS, "power"):
        return Monotonicity.MONOTONIC
    return Monotonicity.ANY


def _table(argument: Monotonicity, entries: tuple[float, ...]) -> Monotonicity:
    if argument in (Monotonicity.CONSTANT, Monotonicity.ANY):
        return argument
    one_way = list(entries) in (sorted(entries), sorted(entries, reverse=True))
    return Monotonicity.MONOTONIC if one_way else Monotonicity.ANY


def _whole_power(base: Monotonicity, exponent: float) -> Monotonicity:
    """Return what is known of a whole power: odd ones grow with the base, if they have no pole."""
    if base == Monotonicity.CONSTANT:
        return base
    return (
        max(base, Monotonicity.MONOTONIC)
        if exponent > 0 and exponent % 2 == 1
        else Monotonicity.ANY
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

    def kind(self, curved: Collection[str] = ()) -> Monotonicity:
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
