"""From Python's syntax tree to the nodes of an expression, by a whitelist of what is allowed."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

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
    TIGHT_LOGIC,
)
from .source import MAX_DEPTH, fail, fail_too_deep, python_tree
from .tables import table
from .tree import (
    Call,
    Comparison,
    Constant,
    Field,
    IntegerPower,
    Interpolation,
    Logic,
    Node,
    Quantity,
    Where,
)
from .vector_builder import VECTOR_CALLS, VectorBuilder

MAX_INTEGER_POWER = 8


def parse(text: str, *, vectors: bool = False) -> tuple[Node, tuple[str, ...]]:
    """Return the tree of an expression and the field names in it, in order of first appearance.

    Derivatives have names too: their text. With `vectors` the tree may be a `Vector`.

    Raises
    ------
    ExpressionError
        If the text is too long, nested too deeply, or not in the language.
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
        return constant if parsed is None else Quantity(constant.value, parsed)

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
            if operator is ast.USub and isinstance(operand, (Constant, Quantity)):
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
            argument = Call("divide", (argument, Quantity(1.0, unit)))
        try:
            found = interpolation(argument, places, entries)
        except InputError as error:
            self._fail(node, str(error))
        if entries_unit is None:
            return found
        return Call("multiply", (found, Quantity(1.0, entries_unit)))

    def _numbers(self, node: ast.expr) -> tuple[list[float], Any]:
        if not isinstance(node, ast.List):
            self._fail(node, f"here a list of numbers is needed: {FUNCTIONS['interp'].signature}")
        built = [(self.build(element), element) for element in node.elts]
        for number, element in built:
            if not isinstance(number, (Constant, Quantity)):
                self._fail(element, "the tables of interp hold numbers only")
        given = [number for number, _ in built if isinstance(number, Quantity)]
        unit = given[0].unit if given else None
        if given and any(not number.unit.is_equivalent(unit) for number in given):
            self._fail(node, f"the numbers of a table need units of one kind, such as {unit}")
        if given and any(n not in given and n != Constant(0.0) for n, _ in built):
            self._fail(node, f"give all numbers of the table a unit, such as {unit}, or none")
        return [n.value * (n.unit.to(unit) if n in given else 1.0) for n, _ in built], unit  # type: ignore[attr-defined]


def interpolation(argument: Node, places: Any, entries: Any) -> Node:
    """Return the node for a table.

    Raises
    ------
    InputError
        If places and entries are none.
    """
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
