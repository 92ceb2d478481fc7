"""Unit spellings in files that astropy does not support or interprets differently."""

from __future__ import annotations

import re

from ..errors import UnitsError
from ..units import parse_unit, unit_name
from .contract import UnitLike

# Spellings of udunits and CF (https://cfconventions.org) that differ from astropy's. "mb" is a
# millibit in astropy, and "C" a coulomb in both: its meaning in an atmosphere is ambiguous.
_SPELLINGS = {
    "mb": "mbar",
    "millibar": "mbar",
    "hectopascal": "hPa",
    "degc": "deg_C",
    "deg c": "deg_C",
    "°c": "deg_C",
    "celsius": "deg_C",
    "degree_celsius": "deg_C",
    "degk": "K",
    "gpm": "m",
    "metre": "m",
    "kilometre": "km",
    "centimetre": "cm",
    "millimetre": "mm",
    "micrometre": "um",
    "nanometre": "nm",
    "count": "ct",
}
_ANGLE = re.compile(r"degrees?(_?(north|east|south|west|n|e|s|w))?|°", re.IGNORECASE)
_PLURAL = re.compile(r"(?<=[a-z]{3})s\b")


def known_unit(text: str) -> str:
    """Return astropy's name of a unit; an empty string if there is none.

    Examples
    --------
    >>> known_unit("degrees_north"), known_unit("kg m-2 s-1"), known_unit("sigma_level")
    ('deg', 'kg / (s m2)', '')
    """
    text = text.strip()
    if _ANGLE.fullmatch(text):
        return "deg"
    for spelling in _spellings(text):
        try:
            unit = parse_unit(spelling)
        except UnitsError:
            continue
        return "" if _is_function(unit) else unit_name(unit)
    return ""


def _is_function(unit: UnitLike) -> bool:
    """Return True for decibels and magnitudes: fields cannot be converted with them."""
    from astropy import units as u

    return unit is not None and (
        not isinstance(unit, u.UnitBase) or u.dex in unit.decompose().bases
    )


def _spellings(text: str) -> list[str]:
    lower = text.lower()
    single = _PLURAL.sub("", lower)
    named = [_SPELLINGS[word] for word in (lower, single) if word in _SPELLINGS]
    return named or [text, single]
