"""Numbers that say how fine a grid of particles is, checked."""

from __future__ import annotations

from numbers import Integral, Real
from typing import Any

import numpy as np

from ..errors import InputError
from ..memory import check_memory
from .octree import DEEPEST

# Memory that a particle takes: coordinates, keys, their sorting.
_PARTICLE_BYTES = 300


def check_options(
    max_particles: Any, cell_width: Any, min_level: Any, max_level: Any, periodic: Any
) -> None:
    """Refuse options that cannot be; they are those of `from_particles`.

    Raises
    ------
    InputError
        Tells which is wrong, and what it should be.
    """
    if not isinstance(max_particles, Integral) or max_particles < 1:
        raise InputError(f"max_particles must be a whole number, at least 1, got {max_particles!r}")
    width = float(cell_width) if isinstance(cell_width, Real) else 0.0
    if cell_width is not None and not 0 < width < float("inf"):
        raise InputError(f"cell_width must be a positive, finite number, got {cell_width!r}")
    levels = (min_level, max_level)
    whole = all(isinstance(level, Integral) for level in levels)
    if not whole or not 0 <= min_level <= max_level <= DEEPEST:
        raise InputError(
            f"expected whole numbers, 0 <= min_level <= max_level <= {DEEPEST}, got "
            f"{min_level!r}, {max_level!r}"
        )
    if np.ndim(periodic) or periodic not in (True, False):
        raise InputError(
            f"periodic must be True, all axes, or False, got {periodic!r}; a box that is periodic "
            "along some axes is not known"
        )


def check_count(count: int) -> None:
    """Refuse more particles than there is memory for.

    Raises
    ------
    MemoryNeededError
    """
    advice = "give a part of them, or use a machine with more memory"
    check_memory(count * _PARTICLE_BYTES, f"placing {count} particles on a grid", advice)
