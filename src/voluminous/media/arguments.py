"""Arguments of media: checked and brought into one form, and described in scene files."""

from __future__ import annotations

import inspect
import math
from numbers import Real
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ..colormaps import (
    get_color,
    get_colormap,
    is_color,
    is_name_and_alpha,
    mapped_colors,
    without_alpha,
)
from ..errors import InputError, UnknownNameError
from ..expressions import Expression
from ..units import as_given, is_quantity, parse_unit, plain, split_text, unit_name, unit_of
from ..value import Value

if TYPE_CHECKING:
    from ..evaluation import Evaluation

V = TypeVar("V", bound=Value)


def described(thing: Value) -> dict[str, Any]:
    """Return the arguments of a medium as plain values, without None and options at their defaults.

    Of an argument that is also an attribute, it is the attribute.
    """
    parameters = inspect.signature(type(thing)).parameters
    result = {}
    for name, given in thing.arguments().items():
        parameter = parameters.get(name)
        option = parameter is not None and parameter.kind is parameter.KEYWORD_ONLY
        default = parameter.default if parameter is not None and option else None
        if given is default or (isinstance(given, (str, float, int)) and given == default):
            continue
        value: Any = given if isinstance(given, Value) else getattr(thing, name, given)
        if name == "where":
            value = Expression(given)
        if isinstance(value, tuple) and len(value) == 1 and not isinstance(value[0], Value):
            value = value[0]
        result[name] = _described(float(value) if isinstance(default, float) else value)
    return result


def with_plain_expressions(thing: V, volume: Evaluation) -> V:
    """Return a value whose expressions are plain numbers of a volume's fields; those in it, too."""
    changes: dict[str, Any] = {}
    for name, given in thing.arguments().items():
        new = given
        if isinstance(given, Value):
            new = with_plain_expressions(given, volume)
        elif name in ("expr", "where") and given is not None:
            given = Expression(given)
            new = volume.without_units(given)
        if new is not given:
            changes[name] = new
    return thing.replace(**changes) if changes else thing


def _described(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return [_described(one) for one in value]
    if isinstance(value, Value):
        return value.describe()
    if isinstance(value, Expression):
        return value.text
    if isinstance(value, (np.ndarray, np.generic)) and not is_quantity(value):
        return value.tolist()
    return named(value)


def scalar(value: Any, what: str) -> Any:
    """Return a finite float, or a Quantity left as it is until the volume's unit is known.

    Of text such as "0.1 pc" it is the quantity in it.
    """
    value = as_given(value, what)
    magnitude = value.value if is_quantity(value) else value
    try:
        number = float(magnitude)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{what} must be one number or quantity, got {value!r}") from error
    if not math.isfinite(number):
        raise InputError(f"{what} must be finite, got {value!r}")
    return value if is_quantity(value) else number


def whole_number(value: Any, what: str, least: int, most: int) -> int:
    """Return a whole number, which may be written as ``16.0``."""
    real = isinstance(value, Real)
    if not real or not least <= value <= most or int(value) != value:
        raise InputError(f"{what} must be a whole number from {least} to {most}, got {value!r}")
    return int(value)


def listed(value: Any) -> bool:
    """Return True for lists, tuples and arrays of at least one dimension."""
    return isinstance(value, (list, tuple)) or (isinstance(value, np.ndarray) and value.ndim > 0)


def named(value: Any) -> Any:
    """Return a number, or a quantity as text such as ``"2.5e+16 cm"``."""
    if is_quantity(value):
        return f"{float(value.value)!r} {unit_name(parse_unit(value.unit))}".strip()
    return value


def plain_number(value: Any) -> float:
    """Return a quantity's value, or a number itself."""
    return float(value.value if is_quantity(value) else value)


def channel_values(value: Any, what: str) -> tuple[float, ...]:
    """Return finite floats, one per channel, from a number or a sequence."""
    check_plain(value, what)
    try:
        values = np.atleast_1d(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{what} must be a number or one number per channel, got {value!r}"
        ) from error
    if values.ndim != 1 or values.size == 0 or not np.all(np.isfinite(values)):
        raise InputError(f"{what} must be finite, one number per channel, got {value!r}")
    return tuple(float(v) for v in values)


def color_values(color: Any) -> tuple[float, ...]:
    """Return emission per channel, from numbers, or red, green and blue from a colour's name."""
    if isinstance(color, str):
        return get_color(color)
    return channel_values(without_alpha(color, "color"), "color")


def check_plain(value: Any, what: str) -> None:
    """Refuse quantities where NumPy would drop the unit."""
    if unit_of(value) is not None or is_quantity(value):
        raise InputError(
            f"{what} must be plain numbers, got {value}; units belong to expr and path_length"
        )


def check_extinction(values: tuple[float, ...], channels: int, what: str) -> None:
    """Refuse negative opacities, and a number of them that is neither one nor the channels'."""
    if min(values) < 0:
        raise InputError(f"{what} must not be negative, got {min(values):g}")
    if len(values) not in (1, channels):
        raise InputError(
            f"{what} must be one number (grey) or {channels} (one per channel), got {len(values)}"
        )


def fraction(value: Any, what: str) -> float:
    """Return a number from 0 to 1."""
    if not isinstance(value, (int, float)) or not 0 <= value <= 1:
        raise InputError(f"{what} must be a number from 0 to 1, got {value!r}")
    return float(value)


# As a path length: the median thickness in the volume (`calibration`).
AUTO = "auto"


def given_path_length(value: Any) -> Any:
    """Return a positive length, or "auto", which stays until the volume is known."""
    if isinstance(value, str):
        if value == AUTO:
            return value
        if split_text(value) is None:
            expected = "a number, a quantity such as '0.1 pc', or 'auto'"
            raise InputError(f"path_length must be {expected}, got {value!r}")
    length = scalar(value, "path_length")
    check_positive(length, "path_length")
    return length


def length_in(path_length: Any, unit: Any) -> float:
    """Return a path length as a number in the volume's unit; "auto" must have become one."""
    if isinstance(path_length, str):
        raise InputError(
            "path_length is still 'auto', which only a volume makes a number: use the medium that "
            "medium.calibrated(volume) returns (vm.render does that by itself)"
        )
    return float(plain(path_length, unit, "path_length"))


def check_positive(value: Any, what: str) -> None:
    """Refuse a number or quantity that is not positive."""
    if plain_number(value) <= 0:
        raise InputError(f"{what} must be positive, got {value}")


# The optical depth of an opaque surface: what shows through is below all rounding.
_OPAQUE = 40.0


def given_levels(level: Any) -> tuple[Any, ...]:
    """Return the levels of surfaces, from one value or several."""
    several = isinstance(level, (list, tuple)) or np.ndim(level) > 0
    levels = list(level) if several else [level]
    if level is None or not levels:
        raise InputError("level must be a value, or a list of at least one")
    return tuple(scalar(value, "level") for value in levels)


def level_colors(color: Any, count: int) -> tuple[tuple[float, ...], ...]:
    """Return one colour per level, from colours, their names, or the name of a colormap."""
    if isinstance(color, str) and not (count == 1 and is_color(color)):
        try:
            colormap = get_colormap(color)
        except UnknownNameError:
            if is_color(color):
                return (get_color(color),) * count
            raise
        places = np.linspace(0.3, 1.0, count) if count > 1 else np.array([1.0])
        return tuple(tuple(map(float, row)) for row in mapped_colors(colormap, places))
    several = listed(color) and len(color) and not is_name_and_alpha(color)
    nested = several and (np.ndim(color[0]) == 1 or isinstance(color[0], str))
    rows = [color_values(row) for row in (color if nested else [color] * count)]
    if len(rows) != count or len({len(row) for row in rows}) != 1:
        raise InputError(
            f"color must be one colour, or {count} (one per level) with the same number of "
            f"channels, got {color!r}"
        )
    return tuple(rows)


def given_opacities(opacity: Any, count: int, channels: int) -> tuple[tuple[float, ...], ...]:
    """Return one row of opacities per level; of one number each if they are grey."""
    several = listed(opacity)
    nested = several and any(np.ndim(row) for row in opacity)
    if nested and len(opacity) != count:
        raise InputError(
            f"opacity must be one row per level (there are {count}), got {len(opacity)} rows"
        )
    if several and not nested and count > 1 and len(opacity) not in (1, channels, count):
        raise InputError(
            f"opacity must be one number, {count} (one per level) or {channels} (one per channel), "
            f"got {len(opacity)}"
        )
    one_each = nested or (several and len(opacity) == count > 1)
    rows = [channel_values(row, "opacity") for row in (opacity if one_each else [opacity] * count)]
    for row in rows:
        check_extinction(row, channels, "opacity")
        if max(row) > 1:
            raise InputError(
                "opacity is the part of the light that one crossing takes away: from 0 to 1, "
                f"got {max(row):g}"
            )
    if all(len(set(row)) == 1 for row in rows):
        return tuple(row[:1] for row in rows)
    return tuple(row if len(row) > 1 else row * channels for row in rows)


def depth_of(opacity: float) -> float:
    """Return the optical depth of a crossing."""
    return min(-math.log1p(-opacity), _OPAQUE) if opacity < 1 else _OPAQUE


def plain_opacities(opacities: tuple[tuple[float, ...], ...]) -> Any:
    """Return opacities as short as they can be given: a number, or a row (of them) per level."""
    rows = [row[0] if len(row) == 1 else list(row) for row in opacities]
    alike = len(set(opacities)) == 1 and (len(rows) == 1 or not isinstance(rows[0], list))
    return rows[0] if alike else rows


def given_values(values: Any) -> np.ndarray:
    """Return the values of the scalar, checked."""
    nodes = np.asarray(values, dtype=np.float64)
    if nodes.ndim != 1 or len(nodes) < 2:
        raise InputError(f"values must be at least two numbers, got shape {nodes.shape}")
    if not np.all(np.isfinite(nodes)):
        raise InputError("values must be finite")
    if np.any(np.diff(nodes) < 0):
        bad = int(np.flatnonzero(np.diff(nodes) < 0)[0])
        raise InputError(f"values must increase; {nodes[bad]:g} is followed by {nodes[bad + 1]:g}")
    return nodes


def given_colors(colors: Any, rows: int) -> np.ndarray:
    """Return colours, one row per value; their names stand for red, green and blue."""
    if listed(colors) and any(isinstance(color, str) for color in colors):
        colors = [color_values(color) for color in colors]
        if len({len(color) for color in colors}) > 1:
            raise InputError("colors given by names go with others of red, green and blue only")
    if listed(colors) and any(map(listed, colors)):
        colors = without_alpha(colors, "colors")
    return given_columns(colors, rows, "colors")


def given_columns(data: Any, rows: int, what: str) -> np.ndarray:
    """Return colours or opacities, one row per value and one column per channel."""
    check_plain(data, what)
    try:
        array = np.asarray(data, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{what} must be numbers, got {data!r}") from error
    if array.ndim == 0:
        array = np.full(rows, float(array))
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2 or len(array) != rows or array.size == 0:
        raise InputError(f"{what} must have {rows} rows (one per value), got shape {array.shape}")
    if not np.all(np.isfinite(array)):
        raise InputError(f"{what} must be finite")
    return np.ascontiguousarray(array)
