"""Units in files: those of simulation codes, and spellings that astropy does not read as meant."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import InputError, UnitsError
from ..units import UnitLike, parse_unit, unit_name
from .axes import round_unit

if TYPE_CHECKING:
    from astropy import units as u

OPTIONS = {
    "unit": "unit of length of the grid; without length_unit, what numbers in the file are in",
    "length_unit": "the code's unit of length, such as '1.5e16 cm'",
    "mass_unit": "the code's unit of mass",
    "time_unit": "the code's unit of time",
    "velocity_unit": "the code's unit of velocity, in place of time_unit",
    "density_unit": "the code's unit of density, in place of mass_unit",
}
_CGS = {
    "length_unit": "cm",
    "mass_unit": "g",
    "time_unit": "s",
    "velocity_unit": "cm / s",
    "density_unit": "g / cm3",
}


class Quantity(NamedTuple):
    """A physical quantity: its name, its powers of length, mass and time, and its unit."""

    name: str
    powers: tuple[int, int, int]
    unit: str


TIME = Quantity("time", (0, 0, 1), "s")


class CodeUnits(NamedTuple):
    """A code's units; None where they are unknown."""

    length: u.UnitBase | None = None
    mass: u.UnitBase | None = None
    time: u.UnitBase | None = None

    @classmethod
    def given(cls, **options: UnitLike) -> CodeUnits:
        """Return the units in the options that the user gives; see `OPTIONS`."""
        units = {name: _checked(name, unit) for name, unit in options.items() if unit is not None}
        if units and "length_unit" not in units:
            raise InputError(f"{', '.join(units)}: give length_unit too")
        for name, other in (("time_unit", "velocity_unit"), ("mass_unit", "density_unit")):
            if name in units and other in units:
                raise InputError(f"give {name} or {other}, not both: one follows from the other")
        length, mass, time = (units.get(n) for n in ("length_unit", "mass_unit", "time_unit"))
        if length is not None and "velocity_unit" in units:
            time = length / units["velocity_unit"]
        if length is not None and "density_unit" in units:
            mass = units["density_unit"] * length**3
        return cls(length, mass, time)

    def of(self, quantity: Quantity | None) -> tuple[float, str]:
        """Return (factor, unit) of a quantity; (1, "") if they are undetermined.

        A magnetic field in G is the root of 4π times an energy density: codes omit the factor 4π of
        Gaussian units, the energy density is B²/2.
        """
        if quantity is None:
            return 1.0, ""
        from astropy import units as u

        code = u.dimensionless_unscaled
        for base, power in zip(self, quantity.powers, strict=True):
            if power:
                if base is None:
                    return 1.0, ""
                code = code * base**power
        if quantity.unit == "G":
            return math.sqrt(4 * math.pi * code.to("erg / cm3")), "G"
        return float(code.to(quantity.unit)), quantity.unit

    def edges(
        self, edges: Sequence[np.ndarray], lengths: Sequence[int], unit: UnitLike
    ) -> tuple[Sequence[np.ndarray], UnitLike]:
        """Return the edges of a grid in the unit of the volume, and this unit.

        `lengths` are the axes that are lengths; without a code unit nothing is converted.
        """
        if self.length is None:
            return edges, unit
        width = max(float(np.ptp(edges[axis])) for axis in lengths)
        rounded = round_unit(width * self.length) if unit is None else unit
        factor = self.length.to(rounded)
        return [e * factor if axis in lengths else e for axis, e in enumerate(edges)], rounded


def _checked(name: str, value: Any) -> u.UnitBase:
    unit = parse_unit(value)
    if unit is None or not unit.is_equivalent(_CGS[name]):
        raise UnitsError(f"{name} must be a unit such as '2.5 {_CGS[name]}', got {value!r}")
    return unit


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
