"""Numbers as Fortran writes them."""

from __future__ import annotations

import math
import re

# Fortran leaves out the letter where an exponent has three digits: 1.0-100.
_NUMBER = re.compile(rb"([+-]?(?:\d+\.?\d*|\.\d+))(?:[eEdDqQ]?([+-]\d+)|[eEdDqQ](\d+))?")
_WORDS = re.compile(rb"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)
_SHOWN = 32


def number(token: bytes) -> float:
    """Return a number as Fortran writes it, rounded to the nearest double.

    Raises
    ------
    ValueError
        If it is none, or too large.
    """
    found = _NUMBER.fullmatch(token)
    if found is None:
        if _WORDS.fullmatch(token):
            return float(token)
        raise ValueError(f"expected a number, got {shown(token)}")
    digits, signed, unsigned = found.groups()
    value = float(digits + b"e" + (signed or unsigned or b"0"))
    if math.isinf(value):
        raise ValueError(f"{shown(token)} is too large a number")
    return value


def shown(token: bytes) -> str:
    """Return a part of a text as error messages quote it."""
    text = token[:_SHOWN].decode("ascii", "backslashreplace")
    return repr(text) + (" …" if len(token) > _SHOWN else "")
