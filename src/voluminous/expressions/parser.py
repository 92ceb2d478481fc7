"""The language of expressions: from its text to a tree of nodes.

The text is parsed with Python's grammar, and everything not listed here is refused. Python has no
place for a unit. Therefore ``los(velocity) / (0.2 km/s)`` is rewritten with ``0.2["km/s"]`` before
it is parsed, and the parser makes a `NumberWithUnit` of that.

A derivative needs neighbouring cells, which no element-wise evaluation has. It therefore becomes a
field whose name is its text, and `Volume` computes it. So does ``cellwise(a)``, which is computed
in cells and then interpolated as one field. Vectors exist only while parsing: what remains are
numbers computed from their components.
"""

from __future__ import annotations

import ast
import functools
import math
import re
import unicodedata
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, NoReturn

import numpy as np

from ..errors import ExpressionError, InputError, UnitsError, unknown_name
from ..units import Unit, parse_unit
from .ops import NumpyOps
from .tree import Call, Constant, Derivative, Field, Node, NumberWithUnit, field_names, nodes, text

CONSTANTS = {"pi": math.pi, "e": math.e, "true": 1.0, "false": 0.0}


class Signature(NamedTuple):
    """How a function of the language is called, and how many arguments it takes."""

    signature: str
    least: int
    most: float


FUNCTIONS = {
    "where": Signature("where(condition, a, b)", 3, 3),
    "atan2": Signature("atan2(y, x)", 2, 2),
    "clip": Signature("clip(x, lower, upper)", 3, 3),
    "interp": Signature("interp(x, [x1, x2, …], [y1, y2, …])", 3, 3),
    "min": Signature("min(a, b, …)", 2, math.inf),
    "max": Signature("max(a, b, …)", 2, math.inf),
    "vector": Signature("vector(a, b, c)", 3, 3),
    "norm": Signature("norm(v)", 1, 1),
    "dot": Signature("dot(v, w)", 2, 2),
    "los": Signature("los(v)", 1, 1),
}
_ONE = ("abs", "cos", "exp", "log", "log10", "sin", "sqrt", "tan", "tanh")
for _name in (*_ONE, "cellwise", "grad", "gradmag", "laplacian"):
    FUNCTIONS[_name] = Signature(f"{_name}(x)", 1, 1)

# Python's operators, by the methods of `Ops` that evaluate them; `**` is parsed by itself.
OPERATORS: dict[type[ast.AST], str] = {
    ast.Add: "add",
    ast.Sub: "subtract",
    ast.Mult: "multiply",
    ast.Div: "divide",
    ast.FloorDiv: "floor_divide",
    ast.Mod: "remainder",
    ast.UAdd: "positive",
    ast.USub: "negative",
    ast.Lt: "less",
    ast.LtE: "less_equal",
    ast.Gt: "greater",
    ast.GtE: "greater_equal",
    ast.Eq: "equal",
    ast.NotEq: "not_equal",
    ast.And: "logical_and",
    ast.Or: "logical_or",
    ast.Not: "logical_not",
    ast.BitAnd: "logical_and",
    ast.BitOr: "logical_or",
    ast.Invert: "logical_not",
}
FOREIGN_OPERATORS: dict[type[ast.AST], tuple[str, str]] = {
    ast.BitXor: ("^", "powers are written with '**'"),
    ast.MatMult: ("@", "'*' multiplies"),
    ast.LShift: ("<<", "'<' compares"),
    ast.RShift: (">>", "'>' compares"),
}
NOT_AN_OPERATOR = "'{}' is not an operator of expressions; {}"
FOREIGN: dict[type[ast.AST], str] = {
    ast.Attribute: "'.' after a name is not part of an expression; write log10(x), not np.log10(x)",
    ast.Subscript: "[] after a name is not part of an expression; it holds for all elements",
    ast.JoinedStr: "text in quotes is not part of an expression; write field names without quotes",
    ast.NamedExpr: "':=' is not part of an expression; '==' compares",
    ast.List: "a list is only allowed as the table of interp(x, [x1, x2, …], [y1, y2, …])",
    ast.Tuple: "',' is only allowed between the arguments of a function",
}
# Functions of other languages, and how to write them here.
FOREIGN_FUNCTIONS: dict[str, str] = {
    "ln": "the natural logarithm is log(x)",
    "log2": "write log(x) / log(2)",
    "pow": "powers are written x**2",
    "power": "powers are written x**2",
    "asin": "write atan2(x, sqrt(1 - x**2))",
    "acos": "write atan2(sqrt(1 - x**2), x)",
    "atan": "write atan2(x, 1)",
    "sinh": "write (exp(x) - exp(-x)) / 2",
    "cosh": "write (exp(x) + exp(-x)) / 2",
    "floor": "write x // 1",
    "round": "write (x + 0.5) // 1",
    "sign": "write (x > 0) - (x < 0)",
    "heaviside": "write x > 0, which counts 1 where it holds",
}
for _name in ("asin", "acos", "atan"):
    FOREIGN_FUNCTIONS[f"arc{_name[1:]}"] = FOREIGN_FUNCTIONS[_name]

MAX_LENGTH = 10_000
MAX_DEPTH = 100

# Habits from other languages, by the character at which Python's parser gives up.
_HINTS = {
    "=": NOT_AN_OPERATOR.format("=", "'==' compares"),
    "&": NOT_AN_OPERATOR.format("&&", "write 'and'"),
    "|": NOT_AN_OPERATOR.format("||", "write 'or'"),
    "!": NOT_AN_OPERATOR.format("!", "write 'not'"),
    "?": NOT_AN_OPERATOR.format("?", "write where(condition, a, b)"),
}
# For two names or numbers with nothing between them: `2 a`, `log10 a`, `v - 5 km`.
_NO_OPERATOR = (
    "an operator or brackets are missing here: write 2*a and log10(a); a number may be followed by "
    "a unit that astropy knows, as in 'v / (5 km/s)'"
)


def one_line(source: str) -> str:
    """Return the text without spaces around it, and with spaces for tabs and line ends."""
    return source.translate(dict.fromkeys(map(ord, "\t\n\r\f\v"), " ")).strip(" ")


def python_tree(source: str) -> ast.expr:
    """Return Python's syntax tree of the text; nothing is compiled."""
    if not source:
        raise ExpressionError("the expression is empty; write a field name or 'log10(density)'")
    if len(source) > MAX_LENGTH:
        raise ExpressionError(
            f"the expression has {len(source)} characters, expected at most {MAX_LENGTH}; "
            "split it into derived fields"
        )
    for character, what in (("#", "a comment ('#')"), ("\0", "a null byte")):
        if character in source:
            fail(source, source.index(character), f"{what} cannot be part of an expression")
    try:
        return ast.parse(source, mode="eval").body
    except SyntaxError as error:
        _fail_syntax(source, error)
    except ValueError as error:  # characters that cannot be encoded
        raise ExpressionError(f"the expression cannot be read: {error}") from None
    except (RecursionError, MemoryError):  # how Python's parser reports too deep a nesting
        fail_too_deep(source, 0)


def _fail_syntax(source: str, error: SyntaxError) -> NoReturn:
    if not error.offset:  # it counts from 1; 0 stands for the whole text, or its end
        if error.msg == "invalid syntax":
            fail(source, len(source), "the expression ends too early")
        fail(source, 0, error.msg)
    place = error.offset - 1
    before, here = source[:place].rstrip()[-1:], source[place : place + 1]
    adjacent = (before.isalnum() or before == ")") and here.isalnum()
    # Of 2a Python points to the number.
    plain = _NO_OPERATOR if adjacent or "decimal literal" in error.msg else error.msg
    fail(source, place, _HINTS.get(here, plain))


def fail_too_deep(source: str, place: int) -> NoReturn:
    """Raise the error for an expression with too many levels."""
    problem = f"nested too deeply: over {MAX_DEPTH} levels, each '+' of a long sum being one"
    fail(source, place, f"{problem}; split it into derived fields")


def fail(source: str, place: int, problem: str) -> NoReturn:
    """Raise the error for a problem at character `place`, with a caret under it."""
    # Units stand in brackets and quotes, see `marked`.
    before, after = (
        re.sub(r'\["(.*?)"\]', r" \1", part) for part in (source[:place], source[place:])
    )
    source, place = before + after, len(before)
    start, end = max(0, place - 50), place + 50
    before, after = "…" * (start > 0), "…" * (end < len(source))
    shown = "".join(
        c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in source[start:end]
    )
    caret = " " * (len(before) + place - start) + "^"
    raise ExpressionError(f"{problem}\n    {before}{shown}{after}\n    {caret}")


# A whole number literal: not the "10" of 0x10, nor the "2" of a2.
_NUMBER = re.compile(r"(?<![\w.])(?!0[xXbBoO])(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\d.])")
_FRACTION = r"\([-+]?\d+(?:[./]\d+)?\)"
_POWER = rf"(?:[-+]?\d+|{_FRACTION}|\s*(?:\*\*|\^)\s*(?:[-+]?\d+(?:\.\d+)?|{_FRACTION}))?"
# One factor of a unit: a name that is no function being called, with its power.
_FACTOR = re.compile(rf"([^\W\d]+)({_POWER})(?![\w(])")
_FIRST = re.compile(r"\s*(?=[^\W\d])|\s+1\s*/\s*(?=[^\W\d(])")
_OPENED, _CLOSED = re.compile(r"(?:dex)?\("), re.compile(rf"\s*\){_POWER}")
_NEXT = re.compile(r"\s*[*/]\s*|\s+")
# `a` and `b` are units too (years, bits), but nobody means these by "2a".
_KEYWORDS = {"and", "or", "not", "if", "else", "in", "is", "lambda", "a", "b", *CONSTANTS}


@functools.lru_cache(maxsize=1 << 13)
def marked(source: str, fields: tuple[str, ...] = ()) -> str:
    """Return the text with ``0.2["km/s"]`` in place of ``0.2 km/s``.

    `fields` are names that are fields where they follow ``*`` or ``/``, even if they are units too:
    in ``20 K/T`` T is the temperature if there is such a field, else the tesla.
    """
    parts, place = [], 0
    for number in _NUMBER.finditer(source):
        if number.start() < place:  # the 1 of "2 1/cm", the 3 of "2 cm-3"
            continue
        end = _unit_end(source, number.end(), fields)
        if end > number.end():
            unit = source[number.end() : end].strip()
            parts += [source[place : number.end()], f'["{unit}"]']
            place = end
    return "".join([*parts, source[place:]])


def _unit_end(source: str, start: int, fields: Collection[str]) -> int:
    """Return where the longest unit ends that begins after a number; `start` if there is none."""
    first = _FIRST.match(source, start)
    if first is None:
        return start
    name = _FACTOR.match(source, first.end())
    if name is not None and name[1] in fields and "/" not in first[0] and _is_unit(name[1]):
        fail(
            source,
            first.end(),
            f"{name[1]!r} is a field and the name of a unit: write 2*{name[1]} for a product, or "
            "the unit by another name, such as 'meter' for 'm'",
        )
    return _factors_end(source, first.end(), fields) or start


def _factors_end(source: str, place: int, fields: Collection[str]) -> int | None:
    """Return where the longest product of units ends that begins here; None if there is none."""
    end = None
    while True:
        opened = _OPENED.match(source, place)
        if opened is not None:
            inside = _factors_end(source, opened.end(), fields)
            factor = None if inside is None else _CLOSED.match(source, inside)
        else:
            factor = _FACTOR.match(source, place)
            if factor is not None and (factor[1] in fields or not _is_unit(factor[1])):
                factor = None
        if factor is None:
            return end
        end = factor.end()
        between = _NEXT.match(source, end)
        if between is None:
            return end
        place = between.end()


def _is_unit(name: str) -> bool:
    try:
        return name not in _KEYWORDS and parse_unit(name) is not None
    except UnitsError:
        return False


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
    """Return the node of ``gradmag``, ``cellwise``, or a component such as ``grad.x``."""
    function, dot, axis = operation.partition(".")
    return Derivative(f"{function}({text(argument)}){dot}{axis}", operation, argument)


# A product of vectors becomes this many levels of sums and products.
_LEVELS_OF_VECTORS = 3
# Operations by which numbers overflow.
_GROWS = {"power", "integer_power", "multiply", "exp"}
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
    if builder.overflow is not None and builder.names:
        builder._fail(builder.overflow, "this overflows: double precision cannot hold it")
    return tree, tuple(builder.names)


class _Builder:
    """Turns Python's nodes into ours, and collects the field names on the way."""

    def __init__(self, text: str, depth: int = 0) -> None:
        self._text, self._depth = text, depth
        self.names: dict[str, None] = {}  # a dict, because it keeps the order
        self.overflow: ast.expr | None = None

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
        if isinstance(built, Call) and built.operation in _GROWS and not list(field_names(built)):
            self._check_size(node, built)
        return built

    def _check_size(self, node: ast.expr, built: Call) -> None:
        """Note where a number overflows: with it there is nothing to compute from fields."""
        if not all(isinstance(part, (Call, Constant)) for part in nodes(built)):
            return
        with np.errstate(all="ignore"):
            first, *others = (float(part.number(NumpyOps(), {})) for part in built.arguments)
            finite = all(map(math.isfinite, (first, *others))) and first != 0.0
            if finite and math.isinf(float(built.number(NumpyOps(), {}))):
                self.overflow = node

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
            case "cellwise" | "gradmag" | "laplacian":
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
        unit = next((given for given in units if given is not None), None)
        if unit is None:
            return numbers, None
        if not all(given is None or given.is_equivalent(unit) for given in units):
            self._fail(node, f"the numbers of a table need units of one kind, such as {unit}")
        if any(given is None and number != 0 for number, given in zip(numbers, units, strict=True)):
            self._fail(node, f"give all numbers of the table a unit, such as {unit}, or none")
        pairs = zip(numbers, units, strict=True)
        return [0.0 if given is None else number * given.to(unit) for number, given in pairs], unit
