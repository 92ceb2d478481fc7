"""Variable names of Athena++ and PLUTO, and their physical quantities."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError, UnitsError
from ...units import parse_unit
from ..names import field_name

COMPONENTS = {
    "cartesian": ("x", "y", "z"),
    "spherical": ("r", "theta", "phi"),
    "cylindrical": ("R", "phi", "z"),
}
# Common name, powers of length, mass and time, and unit.
Kind = tuple[str, tuple[int, int, int], str]
_SCALARS: dict[str, Kind] = {
    "rho": ("density", (-3, 1, 0), "g / cm3"),
    "prs": ("pressure", (-1, 1, -2), "erg / cm3"),
    "press": ("pressure", (-1, 1, -2), "erg / cm3"),
    "dens": ("density", (-3, 1, 0), "g / cm3"),
    "Etot": ("total_energy", (-1, 1, -2), "erg / cm3"),
    "phi": ("potential", (2, 0, -2), "cm2 / s2"),
}
_VECTORS: dict[str, Kind] = {
    "vel": ("velocity", (1, 0, -1), "cm / s"),
    "vx": ("velocity", (1, 0, -1), "cm / s"),
    "Bx": ("magnetic_field", (-1, 1, -2), "G"),
    "mom": ("momentum", (-2, 1, -1), "g / (cm2 s)"),
    # Its square is an energy density.
    "Bcc": ("magnetic_field", (-1, 1, -2), "G"),
}


@dataclass(frozen=True)
class Variable:
    """A variable: its name and position in the file, and its quantity.

    `kind` has the common name, powers of length, mass and time, and the unit; None if unidentified.
    """

    place: str
    dataset: str
    row: int
    name: str
    kind: Kind | None


def variables(attrs: Any, kind: str) -> list[Variable]:
    """Return all variables of a file, from the file attributes."""
    names = [_text(name) for name in np.ravel(attrs["VariableNames"])]
    datasets = [_text(name) for name in np.ravel(attrs["DatasetNames"])]
    counts = [int(n) for n in np.ravel(attrs["NumVariables"])]
    rows = [(d, k) for d, n in zip(datasets, counts, strict=True) for k in range(max(n, 0))]
    listed: list[Variable] = []
    for (dataset, row), place in zip(rows, names, strict=True):
        name, what = described(place, kind)
        taken = {variable.name for variable in listed}
        own = field_name(place)
        listed.append(Variable(place, dataset, row, own if name in taken else name, what))
    return listed


def described(place: str, kind: str) -> tuple[str, Kind | None]:
    """Return the common name and the quantity of a variable."""
    if place in _SCALARS:
        return _SCALARS[place][0], _SCALARS[place]
    stem, number = place[:-1], place[-1:]
    if stem in _VECTORS and number in "123":
        what = _VECTORS[stem]
        return f"{what[0]}_{COMPONENTS[kind][int(number) - 1]}", what
    return field_name(place), None


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


class CodeUnits:
    """Code units of length, mass and time, from those that the user gives."""

    def __init__(self, **given: Any) -> None:
        units = {name: _unit(name, unit) for name, unit in given.items() if unit is not None}
        length: Any = units.get("length_unit")
        if length is None and units:
            raise InputError(f"{', '.join(units)}: give length_unit too")
        for name, other in (("time_unit", "velocity_unit"), ("mass_unit", "density_unit")):
            if name in units and other in units:
                raise InputError(f"give {name} or {other}, not both: one follows from the other")
        self.length, self.time = length, units.get("time_unit")
        self.mass = units.get("mass_unit")
        if "velocity_unit" in units:
            self.time = length / units["velocity_unit"]
        if "density_unit" in units:
            self.mass = units["density_unit"] * length**3

    def of(self, kind: Kind | None) -> tuple[float, Any]:
        """Return (factor, unit) of a quantity; (1, None) if they are undetermined.

        Fields of these codes omit the factor 4π of Gaussian units: the energy density is B²/2.
        """
        base: Any = (self.length, self.mass, self.time)
        if kind is None or any(u is None for u, p in zip(base, kind[1], strict=True) if p):
            return 1.0, None
        import astropy.units as u

        code: Any = u.dimensionless_unscaled
        for one, power in zip(base, kind[1], strict=True):
            code = code * one**power if power else code
        if kind[2] == "G":
            return math.sqrt(4 * math.pi * code.to("erg / cm3")), u.G
        return float(code.to(kind[2])), u.Unit(kind[2])


def _unit(name: str, value: Any) -> Any:
    import astropy.units as u

    expected = {
        "length_unit": u.cm,
        "mass_unit": u.g,
        "time_unit": u.s,
        "velocity_unit": u.cm / u.s,
        "density_unit": u.g / u.cm**3,
    }[name]
    unit = parse_unit(value)
    if unit is None or not unit.is_equivalent(expected):
        raise UnitsError(f"{name} must be a unit such as '2.5 {expected}', got {value!r}")
    return unit
