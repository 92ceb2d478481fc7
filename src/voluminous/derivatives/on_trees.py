"""Derivatives on trees of boxes, straight or bent, at the speed of kernels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..backend import dr, from_host, get_backend
from ..geometry import CARTESIAN
from ..memory import check_memory
from .cell_slopes import CellSlopes, Part
from .neighbours import evaluated, filled_up
from .quadratic_fit import fitted


def is_tree(grid: Any) -> bool:
    """Return True for grids that kernels find neighbours on."""
    return bool(grid.has_neighbourhood)


class BoxesOfTree:
    """What `neighbours.Cells` is for grids of any kind, for those that `is_tree`.

    Parameters
    ----------
    grid : TreeCells or RefinedCells
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
        self.slopes = CellSlopes(grid, [from_host(backend.Float, self.values)], backend, own=False)

    def gradient(self, runs: Sequence[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
        """Return gradients (3, n) of runs of cells, and which cells are at the surface (n,).

        Those of linear functions: some cells are looked at without the others' being known.
        """
        (slopes,), alone, _ = self.slopes.looked_at(self.slopes.part(runs))
        dr.eval(slopes, alone)
        found, end = _on_host(slopes), 0
        for first, last in runs:
            here = slice(end, end := end + last - first)
            found[:, here] = self._turned(found[:, here], first, last)
        return found, np.array(alone)

    def derivative(self, operation: str) -> np.ndarray:
        """Return a derivative in all cells; see `neighbours.Cells.derivative`."""
        if operation == "laplacian":
            return self._laplacian()
        out = np.empty(self.grid.size)
        for first, part in self.slopes.parts():
            last = first + dr.width(part.middle)
            gradient = self._turned(self._slopes(part), first, last)
            if operation == "gradmag":
                out[first:last] = np.sqrt(np.sum(gradient * gradient, axis=0))
            else:
                out[first:last] = gradient["xyz".index(operation[-1])]
        return out

    def _slopes(self, part: Part) -> np.ndarray:
        """Return gradients, those of quadratic functions beside cells of other sizes."""
        (slopes,), alone, aside = self.slopes.looked_at(part)
        at_jump = aside & ~alone
        dr.eval(slopes, at_jump)
        found = _on_host(slopes)
        self._refit(found, part, dr.compress(at_jump), 0)
        return found

    def _turned(self, slopes: np.ndarray, first: int, last: int) -> np.ndarray:
        """Return gradients per length along x, y and z, of those along the axes of the cells."""
        slopes /= self.grid.scale
        if tuple(self.grid.coordinates) == CARTESIAN:
            return slopes
        return np.einsum("kan,kn->an", self.grid.basis(first, last), slopes)

    def _refit(self, found: np.ndarray, part: Part, which: Any, order: int) -> None:
        """Write what quadratic functions tell of some cells of a part, given by their numbers.

        First derivatives (order 0) or second ones (1).
        """
        if not dr.width(which):
            return
        middle, size = (
            [dr.gather(type(v), v, which) for v in each] for each in (part.middle, part.size)
        )
        values = [dr.gather(type(v), v, which) for v in part.values]
        better = fitted(self.slopes, Part(middle, size, values))[order]
        dr.eval(better)
        found[:, np.array(which)] = _on_host(better)

    def _laplacian(self) -> np.ndarray:
        size = self.grid.size
        check_memory(36 * size, f"second differences of {size} cells", "coarsen the volume")
        bends, inner = np.empty((3, size)), np.empty((3, size), np.uint32)
        unknown = np.empty(size, bool)
        for first, part in self.slopes.parts():
            last = first + dr.width(part.middle)
            bend, beside, lacking, at_jump = self.slopes.second_derivatives(part)
            dr.eval(bend, beside, lacking, at_jump)
            unknown[first:last] = np.array(lacking)
            bends[:, first:last], inner[:, first:last] = _on_host(bend), _on_host(beside)
            self._refit(bends[:, first:last], part, dr.compress(at_jump), 1)
        return filled_up(bends, inner, unknown).sum(axis=0) / self.grid.scale**2


def _on_host(columns: list[Any]) -> np.ndarray:
    return np.array([np.array(column) for column in columns])
