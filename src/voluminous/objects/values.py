"""Arguments of objects: numbers and quantities in lists of any depth, and as plain values again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..colormaps import get_color, is_name_and_alpha, without_alpha
from ..errors import InputError, check_name
from ..units import is_listed, plain, shown, unit_of

# More numbers are only counted where a picture tells what it shows.
MANY = 64


def positions_of(value: Any, what: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """Return positions as plain numbers, if they are finite and of a shape."""
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
    return array


def count_of(value: Any) -> int:
    """Return how many numbers or texts there are in a value."""
    return sum(map(count_of, value)) if isinstance(value, (list, tuple)) else int(np.size(value))


def check_colors(colors: Any, count: int, what: str) -> None:
    """Refuse what cannot be colours of `count` things, whatever the picture."""
    if is_named(colors):
        named_rgb(colors, count, what)
        return
    if is_spectrum(colors):
        return
    colors = without_alpha(colors, what)
    try:
        array = np.asarray(plain(colors, unit_of(colors), what), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(
            f"{what} must be names of colours, or numbers, got {shown(colors)}"
        ) from None
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
    return isinstance(colors[0] if is_listed(colors) and len(colors) else colors, str)


def is_spectrum(colors: Any) -> bool:
    """Return True for a spectrum such as `Blackbody`, or a list of them."""
    several = isinstance(colors, (list, tuple)) and len(colors) > 0
    return hasattr(colors[0] if several else colors, "intensity")


def named_rgb(names: Any, count: int, what: str) -> np.ndarray:
    """Return red, green and blue of one name, or of `count` names."""
    listed = [names] if isinstance(names, str) else list(names)
    if len(listed) not in (1, count):
        raise InputError(f"{what}: expected one name, or {count}, got {len(listed)}")
    return np.array([get_color(name) for name in listed])


def column_names(table: Any) -> list[str]:
    """Return the names of the columns of a table."""
    names = getattr(table, "colnames", getattr(table, "columns", None))  # astropy, pandas
    if names is None and isinstance(table, Mapping):
        names = table
    if names is None and isinstance(table, np.ndarray):
        names = table.dtype.names or ()
    if names is None:
        raise InputError(
            "expected a table of astropy or pandas, a dictionary of columns, or an array with "
            f"fields, got {type(table).__name__}"
        )
    return [str(name) for name in names]


def column(table: Any, name: str) -> Any:
    """Return a column as an array, or as a Quantity if it has a unit; masked values are NaN.

    Raises
    ------
    InputError
        If it is no table.
    UnknownNameError
        If there is none of this name; names the nearest.
    """
    names = column_names(table)
    check_name("column", name, names)
    values = table[name]
    if hasattr(values, "filled") and np.asarray(values).dtype.kind == "f":
        values = values.filled(np.nan)
    if getattr(values, "unit", None) is None:
        return np.asarray(values)
    return getattr(values, "quantity", values)  # of astropy's Column
