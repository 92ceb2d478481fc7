"""Measured quantities: expressions of fields, and the units of their integrals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import InputError, UnitsError
from ..expressions import Expression, components, is_dex, without_unit
from ..units import Unit, UnitLike, parse_unit, unit_name

if TYPE_CHECKING:
    from ..volume import Volume


class CellQuantity(NamedTuple):
    """An expression in plain numbers of a volume's fields, and its unit (None: a plain number)."""

    expression: Expression
    unit: Unit
    text: str

    @classmethod
    def of(cls, volume: Volume, expression: Any, what: str = "quantity") -> CellQuantity:
        """Return the quantity of a user's expression; `what` names it in errors."""
        if not isinstance(expression, (str, Expression, int, float)):
            advice = "an array; put it into the volume, volume['name'] = array, and give the name"
            got = advice if isinstance(expression, np.ndarray) else repr(expression)
            raise InputError(
                f"{what} must be a field or an expression such as 'density', got {got}"
            )
        first, *others = components(expression)
        if others:
            raise InputError(f"{what} must be one number per cell, got the vector {expression!r}")
        plain, unit = volume.resolved(first)
        return cls(plain, unit, first.text)

    @property
    def number(self) -> Expression:
        """The quantity divided by its unit: what rays add up."""
        return without_unit(self.expression, self.unit, self.text)


def integral_unit(unit: Unit, length: Unit, power: int = 1) -> tuple[Unit, float]:
    """Return a unit times a power of a length, and the factor that numbers are multiplied by.

    The length is in the unit of length that the first unit contains: g / cm3 along parsecs gives
    g / cm2.
    """
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


def check_volume(volume: Any) -> None:
    """Refuse anything but a volume."""
    if not hasattr(volume, "seen_by"):
        raise InputError(f"measurements need a Volume first, got {type(volume).__name__}")


def converted(unit: Unit, wanted: UnitLike, what: str) -> tuple[Unit, float]:
    """Return the unit a user wants, and the factor that converts to it."""
    from astropy import units as u

    if wanted is None:
        return unit, 1.0
    own, target = (u.dimensionless_unscaled if x is None else x for x in (unit, parse_unit(wanted)))
    try:
        return parse_unit(target), float(own.to(target))
    except u.UnitConversionError as error:
        raise UnitsError(
            f"{what} is in {unit_name(own) or 'no unit'}, which is not {wanted}"
        ) from error
