"""The language of expressions: its words, its errors, and numbers with units in it.

Python's grammar has no place for a unit. Therefore ``los(velocity) / (0.2 km/s)`` is rewritten with
``0.2["km/s"]`` before it is parsed, and the parser makes a `NumberWithUnit` of that.
"""

from __future__ import annotations

import ast
import functools
import math
import re
from collections.abc import Collection
from typing import NamedTuple, NoReturn

from ..errors import ExpressionError, UnitsError
from ..units import parse_unit

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
for _name in (*_ONE, "grad", "gradmag", "laplacian"):
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


def one_line(text: str) -> str:
    """Return the text without spaces around it, and with spaces for tabs and line ends."""
    return text.translate(dict.fromkeys(map(ord, "\t\n\r\f\v"), " ")).strip(" ")


def python_tree(text: str) -> ast.expr:
    """Return Python's syntax tree of the text; nothing is compiled."""
    if not text:
        raise ExpressionError("the expression is empty; write a field name or 'log10(density)'")
    if len(text) > MAX_LENGTH:
        raise ExpressionError(
            f"the expression has {len(text)} characters, expected at most {MAX_LENGTH}; "
            "split it into derived fields"
        )
    for character, what in (("#", "a comment ('#')"), ("\0", "a null byte")):
        if character in text:
            fail(text, text.index(character), f"{what} cannot be part of an expression")
    try:
        return ast.parse(text, mode="eval").body
    except SyntaxError as error:
        _fail_syntax(text, error)
    except ValueError as error:  # characters that cannot be encoded
        raise ExpressionError(f"the expression cannot be read: {error}") from None
    except (RecursionError, MemoryError):  # how Python's parser reports too deep a nesting
        fail_too_deep(text, 0)


def _fail_syntax(text: str, error: SyntaxError) -> NoReturn:
    if not error.offset:  # it counts from 1; 0 stands for the whole text, or its end
        if error.msg == "invalid syntax":
            fail(text, len(text), "the expression ends too early")
        fail(text, 0, error.msg)
    place = error.offset - 1
    before, here = text[:place].rstrip()[-1:], text[place : place + 1]
    adjacent = (before.isalnum() or before == ")") and here.isalnum()
    # Of 2a Python points to the number.
    plain = _NO_OPERATOR if adjacent or "decimal literal" in error.msg else error.msg
    fail(text, place, _HINTS.get(here, plain))


def fail_too_deep(text: str, place: int) -> NoReturn:
    """Raise the error for an expression with too many levels."""
    problem = f"nested too deeply: over {MAX_DEPTH} levels, each '+' of a long sum being one"
    fail(text, place, f"{problem}; split it into derived fields")


def fail(text: str, place: int, problem: str) -> NoReturn:
    """Raise the error for a problem at character `place`, with a caret under it."""
    # Units stand in brackets and quotes, see `marked`.
    before, after = (re.sub(r'\["(.*?)"\]', r" \1", part) for part in (text[:place], text[place:]))
    text, place = before + after, len(before)
    start, end = max(0, place - 50), place + 50
    before, after = "…" * (start > 0), "…" * (end < len(text))
    shown = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text[start:end])
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


@functools.lru_cache(maxsize=1024)
def marked(text: str, fields: tuple[str, ...] = ()) -> str:
    """Return the text with ``0.2["km/s"]`` in place of ``0.2 km/s``.

    `fields` are names that are fields where they follow ``*`` or ``/``, even if they are units too:
    in ``20 K/T`` T is the temperature if there is such a field, else the tesla.
    """
    parts, place = [], 0
    for number in _NUMBER.finditer(text):
        if number.start() < place:  # the 1 of "2 1/cm", the 3 of "2 cm-3"
            continue
        end = _unit_end(text, number.end(), fields)
        if end > number.end():
            unit = text[number.end() : end].strip()
            parts += [text[place : number.end()], f'["{unit}"]']
            place = end
    return "".join([*parts, text[place:]])


def _unit_end(text: str, start: int, fields: Collection[str]) -> int:
    """Return where the longest unit ends that begins after a number; `start` if there is none."""
    first = _FIRST.match(text, start)
    if first is None:
        return start
    name = _FACTOR.match(text, first.end())
    if name is not None and name[1] in fields and "/" not in first[0] and _is_unit(name[1]):
        fail(
            text,
            first.end(),
            f"{name[1]!r} is a field and the name of a unit: write 2*{name[1]} for a product, or "
            "the unit by another name, such as 'meter' for 'm'",
        )
    return _factors_end(text, first.end(), fields) or start


def _factors_end(text: str, place: int, fields: Collection[str]) -> int | None:
    """Return where the longest product of units ends that begins here; None if there is none."""
    end = None
    while True:
        opened = _OPENED.match(text, place)
        if opened is not None:
            inside = _factors_end(text, opened.end(), fields)
            factor = None if inside is None else _CLOSED.match(text, inside)
        else:
            factor = _FACTOR.match(text, place)
            if factor is not None and (factor[1] in fields or not _is_unit(factor[1])):
                factor = None
        if factor is None:
            return end
        end = factor.end()
        between = _NEXT.match(text, end)
        if between is None:
            return end
        place = between.end()


def _is_unit(name: str) -> bool:
    try:
        return name not in _KEYWORDS and parse_unit(name) is not None
    except UnitsError:
        return False
