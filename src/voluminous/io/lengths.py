"""Units of length in which a domain has a handy size."""

from __future__ import annotations

from typing import Any

# From small to large; a domain is less than some hundred thousand of one wide, and 1 at least.
_ROUND = ("nm", "um", "mm", "cm", "m", "km", "solRad", "au", "pc", "kpc", "Mpc", "Gpc")


def round_unit(width: Any) -> Any:
    """Return the largest unit of length of which a domain is at least one wide.

    Parameters
    ----------
    width : Quantity or unit
        Its largest width.

    Examples
    --------
    >>> from astropy import units as u
    >>> str(round_unit(16 * 1.559e16 * u.cm)), str(round_unit(5e-6 * u.cm))
    ('AU', 'nm')
    """
    from astropy import units as u

    width = u.Quantity(1 * width)
    fitting = [name for name in _ROUND if width.to_value(name) >= 1 - 1e-9]
    return u.Unit(fitting[-1] if fitting else _ROUND[0])
