"""The nodes of a parsed expression: immutable, comparable, and able to evaluate themselves."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from ..errors import UnitsError
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
class Quantity(Node):
    """A number with a unit, which has no value before the units of the fields are known."""

    value: float
    unit: Any

    def evaluate(self, ops: Ops, fields: Fields) -> Any:
        raise UnitsError(
            f"'{self.value:g} {self.unit}' is a number with a unit, which only a volume can "
            "convert: volume.evaluate, media, and measurements do; here write the number in the "
            "unit of the fields"
        )


@dataclass(frozen=True, slots=True)
class InUnit(Constant):
    """A plain number whose unit fits those of the fields it is combined with."""

    unit: Any


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
