"""Both halves of a volume of which only the upper one is stored."""

from __future__ import annotations

from collections.abc import Container
from typing import Any

import numpy as np

from ..errors import InputError

# What changes its sign in a mirror at the midplane, and the components beside it.
_FLIPPED = {"theta": [("r", "phi")], "z": [("x", "y"), ("R", "phi")]}
_THETA = 1


def unfolded(volume: Any) -> Any:
    """Return a volume without a mirror; see `Volume.unfolded`."""
    grid = volume.grid
    if not getattr(grid, "mirror", False):
        return volume
    if len(grid.shape) == 1:
        raise InputError(
            "a refined grid with mirror=True cannot be unfolded; make it with both halves, or "
            "use volume.resample(grid) first"
        )
    r, theta, phi = grid.edges
    both = np.concatenate([theta, np.pi - theta[-2::-1]])
    other = type(volume)(type(grid)(r, both, phi, unit=grid.unit))
    for name in volume.fields:
        above = volume.array(name)
        below = np.flip(above, _THETA)
        signed = -below if _changes_sign(name, volume) else below
        other[name] = np.concatenate([above, signed], axis=_THETA)
        other.set_unit(name, volume.field_unit(name))
    other.meta |= volume.meta
    other.wcs = volume.wcs
    return other


def _changes_sign(name: str, fields: Container[str]) -> bool:
    """Return True for a component of a vector that runs up or down."""
    stem, _, axis = name.rpartition("_")
    return any(
        stem and all(f"{stem}_{other}" in fields for other in others)
        for others in _FLIPPED.get(axis, ())
    )
