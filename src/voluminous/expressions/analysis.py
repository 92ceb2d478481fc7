"""How expressions depend on their fields: sums, and monotonic functions of sums.

Along a segment of a ray fields are polynomials with Bézier control points. A sum of fields has the
sums of these control points and stays between them (Farin 2002, section 5.1); so does a monotonic
function of a sum.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from enum import IntEnum

from .tree import Call, Constant, Earlier, Field, Node, Steps


class Monotonicity(IntEnum):
    """How an expression depends on its fields: each kind includes those before it."""

    CONSTANT = 0
    SUM = 1
    MONOTONIC = 2
    ANY = 3


_SUMS = {"add", "subtract", "negative", "positive"}
_MONOTONIC = {*_SUMS, "log10", "log", "exp", "sqrt", "tanh", "min", "max", "clip", "power"}


def kind_of(
    node: Node, curved: Collection[str] = (), steps: Sequence[Monotonicity] = ()
) -> Monotonicity:
    """Return how an expression depends on its fields, given the kinds of the steps before it.

    Fields in `curved`, such as the radius, are no polynomials along rays.
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
