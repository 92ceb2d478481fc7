"""From blocks of cells to a grid, and from the values in blocks to a field on it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...grids import CartesianGrid, CylindricalGrid, PatchGrid, SphericalGrid
from ..leaves import placed_values, tree_of_leaves
from .mesh import Mesh

Arrange = Callable[[np.ndarray], Any]
REGULAR: dict[str, Any] = {
    "cartesian": CartesianGrid,
    "spherical": SphericalGrid,
    "cylindrical": CylindricalGrid,
}


def grid_of_mesh(mesh: Mesh, edges: Sequence[np.ndarray], unit: Any) -> tuple[Any, Arrange]:
    """Return the grid of a mesh, and what makes a field of values ``[block, ix, iy, iz]``.

    Blocks of one level that fill the domain make a regular grid; others patches, or in curvilinear
    coordinates a tree.

    Parameters
    ----------
    mesh : Mesh
    edges : sequence of three arrays
        The walls of its root cells, lengths in `unit`.
    unit : unit or None
    """
    if not mesh.level.any() and len(mesh.level) * mesh.block.prod() == mesh.counts.prod():
        return REGULAR[mesh.kind](*edges, unit=unit), _Joined(mesh)
    if mesh.kind == "cartesian":
        shape = np.broadcast_to(mesh.block, mesh.low.shape)
        ratio = np.where(mesh.counts > 1, 2, 1)
        ratios = np.broadcast_to(ratio, (int(mesh.level.max()), 3))
        x, y, z = edges
        grid = PatchGrid.from_boxes(x, y, z, mesh.level, mesh.low, shape, ratios, unit=unit)
        return grid, lambda values: values
    tree, source = _tree(mesh, edges, unit)
    return tree, lambda values: placed_values(values.reshape(-1), source)


class _Joined:
    """Puts blocks of one level side by side."""

    def __init__(self, mesh: Mesh) -> None:
        self.shape, self.block, self.low = tuple(mesh.counts), mesh.block, mesh.low

    def __call__(self, values: np.ndarray) -> np.ndarray:
        missing = np.nan if values.dtype.kind == "f" else 0
        whole = np.full(self.shape, missing, values.dtype)
        for part, low in zip(values, self.low, strict=True):
            x, y, z = (slice(a, a + n) for a, n in zip(low, self.block, strict=True))
            whole[x, y, z] = part
        return whole


def _tree(mesh: Mesh, edges: Sequence[np.ndarray], unit: Any) -> tuple[Any, np.ndarray]:
    local = np.moveaxis(np.indices(mesh.block.tolist()), 0, -1).reshape(-1, 3)
    index = (mesh.low[:, None] + local).reshape(-1, 3)
    level = np.repeat(mesh.level, len(local))
    return tree_of_leaves(REGULAR[mesh.kind], edges, level, index, mesh.axes, unit=unit)
