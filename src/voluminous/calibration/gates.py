"""Gates with units, ``where="velocity_z > 5 km/s"``: numbers in the units of a volume's fields."""

from __future__ import annotations

import copy
from typing import Any

from ..media import Medium
from ..volume import Volume


def with_plain_gates(medium: Medium, volume: Volume) -> Medium:
    """Return a medium without units in its gates; itself if there are none.

    Raises
    ------
    UnitsError, UnknownNameError
        If a number cannot be converted to the unit of what it is compared with.
    """
    return medium.with_each(lambda part: _with_plain_gate(part, volume))


def _with_plain_gate(medium: Any, volume: Volume) -> Any:
    gate = getattr(getattr(medium, "modulation", None), "where", None)
    plain = None if gate is None else volume.without_units(gate)
    if plain is gate:
        return medium
    other = copy.copy(medium)
    other.modulation = copy.copy(medium.modulation)
    other.modulation.where = plain
    return other
