"""Derivatives on trees of boxes, at the speed of kernels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..backend import dr, from_host, get_backend
from ..geometry import CARTESIAN
from ..memory import check_memory
from .cell_slopes import CellSlopes, Part
from .neighbours import evaluated, filled_up
from .quadratic_fit import second_derivatives


def is_tree(grid: Any) -> bool:
    """Return True for grids that kernels find neighbours on, in a straight frame."""
    return hasattr(grid, "surroundings") and tuple(grid.coordinates) == CARTESIAN


class BoxesOfTree:
    """What `neighbours.Cells` is for grids of any kind, for those that `is_tree`.

    Parameters
    ----------
    grid : TreeCells
    evaluate : callable
        Returns what is differentiated, for the cells between two numbers.

    Attributes
    ----------
    values : array, shape (N,)
    """

    def __init__(self, grid: Any, evaluate: Callable[[int, int], np.ndarray]) -> None:
        size = grid.size
        check_memory(16 * size, f"differences between {size} cells", "coarsen the volume")
        self.grid, self.values = grid, evaluated(size, evaluate)
        backend = get_backend("cpu", "double")
        self.slopes = CellSlopes(grid, from_host(backend.Float, self.values), backend)
        self._per_length = backend.opaque(1.0 / grid.scale)

    def gradient(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Return gradients (3, n) of consecutive cells, and which cells are at the surface (n,)."""
        slopes, alone = self.slopes.looked_at(self.slopes.part(first, last))
        found = [slope * self._per_length for slope in slopes]
        dr.eval(found, alone)
        return np.array([np.array(slope) for slope in found]), np.array(alone)

    def derivative(self, operation: str) -> np.ndarray:
        """Return a derivative in all cells; see `neighbours.Cells.derivative`."""
        if operation == "laplacian":
            return self._laplacian()
        out = np.empty(self.grid.size)
        for first, part in self.slopes.parts():
            found = np.array(self._of_gradient(part, operation))
            out[first : first + len(found)] = found
        return out

    def _of_gradient(self, part: Part, operation: str) -> Any:
        x, y, z = self.slopes.gradient(part)
        if operation == "gradmag":
            return dr.sqrt(x * x + y * y + z * z) * self._per_length
        return (x, y, z)["xyz".index(operation[-1])] * self._per_length

    def _refit(self, bends: np.ndarray, first: int, part: Part, which: Any) -> None:
        """Write what quadratic functions tell of some cells of a part, given by their numbers."""
        if not dr.width(which):
            return
        middle, size = (
            [dr.gather(type(v), v, which) for v in each] for each in (part.middle, part.size)
        )
        value = dr.gather(type(part.value), part.value, which)
        found = second_derivatives(self.slopes, Part(middle, size, value))
        dr.eval(found)
        for row, own in zip(bends, found, strict=True):
            row[first + np.array(which)] = np.array(own)

    def _laplacian(self) -> np.ndarray:
        """Return the sum of the second derivatives along the axes."""
        size = self.grid.size
        check_memory(36 * size, f"second differences of {size} cells", "coarsen the volume")
        bends, inner = np.empty((3, size)), np.empty((3, size), np.uint32)
        for first, part in self.slopes.parts():
            *found, at_jump = self.slopes.second_derivatives(part)
            dr.eval(found, at_jump)
            for whole, own in zip((bends, inner), found, strict=True):
                for row, values in zip(whole, own, strict=True):
                    row[first : first + dr.width(values)] = np.array(values)
            self._refit(bends, first, part, dr.compress(at_jump))
        return filled_up(bends, inner).sum(axis=0) / self.grid.scale**2
