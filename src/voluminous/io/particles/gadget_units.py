"""The header of Gadget-like snapshots: units, cosmology, time, box.

If the file does not give the powers of the scale factor a and of h, those of Gadget-2 and AREPO
are used: Springel (2005, MNRAS 364, 1105, and the code's user guide), Nelson et al. (2019, Comput.
Astrophys. 6, 2, with the data specifications of IllustrisTNG).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, UnitsError
from ...units import is_quantity, parse_unit, unit_name
from .common import number

if TYPE_CHECKING:
    import h5py


@dataclass(frozen=True)
class Dimension:
    """Dimension of a data set: powers of mass, length, velocity, a and h, and the output unit."""

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
    # Its square is a pressure; values are in the square root of the code's pressure unit.
    "magnetic_field": Dimension(0.5, -1.5, 1, -2, 1, "G"),
}
# In these units regardless of the code's units.
_FIXED = {"temperature": "K", "star_formation_rate": "solMass / yr"}
_EXPONENTS = ("U_M exponent", "U_L exponent", "U_t exponent")


@dataclass(frozen=True)
class GadgetUnits:
    """The code units in cgs (None if the file omits them), a and h (1 without cosmology)."""

    length: float | None = None
    mass: float | None = None
    velocity: float | None = None
    a: float = 1.0
    h: float = 1.0

    @property
    def known(self) -> bool:
        return None not in (self.length, self.mass, self.velocity)

    def of(self, name: str, attributes: Mapping[str, Any]) -> tuple[float, str]:
        """Return (factor, unit): factor converts a data set, given by its common name, to unit."""
        if not self.known:
            return 1.0, ""
        if name in _FIXED and not set(_EXPONENTS) <= set(attributes):
            return 1.0, unit_name(parse_unit(_FIXED[name]))
        dimension = _dimension_of(name, attributes)
        return self._factor(dimension), unit_name(parse_unit(dimension.unit))

    def _factor(self, d: Dimension) -> float:
        from astropy import units as u

        bases = (self.mass, self.length, self.velocity, self.a, self.h)
        powers = (d.mass, d.length, d.velocity, d.a, d.h)
        value = float(np.exp(np.dot(powers, np.log(np.array(bases, np.float64)))))
        if d.unit in ("", "G"):
            return value if d.unit else 1.0
        cgs = u.g**d.mass * u.cm**d.length * (u.cm / u.s) ** d.velocity
        return value * float(cgs.to(u.Unit(d.unit)))


def _dimension_of(name: str, attributes: Mapping[str, Any]) -> Dimension:
    """Return a data set's dimension, from its name or else from AREPO's or SWIFT's attributes."""
    given = _scaling(attributes)
    if name in _KNOWN:
        known = _KNOWN[name]
        return known if given is None else replace(known, a=given.a, h=given.h)
    return given or Dimension()


def _scaling(attributes: Mapping[str, Any]) -> Dimension | None:
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


# Attributes with the code units in SWIFT, and in other codes.
_UNITS = {
    "length": ("Unit length in cgs (U_L)", "UnitLength_in_cm", "UnitLength_In_CGS"),
    "mass": ("Unit mass in cgs (U_M)", "UnitMass_in_g", "UnitMass_In_CGS"),
    "velocity": ("", "UnitVelocity_in_cm_per_s", "UnitVelocity_In_CGS"),
}
_TIME = "Unit time in cgs (U_t)"
_CGS = {"length": "cm", "mass": "g", "velocity": "cm / s"}


@dataclass(frozen=True)
class GadgetHeader:
    """The contents of the header."""

    units: GadgetUnits
    box: np.ndarray | None  # box widths, in the code's unit; the box begins at 0
    periodic: bool
    meta: dict[str, Any]  # time or redshift
    masses: np.ndarray  # particle mass of each type, 0 if masses are stored per particle


def read_header(file: h5py.File, given: tuple[Any, Any, Any]) -> GadgetHeader:
    """Return the header of an open file; units given by the user take precedence."""
    header = _attributes(file, "Header")
    attrs = _attributes(file, "Parameters") | header | _attributes(file, "Units")
    cosmological = _is_cosmological(file, attrs)
    redshift = number(attrs, "Redshift") or 0.0
    units = _units(attrs, given, 1 / (1 + redshift) if cosmological else 1.0, cosmological)
    masses = np.ravel(header.get("MassTable", np.zeros(0))).astype(np.float64)
    periodic = number(attrs, "PeriodicBoundariesOn")
    return GadgetHeader(
        units,
        _box(attrs),
        cosmological if periodic is None else bool(periodic),
        _meta(attrs, units, redshift if cosmological else None),
        masses,
    )


def _attributes(file: h5py.File, group: str) -> dict[str, Any]:
    return dict(file[group].attrs) if group in file else {}


def _is_cosmological(file: h5py.File, attrs: dict[str, Any]) -> bool:
    """Return True if lengths are comoving; without a flag, if time is the scale factor."""
    swift = _attributes(file, "Cosmology")
    flag = number(attrs | swift, "ComovingIntegrationOn", "Cosmological run")
    if flag is not None:
        return bool(flag)
    matter, time = number(attrs, "Omega0", "Omega_Matter"), number(attrs, "Time")
    redshift = number(attrs, "Redshift")
    if not matter or time is None or redshift is None:
        return False
    return abs(time * (1 + redshift) - 1) < 1e-3


def _units(
    attrs: dict[str, Any], given: tuple[Any, Any, Any], a: float, cosmological: bool
) -> GadgetUnits:
    found = {kind: number(attrs, *(n for n in names if n)) for kind, names in _UNITS.items()}
    time = number(attrs, _TIME)
    if found["length"] and time:
        found["velocity"] = found["length"] / time
    for kind, unit in zip(_UNITS, given, strict=True):
        found[kind] = found[kind] if unit is None else _size(unit, kind)
    for kind, size in found.items():
        if size is not None and not size > 0:
            raise FileFormatError(f"the code's unit of {kind} must be positive, got {size}")
    h = number(attrs, "HubbleParam") if cosmological else None
    if not a > 0 or not (h is None or h > 0):
        raise FileFormatError(f"HubbleParam {h} or Redshift {1 / a - 1 if a else a} is impossible")
    return GadgetUnits(**found, a=a, h=h or 1.0)


def _size(unit: Any, kind: str) -> float:
    from astropy import units as u

    size = unit if is_quantity(unit) else u.Quantity(1.0, parse_unit(unit))
    try:
        return float(size.to(_CGS[kind]).value)
    except u.UnitConversionError as error:
        raise UnitsError(f"{kind}_unit {unit} is no unit of {kind}") from error


def _box(attrs: dict[str, Any]) -> np.ndarray | None:
    size = np.ravel(attrs.get("BoxSize", 0.0))
    if size.dtype.kind not in "fiu" or size.size not in (1, 3):
        raise FileFormatError(f"BoxSize must be one or three numbers, got {attrs['BoxSize']!r}")
    box = np.broadcast_to(size.astype(np.float64), (3,))
    return box if np.isfinite(box).all() and (box > 0).all() else None


def _meta(attrs: dict[str, Any], units: GadgetUnits, redshift: float | None) -> dict[str, Any]:
    if redshift is not None:
        return {"redshift": redshift, "scale_factor": units.a}
    time = number(attrs, "Time")
    if time is None:
        return {}
    if units.length is None or units.velocity is None:
        return {"time": time}
    return {"time": time * units.length / units.velocity, "time_unit": "s"}
