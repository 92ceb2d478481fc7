"""Units of yt (unyt) as units of astropy."""

from __future__ import annotations

from typing import Any

from ...errors import UnitsError
from ...packages import require
from ...units import parse_unit, unit_name

# Constants in the two packages (the parsec, the Sun's mass) differ by less.
_ALIKE = 1e-3
# Of these the two differ in dimension: they are the same in the systems they belong to.
_GAUSSIAN = {"gauss": "G", "G": "G", "uG": "uG", "nG": "nG", "mG": "mG"}


def units_of_field(ds: Any, field: tuple[str, str]) -> tuple[Any, Any]:
    """Return the unit of yt to convert a field to, and that unit in astropy (None: a number).

    It is the unit that yt shows the field in; of a code's own units the cgs unit.
    """
    info = ds._get_field_info(field)
    text = next((t for t in (info.output_units, info.units) if t not in (None, "auto")), None)
    if text is None:
        text = ds.unit_system[info.dimensions] if info.dimensions not in (None, 1) else ""
    unit = require("unyt", "yt", "from_yt").Unit(text, registry=ds.unit_registry)
    found = _in_astropy(unit)
    if found is None:
        unit = unit.get_cgs_equivalent()
        found = _in_astropy(unit)
    return (unit, found) if found is not None else (unit, parse_unit(None))


def _in_astropy(unit: Any) -> Any:
    """Return the same unit in astropy, dimensionless included; None if it has no word for it."""
    from astropy import units as u

    text = str(unit)
    if unit.is_dimensionless and unit.base_value == 1:
        return u.dimensionless_unscaled
    if text in _GAUSSIAN:
        return u.Unit(_GAUSSIAN[text])
    spelt = text.replace("Å", "angstrom").replace("dimensionless", "")
    try:
        found = parse_unit(spelt)
    except UnitsError:
        return None
    if found is None or not hasattr(found, "si"):
        return None
    # "h" is an hour to astropy and may be Hubble's constant to yt: the size tells.
    same = abs(found.si.scale / float(unit.base_value) - 1) < _ALIKE
    return found if same and not unit.base_offset else None


def converted(field: tuple[str, str], unit: Any, wanted: Any) -> tuple[Any, float]:
    """Return a unit asked for, and the factor to it.

    Raises
    ------
    UnitsError
        If a field cannot have it.
    """
    from astropy import units as u

    target = parse_unit(wanted) or u.dimensionless_unscaled
    try:
        return target, float((unit or u.dimensionless_unscaled).to(target))
    except u.UnitConversionError as error:
        raise UnitsError(
            f"{'/'.join(field)} is in {unit_name(unit) or 'no unit'}, which cannot become {target}"
        ) from error
