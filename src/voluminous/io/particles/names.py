"""Common names for what codes call the properties of particles."""

from __future__ import annotations

import re

from ..names import field_name

# Where a word of a name in capitals begins.
_WORD = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|[\s_]+")
# SWIFT writes plurals.
_SINGULAR = {
    "masses": "mass",
    "densities": "density",
    "velocities": "velocity",
    "energies": "energy",
    "entropies": "entropy",
    "metallicities": "metallicity",
    "temperatures": "temperature",
    "pressures": "pressure",
    "potentials": "potential",
    "lengths": "length",
    "rates": "rate",
    "fractions": "fraction",
}


def common_name(name: str) -> str:
    """Return the common name of a property.

    Examples
    --------
    >>> common_name("InternalEnergies"), common_name("StarFormationRate"), common_name("Velocities")
    ('internal_energy', 'star_formation_rate', 'velocity')
    """
    words = [word.lower() for word in _WORD.split(name) if word]
    common = "_".join(_SINGULAR.get(word, word) for word in words)
    return field_name(common.removeprefix("gfm_"))
