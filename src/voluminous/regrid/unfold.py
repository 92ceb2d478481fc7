"""Volumes in full: both halves of a mirrored one, many cells in place of one all around."""

from __future__ import annotations

from collections.abc import Callable, Container
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..geometry import CARTESIAN, CYLINDRICAL, SPHERICAL, turns
from ..grids.structured import is_structured
from ..memory import check_memory

if TYPE_CHECKING:
    from ..grids.contract import Grid

# Components that change their sign in a mirror at the midplane, if they are a vector's.
_UPWARDS = ("theta", "z")
_THETA = 1


def unfolded_volume(volume: Any, phi: int | None, theta: int | None) -> Any:
    """Return a volume in which every cell is in one place; see `Volume.unfolded`."""
    return _divided(_unmirrored(volume), phi, theta)


def _unmirrored(volume: Any) -> Any:
    """Return a volume without a mirror; see `Volume.unfolded`."""
    grid: Any = volume.grid
    if not grid.mirror:
        return volume
    if not is_structured(grid):
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

    kind: Any = type(grid)
    return on_more_cells(volume, kind(r, both, phi, unit=grid.unit), in_both)


def on_more_cells(volume: Any, grid: Grid, values: Callable[[str], np.ndarray]) -> Any:
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
    systems = [one for one in (CARTESIAN, SPHERICAL, CYLINDRICAL) if axis in one]
    return any(all(f"{stem}_{part}" in fields for part in system) for system in systems)


# Fewer cells than that are wider than a quarter turn: fields between them mean nothing.
_FEWEST = {"phi": 4, "theta": 2}
_SPAN = {"phi": 2.0 * np.pi, "theta": np.pi}


def _divided(volume: Any, phi: int | None, theta: int | None) -> Any:
    """Return a volume with so many cells around; see `Volume.unfolded`."""
    asked = {axis: n for axis, n in (("phi", phi), ("theta", theta)) if n is not None}
    if not asked:
        return volume
    grid, counts = volume.grid, {axis: _checked(axis, n) for axis, n in asked.items()}
    around = len(turns(grid))
    _check_goes_around(grid, counts, around)
    if around == 2:  # of both angles: cells as wide as high
        counts.setdefault("theta", max(counts.get("phi", 0) // 2, _FEWEST["theta"]))
        counts.setdefault("phi", 2 * counts["theta"])
    _check_vectors(volume)
    edges = dict(zip(grid.coordinates, grid.edges, strict=True))
    for axis, count in counts.items():
        edges[axis] = edges[axis][0] + np.linspace(0.0, _SPAN[axis], count + 1)
    shape = tuple(len(e) - 1 for e in edges.values())
    check_memory(
        8 * int(np.prod(shape, dtype=object)) * (len(volume.fields) + 1),
        f"a volume of {' x '.join(map(str, shape))} cells",
        "ask for fewer cells in phi",
    )
    return on_more_cells(
        volume,
        type(grid)(**edges, unit=grid.unit),
        lambda name: np.broadcast_to(volume.array(name), shape),
    )


def _checked(axis: str, count: Any) -> int:
    whole = isinstance(count, (int, np.integer)) and not isinstance(count, bool)
    if not whole or count < _FEWEST[axis]:
        raise InputError(
            f"{axis} must be a whole number of cells, {_FEWEST[axis]} or more; got {count!r}"
        )
    return int(count)


def _check_goes_around(grid: Grid, counts: dict[str, int], around: int) -> None:
    possible = ("phi", "theta")[:around]
    for axis in counts:
        if axis not in possible:
            raise InputError(
                f"{axis} can only be divided where one cell goes all around, which is not so on "
                f"this grid: {grid!r}"
            )
    if not is_structured(grid):
        raise InputError(
            "a refined grid cannot be unfolded; use volume.resample(grid) with a grid that has "
            "many cells in phi"
        )


def _check_vectors(volume: Any) -> None:
    """Refuse vectors along x and y: in a cell that goes all around they have no direction."""
    for name in volume.fields:
        stem, _, axis = name.rpartition("_")
        if stem and axis == "x" and all(f"{stem}_{names}" in volume for names in CARTESIAN):
            names = ", ".join(f"{stem}_{axis}" for axis in volume.grid.coordinates)
            raise InputError(
                f"{name!r} is a component along x, which in a cell that goes all around has no "
                f"direction; give the vector along the grid's own coordinates ({names})"
            )
