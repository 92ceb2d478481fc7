"""The operations that evaluate an expression, and their implementation for NumPy arrays."""

from __future__ import annotations

import functools
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np

from ..errors import InputError

Value: TypeAlias = Any
"""Numbers or masks as an evaluator has them: NumPy or Dr.Jit arrays, intervals, jets."""
_One: TypeAlias = Callable[[Value], Value]
_Two: TypeAlias = Callable[[Value, Value], Value]


class Ops(ABC):
    """An evaluator: the operators and functions of the language.

    Arithmetic, functions and comparisons get numbers; `logical_and`, `logical_or` and `logical_not`
    get masks.
    """

    add = staticmethod(operator.add)
    subtract = staticmethod(operator.sub)
    multiply = staticmethod(operator.mul)
    divide = staticmethod(operator.truediv)
    negative = staticmethod(operator.neg)
    positive = staticmethod(operator.pos)
    less = staticmethod(operator.lt)
    less_equal = staticmethod(operator.le)
    greater = staticmethod(operator.gt)
    greater_equal = staticmethod(operator.ge)
    equal = staticmethod(operator.eq)
    logical_not = staticmethod(operator.invert)
    abs = staticmethod(operator.abs)

    log10: _One
    log: _One
    exp: _One
    sqrt: _One
    sin: _One
    cos: _One
    tan: _One
    tanh: _One
    atan2: _Two
    power: _Two
    floor_divide: _Two
    remainder: _Two
    minimum: _Two
    maximum: _Two
    where: Callable[[Value, Value, Value], Value]
    ones_like: _One

    @abstractmethod
    def prepare(self, values: Mapping[str, Value]) -> tuple[Ops, dict[str, Value]]:
        """Return the evaluator fit for these fields, and the fields as it computes with them."""

    @abstractmethod
    def constant(self, value: float) -> Value:
        """Return a constant in the evaluator's type."""

    def literal(self, value: float) -> Value:
        """Return a constant that may be compiled into the kernel."""
        return self.constant(value)

    @abstractmethod
    def interp(self, x: Value, places: tuple[float, ...], entries: tuple[float, ...]) -> Value:
        """Return the entries of a table, given at increasing places, interpolated at x."""

    @abstractmethod
    def is_mask(self, value: Value) -> bool:
        """Return True if `value` is true or false rather than a number."""

    @abstractmethod
    def number(self, value: Value) -> Value:
        """Return `value` as numbers: true is 1, false is 0."""

    def mask(self, value: Value) -> Value:
        """Return `value` as a mask: numbers other than 0 are true, NaN too."""
        return value if self.is_mask(value) else ~(value == 0)

    def logical_and(self, *masks: Value) -> Value:
        return functools.reduce(operator.and_, masks)

    def logical_or(self, *masks: Value) -> Value:
        return functools.reduce(operator.or_, masks)

    def not_equal(self, left: Value, right: Value) -> Value:
        """Return where two numbers differ; NaN differs from everything (not so in Dr.Jit's !=)."""
        return ~self.equal(left, right)

    def compare(self, *arguments: Any) -> Value:
        """Return where a chain holds, given its values and the names of the comparisons between."""
        *values, operations = arguments
        pairs = zip(operations, pairwise(values), strict=True)
        return self.logical_and(*(getattr(self, operation)(*pair) for operation, pair in pairs))

    def min(self, *values: Value) -> Value:
        """Return the smallest of two or more; NaN if one is."""
        return functools.reduce(self.minimum, values)

    def max(self, *values: Value) -> Value:
        """Return the largest of two or more; NaN if one is."""
        return functools.reduce(self.maximum, values)

    def clip(self, value: Value, lower: Value, upper: Value) -> Value:
        """Return `value` limited to an interval; `upper` wins if the limits are the wrong way."""
        return self.minimum(self.maximum(value, lower), upper)

    def integer_power(self, base: Value, exponent: int) -> Value:
        """Return a whole power by repeated squaring; the reciprocal for a negative exponent."""
        if exponent < 0:
            return self.ones_like(base) / self.integer_power(base, -exponent)
        if exponent == 0:
            return self.ones_like(base)
        if exponent % 2:
            return base if exponent == 1 else base * self.integer_power(base, exponent - 1)
        half = self.integer_power(base, exponent // 2)
        return half * half


class NumpyOps(Ops):
    """Evaluation with NumPy arrays.

    All fields are promoted to one floating type: float32 if every field is float32, float16, bool
    or an integer of at most 16 bits, else float64. Constants get that type too, so that they never
    change it. An expression without fields is float64.
    """

    atan2 = staticmethod(np.arctan2)

    def __init__(self, dtype: Any = np.float64) -> None:
        self._dtype = np.dtype(dtype)

    def prepare(self, values: Mapping[str, Value]) -> tuple[Ops, dict[str, Value]]:
        arrays = {name: np.asarray(value) for name, value in values.items()}
        types = [_floating_type(name, array.dtype) for name, array in arrays.items()]
        common = functools.reduce(np.promote_types, types) if types else np.dtype(np.float64)
        return NumpyOps(common), {
            name: array.astype(common, copy=False) for name, array in arrays.items()
        }

    def constant(self, value: float) -> Value:
        return np.asarray(value, dtype=self._dtype)

    def interp(self, x: Value, places: tuple[float, ...], entries: tuple[float, ...]) -> Value:
        return self.number(np.interp(x, places, entries))

    def is_mask(self, value: Value) -> bool:
        return bool(value.dtype == np.bool_)

    def number(self, value: Value) -> Value:
        return np.asarray(value, dtype=self._dtype)


for _name in ("log10", "log", "exp", "sqrt", "sin", "cos", "tan", "tanh", "power", "floor_divide"):
    setattr(NumpyOps, _name, staticmethod(getattr(np, _name)))
for _name in ("remainder", "minimum", "maximum", "where", "ones_like"):
    setattr(NumpyOps, _name, staticmethod(getattr(np, _name)))


def _floating_type(name: str, dtype: np.dtype[Any]) -> np.dtype[Any]:
    if dtype.kind not in "biuf":
        raise InputError(f"field {name!r} must hold real numbers, got an array of {dtype}")
    promoted = np.promote_types(dtype, np.float32)
    return promoted if promoted == np.float32 else np.dtype(np.float64)
