"""Units of length and angle as the makers of scanners and microscopes spell them."""

from __future__ import annotations

from ...units import parse_unit
from ..unit_texts import known_unit

_INCH = "25.4 mm"
# What the cells of a grid may be measured in.
_EXTENTS = ("length", "angle")


def length_unit(text: str) -> str:
    """Return astropy's name of a unit of length or angle; the empty string for anything else.

    Examples
    --------
    >>> length_unit("micron"), length_unit('"mm"'), length_unit("pixel"), length_unit("inch")
    ('micron', 'mm', '', '25.4 mm')
    """
    # ImageJ writes the micro sign as it does in Java's source.
    word = text.strip().strip('"').replace("\\u00B5", "u").replace("µ", "u").replace("μ", "u")
    name = known_unit(_INCH if word.lower() in ("in", "inch") else word)
    unit = parse_unit(name)
    return name if unit is not None and unit.physical_type in _EXTENTS else ""


def conversion(unit: str, to: str) -> float:
    """Return the factor between two of these units; one where either is not known."""
    if not unit or not to or unit == to:
        return 1.0
    return float(parse_unit(unit).to(parse_unit(to)))
