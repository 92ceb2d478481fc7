"""What Phantom's arrays are called, and their units."""

from __future__ import annotations

import functools
from typing import Any

from ...units import parse_unit
from ..names import field_name
from .columns import Column, Density
from .phantom_source import Source

# Common names; powers of the code's length, mass and time; and the unit to give them in.
_KNOWN: dict[str, tuple[str, tuple[int, int, int], str]] = {
    **{f"v{axis}": (f"velocity_{axis}", (1, 0, -1), "km / s") for axis in "xyz"},
    "u": ("internal_energy", (2, 0, -2), "km2 / s2"),
    "h": ("smoothing_length", (1, 0, 0), "cm"),
}
_MAGNETIC = {f"B{axis}": f"magnetic_field_{axis}" for axis in "xyz"}


def columns_of(source: Source) -> list[Column]:
    """Return what can be fields: all real numbers but positions."""
    found = []
    for tag, item in source.particles.items():
        if item.dtype.kind == "f" and tag not in ("x", "y", "z"):
            name, factor, unit = _described(source, tag)
            load = functools.partial(source.values, tag, factor)
            found.append(Column(name, item.place, item.shape, str(item.dtype), load, unit))
    return found


def density_of(source: Source) -> Density:
    """Return the field that masses make."""
    item = source.particles["h"]
    return Density(source.mass_place, item.shape, "float64", source.units is not None)


def _described(source: Source, tag: str) -> tuple[str, float, Any]:
    if tag in _KNOWN:
        name, powers, unit = _KNOWN[tag]
        return name, *source.factor(powers, unit)
    if tag in _MAGNETIC:
        gauss = source.number("umagfd", 0.0)
        return (_MAGNETIC[tag], gauss, parse_unit("G")) if gauss else (_MAGNETIC[tag], 1.0, None)
    if tag in ("T", "temperature"):
        return "temperature", 1.0, parse_unit("K")
    return field_name(tag), 1.0, None
