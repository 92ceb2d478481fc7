"""Readable lengths, angles, times and numbers."""

from __future__ import annotations

import math
from typing import Any

from .arguments import known_unit

# A length is written in the last of these units in which it reaches the minimum value.
_LENGTHS = (
    ("nm", "nm", 0.0),
    ("um", "µm", 1.0),
    ("mm", "mm", 1.0),
    ("cm", "cm", 1.0),
    ("m", "m", 1.0),
    ("km", "km", 1.0),
    ("R_sun", r"R$_\odot$", 1.0),
    ("au", "au", 0.1),
    ("pc", "pc", 0.1),
    ("kpc", "kpc", 1.0),
    ("Mpc", "Mpc", 1.0),
    ("Gpc", "Gpc", 1.0),
)


_ANGLES = (
    ("uas", "µas", 0.0),
    ("mas", "mas", 1.0),
    ("arcsec", "″", 1.0),
    ("arcmin", "′", 1.0),
    ("deg", "°", 1.0),
)


_TIMES = (
    ("s", "s", 0.0),
    ("min", "min", 1.0),
    ("h", "h", 1.0),
    ("d", "d", 1.0),
    ("yr", "yr", 1.0),
    ("kyr", "kyr", 1.0),
    ("Myr", "Myr", 1.0),
    ("Gyr", "Gyr", 1.0),
)


# Range of numbers that keep their unit.
_HANDY = (0.1, 1000.0)


def readable(size: float, unit: Any) -> tuple[float, str]:
    """Return the conversion factor from `unit` to a readable unit, and the name of that unit.

    Parameters
    ----------
    size : float
        Typical size of the numbers, in `unit`.
    unit : str
        A unit of length, angle or time; any other unit stays unchanged.

    Examples
    --------
    >>> factor, name = readable(3e15, "cm")
    >>> round(3e15 * factor), name
    (201, 'au')
    """
    own = known_unit(unit)
    if own is None or not math.isfinite(size) or size == 0:
        return 1.0, str(unit or "")
    for ladder in (_LENGTHS, _ANGLES, _TIMES):
        if own.is_equivalent(ladder[0][0]):
            return _on(ladder, abs(size), own)
    return 1.0, str(unit)


def _on(ladder: Any, size: float, own: Any) -> tuple[float, str]:
    from astropy import units as u

    names = {u.Unit(name): text for name, text, _ in ladder}
    if _HANDY[0] <= size < _HANDY[1] and (own in names or own.si.scale != 1.0):
        return 1.0, next((text for unit, text in names.items() if unit == own), str(own))
    # Rounding must not turn 1 of one unit into 999.9999 of the previous one.
    fits = (size * own.to(name) >= least * (1.0 - 1e-9) for name, _, least in ladder)
    last = max(k for k, does in enumerate(fits) if does or k == 0)
    return float(own.to(ladder[last][0])), ladder[last][1]


def bar_length(longest: float, unit: str, shown: tuple[float, str] | None = None) -> Any:
    """Return a round length that is at most `longest`, in `unit`, and its text.

    `shown` is the result of `readable`; by default a unit that suits the length.

    Examples
    --------
    >>> bar_length(0.07, "pc")
    (0.048..., '10000 au')
    """
    factor, name = readable(longest, unit) if shown is None else shown
    number = round_length(longest * factor)
    return number / factor, with_unit(number, name)


def with_unit(number: float, name: str) -> str:
    """Return a number and its unit; angle symbols (°, ′, ″) follow without a space."""
    return f"{number_text(number)}{'' if name in _SIGNS else ' '}{name}".strip()


_SIGNS = ("°", "′", "″")


def number_text(number: float) -> str:
    """Return a number with a few digits, as a power of ten if it is far from one."""
    if number == 0 or 1e-3 <= abs(number) < 1e6:
        return f"{number:.4g}" if abs(number) < 1e4 else f"{number:.0f}"
    mantissa, power = f"{number:.3g}".split("e") if "e" in f"{number:.3g}" else _parts(number)
    times = "" if float(mantissa) == 1 else rf"{mantissa}\times "
    return rf"${times}10^{{{int(power)}}}$"


def _parts(number: float) -> tuple[str, str]:
    mantissa, power = f"{number:.2e}".split("e")
    return f"{float(mantissa):g}", power


def labelled(name: str, unit: str) -> str:
    """Return a name and a unit in brackets, if there is one."""
    return f"{name} [{unit}]" if unit else name


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


def round_length(longest: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that does not exceed `longest`.

    Examples
    --------
    >>> round_length(0.0625)
    0.05
    """
    power = math.floor(math.log10(longest))
    # Division gives the double nearest to 0.1, 0.02, …; multiplying by a negative power does not.
    steps = [f * 10**power if power >= 0 else f / 10**-power for f in (1, 2, 5)]
    return float(max((s for s in steps if s <= longest), default=steps[0]))
