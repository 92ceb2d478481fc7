"""Numbers with units in the text of an expression: ``los(velocity) / (0.2 km/s)``.

Python's grammar has no place for a unit, so the text is rewritten as ``0.2["km/s"]`` before it is
parsed, and the parser makes a `Quantity` of that.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Collection

from ..errors import UnitsError
from ..units import parse_unit
from .language import CONSTANTS
from .source import fail

# A whole number literal: not the "10" of 0x10, nor the "2" of a2.
_NUMBER = re.compile(r"(?<![\w.])(?!0[xXbBoO])(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\d.])")
_FRACTION = r"\([-+]?\d+(?:[./]\d+)?\)"
_POWER = rf"(?:[-+]?\d+|{_FRACTION}|\s*(?:\*\*|\^)\s*(?:[-+]?\d+(?:\.\d+)?|{_FRACTION}))?"
# One factor of a unit: a name that is no function being called, with its power.
_FACTOR = re.compile(rf"([^\W\d]+)({_POWER})(?![\w(])")
_FIRST = re.compile(r"\s*(?=[^\W\d])|\s+1\s*/\s*(?=[^\W\d(])")
_OPENED = re.compile(r"(?:dex)?\(")
_NEXT = re.compile(r"\s*[*/]\s*|\s+")
# `a` and `b` are units too (years, bits), but nobody means these by "2a".
_KEYWORDS = {"and", "or", "not", "if", "else", "in", "is", "lambda", "a", "b", *CONSTANTS}


@functools.lru_cache(maxsize=1024)
def marked(text: str, fields: tuple[str, ...] = ()) -> str:
    """Return the text with ``0.2["km/s"]`` in place of ``0.2 km/s``.

    Parameters
    ----------
    text : str
        An expression.
    fields : tuple of str
        Names that are fields where they follow ``*`` or ``/``, even if they are units too:
        in ``20 K/T`` T is the temperature if there is such a field, else the tesla.
    """
    parts, place = [], 0
    for number in _NUMBER.finditer(text):
        if number.start() < place:  # the 1 of "2 1/cm", the 3 of "2 cm-3"
            continue
        end = _unit_end(text, number.end(), fields)
        if end > number.end():
            unit = text[number.end() : end].strip()
            parts += [text[place : number.end()], f'["{unit}"]']
            place = end
    return "".join([*parts, text[place:]])


def _unit_end(text: str, start: int, fields: Collection[str]) -> int:
    """Return where the longest unit ends that begins after a number; `start` if there is none."""
    first = _FIRST.match(text, start)
    if first is None:
        return start
    name = _FACTOR.match(text, first.end())
    if name is not None and name[1] in fields and "/" not in first[0] and _is_unit(name[1]):
        fail(
            text,
            first.end(),
            f"{name[1]!r} is a field and the name of a unit: write 2*{name[1]} for a product, or "
            "the unit by another name, such as 'meter' for 'm'",
        )
    end = _factors_end(text, first.end(), fields)
    return start if end is None else end


def _factors_end(text: str, place: int, fields: Collection[str]) -> int | None:
    end = None
    while True:
        after = _factor_end(text, place, fields)
        if after is None:
            return end
        end = after
        between = _NEXT.match(text, end)
        if between is None:
            return end
        place = between.end()


def _factor_end(text: str, place: int, excluded: Collection[str]) -> int | None:
    opened = _OPENED.match(text, place)
    if opened is not None:
        inside = _factors_end(text, opened.end(), excluded)
        closed = None if inside is None else re.compile(rf"\s*\){_POWER}").match(text, inside)
        return None if closed is None else closed.end()
    factor = _FACTOR.match(text, place)
    if factor is None or factor[1] in excluded or not _is_unit(factor[1]):
        return None
    return factor.end()


def _is_unit(name: str) -> bool:
    if name in _KEYWORDS:
        return False
    try:
        return parse_unit(name) is not None
    except UnitsError:
        return False
