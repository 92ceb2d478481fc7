"""Arguments of objects: numbers and quantities in lists of any depth, and as plain values again."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import InputError
from ..units import as_given, is_quantity, parse_unit, plain, unit_name, unit_of

# More numbers are only counted where a picture tells what it shows.
MANY = 64


def joined(value: Any) -> Any:
    """Return one quantity in place of lists of quantities; everything else as it is."""
    if not isinstance(value, (list, tuple)):
        return value
    parts = [joined(v) for v in value]
    if not parts or not is_quantity(parts[0]):
        return value
    unit = parts[0].unit
    return np.array([plain(part, unit, "value") for part in parts]) * unit


def merged(value: Any) -> Any:
    """Return what `joined` does, once texts such as "0.1 pc" are the quantities that they name."""
    return joined(_without_texts(value))


def _without_texts(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return type(value)(_without_texts(v) for v in value)
    return as_given(value)


def positions_of(value: Any, what: str, shape: tuple[Any, ...]) -> Any:
    """Return positions as they were given, once they are seen to be finite and of a shape.

    Raises
    ------
    InputError
        If they are not. None in `shape` stands for any number.
    """
    value = merged(value)
    array = np.asarray(plain(value, unit_of(value), what))
    fits = array.ndim == len(shape) and all(
        wanted in (None, n) for wanted, n in zip(shape, array.shape, strict=True)
    )
    if not fits or not np.all(np.isfinite(array)):
        wanted = ", ".join("n" if n is None else str(n) for n in shape)
        raise InputError(
            f"{what} must be finite, of shape ({wanted}{',' * (len(shape) == 1)}); got "
            f"{'some that are not finite' if fits else f'shape {array.shape}'}"
        )
    return value


def options_of(make: Callable[..., Any], thing: Any, most: float = math.inf) -> dict[str, Any]:
    """Return the arguments of what makes a thing that differ from their defaults, as plain values.

    They are the attributes of these names; what is no attribute is not told. More than `most`
    values are only counted.
    """
    told = {}
    for name, parameter in inspect.signature(make).parameters.items():
        value, default = getattr(thing, name, parameter.default), parameter.default
        single = not isinstance(value, (list, tuple)) and np.ndim(value) == 0
        same = value is default or (single and bool(np.all(value == default)))
        if not same:
            count = _count(value)
            told[name] = described(value) if count <= most else f"{count} values"
    return told


def described(value: Any) -> Any:
    """Return a value as plain ones: quantities as texts such as "1.0 pc"."""
    if is_quantity(value):
        name = unit_name(parse_unit(value.unit))
        return _texts(np.asarray(value.value, dtype=np.float64).tolist(), name)
    if isinstance(value, (list, tuple)):
        return [described(v) for v in value]
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value


def _texts(numbers: Any, unit: str) -> Any:
    if isinstance(numbers, list):
        return [_texts(n, unit) for n in numbers]
    return f"{numbers!r} {unit}" if unit else numbers


def _count(value: Any) -> int:
    return sum(map(_count, value)) if isinstance(value, (list, tuple)) else int(np.size(value))
