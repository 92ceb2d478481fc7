"""Variable names of Athena++ and PLUTO, and their physical quantities."""

from __future__ import annotations

from ..code_units import Quantity
from ..names import field_name

COMPONENTS = {
    "cartesian": ("x", "y", "z"),
    "spherical": ("r", "theta", "phi"),
    "cylindrical": ("R", "phi", "z"),
}
# The axes of these grids that are lengths.
LENGTHS = {"cartesian": (0, 1, 2), "spherical": (0,), "cylindrical": (0, 2)}
_DENSITY = Quantity("density", (-3, 1, 0), "g / cm3")
_PRESSURE = Quantity("pressure", (-1, 1, -2), "erg / cm3")
_SCALARS = {
    "rho": _DENSITY,
    "dens": _DENSITY,
    "prs": _PRESSURE,
    "press": _PRESSURE,
    "Etot": Quantity("total_energy", (-1, 1, -2), "erg / cm3"),
    "phi": Quantity("potential", (2, 0, -2), "cm2 / s2"),
}
_VELOCITY = Quantity("velocity", (1, 0, -1), "cm / s")
_FIELD = Quantity("magnetic_field", (-1, 1, -2), "G")
_VECTORS = {
    "vel": _VELOCITY,
    "vx": _VELOCITY,
    "Bx": _FIELD,
    "Bcc": _FIELD,
    "mom": Quantity("momentum", (-2, 1, -1), "g / (cm2 s)"),
}


def described(place: str, kind: str) -> tuple[str, Quantity | None]:
    """Return the common name and the quantity of a variable on a kind of grid."""
    if place in _SCALARS:
        return _SCALARS[place].name, _SCALARS[place]
    stem, number = place[:-1], place[-1:]
    if stem in _VECTORS and number in "123":
        quantity = _VECTORS[stem]
        return f"{quantity.name}_{COMPONENTS[kind][int(number) - 1]}", quantity
    return field_name(place), None
