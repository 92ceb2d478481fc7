"""From Python's syntax tree to the nodes of an expression, by a whitelist of what is allowed.

A derivative needs neighbours, which no element-wise evaluation has. It therefore becomes a field
whose name is its text, and `Volume` computes it. Vectors exist only while parsing: what remains are
numbers made of their components.
"""

from __future__ import annotations

import ast
import functools
import math
import unicodedata
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, NoReturn, cast

import numpy as np

from ..errors import InputError, unknown_name
from ..units import parse_unit
from .language import (
    ARITHMETIC,
    COMPARISONS,
    CONSTANTS,
    FOREIGN,
    FOREIGN_FUNCTIONS,
    FOREIGN_OPERATORS,
    FUNCTIONS,
    LOGIC,
    MAX_DEPTH,
    MAX_LENGTH,
    TIGHT_LOGIC,
    fail,
    fail_too_deep,
    one_line,
    python_tree,
)
from .tree import (
    Call,
    Comparison,
    Constant,
    Derivative,
    Field,
    IntegerPower,
    Interpolation,
    Logic,
    Node,
    NumberWithUnit,
    Where,
    text,
)


def table(places: Any, entries: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the places and entries of a table that can be interpolated.

    Parameters
    ----------
    places, entries : array_like, shape (n,)
        At least two increasing places, and a number for each.
    """
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


AXES = "xyz"


@dataclass(frozen=True, slots=True)
class Vector(Node):
    """Three components and the magnitude; `shown` is the text that is parsed into it."""

    components: tuple[Node, ...]
    magnitude: Node
    shown: str


def derivative(operation: str, argument: Node) -> Derivative:
    """Return the node of ``gradmag``, ``laplacian``, or a component such as ``grad.x``."""
    function, dot, axis = operation.partition(".")
    return Derivative(f"{function}({text(argument)}){dot}{axis}", operation, argument)


def gradient(argument: Node) -> Vector:
    """Return the vector of first derivatives."""
    components = tuple(derivative(f"grad.{axis}", argument) for axis in AXES)
    return Vector(components, derivative("gradmag", argument), f"grad({text(argument)})")


def vector(components: tuple[Node, ...]) -> Vector:
    """Return the vector of three numbers."""
    shown = f"vector({', '.join(text(component) for component in components)})"
    return Vector(components, _length(components), shown)


def named_vector(name: str) -> Vector:
    """Return the vector of the fields ``name_x``, ``name_y`` and ``name_z``."""
    components = tuple(Field(f"{name}_{axis}") for axis in AXES)
    return Vector(components, _length(components), f'"{name}"')


def line_of_sight(whole: Vector) -> Derivative:
    """Return the node of ``los``: a vector's component away from the observer."""
    return Derivative(f"los({whole.shown})", "los", whole)


def _length(components: tuple[Node, ...]) -> Node:
    return Call("sqrt", (_sum(IntegerPower(component, 2) for component in components),))


def dot(left: Vector, right: Vector) -> Node:
    """Return the scalar product."""
    pairs = zip(left.components, right.components, strict=True)
    return _sum(Call("multiply", pair) for pair in pairs)


def _sum(nodes: Iterable[Node]) -> Node:
    return functools.reduce(lambda total, node: Call("add", (total, node)), nodes)


# Levels of sums and products that stand for a product of vectors.
_LEVELS_OF_VECTORS = 3
# Names that are none of vectors.
_NUMBERS = {*CONSTANTS, *FUNCTIONS, "x", "y", "z", "r"}
_A_VECTOR = "grad(density), vector(a, b, c), or the name of one, as in norm(velocity)"


class VectorBuilder(ABC):
    """Turns Python's nodes into ours, and collects the field names on the way."""

    def __init__(self, text: str, depth: int = 0) -> None:
        self._text = text
        self._depth = depth
        self.names: dict[str, None] = {}  # a dict, because it keeps the order

    @abstractmethod
    def build_any(self, node: ast.expr) -> Node:
        """Return our node, a number or a vector, for Python's `node`."""

    def build(self, node: ast.expr) -> Node:
        """Return our node, a number, for Python's `node`."""
        built = self.build_any(node)
        if isinstance(built, Vector):
            self._fail(
                node,
                "this is a vector, but a number is needed here; take a component with .x, .y or "
                ".z, or use norm(v) or dot(v, w)",
            )
        return built

    def _character(self, byte: int) -> int:
        # Python counts in bytes of UTF-8, a caret in characters.
        return len(self._text.encode()[:byte].decode())

    def _fail(self, node: ast.expr, problem: str) -> NoReturn:
        fail(self._text, self._character(node.col_offset), problem)

    def _many(self, nodes: list[ast.expr]) -> tuple[Node, ...]:
        return tuple(self.build(node) for node in nodes)

    def _scalar_derivative(self, node: ast.Call) -> Node:
        operation = cast(ast.Name, node.func).id
        return self._use(derivative(operation, self._differentiated(node)), node)

    def _gradient(self, node: ast.Call) -> Node:
        return gradient(self._differentiated(node))

    def _differentiated(self, node: ast.Call) -> Node:
        argument = node.args[0]
        # A builder of its own: the names in the argument are not names of the expression.
        if isinstance(argument, ast.Constant) and isinstance(argument.value, str):
            quoted = one_line(argument.value)
            return type(self)(quoted, self._depth).build(python_tree(quoted))
        return type(self)(self._text, self._depth).build(argument)

    def _use(self, number: Node, node: ast.expr) -> Node:
        """Return a number made of a vector; only now a derivative is known to be needed."""
        if isinstance(number, Derivative):
            if len(number.name) > MAX_LENGTH:
                self._fail(node, "this derivative is too long; split it into derived fields")
            self.names.setdefault(number.name)
        return number

    def _component(self, node: ast.Attribute) -> Node:
        if not isinstance(node.value, ast.Call) or not isinstance(node.value.func, ast.Name):
            self._fail(node, FOREIGN[ast.Attribute])
        whole = self.build_any(node.value)
        if not isinstance(whole, Vector):
            self._fail(node, f"only a vector has components: {_A_VECTOR}")
        if node.attr not in AXES:
            self._fail(node, f"the components of a vector are .x, .y and .z, not .{node.attr}")
        return self._use(whole.components[AXES.index(node.attr)], node)

    def _vector(self, node: ast.Call) -> Node:
        return vector(self._many(node.args))

    def _norm(self, node: ast.Call) -> Node:
        (argument,) = self._vectors(node)
        return self._use(argument.magnitude, node)

    def _dot(self, node: ast.Call) -> Node:
        left, right = self._vectors(node)
        for component in left.components + right.components:
            self._use(component, node)
        return dot(left, right)

    def _line_of_sight(self, node: ast.Call) -> Node:
        # The fields that the component is made of are not fields of the expression.
        (argument,) = type(self)(self._text, self._depth)._vectors(node)
        return self._use(line_of_sight(argument), node)

    def _vector_argument(self, node: ast.expr) -> Node:
        """Return the node of an argument that may be the name of a vector, also in quotes."""
        if isinstance(node, ast.Name) and node.id not in _NUMBERS:
            name = node.id
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            name = unicodedata.normalize("NFKC", node.value)
        else:
            return self.build_any(node)
        if not name.isidentifier():
            self._fail(node, "quotes hold the name of a vector, as in norm('velocity')")
        self.names |= dict.fromkeys(f"{name}_{axis}" for axis in AXES)
        return named_vector(name)

    def _vectors(self, node: ast.Call) -> list[Vector]:
        self._depth += _LEVELS_OF_VECTORS
        built = [self._vector_argument(argument) for argument in node.args]
        self._depth -= _LEVELS_OF_VECTORS
        for argument, whole in zip(node.args, built, strict=True):
            if not isinstance(whole, Vector):
                self._fail(argument, f"this is a number, but a vector is needed: {_A_VECTOR}")
        return cast(list[Vector], built)


VECTOR_CALLS: dict[str, Callable[[VectorBuilder, Any], Node]] = {
    "gradmag": VectorBuilder._scalar_derivative,
    "laplacian": VectorBuilder._scalar_derivative,
    "grad": VectorBuilder._gradient,
    "vector": VectorBuilder._vector,
    "norm": VectorBuilder._norm,
    "los": VectorBuilder._line_of_sight,
    "dot": VectorBuilder._dot,
}


MAX_INTEGER_POWER = 8


def parse(text: str, *, vectors: bool = False) -> tuple[Node, tuple[str, ...]]:
    """Return the tree of an expression and the field names in it, in order of first appearance.

    Derivatives have names too: their text. With `vectors` the tree may be a `Vector`.
    """
    builder = _Builder(text)
    build = builder.build_any if vectors else builder.build
    tree = build(python_tree(text))
    return tree, tuple(builder.names)


class _Builder(VectorBuilder):
    """Builds all that Python's grammar has; calls of vectors are its base's."""

    def build_any(self, node: ast.expr) -> Node:
        handler = _HANDLERS.get(type(node))
        if handler is None:
            self._fail(node, FOREIGN.get(type(node), "this is not part of an expression"))
        if self._depth >= MAX_DEPTH:
            fail_too_deep(self._text, self._character(node.col_offset))
        self._depth += 1
        built = handler(self, node)
        self._depth -= 1
        return built

    def _constant(self, node: ast.Constant) -> Node:
        if isinstance(node.value, (str, bytes)):
            self._fail(node, FOREIGN[ast.JoinedStr])
        if not isinstance(node.value, (bool, int, float)):
            self._fail(node, f"{node.value!r} is not a real number")
        try:
            value = float(node.value)
        except OverflowError:
            value = math.inf
        if math.isinf(value):
            self._fail(node, "the number is larger than double precision can hold")
        return Constant(value)

    def _quantity(self, node: ast.Subscript) -> Node:
        number, unit = node.value, node.slice
        if not (isinstance(number, ast.Constant) and isinstance(unit, ast.Constant)):
            self._fail(node, FOREIGN[ast.Subscript])
        constant, parsed = self._constant(number), parse_unit(unit.value)
        assert isinstance(constant, Constant)
        return constant if parsed is None else NumberWithUnit(constant.value, parsed)

    def _name(self, node: ast.Name) -> Node:
        if node.id in FUNCTIONS:
            self._fail(node, f"{node.id} is a function; call {FUNCTIONS[node.id].signature}")
        if node.id in CONSTANTS:
            return Constant(CONSTANTS[node.id])
        self.names.setdefault(node.id)
        return Field(node.id)

    def _unary(self, node: ast.UnaryOp) -> Node:
        operand = self.build(node.operand)
        operator = type(node.op)
        if operator in ARITHMETIC:
            if operator is ast.USub and isinstance(operand, (Constant, NumberWithUnit)):
                return replace(operand, value=-operand.value)
            return Call(ARITHMETIC[operator], (operand,))
        return Logic((LOGIC | TIGHT_LOGIC)[operator], (operand,))

    def _binary(self, node: ast.BinOp) -> Node:
        operator = type(node.op)
        if operator in FOREIGN_OPERATORS:
            symbol, problem = FOREIGN_OPERATORS[operator]
            end_of_left = self._character(node.left.end_col_offset or 0)
            fail(self._text, self._text.index(symbol, end_of_left), problem)
        if operator is ast.Pow:
            return power(self.build(node.left), self.build(node.right))
        if operator in TIGHT_LOGIC:
            return Logic(TIGHT_LOGIC[operator], self._many([node.left, node.right]))
        return Call(ARITHMETIC[operator], self._many([node.left, node.right]))

    def _boolean(self, node: ast.BoolOp) -> Node:
        return Logic(LOGIC[type(node.op)], self._many(node.values))

    def _compare(self, node: ast.Compare) -> Node:
        operands = [node.left, *node.comparators]
        for operand in operands:
            # 'a > 1 & b < 2' would mean 'a > (1 & b) < 2', which nobody wants.
            if isinstance(operand, (ast.BinOp, ast.UnaryOp)) and type(operand.op) in TIGHT_LOGIC:
                self._fail(
                    operand,
                    "'&', '|' and '~' come before comparisons: use 'and', 'or', 'not', "
                    "or parentheses as in (a > 1) & (b < 2)",
                )
        operators = [type(operator) for operator in node.ops]
        if any(operator not in COMPARISONS for operator in operators):
            self._fail(node, "'in' and 'is' are not part of an expression; '==' compares")
        return Comparison(tuple(COMPARISONS[op] for op in operators), self._many(operands))

    def _if_else(self, node: ast.IfExp) -> Node:
        chosen, condition, otherwise = self._many([node.body, node.test, node.orelse])
        return Where(condition, chosen, otherwise)

    def _call(self, node: ast.Call) -> Node:
        if not isinstance(node.func, ast.Name):
            self._fail(node.func, FOREIGN.get(type(node.func), "only a function can be called"))
        name = node.func.id
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
        if name in VECTOR_CALLS:
            return VECTOR_CALLS[name](self, node)
        if name == "interp":
            return self._interpolation(node)
        arguments = self._many(node.args)
        return Where(*arguments) if name == "where" else Call(name, arguments)

    def _interpolation(self, node: ast.Call) -> Node:
        argument = self.build(node.args[0])
        (places, unit), (entries, entries_unit) = map(self._numbers, node.args[1:])
        if unit is not None:
            argument = Call("divide", (argument, NumberWithUnit(1.0, unit)))
        try:
            found = interpolation(argument, places, entries)
        except InputError as error:
            self._fail(node, str(error))
        if entries_unit is None:
            return found
        return Call("multiply", (found, NumberWithUnit(1.0, entries_unit)))

    def _numbers(self, node: ast.expr) -> tuple[list[float], Any]:
        if not isinstance(node, ast.List):
            self._fail(node, f"here a list of numbers is needed: {FUNCTIONS['interp'].signature}")
        built = [(self.build(element), element) for element in node.elts]
        for number, element in built:
            if not isinstance(number, (Constant, NumberWithUnit)):
                self._fail(element, "the tables of interp hold numbers only")
        given = [number for number, _ in built if isinstance(number, NumberWithUnit)]
        unit = given[0].unit if given else None
        if given and any(not number.unit.is_equivalent(unit) for number in given):
            self._fail(node, f"the numbers of a table need units of one kind, such as {unit}")
        if given and any(n not in given and n != Constant(0.0) for n, _ in built):
            self._fail(node, f"give all numbers of the table a unit, such as {unit}, or none")
        return [n.value * (n.unit.to(unit) if n in given else 1.0) for n, _ in built], unit  # type: ignore[attr-defined]


def interpolation(argument: Node, places: Any, entries: Any) -> Node:
    """Return the node for a table."""
    x, y = table(places, entries)
    return Interpolation(argument, tuple(x.tolist()), tuple(y.tolist()))


def power(base: Node, exponent: Node) -> Node:
    """Return the node for a power; exponents known beforehand need no logarithm."""
    if isinstance(exponent, Constant):
        if exponent.value == 0.5:
            return Call("sqrt", (base,))
        if exponent.value.is_integer() and abs(exponent.value) <= MAX_INTEGER_POWER:
            return IntegerPower(base, int(exponent.value))
    return Call("power", (base, exponent))


_HANDLERS: dict[type[ast.AST], Callable[[_Builder, Any], Node]] = {
    ast.Constant: _Builder._constant,
    ast.Name: _Builder._name,
    ast.UnaryOp: _Builder._unary,
    ast.BinOp: _Builder._binary,
    ast.BoolOp: _Builder._boolean,
    ast.Compare: _Builder._compare,
    ast.IfExp: _Builder._if_else,
    ast.Call: _Builder._call,
    ast.Attribute: _Builder._component,
    ast.Subscript: _Builder._quantity,
}
