"""Coordinates of curvilinear grids along rays, which know x, y and z."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable
from typing import Any

from ..backend import dr
from ..fields import COORDINATES

Fields = dict[str, Any]


def ray_coordinates(volume: Any, names: Iterable[str]) -> dict[str, Callable[[Fields], Any]]:
    """Return how to compute the grid's own coordinates among some names from x, y and z."""
    grid = volume.grid
    own = [n for n in names if n in grid.coordinates and n not in (*COORDINATES, *volume)]
    made: dict[str, Callable[[Fields], Any]] = {
        "R": _across,
        "theta": functools.partial(_polar, bool(getattr(grid, "mirror", False))),
        "phi": functools.partial(_azimuth, _first_azimuth(grid) if "phi" in own else 0.0),
    }
    return {name: made[name] for name in own}


def _first_azimuth(grid: Any) -> float:
    return float(grid.edges[grid.coordinates.index("phi")][0])


def _across(fields: Fields) -> Any:
    return dr.sqrt(fields["x"] * fields["x"] + fields["y"] * fields["y"])


def _polar(mirror: bool, fields: Fields) -> Any:
    height = dr.abs(fields["z"]) if mirror else fields["z"]
    return dr.atan2(_across(fields), height)


def _azimuth(first: float, fields: Fields) -> Any:
    """Return azimuths, above the first by less than a full circle."""
    angle = dr.atan2(fields["y"], fields["x"])
    return angle + 2.0 * math.pi * dr.ceil((first - angle) * (0.5 / math.pi))
