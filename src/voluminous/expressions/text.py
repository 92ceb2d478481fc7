"""From a tree back to text, the same for all ways to write an expression."""

from __future__ import annotations

import math
import re
from itertools import chain
from typing import Any

from .tree import (
    Call,
    Comparison,
    Constant,
    Earlier,
    Field,
    IntegerPower,
    Interpolation,
    InUnit,
    Logic,
    Node,
    Quantity,
    Steps,
    Where,
)

_PREFIX = {"negative": "-", "positive": "+", "logical_not": "not "}
_INFIX = {
    "add": "+",
    "subtract": "-",
    "multiply": "*",
    "divide": "/",
    "floor_divide": "//",
    "remainder": "%",
    "power": "**",
    "less": "<",
    "less_equal": "<=",
    "greater": ">",
    "greater_equal": ">=",
    "equal": "==",
    "not_equal": "!=",
    "logical_and": "and",
    "logical_or": "or",
}
# What needs no parentheses wherever it stands.
_CLOSED = (Field, Earlier, Where, Interpolation, Quantity)

# A number in the name of a unit, as in 1e-20 erg, which the language has no place for.
_SCALED = re.compile(r"(?:^|\s\(?|dex\()(?!1 /)\d")


def text(node: Node) -> str:
    """Return a text that is parsed into this very tree; steps, which no text has, one by one."""
    match node:
        case Quantity(value, unit) | InUnit(value, unit) if unit is not None:
            return _quantity(value, unit)
        case Constant(value):
            return repr(value).removesuffix(".0")
        case Field(name):  # a derivative too
            return name
        case Earlier():
            return node.name
        case Steps(steps, result):
            named = [f"{Earlier(k).name} = {text(step)}" for k, step in enumerate(steps)]
            return "; ".join([*named, text(result)])
        case IntegerPower(base, exponent):
            return f"{_operand(base)} ** {exponent}"
        case Comparison(operations, operands):
            return _chained([_INFIX[operation] for operation in operations], operands)
        case Interpolation(argument, places, entries):
            return f"interp({text(argument)}, {_numbers(places)}, {_numbers(entries)})"
        case Where(condition, chosen, otherwise):
            return f"where({_listed((condition, chosen, otherwise))})"
        case Call(operation, arguments) | Logic(operation, arguments):
            return _operation(operation, arguments)
    raise TypeError(f"not a number in an expression: {node!r}")


def _quantity(value: float, unit: Any) -> str:
    shown = str(unit)
    if _SCALED.search(shown):
        own = getattr(unit, "physical_unit", unit).decompose()
        dex = hasattr(unit, "physical_unit")
        value = value + math.log10(own.scale) if dex else value * own.scale
        shown = str(type(own)(1.0, own.bases, own.powers))
        shown = f"dex({shown})" if dex and shown else shown
    return f"({text(Constant(value))} {shown.replace('%', 'percent')}".rstrip() + ")"


def _operation(operation: str, arguments: tuple[Node, ...]) -> str:
    if operation in _PREFIX:
        return _PREFIX[operation] + _operand(arguments[0])
    if operation in _INFIX:
        return _chained([_INFIX[operation]] * (len(arguments) - 1), arguments)
    return f"{operation}({_listed(arguments)})"


def _chained(symbols: list[str], operands: tuple[Node, ...]) -> str:
    first, *others = (_operand(operand) for operand in operands)
    return " ".join((first, *chain.from_iterable(zip(symbols, others, strict=True))))


def _operand(node: Node) -> str:
    """Return the text of an operand, in parentheses unless it can do without."""
    shown = text(node)
    simple = isinstance(node, Constant) and not shown.startswith("-")
    function = isinstance(node, Call) and node.operation not in _PREFIX | _INFIX
    return shown if simple or function or isinstance(node, _CLOSED) else f"({shown})"


def _numbers(values: tuple[float, ...]) -> str:
    return f"[{', '.join(text(Constant(value)) for value in values)}]"


def _listed(nodes: tuple[Node, ...]) -> str:
    return ", ".join(text(node) for node in nodes)
