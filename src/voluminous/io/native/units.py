"""Names of units that lose nothing: astropy's show eight digits of a scale."""

from __future__ import annotations

from typing import Any

from ...errors import UnitsError
from ...units import parse_unit, unit_name


def exact_name(unit: Any) -> str:
    """Return a name that `parse_unit` turns into the same unit.

    Examples
    --------
    >>> exact_name(parse_unit("0.5 kpc")), exact_name(parse_unit("0.123456789012 pc"))
    ('0.5 kpc', '0.123456789012 pc')
    """
    name = unit_name(unit)
    try:
        if parse_unit(name) == unit:
            return name
    except UnitsError:
        pass
    from astropy import units as u

    whole = u.CompositeUnit(1, unit.bases, unit.powers)
    return f"{float(unit.scale)!r} {whole}".strip()
