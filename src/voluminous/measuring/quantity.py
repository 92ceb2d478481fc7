"""What is measured: an expression of fields, and the unit of its integrals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, UnitsError
from ..expressions import Expression, components, is_dex, without_unit
from ..units import parse_unit, unit_name

if TYPE_CHECKING:
    from ..volume import Volume


@dataclass(frozen=True)
class CellQuantity:
    """An expression in plain numbers of a volume's fields, and its unit (None: a plain number)."""

    expression: Expression
    unit: Any
    text: str

    @classmethod
    def of(cls, volume: Volume, expression: Any, what: str = "quantity") -> CellQuantity:
        """Return what a user asks for."""
        if not isinstance(expression, (str, Expression, int, float)):
            raise InputError(
                f"{what} must be a field or an expression such as 'density', "
                f"got {_told(expression)}"
            )
        parts = components(expression)
        if len(parts) != 1:
            raise InputError(f"{what} must be one number per cell, got the vector {expression!r}")
        plain, unit = volume.resolved(parts[0])
        return cls(plain, unit, parts[0].text)

    @property
    def number(self) -> Expression:
        """The quantity divided by its unit: what rays add up."""
        return without_unit(self.expression, self.unit, self.text)


def _told(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return "an array; put it into the volume, volume['name'] = array, and give the name"
    return repr(value)


def check_volume(volume: Volume) -> None:
    """Refuse what cannot be measured at all."""
    if not hasattr(volume, "seen_by"):
        raise InputError(f"measurements need a Volume first, got {type(volume).__name__}")


def column_unit(unit: Any, length: Any) -> tuple[Any, float]:
    """Return the unit of a quantity times a length, and what plain numbers are multiplied by.

    The length is taken in the unit of length that the quantity itself is made of: g / cm3 along
    parsecs gives g / cm2.
    """
    return _times_lengths(unit, length, 1)


def total_unit(unit: Any, length: Any) -> tuple[Any, float]:
    """Return the unit of a quantity times a volume, in the same way as `column_unit`."""
    return _times_lengths(unit, length, 3)


def _times_lengths(unit: Any, length: Any, power: int) -> tuple[Any, float]:
    if is_dex(unit):
        raise UnitsError(
            f"numbers in {unit_name(unit)} depend on the unit of what the logarithm is taken of, "
            "and so does their integral; divide by a number with a unit, as in "
            f"'log10(a / (1 {unit_name(unit.physical_unit)}))'"
        )
    if length is None or unit is None:
        return (unit if length is None else length**power), 1.0
    powers = zip(unit.bases, unit.powers, strict=True)
    inverse = {base: p for base, p in powers if base.physical_type == "length" and p < 0}
    own = min(inverse, key=lambda base: inverse[base]) if inverse else length
    return parse_unit(unit * own**power), float(length.to(own)) ** power


def converted(unit: Any, wanted: Any, what: str) -> tuple[Any, float]:
    """Return the unit a user wants, and what numbers are multiplied by."""
    from astropy import units as u

    if wanted is None:
        return unit, 1.0
    target = parse_unit(wanted)
    own = unit if unit is not None else u.dimensionless_unscaled
    try:
        return target, float(own.to(target if target is not None else u.dimensionless_unscaled))
    except u.UnitConversionError as error:
        raise UnitsError(
            f"{what} is in {unit_name(own) or 'no unit'}, which is not {wanted}"
        ) from error
