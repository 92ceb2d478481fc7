"""Both halves of a volume of which only the upper one is stored."""

from __future__ import annotations

from collections.abc import Callable, Container
from typing import Any

import numpy as np

from ..errors import InputError
from ..geometry import CARTESIAN, CYLINDRICAL, SPHERICAL

# Components that change their sign in a mirror at the midplane, if they are a vector's.
_UPWARDS = ("theta", "z")
_THETA = 1


def unfolded(volume: Any) -> Any:
    """Return a volume without a mirror; see `Volume.unfolded`."""
    grid = volume.grid
    if not grid.mirror:
        return volume
    if not grid.is_structured:
        raise InputError(
            "a refined grid with mirror=True cannot be unfolded; make it with both halves, or "
            "use volume.resample(grid) first"
        )
    r, theta, phi = grid.edges
    both = np.concatenate([theta, np.pi - theta[-2::-1]])

    def in_both(name: str) -> np.ndarray:
        above = volume.array(name)
        below = np.flip(above, _THETA)
        signed = -below if _changes_sign(name, volume) else below
        return np.concatenate([above, signed], axis=_THETA)

    return on_more_cells(volume, type(grid)(r, both, phi, unit=grid.unit), in_both)


def on_more_cells(volume: Any, grid: Any, values: Callable[[str], np.ndarray]) -> Any:
    """Return a volume on another grid in the same place, with what `values` gives of each field."""
    other = type(volume)(grid)
    for name in volume.fields:
        other[name] = values(name)
        other.set_unit(name, volume.field_unit(name))
    other.meta |= volume.meta
    other.wcs = volume.wcs
    return other


def _changes_sign(name: str, fields: Container[str]) -> bool:
    stem, _, axis = name.rpartition("_")
    if not stem or axis not in _UPWARDS:
        return False
    systems = [own for own in (CARTESIAN, SPHERICAL, CYLINDRICAL) if axis in own]
    return any(all(f"{stem}_{part}" in fields for part in system) for system in systems)
