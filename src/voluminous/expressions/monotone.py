"""Which expressions are monotonic functions of a sum of fields.

Along a piece of ray fields are polynomials with Bézier control points. Sums of them have the sums
of these, and stay between them (Farin 2002, section 5.1); so does what grows or falls with a sum.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from enum import IntEnum

from .tree import Call, Constant, Earlier, Field, IntegerPower, Interpolation, Node, Steps


class Kind(IntEnum):
    """What is known of an expression: each includes those before it."""

    CONSTANT = 0
    SUM = 1
    MONOTONIC = 2
    ANY = 3


_SUMS = ("add", "subtract", "negative", "positive")
_MONOTONIC = ("log10", "log", "exp", "sqrt", "tanh")
_LIMITS = ("min", "max", "clip")


def kind_of(node: Node, curved: Collection[str] = (), steps: Sequence[Kind] = ()) -> Kind:
    """Return what is known of an expression.

    Parameters
    ----------
    node : Node
        The tree.
    curved : collection of str
        Names that are no polynomials along rays, such as the radius.
    steps : sequence of Kind
        What is known of the steps before it.
    """
    match node:
        case Constant():
            return Kind.CONSTANT
        case Field(name):
            return Kind.ANY if name in curved else Kind.SUM
        case Earlier(step):
            return steps[step]
        case Steps(own, result):
            kinds: list[Kind] = []
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
    return Kind.ANY


def _call(operation: str, kinds: list[Kind]) -> Kind:
    most, varying = max(kinds), sum(k != Kind.CONSTANT for k in kinds)
    if most == Kind.CONSTANT or (operation in _SUMS and most == Kind.SUM):
        return most
    if varying > 1 or most == Kind.ANY:
        return Kind.ANY
    if operation == "multiply" or (operation == "divide" and kinds[1] == Kind.CONSTANT):
        return most
    # A power has no value for negative numbers, unless its exponent is whole.
    if operation in (*_SUMS, *_MONOTONIC, *_LIMITS, "power"):
        return Kind.MONOTONIC
    return Kind.ANY


def _table(argument: Kind, entries: tuple[float, ...]) -> Kind:
    if argument in (Kind.CONSTANT, Kind.ANY):
        return argument
    one_way = list(entries) in (sorted(entries), sorted(entries, reverse=True))
    return Kind.MONOTONIC if one_way else Kind.ANY


def _whole_power(base: Kind, exponent: float) -> Kind:
    """Return what is known of a whole power: odd ones grow with the base, if they have no pole."""
    if base == Kind.CONSTANT:
        return base
    return max(base, Kind.MONOTONIC) if exponent > 0 and exponent % 2 == 1 else Kind.ANY
