"""Arguments of objects: numbers and quantities in lists of any depth, and as plain values again."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..colormaps import get_color, is_name_and_alpha, without_alpha
from ..errors import InputError, unknown_name
from ..units import as_given, described, is_quantity, plain, unit_of

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
    """Return positions as they were given, once they are seen to be finite and of a shape."""
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


def _count(value: Any) -> int:
    return sum(map(_count, value)) if isinstance(value, (list, tuple)) else int(np.size(value))


def check_colors(colors: Any, count: int, what: str) -> None:
    """Refuse what cannot be colours of `count` things, whatever the picture."""
    if is_named(colors):
        named_rgb(colors, count, what)
        return
    colors = without_alpha(colors, what)
    array = np.asarray(plain(colors, unit_of(colors), what), dtype=np.float64)
    if not np.all(np.isfinite(array)):
        raise InputError(f"{what} must be finite")
    if array.ndim > 2 or (array.ndim == 2 and len(array) not in (1, count)):
        raise InputError(
            f"{what} must be one for all (a name, a number, or one per channel), or a list of "
            f"{count} of them; got shape {array.shape}"
        )


def is_named(colors: Any) -> bool:
    """Return True for a colour's name, or a list of names."""
    if is_name_and_alpha(colors):  # which is refused, or a colour
        return False
    return isinstance(colors, str) or (
        isinstance(colors, (list, tuple, np.ndarray))
        and np.ndim(colors) > 0
        and len(colors) > 0
        and isinstance(colors[0], str)
    )


def named_rgb(names: Any, count: int, what: str) -> np.ndarray:
    """Return red, green and blue of one name, or of `count` names."""
    listed = [names] if isinstance(names, str) else list(names)
    if len(listed) not in (1, count):
        raise InputError(f"{what}: expected one name, or {count}, got {len(listed)}")
    return np.array([get_color(name) for name in listed])


def is_column(table: Any, name: str) -> bool:
    """Return True if a table has a column of this name."""
    return name in _names(table)


def column(table: Any, name: str) -> Any:
    """Return a column as an array, or as a Quantity if it has a unit; masked values are NaN.

    Raises
    ------
    InputError
        If it is no table.
    UnknownNameError
        If there is none of this name; names the nearest.
    """
    if not is_column(table, name):
        raise unknown_name("column", str(name), _names(table))
    found = table[name]
    if hasattr(found, "filled") and np.asarray(found).dtype.kind == "f":
        found = found.filled(np.nan)
    if getattr(found, "unit", None) is None:
        return np.asarray(found)
    return getattr(found, "quantity", found)  # of astropy's Column


def _names(table: Any) -> list[str]:
    for place in ("colnames", "columns"):
        if hasattr(table, place):
            return [str(name) for name in getattr(table, place)]
    dtype = getattr(table, "dtype", None)
    if dtype is None and not isinstance(table, Mapping):
        raise InputError(
            "expected a table of astropy or pandas, a dictionary of columns, or an array with "
            f"fields, got {type(table).__name__}"
        )
    return [str(name) for name in (table if dtype is None else dtype.names or ())]
