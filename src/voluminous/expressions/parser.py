"""From Python's syntax tree to the nodes of an expression, by a whitelist of what is allowed."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable
from typing import Any, NamedTuple, NoReturn

from ..errors import unknown_name
from .source import MAX_DEPTH, fail, fail_too_deep, python_tree
from .tree import Call, Comparison, Constant, Field, IntegerPower, Logic, Node, Where

MAX_INTEGER_POWER = 8

CONSTANTS = {"pi": math.pi, "e": math.e, "true": 1.0, "false": 0.0}


class Function(NamedTuple):
    """A function of the language: how it is called, and how many arguments it takes."""

    signature: str
    least: int
    most: float


FUNCTIONS = {
    "where": Function("where(condition, a, b)", 3, 3),
    "atan2": Function("atan2(y, x)", 2, 2),
    "clip": Function("clip(x, lower, upper)", 3, 3),
    "min": Function("min(a, b, …)", 2, math.inf),
    "max": Function("max(a, b, …)", 2, math.inf),
    **{
        name: Function(f"{name}(x)", 1, 1)
        for name in ("abs", "cos", "exp", "log", "log10", "sin", "sqrt", "tan", "tanh")
    },
}

_ARITHMETIC: dict[type[ast.AST], str] = {
    ast.Add: "add",
    ast.Sub: "subtract",
    ast.Mult: "multiply",
    ast.Div: "divide",
    ast.FloorDiv: "floor_divide",
    ast.Mod: "remainder",
    ast.UAdd: "positive",
    ast.USub: "negative",
}
_COMPARISONS: dict[type[ast.AST], str] = {
    ast.Lt: "less",
    ast.LtE: "less_equal",
    ast.Gt: "greater",
    ast.GtE: "greater_equal",
    ast.Eq: "equal",
    ast.NotEq: "not_equal",
}
_LOGIC: dict[type[ast.AST], str] = {
    ast.And: "logical_and",
    ast.Or: "logical_or",
    ast.Not: "logical_not",
}
# Also logical here, but they bind more tightly than comparisons.
_TIGHT_LOGIC: dict[type[ast.AST], str] = {
    ast.BitAnd: "logical_and",
    ast.BitOr: "logical_or",
    ast.Invert: "logical_not",
}
_FOREIGN_OPERATORS: dict[type[ast.AST], tuple[str, str]] = {
    ast.BitXor: ("^", "'^' is not an operator of expressions; powers are written with '**'"),
    ast.MatMult: ("@", "'@' is not an operator of expressions; '*' multiplies"),
    ast.LShift: ("<<", "'<<' is not an operator of expressions; '<' compares"),
    ast.RShift: (">>", "'>>' is not an operator of expressions; '>' compares"),
}
_FOREIGN: dict[type[ast.AST], str] = {
    ast.Attribute: "'.' after a name is not part of an expression; write log10(x), not np.log10(x)",
    ast.Subscript: "[] after a name is not part of an expression; it holds for all elements",
    ast.JoinedStr: "text in quotes is not part of an expression; write field names without quotes",
    ast.NamedExpr: "':=' is not part of an expression; '==' compares",
    ast.Tuple: "',' is only allowed between the arguments of a function",
}


def parse(text: str) -> tuple[Node, tuple[str, ...]]:
    """Return the tree of an expression and the field names in it, in order of first appearance.

    Raises
    ------
    ExpressionError
        If the text is too long, nested too deeply, or not in the language.
    """
    builder = _Builder(text)
    tree = builder.build(python_tree(text))
    return tree, tuple(builder.names)


class _Builder:
    """Turns Python's nodes into ours, and collects the field names on the way."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._depth = 0
        self.names: dict[str, None] = {}  # a dict, because it keeps the order

    def build(self, node: ast.expr) -> Node:
        """Return our node for Python's `node`."""
        handler = _HANDLERS.get(type(node))
        if handler is None:
            self._fail(node, _FOREIGN.get(type(node), "this is not part of an expression"))
        if self._depth == MAX_DEPTH:
            fail_too_deep(self._text, self._character(node.col_offset))
        self._depth += 1
        built = handler(self, node)
        self._depth -= 1
        return built

    def _character(self, byte: int) -> int:
        # Python counts in bytes of UTF-8, a caret in characters.
        return len(self._text.encode()[:byte].decode())

    def _fail(self, node: ast.expr, problem: str) -> NoReturn:
        fail(self._text, self._character(node.col_offset), problem)

    def _many(self, nodes: list[ast.expr]) -> tuple[Node, ...]:
        return tuple(self.build(node) for node in nodes)

    def _constant(self, node: ast.Constant) -> Node:
        if isinstance(node.value, (str, bytes)):
            self._fail(node, _FOREIGN[ast.JoinedStr])
        if not isinstance(node.value, (bool, int, float)):
            self._fail(node, f"{node.value!r} is not a real number")
        try:
            value = float(node.value)
        except OverflowError:
            value = math.inf
        if math.isinf(value):
            self._fail(node, "the number is larger than double precision can hold")
        return Constant(value)

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
        if operator in _ARITHMETIC:
            if operator is ast.USub and isinstance(operand, Constant):
                return Constant(-operand.value)
            return Call(_ARITHMETIC[operator], (operand,))
        return Logic((_LOGIC | _TIGHT_LOGIC)[operator], (operand,))

    def _binary(self, node: ast.BinOp) -> Node:
        operator = type(node.op)
        if operator in _FOREIGN_OPERATORS:
            symbol, problem = _FOREIGN_OPERATORS[operator]
            end_of_left = self._character(node.left.end_col_offset or 0)
            fail(self._text, self._text.index(symbol, end_of_left), problem)
        if operator is ast.Pow:
            return _power(self.build(node.left), self.build(node.right))
        if operator in _TIGHT_LOGIC:
            return Logic(_TIGHT_LOGIC[operator], self._many([node.left, node.right]))
        return Call(_ARITHMETIC[operator], self._many([node.left, node.right]))

    def _boolean(self, node: ast.BoolOp) -> Node:
        return Logic(_LOGIC[type(node.op)], self._many(node.values))

    def _compare(self, node: ast.Compare) -> Node:
        operands = [node.left, *node.comparators]
        for operand in operands:
            # 'a > 1 & b < 2' would mean 'a > (1 & b) < 2', which nobody wants.
            if isinstance(operand, (ast.BinOp, ast.UnaryOp)) and type(operand.op) in _TIGHT_LOGIC:
                self._fail(
                    operand,
                    "'&', '|' and '~' come before comparisons: use 'and', 'or', 'not', "
                    "or parentheses as in (a > 1) & (b < 2)",
                )
        operators = [type(operator) for operator in node.ops]
        if any(operator not in _COMPARISONS for operator in operators):
            self._fail(node, "'in' and 'is' are not part of an expression; '==' compares")
        return Comparison(tuple(_COMPARISONS[op] for op in operators), self._many(operands))

    def _if_else(self, node: ast.IfExp) -> Node:
        chosen, condition, otherwise = self._many([node.body, node.test, node.orelse])
        return Where(condition, chosen, otherwise)

    def _call(self, node: ast.Call) -> Node:
        if not isinstance(node.func, ast.Name):
            self._fail(node.func, _FOREIGN.get(type(node.func), "only a function can be called"))
        name = node.func.id
        if name not in FUNCTIONS:
            self._fail(node, str(unknown_name("function", name, FUNCTIONS)))
        signature, least, most = FUNCTIONS[name]
        if node.keywords:
            self._fail(node.keywords[0].value, f"arguments have no names; call {signature}")
        if not least <= len(node.args) <= most:
            self._fail(node, f"wrong number of arguments ({len(node.args)}), call {signature}")
        arguments = self._many(node.args)
        return Where(*arguments) if name == "where" else Call(name, arguments)


def _power(base: Node, exponent: Node) -> Node:
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
}
