"""The nodes of a parsed expression: immutable, comparable, and able to evaluate themselves."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, pairwise
from typing import Any

import numpy as np

from ..errors import UnitsError
from ..units import Unit
from .ops import Ops

Fields = Mapping[str, Any]


class Node:
    """A part of an expression."""

    __slots__ = ()

    def evaluate(self, ops: Ops, fields: Fields) -> Any:
        """Return the value: numbers or a mask."""
        raise NotImplementedError

    def number(self, ops: Ops, fields: Fields) -> Any:
        """Return the value as numbers; true is 1 and false is 0."""
        return ops.number(self.evaluate(ops, fields))

    def mask(self, ops: Ops, fields: Fields) -> Any:
        """Return the value as a mask; all but 0 is true."""
        return ops.mask(self.evaluate(ops, fields))


@dataclass(frozen=True, slots=True)
class Constant(Node):
    """A number; always a float, so that no literal can start big-integer arithmetic."""

    value: float

    def evaluate(self, ops: Ops, fields: Fields) -> Any:
        return ops.constant(self.value)


@dataclass(frozen=True, slots=True)
class Literal(Constant):
    """A number that is not to be turned: part of the machine code of a kernel."""

    def evaluate(self, ops: Ops, fields: Fields) -> Any:
        return ops.literal(self.value)


@dataclass(frozen=True, slots=True)
class NumberWithUnit(Node):
    """A number with a unit, which has no value before the units of the fields are known."""

    value: float
    unit: Unit

    def evaluate(self, ops: Ops, fields: Fields) -> Any:
        raise UnitsError(
            f"'{self.value:g} {self.unit}' is a number with a unit, which only a volume can "
            "convert: volume.evaluate, media, and measurements do; here write the number in the "
            "unit of the fields"
        )


@dataclass(frozen=True, slots=True)
class InUnit(Constant):
    """A plain number whose unit fits those of the fields it is combined with."""

    unit: Unit


@dataclass(frozen=True, slots=True)
class Field(Node):
    """The values of a named field."""

    name: str

    def evaluate(self, ops: Ops, fields: Fields) -> Any:
        return fields[self.name]


@dataclass(frozen=True, slots=True)
class Earlier(Node):
    """The value of a step before this one; see `Steps`."""

    step: int

    @property
    def name(self) -> str:
        """By which it is known among the fields; no field can have it."""
        return f"%{self.step}"

    def evaluate(self, ops: Ops, fields: Fields) -> Any:
        return fields[self.name]


@dataclass(frozen=True, slots=True)
class Derivative(Field):
    """A field made of the neighbouring elements of another one; its name is its text.

    The name says everything, so that the argument need not be compared.
    """

    operation: str = field(compare=False)
    argument: Node = field(compare=False)


@dataclass(frozen=True, slots=True)
class Call(Node):
    """An operation on numbers: arithmetic or a function; `operation` is a method of `Ops`."""

    operation: str
    arguments: tuple[Node, ...]

    def evaluate(self, ops: Ops, fields: Fields) -> Any:
        numbers = [argument.number(ops, fields) for argument in self.arguments]
        return getattr(ops, self.operation)(*numbers)


@dataclass(frozen=True, slots=True)
class IntegerPower(Node):
    """A power with a small whole exponent that is written in the expression."""

    base: Node
    exponent: int

    def evaluate(self, ops: Ops, fields: Fields) -> Any:
        return ops.integer_power(self.base.number(ops, fields), self.exponent)


@dataclass(frozen=True, slots=True)
class Comparison(Node):
    """A chain such as ``1 < x <= 2``: true where every neighbouring pair compares so."""

    operations: tuple[str, ...]
    operands: tuple[Node, ...]

    def evaluate(self, ops: Ops, fields: Fields) -> Any:
        values = [operand.number(ops, fields) for operand in self.operands]
        pairs = zip(self.operations, pairwise(values), strict=True)
        result, *others = (getattr(ops, operation)(*pair) for operation, pair in pairs)
        for other in others:
            result = ops.logical_and(result, other)
        return result


@dataclass(frozen=True, slots=True)
class Logic(Node):
    """A logical operation, ``and``, ``or`` or ``not``; `operation` is a method of `Ops`."""

    operation: str
    arguments: tuple[Node, ...]

    def evaluate(self, ops: Ops, fields: Fields) -> Any:
        result, *others = (argument.mask(ops, fields) for argument in self.arguments)
        if not others:
            return getattr(ops, self.operation)(result)
        for other in others:
            result = getattr(ops, self.operation)(result, other)
        return result


@dataclass(frozen=True, slots=True)
class Interpolation(Node):
    """A number looked up in a table: linear between its entries, constant beyond both ends."""

    argument: Node
    places: tuple[float, ...]
    entries: tuple[float, ...]

    def evaluate(self, ops: Ops, fields: Fields) -> Any:
        x = self.argument.number(ops, fields)
        return ops.interpolate(x, np.array(self.places), np.array(self.entries))


@dataclass(frozen=True, slots=True)
class Where(Node):
    """The one value where the condition is true, the other elsewhere."""

    condition: Node
    chosen: Node
    otherwise: Node

    def evaluate(self, ops: Ops, fields: Fields) -> Any:
        mask = self.condition.mask(ops, fields)
        return ops.where(mask, self.chosen.number(ops, fields), self.otherwise.number(ops, fields))


@dataclass(frozen=True, slots=True)
class Steps(Node):
    """A value computed step by step, as a function computes it: each is named, and found once.

    As one tree, where what is used twice is written twice, it may be of any size.
    """

    steps: tuple[Node, ...]
    result: Node

    def evaluate(self, ops: Ops, fields: Fields) -> Any:
        known = dict(fields)
        for number, step in enumerate(self.steps):
            known[Earlier(number).name] = step.evaluate(ops, known)
        return self.result.evaluate(ops, known)


def nodes(tree: Node) -> Iterator[Node]:
    """Yield a node and all below it; what a derivative is made of is a field of its own."""
    yield tree
    if isinstance(tree, Field):
        return
    for part in dataclasses.fields(tree):  # type: ignore[arg-type]
        value = getattr(tree, part.name)
        for below in value if isinstance(value, tuple) else (value,):
            if isinstance(below, Node):
                yield from nodes(below)


def in_steps(steps: Sequence[Node], result: Node) -> Node:
    """Return a result with the steps that it needs, no others: the same for the same formula."""
    needed: set[int] = set()
    waiting = [result]
    while waiting:
        for number in _earlier(waiting.pop()):
            if number not in needed:
                needed.add(number)
                waiting.append(steps[number])
    if not needed:
        return result
    new = {old: k for k, old in enumerate(sorted(needed))}
    return Steps(tuple(_renumbered(steps[old], new) for old in new), _renumbered(result, new))


def _earlier(node: Node) -> list[int]:
    return [below.step for below in nodes(node) if isinstance(below, Earlier)]


def _renumbered(node: Any, new: dict[int, int]) -> Any:
    if isinstance(node, tuple):
        return tuple(_renumbered(part, new) for part in node)
    if isinstance(node, Earlier):
        return Earlier(new[node.step])
    if not isinstance(node, Node) or not _earlier(node):
        return node
    parts = {f.name: getattr(node, f.name) for f in dataclasses.fields(node)}  # type: ignore[arg-type]
    return type(node)(**{name: _renumbered(value, new) for name, value in parts.items()})


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
_CLOSED = (Field, Earlier, Where, Interpolation, NumberWithUnit)

# A number in the name of a unit, as in 1e-20 erg, which the language has no place for.
_SCALED = re.compile(r"(?:^|\s\(?|dex\()(?!1 /)\d")


def text(node: Node) -> str:
    """Return a text that is parsed into this very tree; steps, which no text has, one by one."""
    match node:
        case NumberWithUnit(value, unit) | InUnit(value, unit) if unit is not None:
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


def _quantity(value: float, unit: Unit) -> str:
    shown = str(unit)
    if _SCALED.search(shown):
        dex = is_dex(unit)
        own = (unit.physical_unit if dex else unit).decompose()
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


def is_dex(unit: Unit) -> bool:
    """Return whether a unit is that of a logarithm, such as dex(g / cm3)."""
    return hasattr(unit, "physical_unit")
