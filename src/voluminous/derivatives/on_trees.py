"""Derivatives on trees of boxes, at the speed of kernels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..backend import dr, from_host, get_backend
from ..geometry import CARTESIAN
from ..memory import check_memory
from .cell_slopes import CHUNK, CellSlopes, Part


def is_tree(grid: Any) -> bool:
    """Return True for grids that kernels find neighbours on, in a straight frame."""
    return hasattr(grid, "surroundings") and tuple(grid.coordinates) == CARTESIAN


def on_tree(grid: Any, evaluate: Callable[[int, int], np.ndarray], operation: str) -> np.ndarray:
    """Return a derivative in all cells of a tree; see `neighbours.by_neighbours`."""
    check_memory(16 * grid.size, f"differences between {grid.size} cells", "coarsen the volume")
    values, out = np.empty(grid.size), np.empty(grid.size)
    for first in range(0, grid.size, CHUNK):
        last = min(first + CHUNK, grid.size)
        values[first:last] = evaluate(first, last)
    backend = get_backend("cpu", "double")
    slopes = CellSlopes(grid, from_host(backend.Float, values), backend)
    for first, part in slopes.parts():
        found = np.array(_differentiated(slopes, part, operation))
        out[first : first + len(found)] = found
    return out


def _differentiated(slopes: CellSlopes, part: Part, operation: str) -> Any:
    per_length = slopes.backend.opaque(1.0 / slopes.grid.scale)
    if operation == "laplacian":
        return slopes.laplacian(part) * (per_length * per_length)
    x, y, z = slopes.gradient(part)
    if operation == "gradmag":
        return dr.sqrt(x * x + y * y + z * z) * per_length
    return (x, y, z)["xyz".index(operation[-1])] * per_length
