"""The operations an expression is evaluated with, and their implementation for NumPy arrays."""

from __future__ import annotations

import functools
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..errors import InputError


class Ops(ABC):
    """What an evaluator offers: the operators and functions of the language.

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
    logical_and = staticmethod(operator.and_)
    logical_or = staticmethod(operator.or_)
    logical_not = staticmethod(operator.invert)
    abs = staticmethod(operator.abs)

    log10: Callable[[Any], Any]
    log: Callable[[Any], Any]
    exp: Callable[[Any], Any]
    sqrt: Callable[[Any], Any]
    sin: Callable[[Any], Any]
    cos: Callable[[Any], Any]
    tan: Callable[[Any], Any]
    tanh: Callable[[Any], Any]
    atan2: Callable[[Any, Any], Any]
    power: Callable[[Any, Any], Any]
    floor_divide: Callable[[Any, Any], Any]
    remainder: Callable[[Any, Any], Any]
    minimum: Callable[[Any, Any], Any]
    maximum: Callable[[Any, Any], Any]
    where: Callable[[Any, Any, Any], Any]
    ones_like: Callable[[Any], Any]

    @abstractmethod
    def prepare(self, values: Mapping[str, Any]) -> tuple[Ops, dict[str, Any]]:
        """Return the evaluator fit for these fields, and the fields as it computes with them."""

    @abstractmethod
    def constant(self, value: float) -> Any:
        """Return a constant in the evaluator's type."""

    def literal(self, value: float) -> Any:
        """Return a number that is never turned; where it can be, a part of the machine code."""
        return self.constant(value)

    @abstractmethod
    def interpolate(self, x: Any, places: np.ndarray, entries: np.ndarray) -> Any:
        """Return the entries of a table, given at increasing places, interpolated at x."""

    @abstractmethod
    def is_mask(self, value: Any) -> bool:
        """Return True if `value` is true or false rather than a number."""

    @abstractmethod
    def number(self, value: Any) -> Any:
        """Return `value` as numbers: true is 1, false is 0."""

    def mask(self, value: Any) -> Any:
        """Return `value` as a mask: numbers other than 0 are true, NaN too."""
        return value if self.is_mask(value) else ~(value == 0)

    def not_equal(self, left: Any, right: Any) -> Any:
        """Return where two numbers differ; NaN differs from everything (not so in Dr.Jit's !=)."""
        return ~self.equal(left, right)

    def min(self, *values: Any) -> Any:
        """Return the smallest of two or more; NaN if one is."""
        return functools.reduce(self.minimum, values)

    def max(self, *values: Any) -> Any:
        """Return the largest of two or more; NaN if one is."""
        return functools.reduce(self.maximum, values)

    def clip(self, value: Any, lower: Any, upper: Any) -> Any:
        """Return `value` limited to an interval; `upper` wins if the limits are the wrong way."""
        return self.minimum(self.maximum(value, lower), upper)

    def integer_power(self, base: Any, exponent: int) -> Any:
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

    Parameters
    ----------
    dtype : numpy dtype, optional
        The type of constants; `prepare` finds it from the fields.
    """

    log10 = staticmethod(np.log10)
    log = staticmethod(np.log)
    exp = staticmethod(np.exp)
    sqrt = staticmethod(np.sqrt)
    sin = staticmethod(np.sin)
    cos = staticmethod(np.cos)
    tan = staticmethod(np.tan)
    tanh = staticmethod(np.tanh)
    atan2 = staticmethod(np.arctan2)
    power = staticmethod(np.power)
    floor_divide = staticmethod(np.floor_divide)
    remainder = staticmethod(np.remainder)
    minimum = staticmethod(np.minimum)
    maximum = staticmethod(np.maximum)
    where = staticmethod(np.where)
    ones_like = staticmethod(np.ones_like)

    def __init__(self, dtype: Any = np.float64) -> None:
        self._dtype = np.dtype(dtype)

    def prepare(self, values: Mapping[str, Any]) -> tuple[Ops, dict[str, Any]]:
        """Return the evaluator for the fields' common floating type, and the fields in it."""
        arrays = {name: np.asarray(value) for name, value in values.items()}
        types = [_floating_type(name, array.dtype) for name, array in arrays.items()]
        common = functools.reduce(np.promote_types, types) if types else np.dtype(np.float64)
        return NumpyOps(common), {
            name: array.astype(common, copy=False) for name, array in arrays.items()
        }

    def constant(self, value: float) -> Any:
        return np.asarray(value, dtype=self._dtype)

    def interpolate(self, x: Any, places: np.ndarray, entries: np.ndarray) -> Any:
        return self.number(np.interp(x, places, entries))

    def is_mask(self, value: Any) -> bool:
        return bool(value.dtype == np.bool_)

    def number(self, value: Any) -> Any:
        return np.asarray(value, dtype=self._dtype)


def _floating_type(name: str, dtype: np.dtype[Any]) -> np.dtype[Any]:
    if dtype.kind not in "biuf":
        raise InputError(f"field {name!r} must hold real numbers, got an array of {dtype}")
    promoted = np.promote_types(dtype, np.float32)
    return promoted if promoted == np.float32 else np.dtype(np.float64)
