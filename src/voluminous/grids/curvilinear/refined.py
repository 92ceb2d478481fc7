"""Spherical and cylindrical grids whose cells are split, again and again: octrees in r, θ and φ.

The tree is that of Cartesian octrees (`octree_tree`): it knows whole numbers of finest units only.
Walls between cells of any level are walls of the evenly refined grid, which is never made: only its
edges along each axis are.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ..contract import CellBox, check_walk, on_device
from ..trees.octree_order import Places, checked_flags, levels_from_flags
from ..trees.octree_tree import octree_tree
from ..trees.octree_vertices import octree_vertices
from ..trees.tree import Tree
from ..trees.vertices import LeafGrid, VertexNumbers
from .grid import CurvilinearGrid, CylindricalGrid, SphericalGrid
from .refined_surroundings import RefinedSurroundings, StraightSurroundings
from .surfaces import ANGLE_ROUNDING, FULL_CIRCLE

if TYPE_CHECKING:
    from ...backend.device import Backend

# Finest cells along one axis: kernels hold a table of their walls.
_MOST_WALLS = 1 << 24


class RefinedCells(LeafGrid, CurvilinearGrid):
    """What refinement changes in a curvilinear grid: fields are flat, in the order of the leaves.

    `levels` (leaves,): how often each leaf's base cell was split; `fine_edges`: the walls of the
    evenly refined grid.
    """

    dual_layout = "corners"
    _walk_kinds: tuple[str, ...] = ("cells", "dual")
    places: Places
    fine_edges: tuple[np.ndarray, ...]

    def _finish(self, refined: Any) -> None:
        super()._finish(refined)
        base = int(np.prod(self.base_shape, dtype=object))
        axes = tuple(a for a in range(3) if not self._closes(a))
        levels = levels_from_flags(checked_flags(refined), base, 1 << len(axes))
        levels.setflags(write=False)
        self.places = Places(levels, axes)
        self.levels = levels
        self.divisions = np.ones(3, np.int64)
        self.divisions[list(axes)] <<= self.places.deepest
        self._check_walls()
        self.fine_edges = tuple(
            _divided(e, int(parts)) for e, parts in zip(self.edges, self.divisions, strict=True)
        )

    @property
    def base_edges(self) -> tuple[np.ndarray, ...]:  # type: ignore[override]
        return self.edges

    def _closes(self, axis: int) -> bool:
        edges, name = self.edges[axis], self.coordinates[axis]
        whole = {"theta": 0.5 * FULL_CIRCLE, "phi": FULL_CIRCLE}.get(name, np.inf)
        return len(edges) == 2 and bool(edges[1] - edges[0] > whole - 1e-9)

    def _check_walls(self) -> None:
        most = max(self.divisions * self.base_shape)
        if most > _MOST_WALLS:
            raise InputError(
                f"refined must not divide an axis into more than {_MOST_WALLS} cells; "
                f"{self.places.deepest} levels make {most}"
            )
        axis = self.coordinates.index("phi")
        widest = float(np.diff(self.edges[axis]).max())
        if widest > 0.5 * FULL_CIRCLE + ANGLE_ROUNDING and not self._closes(axis):
            raise InputError(
                "phi cells must be at most half a circle wide where a grid is refined, or one all "
                f"around; one is {widest:g} radian wide: split it in two, phi edges included"
            )

    @functools.cached_property
    def tree(self) -> Tree:
        return octree_tree(self.base_shape, self.places)

    def boxes(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        return self.places.boxes(self.base_shape, first, last)

    def spans(self, first: int = 0, last: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        corner, size = self.boxes(first, self.size if last is None else last)
        low, high = (
            np.stack([e[i] for e, i in zip(self.fine_edges, index, strict=True)])
            for index in (corner, corner + size)
        )
        return low, high

    def locate(self, points: Any) -> np.ndarray:
        native = self.native(points)
        place, inside = np.empty(native.shape, np.int64), np.ones(native.shape[1], bool)
        for axis, (edges, value) in enumerate(zip(self.fine_edges, native, strict=True)):
            found = np.searchsorted(edges, value, side="right") - 1
            place[axis] = np.clip(found, 0, len(edges) - 2)
            inside &= (value >= edges[0]) & (value <= edges[-1])
        return np.where(inside, self.tree.find(place).number, -1)

    @property
    def resolution(self) -> float:
        return super().resolution / float(self.divisions.max())

    @functools.cached_property
    def vertex_numbers(self) -> VertexNumbers:
        return octree_vertices(self)

    def surroundings(self, backend: Backend) -> RefinedSurroundings:
        return RefinedSurroundings(self, backend.with_precision("double"))

    def neighbourhood(self, backend: Backend) -> StraightSurroundings:
        return StraightSurroundings(self, backend.with_precision("double"))

    def walk(self, backend: Backend, kind: str = "cells", box: CellBox | None = None) -> Any:
        from .refined_walk import RefinedFieldWalk, RefinedWalk

        def make() -> RefinedWalk:
            if kind == "dual":
                return RefinedFieldWalk(self, self.fine_edges, backend)
            return RefinedWalk(self, self.fine_edges, backend, kind == "substeps")

        check_walk(self, kind, self._walk_kinds, box)
        return on_device(self, backend, kind, make)


class RefinedSphericalGrid(RefinedCells, SphericalGrid):
    """A spherical grid with cells that are split; made by ``SphericalGrid(..., refined=...)``."""

    _walk_kinds = ("cells", "substeps", "dual")


class RefinedCylindricalGrid(RefinedCells, CylindricalGrid):
    """A cylindrical grid with cells that are split; ``CylindricalGrid(..., refined=...)``."""


# What ``SphericalGrid(..., refined=...)`` makes: assigned here, since it derives from both.
SphericalGrid._refined = RefinedSphericalGrid
CylindricalGrid._refined = RefinedCylindricalGrid


def _divided(edges: np.ndarray, parts: int) -> np.ndarray:
    steps = np.arange(parts) / parts
    inner = edges[:-1, None] + np.diff(edges)[:, None] * steps
    return np.append(inner.ravel(), edges[-1])
