"""Properties of expressions along a ray: where they jump, whether they are smooth or monotonic.

An expression jumps where two sides of a comparison are equal. Along a segment of a ray fields are
polynomials with Bézier control points. A sum of fields has the sums of these control points and
stays between them (Farin 2002, section 5.1); so does a monotonic function of a sum.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise
from typing import TypeGuard

from .ops import Ops, Value
from .tree import Call, Constant, Earlier, Field, Node, Steps, field_names, in_steps, nodes


class Monotonicity(IntEnum):
    """How an expression depends on its fields: each kind includes those before it."""

    CONSTANT = 0
    SUM = 1
    MONOTONIC = 2
    ANY = 3


_SUMS = {"add", "subtract", "negative", "positive"}
_MONOTONIC = {*_SUMS, "log10", "log", "exp", "sqrt", "tanh", "min", "max", "clip", "power"}
_SMOOTH = {*_SUMS, "multiply", "divide", "log10", "log", "exp", "sqrt", "tanh", "power"}
_SMOOTH |= {"integer_power"}
_PARTIAL = {"divide", "power", "log", "log10", "sqrt", "tan", "remainder", "floor_divide"}
_PARTIAL |= {"compare"}
_PEAKED = {"divide", "exp", "power", "tanh", "sin", "cos", "tan", "atan2", "remainder"}
_PEAKED |= {"floor_divide", "where", "interp"}
_ORDER = {"less", "less_equal", "greater", "greater_equal"}


def kind_of(
    node: Node, curved: Collection[str] = (), steps: Sequence[Monotonicity] = ()
) -> Monotonicity:
    """Return how an expression depends on its fields.

    Parameters
    ----------
    node : Node
        The tree.
    curved : collection of str
        Names that are no polynomials along rays, such as the radius.
    steps : sequence of Monotonicity
        The kinds of the steps before it.
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
        case Call("compare" | "where" | "logical_and" | "logical_or" | "logical_not"):
            return Monotonicity.ANY
        case Call(_, arguments):
            return _kind_of_call(node, [kind_of(a, curved, steps) for a in arguments])
    return Monotonicity.ANY


def _kind_of_call(node: Call, kinds: list[Monotonicity]) -> Monotonicity:
    highest, varying = max(kinds), sum(kind != Monotonicity.CONSTANT for kind in kinds)
    if not varying or (node.operation in _SUMS and highest == Monotonicity.SUM):
        return highest
    if varying > 1 or highest == Monotonicity.ANY:
        return Monotonicity.ANY
    match node:
        case Call("multiply"):
            return highest
        case Call("divide") if kinds[1] == Monotonicity.CONSTANT:
            return highest
        case Call("interp", _, (_, entries)):
            monotonic = list(entries) in (sorted(entries), sorted(entries, reverse=True))
        case Call("integer_power", _, (exponent,)):
            monotonic = _is_odd(exponent)
        case Call("power", (_, Constant(exponent))) if exponent.is_integer():
            monotonic = _is_odd(exponent)
        case _:
            monotonic = node.operation in _MONOTONIC
    return Monotonicity.MONOTONIC if monotonic else Monotonicity.ANY


def _is_odd(exponent: float) -> bool:
    """Return whether a power increases with its base and has no pole."""
    return exponent > 0 and exponent % 2 == 1


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
        """Return how the difference depends on the fields; see `Expression.kind`."""
        return kind_of(Call("subtract", (self.left, self.right)), curved)

    def evaluate(self, ops: Ops, values: Mapping[str, Value]) -> Value:
        """Return the difference; it is zero where the comparison changes."""
        fitted, fields = ops.prepare({name: values[name] for name in self.names})
        return fitted.subtract(self.left.number(fitted, fields), self.right.number(fitted, fields))


def margins(tree: Node, text: str) -> tuple[Margin, ...]:
    """Return the margins of all comparisons in an expression."""
    steps = tree.steps if isinstance(tree, Steps) else ()
    pairs = [
        pair
        for node in nodes(tree)
        if isinstance(node, Call) and node.operation == "compare"
        for pair in pairwise(in_steps(steps, side) for side in node.arguments)
    ]
    return tuple(
        Margin(f"{text}: margin {k}", field_names(*pair), *pair) for k, pair in enumerate(pairs)
    )


def is_smooth(tree: Node) -> bool:
    """Return whether nothing in an expression jumps, bends sharply or oscillates."""
    return all(
        isinstance(node, (Constant, Field, Earlier, Steps)) or _is_call(node, _SMOOTH)
        for node in nodes(tree)
    )


def is_stepped(tree: Node) -> bool:
    """Return whether an expression is true or false by order comparisons alone."""
    match tree:
        case Call("logical_and" | "logical_or" | "logical_not", arguments):
            return all(map(is_stepped, arguments))
        case Call("compare", operands, (operations,)):
            below = (node for side in operands for node in nodes(side))
            return _ORDER.issuperset(operations) and not any(
                _is_call(node, {"compare", "where"}) for node in below
            )
    return False


def is_partial(tree: Node) -> bool:
    """Return whether an expression may be undefined, infinite or either of two values somewhere."""
    return any(
        _is_call(node, _PARTIAL) or (_is_call(node, {"integer_power"}) and node.constants[0] < 0)
        for node in nodes(tree)
    )


def may_peak(tree: Node) -> bool:
    """Return whether an expression may have peaks narrower than any structure of its fields.

    Products and roots of fields bend no more than these.
    """
    return any(
        _is_call(node, _PEAKED)
        or (_is_call(node, {"integer_power"}) and not 0 < node.constants[0] < 4)
        for node in nodes(tree)
    )


def _is_call(node: Node, operations: Collection[str]) -> TypeGuard[Call]:
    return isinstance(node, Call) and node.operation in operations
