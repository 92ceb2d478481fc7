"""Readable lengths, angles, times and numbers."""

from __future__ import annotations

import math
from typing import Any

from .arguments import known_unit

# Units, their names, and the least number of them: a size is written in the last that it reaches.
_LENGTHS = (
    *((name, name, 1.0) for name in ("nm", "um", "mm", "cm", "m", "km")),
    ("R_sun", r"R$_\odot$", 1.0),
    *(("au", "au", 0.1), ("pc", "pc", 0.1)),
    *((name, name, 1.0) for name in ("kpc", "Mpc", "Gpc")),
)
_ANGLES = (
    ("uas", "µas", 1.0),
    ("mas", "mas", 1.0),
    ("arcsec", "″", 1.0),
    ("arcmin", "′", 1.0),
    ("deg", "°", 1.0),
)
_TIMES = tuple((name, name, 1.0) for name in ("s", "min", "h", "d", "yr", "kyr", "Myr", "Gyr"))
# Symbols that follow a number without a space.
_SIGNS = ("°", "′", "″")
# Range of numbers that keep their unit.
_HANDY = (0.1, 1000.0)


def readable(size: float, unit: Any) -> tuple[float, str]:
    """Return the factor from `unit` to a readable unit for numbers like `size`, and its name.

    Units of length, angle and time become readable ones; any other stays unchanged.

    Examples
    --------
    >>> factor, name = readable(3e15, "cm")
    >>> round(3e15 * factor), name
    (201, 'au')
    """
    from astropy import units as u

    present, size = known_unit(unit), abs(size)
    ladders = (_LENGTHS, _ANGLES, _TIMES)
    ladder = next(
        (a for a in ladders if present is not None and present.is_equivalent(a[0][0])), None
    )
    if present is None or ladder is None or not math.isfinite(size) or size == 0:
        return 1.0, str(unit or "")
    names = {u.Unit(name): text.replace("um", "µm") for name, text, _ in ladder}
    if _HANDY[0] <= size < _HANDY[1] and (present in names or present.si.scale != 1.0):
        return 1.0, next((text for known, text in names.items() if known == present), str(present))
    chosen = ladder[0]
    for rung in ladder:
        # Rounding must not turn 1 of one unit into 999.9999 of the previous one.
        if size * present.to(rung[0]) >= rung[2] * (1.0 - 1e-9):
            chosen = rung
    return float(present.to(chosen[0])), names[u.Unit(chosen[0])]


def bar_length(
    longest: float, unit: str, shown: tuple[float, str] | None = None
) -> tuple[float, str]:
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


def number_text(number: float) -> str:
    """Return a number with a few digits, as a power of ten if it is far from one."""
    if number == 0 or 1e-3 <= abs(number) < 1e6:
        return f"{number:.4g}" if abs(number) < 1e4 else f"{number:.0f}"
    mantissa, power = f"{number:.2e}".split("e")
    times = "" if float(mantissa) == 1 else rf"{float(mantissa):g}\times "
    return rf"${times}10^{{{int(power)}}}$"


def labelled(name: str, unit: str) -> str:
    """Return a name and a unit in brackets, if there is one."""
    return f"{name} [{unit}]" if unit else name


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
