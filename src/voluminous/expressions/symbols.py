"""Functions of numbers read as expressions: called with symbols, they write their formulas down.

Symbols know the arithmetic of Python, that of `voluminous.math`, and NumPy's functions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from numbers import Real
from typing import Any

import numpy as np

from .expression import Expression
from .parser import interpolation, power
from .tree import (
    Call,
    Comparison,
    Constant,
    Earlier,
    Field,
    Literal,
    Logic,
    Node,
    Where,
    in_steps,
    text,
)


class UnreadableError(TypeError):
    """What a function does with a symbol is no part of an expression."""


class Symbol(np.lib.mixins.NDArrayOperatorsMixin):
    """A number not yet known. Operators are NumPy's functions: the base class says which.

    Attributes
    ----------
    node : Node
        A field, a constant, or the number of the step that computes it.
    recorder : StepRecorder
        Who keeps the steps.
    """

    __slots__ = ("node", "recorder")

    def __init__(self, node: Node, recorder: StepRecorder) -> None:
        self.node, self.recorder = node, recorder

    def __bool__(self) -> bool:
        raise UnreadableError("a symbol is neither true nor false")

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        """Return the symbol for an operator or a function of NumPy's."""
        # ``a += b`` gives `a` as the place for the result; a symbol never changes.
        options.pop("out", None)
        if method != "__call__" or options:
            raise UnreadableError(f"{ufunc.__name__} so called is no part of an expression")
        return apply(ufunc.__name__, *inputs)

    def __array_function__(self, function: Any, types: Any, given: Any, named: Any) -> Any:
        """Return the symbol for one of NumPy's other functions, such as ``where``."""
        return apply(function.__name__, *given, **named)


class StepRecorder:
    """The steps of one function, in the order in which it takes them; equal ones are one."""

    def __init__(self) -> None:
        self._numbers: dict[Node, int] = {}

    def symbol(self, node: Node) -> Symbol:
        """Return the symbol for a step."""
        if not isinstance(node, (Field, Constant)):
            node = Earlier(self._numbers.setdefault(node, len(self._numbers)))
        return Symbol(node, self)

    def expression(self, value: Any, names: tuple[str, ...]) -> Expression:
        """Return a value of the function as an expression of fields."""
        tree = in_steps(tuple(self._numbers), _node(value))
        return Expression.of_tree(tree, names, text(tree))


def is_symbolic(*values: Any) -> bool:
    """Return whether there is a symbol among some values."""
    return any(isinstance(value, Symbol) for value in values)


def apply(name: str, *values: Any) -> Any:
    """Return the symbol for an operation, by the name that NumPy or `voluminous.math` gives it.

    An array of numbers, such as a colour, makes an array of symbols.
    """
    if name == "interp":
        return _interpolated(*values)
    if any(isinstance(value, np.ndarray) for value in values):
        return _one_by_one(name, values)
    recorder = next(value.recorder for value in values if isinstance(value, Symbol))
    return recorder.symbol(_composed(name, values))


def read(
    function: Callable[..., Any], inputs: Sequence[Expression], parameters: dict[str, float]
) -> tuple[Any, Callable[[Any], Expression]]:
    """Return what a function returns for symbols, and what makes expressions of that.

    Parameters
    ----------
    function : callable
        Called as ``function(*inputs, **parameters)``.
    inputs : sequence of Expression
        Its arguments.
    parameters : dict of float
        Numbers given to it by name.
    """
    recorder = StepRecorder()
    names = tuple(dict.fromkeys(name for e in inputs for name in e.names))
    arguments = [recorder.symbol(e.tree) for e in inputs]
    numbers = {
        name: recorder.symbol(Constant(_finite(value))) for name, value in parameters.items()
    }
    return function(*arguments, **numbers), lambda value: recorder.expression(value, names)


def _interpolated(x: Any, places: Any, entries: Any) -> Symbol:
    if not isinstance(x, Symbol):
        raise UnreadableError("the tables of interp hold numbers only")
    return x.recorder.symbol(interpolation(x.node, places, entries))


def _one_by_one(name: str, values: Sequence[Any]) -> np.ndarray:
    """Return an array of symbols for an operation on arrays of numbers and symbols."""
    parts = np.broadcast_arrays(*(_as_objects(value) for value in values))
    found = np.empty(parts[0].shape, dtype=object)
    for index in np.ndindex(found.shape):
        one = [part[index] for part in parts]
        found[index] = apply(name, *one) if is_symbolic(*one) else getattr(np, name)(*one)
    return found


def _as_objects(value: Any) -> np.ndarray:
    if isinstance(value, np.ndarray):
        return value.astype(object)
    held = np.empty((), dtype=object)
    held[()] = value
    return held


def _node(value: Any) -> Node:
    if isinstance(value, Symbol):
        return value.node
    if isinstance(value, (Real, np.bool_)):
        return Literal(_finite(float(value)))
    raise UnreadableError(f"{type(value).__name__} is no part of an expression")


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise UnreadableError(f"{value} is no part of an expression")
    return value


def _composed(name: str, values: Sequence[Any]) -> Node:
    """Return the node for an operation; of several, if the language has it not."""
    nodes = tuple(_node(value) for value in values)
    if name == "power" and not isinstance(values[1], Symbol):
        return power(*nodes)  # an exponent written in the function, not a parameter
    for table, kind in ((_CALLS, Call), (_LOGIC, Logic)):
        if name in table:
            return kind(table[name], nodes)
    if name in _COMPARISONS:
        return Comparison((_COMPARISONS[name],), nodes)
    if name == "where":
        return Where(*nodes)
    if name not in _COMPOSITIONS:
        raise UnreadableError(f"{name} is no part of an expression")
    return _COMPOSITIONS[name](*nodes)


def _of(operation: str, *parts: Node) -> Node:
    return Call(operation, parts)


def _half_of(x: Node, operation: str) -> Node:
    up = _of("exp", x)
    return _of("multiply", Literal(0.5), _of(operation, up, _of("divide", Literal(1.0), up)))


_CALLS = {
    "add": "add",
    "subtract": "subtract",
    "multiply": "multiply",
    "divide": "divide",
    "floor_divide": "floor_divide",
    "remainder": "remainder",
    "power": "power",
    "negative": "negative",
    "positive": "positive",
    "absolute": "abs",
    "abs": "abs",
    "arctan2": "atan2",
    "atan2": "atan2",
    "minimum": "min",
    "maximum": "max",
    **{n: n for n in ("clip", "cos", "exp", "log", "log10", "sin", "sqrt", "tan", "tanh")},
}
_LOGIC = {
    "bitwise_and": "logical_and",
    "bitwise_or": "logical_or",
    "invert": "logical_not",
    **{n: n for n in ("logical_and", "logical_or", "logical_not")},
}
_COMPARISONS = {n: n for n in ("less", "less_equal", "greater", "greater_equal", "equal")} | {
    "not_equal": "not_equal"
}
_COMPOSITIONS: dict[str, Callable[..., Node]] = {
    "square": lambda x: power(x, Literal(2.0)),
    "reciprocal": lambda x: _of("divide", Literal(1.0), x),
    "log2": lambda x: _of("multiply", _of("log", x), Literal(1 / math.log(2.0))),
    "cosh": lambda x: _half_of(x, "add"),
    # tanh has the digits near zero that a difference of exponentials loses.
    "sinh": lambda x: _of("multiply", _of("tanh", x), _half_of(x, "add")),
    "floor": lambda x: _of("floor_divide", x, Literal(1.0)),
    "ceil": lambda x: _of("negative", _of("floor_divide", _of("negative", x), Literal(1.0))),
    "fma": lambda a, b, c: _of("add", _of("multiply", a, b), c),
    "isnan": lambda x: Comparison(("not_equal",), (x, x)),
    "zeros_like": lambda x: Literal(0.0),
    "ones_like": lambda x: Literal(1.0),
}
