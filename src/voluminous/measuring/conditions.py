"""Conditions with units: ``los("velocity") > 5 km/s``.

Expressions compute with plain numbers in the units of their fields. A number with a unit on either
side of a comparison is converted to the unit of the other side.
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
_UNIT = r"(?!(?:and|or|if|else)\b)[A-Za-z][A-Za-z0-9*/^. -]*?(?:\([^)]*\))?"
_SIGN = r"<=|>=|==|!=|<|>"
_COMPARED = re.compile(
    rf"(?P<sign>{_SIGN})\s*(?P<number>{_NUMBER})\s*(?P<unit>{_UNIT})"
    r"(?=\s*(?:$|[&|)<>=!]|\band\b|\bor\b|\bif\b|\belse\b))"
)
# The same the other way round, where a comparison begins.
_COMPARED_FIRST = re.compile(
    rf"(?P<before>^|[&|(~]|\band\b|\bor\b|\bnot\b|\bif\b|\belse\b)\s*"
    rf"(?P<number>{_NUMBER})\s*(?P<unit>{_UNIT})\s*(?P<sign>{_SIGN})"
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
        whole = text
        text = _COMPARED_FIRST.sub(lambda found: _converted_first(volume, whole, found), text)
        first = text
        text = _COMPARED.sub(lambda found: _converted(volume, first, found), text)
    return Quantity.of(volume, text, what)


def _converted(volume: Any, text: str, found: re.Match[str]) -> str:
    """Return a comparison with the number in the unit of what is on its left."""
    left = _left_side(text[: found.start()])
    return f"{found['sign']} {_in_unit_of(volume, left, found)!r}"


def _converted_first(volume: Any, text: str, found: re.Match[str]) -> str:
    """Return a comparison with the number in the unit of what is on its right."""
    right = _right_side(text[found.end() :])
    return f"{found['before']} {_in_unit_of(volume, right, found)!r} {found['sign']}"


def _in_unit_of(volume: Any, other: str, found: re.Match[str]) -> float:
    """Return a number in the unit of what it is compared with.

    Raises
    ------
    UnitsError
        If its own unit does not fit.
    """
    from astropy import units as u

    unit = Quantity.of(volume, other, "where").unit
    given = f"{found['number']} {found['unit'].strip()}"
    try:
        value = u.Quantity(given).to_value(unit if unit is not None else u.dimensionless_unscaled)
    except (TypeError, ValueError) as error:
        raise UnitsError(
            f"{given!r} is no quantity that {other.strip()!r}, in "
            f"{unit_name(unit) or 'no unit'}, can be compared with"
        ) from error
    return float(value)


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


def _right_side(after: str) -> str:
    """Return what is compared: up to the next word of logic or sign, or a closing parenthesis."""
    depth = 0
    for place, letter in enumerate(after):
        depth += {"(": 1, ")": -1}.get(letter, 0)
        ends = _BEGINS.match(after, place) if depth == 0 else None
        word = ends is not None and place > 0 and after[place - 1].isalnum() and letter.isalpha()
        if depth < 0 or (ends is not None and not word):
            return after[:place]
    return after


def holds(volume: Any, what: Quantity, first: int, last: int) -> Any:
    """Return in which cells a condition holds; not where it has no value."""
    values = volume.evaluate_cells(what.expression, first, last)
    return (values != 0) & (values == values)
