"""Numbers and quantities as the user gave them: checked, and said in words."""

from __future__ import annotations

import math
from numbers import Real
from typing import Any

import numpy as np

from ..colormaps import get_color, without_alpha
from ..errors import InputError
from ..units import as_given, is_quantity, parse_unit, unit_name, unit_of


def scalar(value: Any, what: str) -> Any:
    """Return a finite float, or a Quantity left as it is until the volume's unit is known.

    Of text such as "0.1 pc" it is the quantity in it.

    Raises
    ------
    InputError
        If it is not one finite number.
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
    """Return a whole number, which may be written as ``16.0``.

    Raises
    ------
    InputError
        If it is none, or not between the least and the most.
    """
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
    return float(getattr(value, "value", value))


def channel_values(value: Any, what: str) -> tuple[float, ...]:
    """Return finite floats, one per channel, from a number or a sequence.

    Raises
    ------
    InputError
        If they are not numbers.
    """
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
    """Return emission per channel, from numbers, or red, green and blue from a colour's name.

    Raises
    ------
    InputError, UnknownNameError
        If it is neither.
    """
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
    """Return a number from 0 to 1.

    Raises
    ------
    InputError
        If it is none.
    """
    if not isinstance(value, (int, float)) or not 0 <= value <= 1:
        raise InputError(f"{what} must be a number from 0 to 1, got {value!r}")
    return float(value)
