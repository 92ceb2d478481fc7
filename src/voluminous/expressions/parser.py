"""From Python's syntax tree to the nodes of an expression; everything not listed here is refused.

A derivative needs neighbouring cells, which no element-wise evaluation has. It therefore becomes a
field whose name is its text, and `Volume` computes it. Vectors exist only while parsing: what
remains are numbers computed from their components.
"""

from __future__ import annotations

import ast
import functools
import math
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NoReturn

import numpy as np

from ..errors import InputError, unknown_name
from ..units import Unit, parse_unit
from .language import (
    CONSTANTS,
    FOREIGN,
    FOREIGN_FUNCTIONS,
    FOREIGN_OPERATORS,
    FUNCTIONS,
    MAX_DEPTH,
    MAX_LENGTH,
    NOT_AN_OPERATOR,
    OPERATORS,
    fail,
    fail_too_deep,
    one_line,
    python_tree,
)
from .tree import Call, Constant, Derivative, Field, Node, NumberWithUnit, text

MAX_INTEGER_POWER = 8


def table(places: Any, entries: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return increasing places and their entries as arrays that can be interpolated."""
    x, y = (_numbers(v) for v in (places, entries))
    if x.ndim != 1 or x.shape != y.shape or len(x) < 2:
        raise InputError(
            "interp needs as many values as places, in two lists of at least two numbers, "
            f"got shapes {x.shape} and {y.shape}"
        )
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise InputError("the places and values of interp must be finite")
    wrong = np.flatnonzero(np.diff(x) <= 0)
    if len(wrong):
        before, after = x[wrong[0]], x[wrong[0] + 1]
        raise InputError(
            f"the places of interp must increase, but {before:g} is followed by {after:g}"
        )
    return x, y


def _numbers(values: Any) -> np.ndarray:
    unit = getattr(values, "unit", None)
    if unit is not None and str(unit):
        raise InputError(
            f"interp computes with plain numbers, got numbers in {unit}; give them in the units "
            "of the fields, as in places.to_value(unit)"
        )
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"interp needs lists of numbers, got {values!r}") from error


def interpolation(argument: Node, places: Any, entries: Any) -> Node:
    """Return the node for a table: linear between its entries, constant beyond both ends."""
    return Call("interp", (argument,), tuple(tuple(a.tolist()) for a in table(places, entries)))


def power(base: Node, exponent: Node) -> Node:
    """Return the node for a power; constant exponents need no logarithm if whole or ½."""
    if isinstance(exponent, Constant):
        if exponent.value == 0.5:
            return Call("sqrt", (base,))
        if exponent.value.is_integer() and abs(exponent.value) <= MAX_INTEGER_POWER:
            return Call("integer_power", (base,), (int(exponent.value),))
    return Call("power", (base, exponent))


AXES = "xyz"


@dataclass(frozen=True, slots=True)
class Vector(Node):
    """Three components and the magnitude; `shown` is the text that is parsed into it."""

    components: tuple[Node, ...]
    magnitude: Node
    shown: str


def _vector(components: tuple[Node, ...], shown: str) -> Vector:
    squares = [Call("integer_power", (c,), (2,)) for c in components]
    return Vector(components, Call("sqrt", (_sum(squares),)), shown)


def _sum(nodes: Iterable[Node]) -> Node:
    return functools.reduce(lambda total, node: Call("add", (total, node)), nodes)


def _derivative(operation: str, argument: Node) -> Derivative:
    """Return the node of ``gradmag``, ``laplacian``, or a component such as ``grad.x``."""
    function, dot, axis = operation.partition(".")
    return Derivative(f"{function}({text(argument)}){dot}{axis}", operation, argument)


# A product of vectors becomes this many levels of sums and products.
_LEVELS_OF_VECTORS = 3
# Names that no vector has.
_SCALARS = {*CONSTANTS, *FUNCTIONS, "x", "y", "z", "r"}
_A_VECTOR = "grad(density), vector(a, b, c), or the name of one, as in norm(velocity)"
_TIGHT = (ast.BitAnd, ast.BitOr, ast.Invert)


def parse(text: str, *, vectors: bool = False) -> tuple[Node, tuple[str, ...]]:
    """Return the tree of an expression and the field names in it, in order of first appearance.

    Derivatives have names too: their text. With `vectors` the tree may be a `Vector`.
    """
    builder = _Builder(text)
    build = builder.build_any if vectors else builder.build
    tree = build(python_tree(text))
    return tree, tuple(builder.names)


class _Builder:
    """Turns Python's nodes into ours, and collects the field names on the way."""

    def __init__(self, text: str, depth: int = 0) -> None:
        self._text, self._depth = text, depth
        self.names: dict[str, None] = {}  # a dict, because it keeps the order

    def build(self, node: ast.expr) -> Node:
        """Return our node for Python's `node`: a number."""
        built = self.build_any(node)
        if isinstance(built, Vector):
            self._fail(
                node,
                "this is a vector, but a number is needed here; take a component with .x, .y or "
                ".z, or use norm(v) or dot(v, w)",
            )
        return built

    def build_any(self, node: ast.expr) -> Node:
        """Return our node for Python's `node`: a number or a vector."""
        if self._depth >= MAX_DEPTH:
            fail_too_deep(self._text, self._character(node.col_offset))
        self._depth += 1
        built = self._built(node)
        self._depth -= 1
        return built

    def _built(self, node: ast.expr) -> Node:
        match node:
            case ast.Constant(value=value):
                return Constant(self._number(node, value))
            case ast.Subscript(value=ast.Constant(value=value), slice=ast.Constant(value=name)):
                number, unit = self._number(node.value, value), parse_unit(name)
                return Constant(number) if unit is None else NumberWithUnit(number, unit)
            case ast.Name(id=name):
                return self._name(node, name)
            case ast.UnaryOp(op=op):
                operand = self.build(node.operand)
                if isinstance(op, ast.USub) and isinstance(operand, (Constant, NumberWithUnit)):
                    return replace(operand, value=-operand.value)
                return Call(OPERATORS[type(op)], (operand,))
            case ast.BinOp(op=ast.Pow()):
                return power(*self._all([node.left, node.right]))
            case ast.BinOp(op=op) if type(op) in FOREIGN_OPERATORS:
                symbol, advice = FOREIGN_OPERATORS[type(op)]
                place = self._text.index(symbol, self._character(node.left.end_col_offset or 0))
                fail(self._text, place, NOT_AN_OPERATOR.format(symbol, advice))
            case ast.BinOp(op=op):
                return Call(OPERATORS[type(op)], self._all([node.left, node.right]))
            case ast.BoolOp(op=op):
                return Call(OPERATORS[type(op)], self._all(node.values))
            case ast.Compare():
                return self._comparison(node, [node.left, *node.comparators])
            case ast.IfExp():
                chosen, condition, otherwise = self._all([node.body, node.test, node.orelse])
                return Call("where", (condition, chosen, otherwise))
            case ast.Call(func=ast.Name(id=name)):
                return self._call(node, name)
            case ast.Call(func=function):
                self._fail(function, FOREIGN.get(type(function), "only a function can be called"))
            case ast.Attribute(value=ast.Call(func=ast.Name())):
                return self._component(node)
        self._fail(node, FOREIGN.get(type(node), "this is not part of an expression"))

    def _character(self, byte: int) -> int:
        # Python counts in bytes of UTF-8, a caret in characters.
        return len(self._text.encode()[:byte].decode())

    def _fail(self, node: ast.expr, problem: str) -> NoReturn:
        fail(self._text, self._character(node.col_offset), problem)

    def _all(self, nodes: Sequence[ast.expr]) -> tuple[Node, ...]:
        return tuple(self.build(node) for node in nodes)

    def _number(self, node: ast.expr, value: Any) -> float:
        if isinstance(value, (str, bytes)):
            self._fail(node, FOREIGN[ast.JoinedStr])
        if not isinstance(value, (bool, int, float)):
            self._fail(node, f"{value!r} is not a real number")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if math.isinf(number):
            self._fail(node, "the number is larger than double precision can hold")
        return number

    def _name(self, node: ast.expr, name: str) -> Node:
        if name in FUNCTIONS:
            self._fail(node, f"{name} is a function; call {FUNCTIONS[name].signature}")
        if name in CONSTANTS:
            return Constant(CONSTANTS[name])
        self.names.setdefault(name)
        return Field(name)

    def _comparison(self, node: ast.Compare, operands: list[ast.expr]) -> Node:
        for operand in operands:
            # 'a > 1 & b < 2' would mean 'a > (1 & b) < 2', which nobody wants.
            if isinstance(operand, (ast.BinOp, ast.UnaryOp)) and isinstance(operand.op, _TIGHT):
                self._fail(
                    operand,
                    "'&', '|' and '~' come before comparisons: use 'and', 'or', 'not', "
                    "or parentheses as in (a > 1) & (b < 2)",
                )
        if not all(type(operator) in OPERATORS for operator in node.ops):
            self._fail(node, "'in' and 'is' are not part of an expression; '==' compares")
        operations = tuple(OPERATORS[type(operator)] for operator in node.ops)
        return Call("compare", self._all(operands), (operations,))

    def _call(self, node: ast.Call, name: str) -> Node:
        if name in FOREIGN_FUNCTIONS:
            self._fail(
                node, f"{name!r} is not a function of expressions; {FOREIGN_FUNCTIONS[name]}"
            )
        if name not in FUNCTIONS:
            self._fail(node, str(unknown_name("function", name, FUNCTIONS)))
        signature, least, most = FUNCTIONS[name]
        if node.keywords:
            self._fail(node.keywords[0].value, f"arguments have no names; call {signature}")
        if not least <= len(node.args) <= most:
            self._fail(node, f"wrong number of arguments ({len(node.args)}), call {signature}")
        match name:
            case "interp":
                return self._interpolation(node)
            case "gradmag" | "laplacian":
                return self._use(_derivative(name, self._differentiated(node.args[0])), node)
            case "grad":
                argument = self._differentiated(node.args[0])
                gradient = tuple(_derivative(f"grad.{axis}", argument) for axis in AXES)
                magnitude = _derivative("gradmag", argument)
                return Vector(gradient, magnitude, f"grad({text(argument)})")
            case "vector":
                components = self._all(node.args)
                return _vector(components, f"vector({', '.join(map(text, components))})")
            case "norm":
                return self._use(self._vectors(node)[0].magnitude, node)
            case "dot":
                left, right = self._vectors(node)
                for component in left.components + right.components:
                    self._use(component, node)
                pairs = zip(left.components, right.components, strict=True)
                return _sum(Call("multiply", pair) for pair in pairs)
            case "los":
                # The fields that the component is computed from are not fields of the expression.
                (whole,) = _Builder(self._text, self._depth)._vectors(node)
                return self._use(Derivative(f"los({whole.shown})", "los", whole), node)
        return Call(name, self._all(node.args))

    def _differentiated(self, argument: ast.expr) -> Node:
        # A builder of its own: the names in the argument are not names of the expression.
        if isinstance(argument, ast.Constant) and isinstance(argument.value, str):
            quoted = one_line(argument.value)
            return _Builder(quoted, self._depth).build(python_tree(quoted))
        return _Builder(self._text, self._depth).build(argument)

    def _use(self, number: Node, node: ast.expr) -> Node:
        """Return a number computed from a vector; only now a derivative is known to be needed."""
        if isinstance(number, Derivative):
            if len(number.name) > MAX_LENGTH:
                self._fail(node, "this derivative is too long; split it into derived fields")
            self.names.setdefault(number.name)
        return number

    def _component(self, node: ast.Attribute) -> Node:
        whole = self.build_any(node.value)
        if not isinstance(whole, Vector):
            self._fail(node, f"only a vector has components: {_A_VECTOR}")
        if node.attr not in AXES:
            self._fail(node, f"the components of a vector are .x, .y and .z, not .{node.attr}")
        return self._use(whole.components[AXES.index(node.attr)], node)

    def _vectors(self, node: ast.Call) -> list[Vector]:
        self._depth += _LEVELS_OF_VECTORS
        built = [self._vector_argument(argument) for argument in node.args]
        self._depth -= _LEVELS_OF_VECTORS
        return built

    def _vector_argument(self, node: ast.expr) -> Vector:
        """Return the vector of an argument, which may be its name, also in quotes."""
        if isinstance(node, ast.Name) and node.id not in _SCALARS:
            name = node.id
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            name = unicodedata.normalize("NFKC", node.value)
        else:
            whole = self.build_any(node)
            if not isinstance(whole, Vector):
                self._fail(node, f"this is a number, but a vector is needed: {_A_VECTOR}")
            return whole
        if not name.isidentifier():
            self._fail(node, "quotes hold the name of a vector, as in norm('velocity')")
        names = [f"{name}_{axis}" for axis in AXES]
        self.names |= dict.fromkeys(names)
        return _vector(tuple(map(Field, names)), f'"{name}"')

    def _interpolation(self, node: ast.Call) -> Node:
        argument = self.build(node.args[0])
        (places, unit), (entries, entries_unit) = map(self._list, node.args[1:])
        if unit is not None:
            argument = Call("divide", (argument, NumberWithUnit(1.0, unit)))
        try:
            result = interpolation(argument, places, entries)
        except InputError as error:
            self._fail(node, str(error))
        if entries_unit is None:
            return result
        return Call("multiply", (result, NumberWithUnit(1.0, entries_unit)))

    def _list(self, node: ast.expr) -> tuple[list[float], Unit]:
        """Return the numbers of a list, in the unit of the first that has one, and that unit."""
        if not isinstance(node, ast.List):
            self._fail(node, f"here a list of numbers is needed: {FUNCTIONS['interp'].signature}")
        numbers: list[float] = []
        units: list[Unit] = []
        for element in node.elts:
            built = self.build(element)
            if not isinstance(built, (Constant, NumberWithUnit)):
                self._fail(element, "the tables of interp hold numbers only")
            numbers.append(built.value)
            units.append(built.unit if isinstance(built, NumberWithUnit) else None)
        unit = next((own for own in units if own is not None), None)
        if unit is None:
            return numbers, None
        if not all(own is None or own.is_equivalent(unit) for own in units):
            self._fail(node, f"the numbers of a table need units of one kind, such as {unit}")
        if any(own is None and number != 0 for number, own in zip(numbers, units, strict=True)):
            self._fail(node, f"give all numbers of the table a unit, such as {unit}, or none")
        pairs = zip(numbers, units, strict=True)
        return [0.0 if own is None else number * own.to(unit) for number, own in pairs], unit
