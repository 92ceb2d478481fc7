"""Numbers and quantities as the user gave them: checked, and said in words."""

from __future__ import annotations

import math
from typing import Any

from ..errors import InputError
from ..units import is_quantity, parse_unit, unit_name


def scalar(value: Any, what: str) -> Any:
    """Return a finite float, or a Quantity left as it is until the volume's unit is known.

    Raises
    ------
    InputError
        If it is not one finite number.
    """
    magnitude = value.value if is_quantity(value) else value
    try:
        number = float(magnitude)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} must be one number or quantity, got {value!r}") from error
    if not math.isfinite(number):
        raise InputError(f"{what} must be finite, got {value!r}")
    return value if is_quantity(value) else number


def named(value: Any) -> Any:
    """Return a number, or a quantity as text such as ``"2.5e+16 cm"``."""
    if is_quantity(value):
        return f"{float(value.value)!r} {unit_name(parse_unit(value.unit))}".strip()
    return value


def plain_number(value: Any) -> float:
    """Return a quantity's value, or a number itself."""
    return float(getattr(value, "value", value))
