"""Parsed expressions: immutable, comparable trees of nodes that any `Ops` evaluates."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, TypeAlias

from ..errors import UnitsError
from ..units import Unit
from .ops import Ops, Value

Fields: TypeAlias = Mapping[str, Value]

# How many arguments of an operation, from the first on, are masks; the others are numbers.
_MASKS = {"where": 1, "logical_not": 1, "logical_and": math.inf, "logical_or": math.inf}


class Node:
    """A part of an expression."""

    __slots__ = ()

    @property
    def children(self) -> tuple[Node, ...]:
        """The nodes it is computed from; a derivative is a field, and has none."""
        return ()

    def with_children(self, children: tuple[Node, ...]) -> Node:
        """Return the same operation on other children."""
        return self

    def evaluate(self, ops: Ops, fields: Fields) -> Value:
        """Return the value: numbers or a mask."""
        raise NotImplementedError

    def number(self, ops: Ops, fields: Fields) -> Value:
        return ops.number(self.evaluate(ops, fields))

    def mask(self, ops: Ops, fields: Fields) -> Value:
        """Return the value as a mask: any number but 0 is true."""
        return ops.mask(self.evaluate(ops, fields))


@dataclass(frozen=True, slots=True)
class Constant(Node):
    """A number; always a float, so that no literal can start big-integer arithmetic."""

    value: float

    def evaluate(self, ops: Ops, fields: Fields) -> Value:
        return ops.constant(self.value)


@dataclass(frozen=True, slots=True)
class Literal(Constant):
    """A number that is compiled into the kernel."""

    def evaluate(self, ops: Ops, fields: Fields) -> Value:
        return ops.literal(self.value)


@dataclass(frozen=True, slots=True)
class InUnit(Constant):
    """A number whose unit was converted to fit the fields."""

    unit: Unit


@dataclass(frozen=True, slots=True)
class NumberWithUnit(Node):
    """A number with a unit, before the units of the fields are known."""

    value: float
    unit: Unit

    def evaluate(self, ops: Ops, fields: Fields) -> Value:
        raise UnitsError(
            f"'{self.value:g} {self.unit}' is a number with a unit, which only a volume can "
            "convert: volume.evaluate, media, and measurements do; here write the number in the "
            "unit of the fields"
        )


@dataclass(frozen=True, slots=True)
class Field(Node):
    """The values of a named field."""

    name: str

    def evaluate(self, ops: Ops, fields: Fields) -> Value:
        return fields[self.name]


@dataclass(frozen=True, slots=True)
class Derivative(Field):
    """A field computed from neighbouring cells of another; its name, its text, identifies it."""

    operation: str = field(compare=False)
    argument: Node = field(compare=False)


@dataclass(frozen=True, slots=True)
class Earlier(Node):
    """The value of an earlier step; see `Steps`."""

    step: int

    @property
    def name(self) -> str:
        """Its name among the fields; no field can have it."""
        return f"%{self.step}"

    def evaluate(self, ops: Ops, fields: Fields) -> Value:
        return fields[self.name]


@dataclass(frozen=True, slots=True)
class Call(Node):
    """An operation, a method of `Ops`, on the values of other nodes.

    `constants` are further arguments, which are no nodes: an exponent, a table, or the comparisons
    of a chain such as ``1 < x <= 2``.
    """

    operation: str
    arguments: tuple[Node, ...]
    constants: tuple[Any, ...] = ()

    @property
    def children(self) -> tuple[Node, ...]:
        return self.arguments

    def with_children(self, children: tuple[Node, ...]) -> Node:
        return Call(self.operation, children, self.constants)

    def evaluate(self, ops: Ops, fields: Fields) -> Value:
        masks = _MASKS.get(self.operation, 0)
        values = [
            node.mask(ops, fields) if k < masks else node.number(ops, fields)
            for k, node in enumerate(self.arguments)
        ]
        return getattr(ops, self.operation)(*values, *self.constants)


@dataclass(frozen=True, slots=True)
class Steps(Node):
    """A result computed in steps, each of which is evaluated once.

    Written out as one tree, a function that uses intermediate values twice may be of any size.
    """

    steps: tuple[Node, ...]
    result: Node

    @property
    def children(self) -> tuple[Node, ...]:
        return (*self.steps, self.result)

    def with_children(self, children: tuple[Node, ...]) -> Node:
        return Steps(children[:-1], children[-1])

    def evaluate(self, ops: Ops, fields: Fields) -> Value:
        values = dict(fields)
        for number, step in enumerate(self.steps):
            values[Earlier(number).name] = step.evaluate(ops, values)
        return self.result.evaluate(ops, values)


def nodes(tree: Node) -> Iterator[Node]:
    """Yield a node and all nodes below it."""
    yield tree
    for child in tree.children:
        yield from nodes(child)


def replaced(node: Node, change: Callable[[Node], Node | None]) -> Node:
    """Return a tree in which nodes are replaced by what `change` returns, unless that is None."""
    new = change(node)
    if new is not None:
        return new
    return node.with_children(tuple(replaced(child, change) for child in node.children))


def field_names(*trees: Node) -> tuple[str, ...]:
    """Return the names of all fields in some trees."""
    found = (node.name for tree in trees for node in nodes(tree) if isinstance(node, Field))
    return tuple(dict.fromkeys(found))


def in_steps(steps: Sequence[Node], result: Node) -> Node:
    """Return a result with the steps it needs, renumbered: equal formulas give equal trees."""
    needed: set[int] = set()
    waiting = [result]
    while waiting:
        for node in nodes(waiting.pop()):
            if isinstance(node, Earlier) and node.step not in needed:
                needed.add(node.step)
                waiting.append(steps[node.step])
    if not needed:
        return result
    new = {old: k for k, old in enumerate(sorted(needed))}

    def renumbered(node: Node) -> Node:
        return replaced(node, lambda n: Earlier(new[n.step]) if isinstance(n, Earlier) else None)

    return Steps(tuple(renumbered(steps[old]) for old in new), renumbered(result))


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
_NOT_FUNCTIONS = {*_PREFIX, *_INFIX, "compare", "integer_power"}
# A number in the name of a unit, as in 1e-20 erg: the language cannot write it.
_SCALED = re.compile(r"(?:^|\s\(?|dex\()(?!1 /)\d")


def text(node: Node) -> str:
    """Return a text that is parsed into this tree; `Steps`, which have none, are listed."""
    match node:
        case NumberWithUnit(value, unit) | InUnit(value, unit) if unit is not None:
            return _quantity(value, unit)
        case Constant(value):
            return repr(value).removesuffix(".0")
        case Field(name) | Earlier(name=name):
            return name
        case Steps(steps, result):
            named = [f"{Earlier(k).name} = {text(step)}" for k, step in enumerate(steps)]
            return "; ".join([*named, text(result)])
        case Call("integer_power", (base,), (exponent,)):
            return f"{_operand(base)} ** {exponent}"
        case Call("compare", operands, (operations,)):
            return _chained(operations, operands)
        case Call(operation, (operand,)) if operation in _PREFIX:
            return _PREFIX[operation] + _operand(operand)
        case Call(operation, arguments) if operation in _INFIX:
            return _chained([operation] * (len(arguments) - 1), arguments)
        case Call(operation, arguments, tables):
            lists = (f"[{', '.join(text(Constant(v)) for v in table)}]" for table in tables)
            return f"{operation}({', '.join([*map(text, arguments), *lists])})"
    raise TypeError(f"not a number in an expression: {node!r}")


def _quantity(value: float, unit: Unit) -> str:
    shown = str(unit)
    if _SCALED.search(shown):
        dex = is_dex(unit)
        plain = (unit.physical_unit if dex else unit).decompose()
        value = value + math.log10(plain.scale) if dex else value * plain.scale
        shown = str(type(plain)(1.0, plain.bases, plain.powers))
        shown = f"dex({shown})" if dex and shown else shown
    return f"({text(Constant(value))} {shown.replace('%', 'percent')}".rstrip() + ")"


def _chained(operations: Sequence[str], operands: Sequence[Node]) -> str:
    symbols = [_INFIX[operation] for operation in operations]
    first, *others = map(_operand, operands)
    return " ".join((first, *chain.from_iterable(zip(symbols, others, strict=True))))


def _operand(node: Node) -> str:
    shown = text(node)
    operator = isinstance(node, Call) and node.operation in _NOT_FUNCTIONS
    return f"({shown})" if operator or shown.startswith("-") else shown


def is_dex(unit: Unit) -> bool:
    """Return whether a unit is that of a logarithm, such as dex(g / cm3)."""
    return hasattr(unit, "physical_unit")
