"""Coordinates of curvilinear grids along rays, which know x, y and z: as expressions of these."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ...expressions import Expression
from ...fields import COORDINATES

_ACROSS = "sqrt(x*x + y*y)"


def ray_coordinates(volume: Any, names: Iterable[str]) -> dict[str, Expression]:
    """Return the grid's own coordinates among some names, computed from x, y and z."""
    grid = volume.grid
    own = [n for n in names if n in grid.coordinates and n not in (*COORDINATES, *volume)]
    return {name: _formula(name, grid) for name in own}


def _formula(name: str, grid: Any) -> Expression:
    if name == "R":
        return Expression(_ACROSS)
    if name == "theta":
        height = "abs(z)" if grid.mirror else "z"
        return Expression(f"atan2({_ACROSS}, {height})")
    # Azimuths above the first one by less than a full circle.
    first = float(grid.edges[grid.coordinates.index("phi")][0])
    return Expression(f"atan2(y, x) - 2*pi*((atan2(y, x) - {first!r}) // (2*pi))")
