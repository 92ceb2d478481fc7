"""Media that fade: their emission and extinction grow or vanish from frame to frame."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from ..media.coefficients import Coefficients
from ..media.contract import Medium
from ..units import is_count

# Parts weaker than this are left out.
_LEAST = 1e-4


def fade(first: Medium, last: Medium, frames: int) -> list[Medium]:
    """Return media that go from one to the other: one per frame.

    Emission and extinction are ``(1 - t)`` those of the first and ``t`` those of the last, with t
    from 0 to 1. Parts that both have are constant.

    Parameters
    ----------
    first, last : Medium
        With the same number of channels, and path lengths that are numbers (`Medium.calibrated`).
    frames : int
        Number of media.

    Returns
    -------
    list of Medium

    Raises
    ------
    InputError
        If a path length is "auto", or a medium is a Python function.
    """
    if not is_count(frames, 1 << 31):
        raise InputError(f"frames must be a positive whole number, got {frames!r}")
    if not (isinstance(first, Medium) and isinstance(last, Medium)):
        raise InputError(f"fade goes from a medium to a medium, got {first!r} and {last!r}")
    going = [part for part in first.components() if part not in last.components()]
    coming = [part for part in last.components() if part not in first.components()]
    staying = [part for part in first.components() if part in last.components()]
    return [
        _sum(
            staying
            + [scaled(part, 1.0 - t) for part in going if 1.0 - t > _LEAST]
            + [scaled(part, t) for part in coming if t > _LEAST]
        )
        for t in np.linspace(0.0, 1.0, frames)
    ]


def _sum(parts: list[Medium]) -> Medium:
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return total


def scaled(medium: Medium, weight: float) -> Medium:
    """Return a medium with a multiple of the emission and the extinction of another."""
    arguments = medium.arguments()
    if weight == 1.0:
        return medium
    if medium.path_length is not None:
        length: Any = medium.path_length
        if isinstance(length, str):
            raise InputError(
                "a medium that fades needs a path length; write medium.calibrated(volume)"
            )
        return medium.replace(path_length=length / weight)
    if "opacity" in arguments:  # surfaces: τ = -ln(1 - opacity) of a crossing is scaled
        clear = 1.0 - np.asarray(arguments["opacity"], dtype=np.float64)
        return medium.replace(opacity=(1.0 - clear**weight).tolist())
    if isinstance(medium, Coefficients):
        both = (
            [f"{weight!r} * ({e.text})" for e in expressions]
            for expressions in (medium.emissivity, medium.extinction)
        )
        return Coefficients(*both)
    raise InputError(f"{type(medium).__name__} cannot fade; write it with expressions")
