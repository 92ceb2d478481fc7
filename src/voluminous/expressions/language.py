"""The words of the language: constants, functions, operators, and what to say of foreign ones."""

from __future__ import annotations

import ast
import math
from typing import NamedTuple

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
    "interp": Function("interp(x, [x1, x2, …], [y1, y2, …])", 3, 3),
    "min": Function("min(a, b, …)", 2, math.inf),
    "max": Function("max(a, b, …)", 2, math.inf),
    "gradmag": Function("gradmag(x)", 1, 1),
    "laplacian": Function("laplacian(x)", 1, 1),
    "grad": Function("grad(x)", 1, 1),
    "vector": Function("vector(a, b, c)", 3, 3),
    "norm": Function("norm(v)", 1, 1),
    "dot": Function("dot(v, w)", 2, 2),
    "los": Function("los(v)", 1, 1),
    **{
        name: Function(f"{name}(x)", 1, 1)
        for name in ("abs", "cos", "exp", "log", "log10", "sin", "sqrt", "tan", "tanh")
    },
}

ARITHMETIC: dict[type[ast.AST], str] = {
    ast.Add: "add",
    ast.Sub: "subtract",
    ast.Mult: "multiply",
    ast.Div: "divide",
    ast.FloorDiv: "floor_divide",
    ast.Mod: "remainder",
    ast.UAdd: "positive",
    ast.USub: "negative",
}
COMPARISONS: dict[type[ast.AST], str] = {
    ast.Lt: "less",
    ast.LtE: "less_equal",
    ast.Gt: "greater",
    ast.GtE: "greater_equal",
    ast.Eq: "equal",
    ast.NotEq: "not_equal",
}
LOGIC: dict[type[ast.AST], str] = {
    ast.And: "logical_and",
    ast.Or: "logical_or",
    ast.Not: "logical_not",
}
# Also logical here, but they bind more tightly than comparisons.
TIGHT_LOGIC: dict[type[ast.AST], str] = {
    ast.BitAnd: "logical_and",
    ast.BitOr: "logical_or",
    ast.Invert: "logical_not",
}
FOREIGN_OPERATORS: dict[type[ast.AST], tuple[str, str]] = {
    ast.BitXor: ("^", "'^' is not an operator of expressions; powers are written with '**'"),
    ast.MatMult: ("@", "'@' is not an operator of expressions; '*' multiplies"),
    ast.LShift: ("<<", "'<<' is not an operator of expressions; '<' compares"),
    ast.RShift: (">>", "'>>' is not an operator of expressions; '>' compares"),
}
FOREIGN: dict[type[ast.AST], str] = {
    ast.Attribute: "'.' after a name is not part of an expression; write log10(x), not np.log10(x)",
    ast.Subscript: "[] after a name is not part of an expression; it holds for all elements",
    ast.JoinedStr: "text in quotes is not part of an expression; write field names without quotes",
    ast.NamedExpr: "':=' is not part of an expression; '==' compares",
    ast.List: "a list is only allowed as the table of interp(x, [x1, x2, …], [y1, y2, …])",
    ast.Tuple: "',' is only allowed between the arguments of a function",
}
# Functions of other languages, and what says the same here.
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
FOREIGN_FUNCTIONS |= {
    f"arc{name[1:]}": FOREIGN_FUNCTIONS[name] for name in ("asin", "acos", "atan")
}
