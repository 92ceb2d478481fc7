"""Media that fade: their emission and extinction grow or vanish from frame to frame."""

from __future__ import annotations

import functools
import operator

import numpy as np

from ..errors import InputError
from ..media.contract import Medium
from ..units import is_count

# Components weaker than this are left out.
_LEAST = 1e-4


def fade(first: Medium, last: Medium, frames: int) -> list[Medium]:
    """Return media that go from one to the other: one per frame.

    Emission and extinction are ``(1 - t)`` those of the first and ``t`` those of the last, with t
    from 0 to 1. Components that both have are constant.

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
    going = [one for one in first.components() if one not in last.components()]
    coming = [one for one in last.components() if one not in first.components()]
    staying = [one for one in first.components() if one in last.components()]
    weights = map(float, np.linspace(0.0, 1.0, frames))
    return [
        functools.reduce(
            operator.add,
            staying
            + [one.scaled(1.0 - t) if t else one for one in going if 1.0 - t > _LEAST]
            + [one.scaled(t) if t < 1.0 else one for one in coming if t > _LEAST],
        )
        for t in weights
    ]
