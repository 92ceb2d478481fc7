"""Converts quantities to plain floats in the volume's unit: kernels never see units.

astropy is imported only when a quantity or a unit appears: its import takes longer than a picture.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Sized
from contextlib import suppress
from numbers import Real
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .errors import UnitsError

if TYPE_CHECKING:
    from astropy.units import UnitBase

UnitLike: TypeAlias = "str | UnitBase | None"

Unit: TypeAlias = Any
"""An astropy unit, or None for plain numbers."""

# A value in an error message is written out up to so many characters.
_LONGEST = 100
_ANGLES = ("deg", "rad")
# What has no unit, whatever it looks like.
_PLAIN = (str, bytes, int, float, complex, list, tuple, dict, type(None))
_NO_UNIT = ("", "1", "dimensionless")
_UNKNOWN = (
    "a quantity of {0}.{1} in {2!s} cannot be converted to astropy's; convert it to a unit that "
    "astropy knows, or give plain numbers with an astropy unit: numbers * astropy.units.pc"
)
_NUMBER_THEN_UNIT = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")


def is_quantity(value: Any) -> bool:
    """Return True if `value` carries a unit (astropy or anything that looks like it)."""
    # An image has a unit and can be converted, too, but is no number of them.
    return hasattr(value, "unit") and hasattr(value, "to") and hasattr(value, "value")


def as_quantity(value: Any) -> Any:
    """Return a quantity of another package (unyt, pint, xarray) as astropy's.

    Everything else is returned as it is: plain numbers, arrays, texts, astropy's own quantities.
    """
    if isinstance(value, _PLAIN) or is_quantity(value) or not hasattr(value, "__array__"):
        return value
    if hasattr(value, "to_astropy"):  # unyt, yt
        return _converted(value, lambda: value.to_astropy())
    if hasattr(value, "to_base_units") and hasattr(value, "magnitude"):  # pint
        return _converted(value, lambda: _of_pint(value))
    attributes: Any = getattr(value, "attrs", None)
    if hasattr(value, "dims") and hasattr(attributes, "get"):  # xarray
        inner = as_quantity(value.data)
        name = "" if is_quantity(inner) else str(attributes.get("units", ""))
        if name in _NO_UNIT:
            return inner
        return _converted(value, lambda: inner * (parse_unit(name) or 1.0))
    unit = getattr(value, "units", getattr(value, "unit", None))
    if unit is not None and str(unit) not in _NO_UNIT:
        raise UnitsError(_UNKNOWN.format(type(value).__module__, type(value).__name__, unit))
    return value


def _converted(value: Any, convert: Callable[[], Any]) -> Any:
    try:
        return convert()
    except Exception as error:  # other packages and astropy each raise errors of their own
        unit = getattr(value, "units", "units")
        message = _UNKNOWN.format(type(value).__module__, type(value).__name__, unit)
        raise UnitsError(message) from error


def _of_pint(value: Any) -> Any:
    try:
        return value.magnitude * (parse_unit(f"{value.units:~}") or 1.0)
    except UnitsError:  # a name that only pint has
        base = value.to_base_units()
        return base.magnitude * (parse_unit(f"{base.units:~}") or 1.0)


def split_text(text: str) -> tuple[float, str] | None:
    """Return the number and the name of the unit in a text such as "0.1 pc"; None if it is none."""
    match = _NUMBER_THEN_UNIT.fullmatch(text)
    if match is None or (match[2] and not any(map(str.isalpha, match[2]))):
        return None
    return float(match[1]), match[2]


def quantity_in(text: str) -> Any:
    """Return the quantity in a text such as "0.1 pc", or the number without a unit, or None."""
    parts = split_text(text)
    if parts is None:
        return None
    number, unit = parts[0], parse_unit(parts[1])
    return number if unit is None else number * unit


def as_given(value: Any, what: str = "value", like: str = "0.1 pc") -> Any:
    """Return the quantity in a text such as "0.1 pc", or in each text of a list; else the value.

    Quantities of other packages become astropy's (`as_quantity`). A UnitsError says `what` the
    value is, and what texts look `like`.
    """
    if isinstance(value, (list, tuple)) and any(_is_special(v) for v in value):
        return [as_given(v, what, like) for v in value]
    if not isinstance(value, str):
        return as_quantity(value)
    try:
        found = quantity_in(value)
    except UnitsError as error:
        raise UnitsError(f"{what} is {value!r}: {error}") from None
    if found is None:
        raise UnitsError(
            f"{what} must be a number, a quantity, or a text such as {like!r}, got {value!r}"
        )
    return found


def _is_special(value: Any) -> bool:
    return not isinstance(value, _PLAIN[1:]) and not is_quantity(value)


def parse_unit(unit: Any) -> Any:
    """Return the astropy unit for a name, a unit or None (dimensionless)."""
    if unit is None or (isinstance(unit, str) and unit == ""):
        return None
    if not isinstance(unit, (complex, tuple)):  # of which astropy makes units of its own
        with suppress(TypeError, OverflowError):  # lists and the like cannot be looked up
            return _known_unit(unit)
    raise UnitsError(f"{shown(unit)} is not a unit; expected one such as 'cm', 'pc' or 'g / cm3'")


@functools.lru_cache(maxsize=256)  # a picture asks for a few units, hundreds of times
def _known_unit(unit: Any) -> Any:
    from astropy import units as u

    if hasattr(unit, "dimensions") or hasattr(unit, "dimensionality"):  # of unyt, of pint
        unit = as_quantity(1.0 * unit)
    try:
        parsed = u.Unit(unit)
    except (ValueError, TypeError) as error:
        raise UnitsError(
            f"{unit!r} is not a unit; expected an astropy unit such as 'cm', 'pc' or 'g / cm3'"
        ) from error
    if parsed == u.dimensionless_unscaled:
        return None
    return parsed


def space_unit(unit: Any) -> Any:
    """Return the unit of the edges of cells; texts must name a length or an angle."""
    parsed = parse_unit(unit)
    if isinstance(unit, str) and parsed is not None and not _has_extent(parsed):
        raise UnitsError(
            f"{unit!r} is a unit of {parsed.physical_type}; expected one of length such as 'pc', "
            "or of angle; leave it out if cells are measured in something else"
        )
    return parsed


def _has_extent(unit: Any) -> bool:
    bases = {base.name for base in unit.decompose().bases}
    return unit.physical_type == "unknown" or bool(bases & {"m", "rad"})


@functools.lru_cache(maxsize=256)
def unit_name(unit: Any) -> str:
    """Return the name of a unit; the empty string for dimensionless."""
    return "" if unit is None else str(unit)


def unit_of(value: Any) -> Any:
    """Return the unit of `value`, or of what has one in a sequence; None for plain numbers."""
    value = as_quantity(value)
    if is_quantity(value):
        return parse_unit(value.unit)
    if isinstance(value, str):
        return unit_of(quantity_in(value))
    if isinstance(value, (list, tuple)):
        return next((unit for unit in map(unit_of, value) if unit is not None), None)
    return None


def plain(value: Any, unit: Any, what: str) -> Any:
    """Return `value` as plain float or float64 array in `unit`; plain input is taken as it is.

    For text see `as_given`. None means dimensionless. A UnitsError says `what` the value is.
    """
    like = {"like": "30 deg"} if isinstance(unit, str) and unit in _ANGLES else {}
    value = as_given(value, what, **like)
    if isinstance(value, (list, tuple)) and unit_of(value) is not None:
        return np.array([plain(v, unit, what) for v in value])
    if not is_quantity(value):
        return _as_float(value, what)
    from astropy import units as u

    target = u.dimensionless_unscaled if unit is None else u.Unit(unit)
    if hasattr(target, "physical_unit") and value.unit in (u.dex, u.dimensionless_unscaled):
        return _as_float(value.value, what)  # a difference of logarithms, such as a width
    try:
        converted = value.to(target).value
    except u.UnitConversionError as error:
        name = unit_name(parse_unit(unit)) or "dimensionless"
        advice = (
            "; give a plain number, or a unit to what has none: quantities for the edges of cells, "
            "volume.set_unit(name, unit) for a field"
            if unit is None
            else f"; give a quantity convertible to {name}, or a plain number in {name}"
        )
        raise UnitsError(f"{what} is in {value.unit}, expected {name}{advice}") from error
    return _as_float(converted, what)


def _as_float(value: Any, what: str) -> Any:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise UnitsError(f"{what} must be a number or a quantity, got {shown(value)}") from error
    return float(array) if array.ndim == 0 else array


def described(value: Any) -> Any:
    """Return a value as plain ones: quantities as texts such as "1.0 pc"."""
    if isinstance(value, (list, tuple, range)):
        return [described(v) for v in value]
    value = as_quantity(value)
    if is_quantity(value):
        name = unit_name(parse_unit(value.unit))
        return _texts(np.asarray(value.value, dtype=np.float64).tolist(), name)
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value


def _texts(numbers: Any, unit: str) -> Any:
    if isinstance(numbers, list):
        return [_texts(n, unit) for n in numbers]
    return f"{numbers!r} {unit}" if unit else numbers


def is_count(number: Any, most: int) -> bool:
    """Return whether something is a positive whole number below `most`, of whatever type."""
    real = isinstance(number, Real)
    return real and 1 <= number < most and int(number) == number


def is_listed(value: Any) -> bool:
    """Return whether something is a list, a tuple, or an array with an axis."""
    return isinstance(value, (list, tuple)) or (isinstance(value, np.ndarray) and value.ndim > 0)


def shown(value: Any) -> str:
    """Return a value as it is written; of a long one what it is."""
    text = repr(value)
    if len(text) <= _LONGEST:
        return text
    dtype = f" of {value.dtype}" if hasattr(value, "dtype") else ""
    if not isinstance(value, Sized):
        return f"{text[:_LONGEST]} …"
    return f"{type(value).__name__}{dtype} with {len(value)} entries"


def degrees(value: Any, what: str) -> float:
    """Return one angle in degrees; plain numbers are degrees."""
    angle = None if value is None else plain(value, "deg", what)
    if not isinstance(angle, float):
        raise UnitsError(f"{what} must be one angle, got {shown(value)}")
    return angle


def radians(value: Any, what: str) -> Any:
    """Return an angle in radians; plain numbers are radians."""
    return plain(value, "rad", what)


def pretty_unit(unit: str) -> str:
    """Return a unit in print form, ``g cm⁻²``; unchanged if astropy cannot parse it.

    Examples
    --------
    >>> pretty_unit("g / cm2")
    'g cm⁻²'
    """
    from astropy import units as u

    try:
        return str(u.Unit(unit).to_string("unicode", fraction=False)) if unit else ""
    except (ValueError, TypeError):  # logarithmic units have only one form
        return unit
