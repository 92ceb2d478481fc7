"""Functions of numbers read as expressions: called with symbols, they record their formulas.

Symbols know the arithmetic of Python, that of `voluminous.math`, and NumPy's functions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from numbers import Real
from typing import Any, TypeAlias

import numpy as np

from .expression import Expression
from .parser import interpolation, parse, power
from .tree import Call, Constant, Earlier, Field, Literal, Node, in_steps, replaced


class UnreadableError(TypeError):
    """The language of expressions lacks an operation that a function applies to a symbol."""

    def __init__(self, what: object) -> None:
        super().__init__(f"{what} is not part of an expression")


_Steps: TypeAlias = dict[Node, int]
"""The steps of one function, equal ones once, and their numbers."""


class Symbol(np.lib.mixins.NDArrayOperatorsMixin):
    """An unknown number: a field, a constant, or the number of the step that computes it.

    The base class turns Python's operators into NumPy's functions. `steps` are those so far.
    """

    __slots__ = ("node", "steps")

    def __init__(self, node: Node, steps: _Steps) -> None:
        if not isinstance(node, (Field, Constant)):
            node = Earlier(steps.setdefault(node, len(steps)))
        self.node, self.steps = node, steps

    def __bool__(self) -> bool:
        raise UnreadableError("the truth of a symbol")

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        """Return the symbol for an operator or a function of NumPy's."""
        # ``a += b`` gives `a` as the place for the result; a symbol never changes.
        options.pop("out", None)
        if method != "__call__" or options:
            raise UnreadableError(f"{ufunc.__name__} with these arguments")
        return apply(ufunc.__name__, *inputs)

    def __array_function__(
        self, function: Callable[..., Any], types: Any, inputs: Any, options: Any
    ) -> Any:
        """Return the symbol for one of NumPy's other functions, such as ``where``."""
        return apply(function.__name__, *inputs, **options)


def is_symbolic(*values: Any) -> bool:
    """Return whether one of the values is a symbol."""
    return any(isinstance(value, Symbol) for value in values)


def apply(name: str, *values: Any) -> Any:
    """Return the symbol for an operation, by the name that NumPy or `voluminous.math` gives it.

    An array of numbers, such as a colour, makes an array of symbols.
    """
    if name == "interp":
        x, places, entries = values
        if not isinstance(x, Symbol):
            raise UnreadableError("a table that depends on a symbol")
        return Symbol(interpolation(x.node, places, entries), x.steps)
    if any(isinstance(value, np.ndarray) for value in values):

        def one(*parts: Any) -> Any:
            return apply(name, *parts) if is_symbolic(*parts) else getattr(np, name)(*parts)

        objects = (np.asarray(value, dtype=object) for value in values)
        return np.frompyfunc(one, len(values), 1)(*objects)
    steps = next(value.steps for value in values if isinstance(value, Symbol))
    return Symbol(_composed(name, values), steps)


def read(
    function: Callable[..., Any], inputs: Sequence[Expression], parameters: dict[str, float]
) -> tuple[Any, Callable[[Any], Expression]]:
    """Return what ``function(*inputs, **parameters)`` returns for symbols, and how to convert that.

    The second result turns symbols into expressions.
    """
    steps: _Steps = {}
    names = tuple(dict.fromkeys(name for e in inputs for name in e.names))
    numbers = {n: Symbol(Constant(_finite(value)), steps) for n, value in parameters.items()}
    result = function(*(Symbol(e.tree, steps) for e in inputs), **numbers)

    def expression(value: Any) -> Expression:
        tree = in_steps(tuple(steps), _node(value))
        return Expression.of_tree(tree, names)

    return result, expression


def _node(value: Any) -> Node:
    if isinstance(value, Symbol):
        return value.node
    if isinstance(value, (Real, np.bool_)):
        return Literal(_finite(float(value)))
    raise UnreadableError(type(value).__name__)


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise UnreadableError(value)
    return value


def _composed(name: str, values: Sequence[Any]) -> Node:
    nodes = tuple(_node(value) for value in values)
    if name == "power" and not isinstance(values[1], Symbol):
        return power(*nodes)  # an exponent written in the function, not a parameter
    if name in _CALLS:
        return Call(_CALLS[name], nodes)
    if name in _COMPARISONS:
        return Call("compare", nodes, ((name,),))
    if name not in _COMPOSITIONS:
        raise UnreadableError(name)
    arguments = dict(zip("xyz", nodes, strict=False))

    def filled(node: Node) -> Node | None:
        if isinstance(node, Field):
            return arguments[node.name]
        return Literal(node.value) if isinstance(node, Constant) else None

    return replaced(parse(_COMPOSITIONS[name])[0], filled)


_SAME = "add subtract multiply divide floor_divide remainder power negative positive abs atan2 "
_SAME += "clip cos exp log log10 sin sqrt tan tanh where logical_and logical_or logical_not"
_CALLS = {name: name for name in _SAME.split()} | {
    "absolute": "abs",
    "arctan2": "atan2",
    "minimum": "min",
    "maximum": "max",
    "bitwise_and": "logical_and",
    "bitwise_or": "logical_or",
    "invert": "logical_not",
}
_COMPARISONS = {"less", "less_equal", "greater", "greater_equal", "equal", "not_equal"}
# Other functions, as expressions of their arguments x, y and z.
_COMPOSITIONS = {
    "square": "x**2",
    "reciprocal": "1 / x",
    "log2": f"log(x) * {1 / math.log(2.0)!r}",
    "cosh": "0.5 * (exp(x) + 1 / exp(x))",
    # tanh has the digits near zero that a difference of exponentials loses.
    "sinh": "tanh(x) * (0.5 * (exp(x) + 1 / exp(x)))",
    "floor": "x // 1",
    "ceil": "-(-x // 1)",
    "fma": "x * y + z",
    "isnan": "x != x",
    "zeros_like": "0",
    "ones_like": "1",
}
