"""Conditions with units: ``los("velocity") > 5 km/s``.

Expressions compute with plain numbers in the units of their fields. A number with a unit on the
right side of a comparison is converted to the unit of the left side.
"""

from __future__ import annotations

import re
from typing import Any

from ..errors import UnitsError
from ..units import unit_name
from .quantity import Quantity

# All of it: the "e-19" of 1e-19 is no unit.
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\d.]|[eE][-+]?\d)"
# A comparison with a number and what looks like a unit: letters, powers, products, quotients.
_COMPARED = re.compile(
    rf"(?P<sign><=|>=|==|!=|<|>)\s*(?P<number>{_NUMBER})\s*"
    r"(?P<unit>(?!(?:and|or|if|else)\b)[A-Za-z][A-Za-z0-9*/^. -]*?(?:\([^)]*\))?)"
    r"(?=\s*(?:$|[&|)<>=!]|\band\b|\bor\b|\bif\b|\belse\b))"
)
# Where the left side of a comparison begins.
_BEGINS = re.compile(r"\band\b|\bor\b|\bnot\b|\bif\b|\belse\b|[&|~]|[<>=!]=?")


def condition(volume: Any, text: Any, what: str = "where") -> Quantity:
    """Return a condition without units, as an expression that is zero where it does not hold.

    Raises
    ------
    UnitsError
        If a number's unit does not fit what it is compared with.
    ExpressionError, UnknownNameError
        If it cannot be understood.
    """
    if isinstance(text, str):
        text = _COMPARED.sub(lambda found: _converted(volume, text, found), text)
    return Quantity.of(volume, text, what)


def _converted(volume: Any, text: str, found: re.Match[str]) -> str:
    """Return a comparison with the number in the unit of what is on its left."""
    from astropy import units as u

    left = _left_side(text[: found.start()])
    unit = Quantity.of(volume, left, "where").unit
    given = f"{found['number']} {found['unit'].strip()}"
    try:
        value = u.Quantity(given).to_value(unit if unit is not None else u.dimensionless_unscaled)
    except (TypeError, ValueError) as error:
        raise UnitsError(
            f"{given!r} is no quantity that {left.strip()!r}, in "
            f"{unit_name(unit) or 'no unit'}, can be compared with"
        ) from error
    return f"{found['sign']} {float(value)!r}"


def _left_side(before: str) -> str:
    """Return what is compared: back to the last word of logic, or an open parenthesis."""
    depth, start = 0, 0
    for place in range(len(before) - 1, -1, -1):
        depth += {")": 1, "(": -1}.get(before[place], 0)
        if depth < 0:
            start = place + 1
            break
    part = before[start:]
    level, last = 0, 0
    for place, letter in enumerate(part):
        level += {"(": 1, ")": -1}.get(letter, 0)
        found = _BEGINS.match(part, place) if level == 0 else None
        if found is not None and (place == 0 or not part[place - 1].isalnum()):
            last = max(last, found.end())
    return part[last:]


def holds(volume: Any, what: Quantity, first: int, last: int) -> Any:
    """Return in which cells a condition holds; not where it has no value."""
    values = volume.evaluate_cells(what.expression, first, last)
    return (values != 0) & (values == values)
