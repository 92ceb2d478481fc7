"""What media are made for, checked before anything is looked up in it."""

from __future__ import annotations

import sys
from numbers import Real
from typing import Any

from ..errors import InputError, how_to_take
from ..media import Medium
from ..volume import Volume

# More shells, which nobody tells apart, take minutes to compile.
_MOST = 100


def check_volume(function: str, place: str, volume: Any) -> None:
    """Refuse what is no volume.

    Raises
    ------
    InputError
        Tells what makes one of it.
    """
    if not isinstance(volume, Volume):
        raise InputError(
            f"{function} needs a vm.Volume {place}, got {type(volume).__name__}"
            f"{how_to_take(volume)}"
        )


def check_medium(function: str, medium: Any) -> None:
    """Refuse what is no medium.

    Raises
    ------
    InputError
    """
    if not isinstance(medium, Medium):
        raise InputError(
            f"{function} needs a medium (vm.Gaussian, vm.Table, …) first, got "
            f"{type(medium).__name__}"
        )


def shell_count(n: Any) -> int:
    """Return how many shells there shall be.

    Raises
    ------
    InputError
        If it is no whole number, not positive or more than can be told apart.
    """
    number: Any = n if isinstance(n, Real) else 0
    if not 1 <= number <= _MOST or int(number) != number:
        raise InputError(f"n must be a positive whole number of shells, {_MOST} at most, got {n!r}")
    return int(number)


def positive_opacity(opacity: Any) -> float:
    """Return an optical depth.

    Raises
    ------
    InputError
        If it is no positive, finite number.
    """
    depth: Any = opacity if isinstance(opacity, Real) else 0
    if not 0 < depth <= sys.float_info.max:
        raise InputError(f"opacity must be positive and finite, one number, got {opacity!r}")
    return float(depth)


def nothing_to_see(expr: Any, value: float, where: str = "everywhere") -> InputError:
    """Return the error for an expression that has one value in all of a volume."""
    return InputError(
        f"{expr.text} is {value:g} {where}: there is nothing to see. Look at another field, or "
        "give a medium with numbers of your own: vm.Rectangle, or vm.Colormap with vmin and vmax"
    )
