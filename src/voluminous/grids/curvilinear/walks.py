"""Which families of surfaces a grid's walls are, and the walks through them."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from .approach import approach_axis, approach_centre
from .field_walk import CurvilinearFieldWalk, DualGrid, Smooth
from .radmc3d_substeps import SteppedWalk
from .refined_walk import RefinedWalk
from .surfaces import Planes
from .surfaces_azimuth import HalfPlanes
from .surfaces_cone import Cones
from .surfaces_round import Shells, Tubes
from .walk import CurvilinearWalk

if TYPE_CHECKING:
    from ...backend.device import Backend

KINDS = {"cells": CurvilinearWalk, "substeps": SteppedWalk, "dual": CurvilinearFieldWalk}


def make_walk(grid: Any, backend: Backend, kind: str) -> CurvilinearWalk:
    """Return the walk through a spherical or a cylindrical grid."""
    if len(grid.shape) == 1:
        return _refined_walk(grid, backend, kind)
    if kind == "dual":
        grid = DualGrid.of(grid)
    families = {"spherical": _spherical, "cylindrical": _cylindrical}
    made, approach = families[grid.kind](grid, backend)
    counts = grid.shape
    axes = [a for a, family in enumerate(made) if _divides(family)]
    of_fields = {"axes": axes, "smooth": Smooth.of(grid, backend), "length": grid.scale}
    return KINDS[kind](
        [made[a] for a in axes],
        [_stride(counts, a) for a in axes],
        [_stride([n + 1 for n in counts], a) for a in axes],
        approach,
        grid.scale,
        backend,
        **(of_fields if kind == "dual" else {}),
    )


def _refined_walk(grid: Any, backend: Backend, kind: str) -> RefinedWalk:
    """Return the walk through a grid that is refined: among the walls of the evenly refined one."""
    families = {"spherical": _spherical, "cylindrical": _cylindrical}
    fine = DualGrid(grid.kind, grid.fine_edges, grid.mirror, grid.scale)
    made, approach = families[grid.kind](fine, backend)
    axes = [a for a, family in enumerate(made) if _divides(family)]
    return RefinedWalk(
        [made[a] for a in axes],
        approach,
        grid.scale,
        backend,
        axes=axes,
        grid=grid,
        stepped=kind == "substeps",
    )


def _spherical(grid: Any, backend: Backend) -> tuple[list[Any], Any]:
    r, theta, phi = grid.edges
    radii = r / grid.scale
    families = [
        Shells(radii, backend),
        Cones(theta, grid.mirror, backend),
        HalfPlanes(phi, backend),
    ]
    return families, partial(approach_centre, outer=backend.wide(radii[-1]))


def _cylindrical(grid: Any, backend: Backend) -> tuple[list[Any], Any]:
    R, phi, z = grid.edges
    radii, heights = R / grid.scale, z / grid.scale
    families = [Tubes(radii, backend), HalfPlanes(phi, backend), Planes(heights, backend)]
    limits = {"outer": radii[-1], "low": heights[0], "high": heights[-1]}
    return families, partial(approach_axis, **{k: backend.wide(v) for k, v in limits.items()})


def _divides(family: Any) -> bool:
    """Return True if its walls part cells from each other, or from empty space."""
    return bool(family.encloses or family.has_gaps or family.cells > 1)


def _stride(counts: Any, axis: int) -> int:
    stride = 1
    for n in counts[axis + 1 :]:
        stride *= int(n)
    return stride
