"""The header of Gadget-like snapshots: units, cosmology, time, box.

If the file does not give the powers of the scale factor a and of h, those of Gadget-2 and AREPO
are used: Springel (2005, MNRAS 364, 1105, and the code's user guide), Nelson et al. (2019, Comput.
Astrophys. 6, 2, with the data specifications of IllustrisTNG).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...errors import FileFormatError, UnitsError
from ...units import is_quantity, parse_unit
from .common import number

if TYPE_CHECKING:
    import h5py


class Dimension(NamedTuple):
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
# Attributes of a data set with its dimension, in AREPO and in SWIFT.
_SCALING = ("mass_scaling", "length_scaling", "velocity_scaling", "a_scaling", "h_scaling")
_EXPONENTS = ("U_M exponent", "U_L exponent", "U_t exponent")
# Attributes of the header with the code units in SWIFT, and in other codes; and their cgs units.
_UNITS = {
    "mass": (("Unit mass in cgs (U_M)", "UnitMass_in_g", "UnitMass_In_CGS"), "g"),
    "length": (("Unit length in cgs (U_L)", "UnitLength_in_cm", "UnitLength_In_CGS"), "cm"),
    "velocity": (("UnitVelocity_in_cm_per_s", "UnitVelocity_In_CGS"), "cm / s"),
}
_TIME = "Unit time in cgs (U_t)"


class GadgetHeader:
    """The header of an open file; units given by the user take precedence.

    `units` are the code units of mass, length and velocity in cgs (None if the file omits them),
    `a` and `h` are 1 without cosmology, `box` has the widths in the code's unit of a box that
    begins at 0, `meta` the time or redshift, `masses` the particle mass of each type (0 if masses
    are stored per particle).
    """

    def __init__(self, file: h5py.File, given: Mapping[str, Any]) -> None:
        def attributes(group: str) -> dict[str, Any]:
            return dict(file[group].attrs) if group in file else {}

        header = attributes("Header")
        attrs = attributes("Parameters") | header | attributes("Units")
        redshift, time = number(attrs, "Redshift"), number(attrs, "Time")
        flag = number(attrs | attributes("Cosmology"), "ComovingIntegrationOn", "Cosmological run")
        cosmological = bool(flag)
        if flag is None and number(attrs, "Omega0", "Omega_Matter"):  # is time the scale factor?
            known = time is not None and redshift is not None
            cosmological = known and abs((time or 0) * (1 + (redshift or 0)) - 1) < 1e-3
        z = (redshift or 0.0) if cosmological else 0.0
        h = number(attrs, "HubbleParam") if cosmological else None
        if not z > -1 or not (h is None or h > 0):
            raise FileFormatError(f"HubbleParam {h} or Redshift {z} is impossible")
        self.a, self.h = 1 / (1 + z), h or 1.0
        self.units = _code_units(attrs, given)
        self.known = None not in self.units.values()
        size = np.ravel(attrs.get("BoxSize", 0.0))
        if size.dtype.kind not in "fiu" or size.size not in (1, 3):
            raise FileFormatError(f"BoxSize must be one or three numbers, got {attrs['BoxSize']!r}")
        box = np.broadcast_to(size.astype(np.float64), (3,))
        self.box = box if np.isfinite(box).all() and (box > 0).all() else None
        periodic = number(attrs, "PeriodicBoundariesOn")
        self.periodic = cosmological if periodic is None else bool(periodic)
        self.masses = np.ravel(header.get("MassTable", np.zeros(0))).astype(np.float64)
        self.meta: dict[str, Any] = {}
        length, velocity = self.units["length"], self.units["velocity"]
        if cosmological:
            self.meta = {"redshift": z, "scale_factor": self.a}
        elif time is not None and length is not None and velocity is not None:
            self.meta = {"time": time * length / velocity, "time_unit": "s"}
        elif time is not None:
            self.meta = {"time": time}

    def of(self, name: str, attributes: Mapping[str, Any]) -> tuple[float, str]:
        """Return (factor, unit): factor converts a data set, given by its common name, to unit."""
        if not self.known:
            return 1.0, ""
        if name in _FIXED and not set(_EXPONENTS) <= set(attributes):
            return 1.0, _FIXED[name]
        from astropy import units as u

        *powers, unit = _dimension_of(name, attributes)
        bases = np.array([*self.units.values(), self.a, self.h], np.float64)
        factor = float(np.exp(np.dot(powers, np.log(bases))))
        if unit in ("", "G"):
            return factor if unit else 1.0, unit
        mass, length, velocity = powers[:3]
        cgs = u.g**mass * u.cm**length * (u.cm / u.s) ** velocity
        return factor * float(cgs.to(unit)), unit


def _dimension_of(name: str, attributes: Mapping[str, Any]) -> Dimension:
    if "a_scaling" in attributes:
        mass, length, velocity, a, h = (number(attributes, key) or 0.0 for key in _SCALING)
    elif set(_EXPONENTS) <= set(attributes):
        mass, length, time = (number(attributes, key) or 0.0 for key in _EXPONENTS)
        length, velocity = length + time, -time
        a, h = (number(attributes, f"{key}-scale exponent") or 0.0 for key in "ah")
    else:
        return _KNOWN.get(name, Dimension())
    if name in _KNOWN:
        return _KNOWN[name]._replace(a=a, h=h)
    from astropy import units as u

    unit = u.g**mass * u.cm ** (length + velocity) * u.s**-velocity
    text = "" if unit == u.dimensionless_unscaled else str(unit)
    return Dimension(mass, length, velocity, a, h, text)


def _code_units(attrs: dict[str, Any], given: Mapping[str, Any]) -> dict[str, float | None]:
    from astropy import units as u

    sizes = {kind: number(attrs, *names) for kind, (names, _) in _UNITS.items()}
    time = number(attrs, _TIME)
    if sizes["length"] and time:
        sizes["velocity"] = sizes["length"] / time
    for kind, (_, cgs) in _UNITS.items():
        unit = given.get(f"{kind}_unit")
        if unit is not None:
            size = unit if is_quantity(unit) else u.Quantity(1.0, parse_unit(unit))
            try:
                sizes[kind] = float(size.to(cgs).value)
            except u.UnitConversionError as error:
                raise UnitsError(f"{kind}_unit {unit} is no unit of {kind}") from error
        known = sizes[kind]
        if known is not None and not known > 0:
            raise FileFormatError(f"the code's unit of {kind} must be positive, got {known}")
    return sizes
