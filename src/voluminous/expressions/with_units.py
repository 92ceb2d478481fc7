"""Conditions with units: ``velocity_z > 5 km/s``.

Expressions compute with plain numbers in the units of their fields. A number with a unit on either
side of a comparison is converted to the unit of the other side, as soon as that is known.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..errors import UnitsError
from ..units import unit_name
from .tree import Fields, Node

# All of it: the "e-19" of 1e-19 is no unit, nor is the "x10" of 0x10.
_NUMBER = r"[-+]?(?!0[xXbBoO])(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?(?![\d.]|[eE][-+]?\d)"
# A comparison with a number and what looks like a unit: letters, powers, products, quotients. Of
# limited length, so that no text takes long.
_UNIT = r"(?!(?:and|or|if|else)\b)[A-Za-z][A-Za-z0-9*/^. -]{0,60}?(?:\([^)]{0,60}\))?"
_SIGN = r"<=|>=|==|!=|<|>"
_COMPARED = re.compile(
    rf"(?P<sign>{_SIGN})\s*(?P<number>{_NUMBER})\s*(?P<unit>{_UNIT})"
    r"(?=\s*(?:$|[&|),<>=!]|\band\b|\bor\b|\bif\b|\belse\b))"
)
# The same the other way round, where a comparison begins.
_COMPARED_FIRST = re.compile(
    rf"(?P<before>^|[&|(~,]|\band\b|\bor\b|\bnot\b|\bif\b|\belse\b)\s*"
    rf"(?P<number>{_NUMBER})\s*(?P<unit>{_UNIT})\s*(?P<sign>{_SIGN})"
)
# Where one side of a comparison begins or ends.
_BEGINS = re.compile(r"\band\b|\bor\b|\bnot\b|\bif\b|\belse\b|[&|~,]|[<>=!]=?")

# From a number with a unit, and what returns the other side of the comparison, to one without.
Conversion = Callable[["re.Match[str]", Callable[[], str]], str]


@dataclass(frozen=True, slots=True)
class WithUnits(Node):
    """An expression that has no value before its units are those of a volume."""

    tree: Node
    text: str

    def evaluate(self, ops: Any, fields: Fields) -> Any:
        """Raise the error that says what to do."""
        raise UnitsError(
            f"{self.text!r} compares with units, which only a volume can convert: "
            "volume.evaluate, volume.cells and the where= of media and measurements do; "
            "here write the number in the unit of what it is compared with"
        )


def dropped(text: str) -> str:
    """Return a text with units left out; the very text if there are none."""
    return _replaced(text, lambda found, other: found["number"])


def converted(text: str, unit_of: Callable[[str], Any]) -> str:
    """Return a text with every number in the unit of what it is compared with.

    Parameters
    ----------
    text : str
    unit_of : callable
        Returns the unit of an expression, given as text, or None.

    Raises
    ------
    UnitsError
        If a number's unit does not exist, or does not fit.
    """
    return _replaced(text, lambda found, other: repr(_in_unit(found, other(), unit_of)))


def _replaced(text: str, conversion: Conversion) -> str:
    def first(found: re.Match[str]) -> str:
        number = conversion(found, lambda: _right_side(text[found.end() :]))
        return f"{found['before']} {number} {found['sign']}".lstrip(" ")

    def second(found: re.Match[str]) -> str:
        number = conversion(found, lambda: _left_side(begun[: found.start()]))
        return f"{found['sign']} {number}"

    begun = _COMPARED_FIRST.sub(first, text)
    return _COMPARED.sub(second, begun)


def _in_unit(found: re.Match[str], other: str, unit_of: Callable[[str], Any]) -> float:
    """Return a number in the unit of what it is compared with.

    Raises
    ------
    UnitsError
        If its own unit does not fit.
    """
    from astropy import units as u

    unit = unit_of(other)
    given = f"{found['number']} {found['unit'].strip()}"
    try:
        value = u.Quantity(given).to_value(unit if unit is not None else u.dimensionless_unscaled)
    except (TypeError, ValueError) as error:
        raise UnitsError(
            f"{given!r} is no quantity that {other!r}, in "
            f"{unit_name(unit) or 'no unit'}, can be compared with"
        ) from error
    return float(value)


def _left_side(before: str) -> str:
    """Return what is compared: back to the last word of logic, sign, or open parenthesis."""
    depth = 0
    for place in range(len(before) - 1, -1, -1):
        depth += {")": 1, "(": -1}.get(before[place], 0)
        if depth < 0:
            return before[place + 1 :].strip()
        begins = _BEGINS.match(before, place) if depth == 0 else None
        if begins is not None:
            return before[begins.end() :].strip()
    return before.strip()


def _right_side(after: str) -> str:
    """Return what is compared: up to the next word of logic or sign, or a closing parenthesis."""
    depth = 0
    for place, letter in enumerate(after):
        depth += {"(": 1, ")": -1}.get(letter, 0)
        if depth < 0 or (depth == 0 and _BEGINS.match(after, place)):
            return after[:place].strip()
    return after.strip()
