"""The units of snapshots like Gadget's: of the code, of cosmology, and of each data set.

Powers of the scale factor a and of h where the file does not tell them are Gadget-2's and AREPO's:
Springel (2005, MNRAS 364, 1105, and the code's user guide), Nelson et al. (2019, Comput.
Astrophys. 6, 2, with the data specifications of IllustrisTNG).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...units import parse_unit
from .attributes import number


@dataclass(frozen=True)
class Dimension:
    """What a data set is: powers of mass, length, velocity, a and h, and the unit to give it."""

    mass: float = 0
    length: float = 0
    velocity: float = 0
    a: float = 0
    h: float = 0
    unit: str = ""


_LENGTH = Dimension(length=1, a=1, h=-1, unit="cm")
_KNOWN = {
    "coordinates": _LENGTH,
    "smoothing_length": _LENGTH,
    "volume": Dimension(length=3, a=3, h=-3, unit="cm3"),
    "mass": Dimension(mass=1, h=-1, unit="g"),
    "density": Dimension(1, -3, 0, -3, 2, "g / cm3"),
    "velocity": Dimension(velocity=1, a=0.5, unit="km / s"),
    "internal_energy": Dimension(velocity=2, unit="km2 / s2"),
    "potential": Dimension(velocity=2, a=-1, unit="km2 / s2"),
    "pressure": Dimension(1, -3, 2, -3, 2, "erg / cm3"),
    # Its square is a pressure; a code's numbers are in the root of the code's unit of pressure.
    "magnetic_field": Dimension(0.5, -1.5, 1, -2, 1, "G"),
}
# In these units whatever the code's are.
_FIXED = {"temperature": "K", "star_formation_rate": "solMass / yr"}
_EXPONENTS = ("U_M exponent", "U_L exponent", "U_t exponent")


@dataclass(frozen=True)
class CodeUnits:
    """The code's units in cgs, None where the file does not tell; a and h, 1 without cosmology."""

    length: float | None = None
    mass: float | None = None
    velocity: float | None = None
    a: float = 1.0
    h: float = 1.0

    @property
    def known(self) -> bool:
        """True if all units are known."""
        return None not in (self.length, self.mass, self.velocity)

    def of(self, name: str, attributes: Mapping[str, Any]) -> tuple[float, Any]:
        """Return the factor from a data set's numbers to a unit, and the unit.

        Parameters
        ----------
        name : str
            Common name of the data set.
        attributes : mapping
            Its attributes.
        """
        if not self.known:
            return 1.0, None
        if name in _FIXED and not set(_EXPONENTS) <= set(attributes):
            return 1.0, parse_unit(_FIXED[name])
        dimension = dimension_of(name, attributes)
        return self.factor(dimension), parse_unit(dimension.unit)

    def factor(self, dimension: Dimension) -> float:
        """Return the factor from the code's numbers to the unit of a dimension."""
        if not self.known:
            return 1.0
        from astropy import units as u

        d = dimension
        bases = (self.mass, self.length, self.velocity, self.a, self.h)
        powers = (d.mass, d.length, d.velocity, d.a, d.h)
        value = float(np.exp(np.dot(powers, np.log(np.array(bases, np.float64)))))
        if d.unit in ("", "G"):
            return value if d.unit else 1.0
        cgs = u.g**d.mass * u.cm**d.length * (u.cm / u.s) ** d.velocity
        return value * float(cgs.to(u.Unit(d.unit)))


def dimension_of(name: str, attributes: Mapping[str, Any]) -> Dimension:
    """Return what a data set is: by its name, else by attributes as AREPO and SWIFT give them."""
    told = _told(attributes)
    if name in _KNOWN:
        known = _KNOWN[name]
        return known if told is None else replace(known, a=told.a, h=told.h)
    return told or Dimension()


def _told(attributes: Mapping[str, Any]) -> Dimension | None:
    if "a_scaling" in attributes:
        names = ("mass_scaling", "length_scaling", "velocity_scaling", "a_scaling", "h_scaling")
        mass, length, velocity, a, h = (number(attributes, name) or 0.0 for name in names)
    elif set(_EXPONENTS) <= set(attributes):
        mass, length, time = (number(attributes, name) or 0.0 for name in _EXPONENTS)
        length, velocity = length + time, -time
        a = number(attributes, "a-scale exponent") or 0.0
        h = number(attributes, "h-scale exponent") or 0.0
    else:
        return None
    return Dimension(mass, length, velocity, a, h, _composed(mass, length, velocity))


def _composed(mass: float, length: float, velocity: float) -> str:
    from astropy import units as u

    unit = u.g**mass * u.cm ** (length + velocity) * u.s**-velocity
    return "" if unit == u.dimensionless_unscaled else str(unit)
