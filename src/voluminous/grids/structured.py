"""What grids share whose cells form three axes: Cartesian, spherical and cylindrical ones."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np

from ..backend.types import Int, Mask
from .contract import BoxGrid, DualGrid, Grid, VertexGrid

if TYPE_CHECKING:
    from ..backend.device import Backend


class StructuredGrid(BoxGrid, VertexGrid, DualGrid):
    """Cells between surfaces of constant coordinates: ``edges`` along three axes.

    `is_periodic`: azimuth spans a full circle.
    """

    edges: tuple[np.ndarray, ...]

    @property
    def is_periodic(self) -> bool:
        return False

    def _limits(self) -> list[tuple[float, float]]:
        return [(e[0], e[-1]) for e in self.edges]

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(len(e) - 1 for e in self.edges)

    @property
    def size(self) -> int:
        return int(np.prod(self.shape, dtype=object))

    @property
    def centers(self) -> tuple[np.ndarray, ...]:
        """Middles of the cells along each axis; where they are refined, of the base cells."""
        return tuple(0.5 * (e[1:] + e[:-1]) for e in self.edges)

    @functools.cached_property
    def levels(self) -> np.ndarray:
        """Zeros: nothing is refined."""
        return np.broadcast_to(np.uint8(0), self.shape)

    def native(self, points: Any) -> np.ndarray:
        """Return the grid's own coordinates (3, n) of points (n, 3), as `locate` takes them."""
        raise NotImplementedError

    def native_centers(self, first: int = 0, last: int | None = None) -> np.ndarray:
        low, high = self.spans(first, last)
        return np.asarray(0.5 * (low + high))

    def spans(self, first: int = 0, last: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        return self.spread([e[:-1] for e in self.edges], first, last), self.spread(
            [e[1:] for e in self.edges], first, last
        )

    def spread(self, axes: Sequence[np.ndarray], first: int, last: int | None) -> np.ndarray:
        """Return the values of three axes at consecutive cells, shape (3, n).

        Whole rows of the last axis are filled, so nothing is computed per cell.
        """
        x, y, z = axes
        last = self.size if last is None else last
        rows = np.arange(first // len(z), -(-last // len(z)))
        i, j = np.divmod(rows, len(y))
        filled = np.empty((3, len(rows), len(z)))
        filled[0], filled[1], filled[2] = x[i, None], y[j, None], z
        start = first - (int(rows[0]) if len(rows) else 0) * len(z)
        return filled.reshape(3, -1)[:, start : start + last - first]

    def locate(self, points: Any) -> np.ndarray:
        """Return the flat number of the cell that each point is in, -1 outside.

        A point on a wall is in the cell above it; on the last wall of all, below it.

        Parameters
        ----------
        points : array_like or Quantity, shape (n, 3)
            x, y and z; plain numbers are in the grid's unit.
        """
        native = self.native(points)
        flat, inside = np.zeros(native.shape[1], np.int64), np.ones(native.shape[1], bool)
        for edges, value in zip(self.edges, native, strict=True):
            inside &= (value >= edges[0]) & (value <= edges[-1])
            index = np.searchsorted(edges, value, "right") - 1
            flat = flat * (len(edges) - 1) + np.clip(index, 0, len(edges) - 2)
        return np.where(inside, flat, -1)

    @property
    def vertex_count(self) -> int:
        return int(np.prod([n + 1 for n in self.shape], dtype=object))

    def vertex_cells(self, vertex: Int, backend: Backend) -> list[tuple[Int, Mask]]:
        """Return the eight cells around vertices, each with where it exists (traced).

        Azimuth that spans a full circle is cyclic: the first and the last vertex have the same
        cells. Cells next to a mirrored midplane lie on both sides of it. There is nothing beyond
        the other ends, the poles included: what RADMC-3D does.
        """
        from ..backend import dr

        Int, UInt, rest, numbers = backend.Int, backend.UInt, backend.UInt(vertex), []
        for count in self.shape[:0:-1]:
            row = backend.quotient(rest, dr.opaque(UInt, count + 1))
            numbers.append(Int(rest) - Int(row) * dr.opaque(Int, count + 1))
            rest = row
        around = [(Int(0), backend.Bool(True))]
        for name, number, count in zip(
            self.coordinates, [Int(rest), *numbers[::-1]], self.shape, strict=True
        ):
            last = dr.opaque(Int, count - 1)
            sides = [number - 1, number]
            if name == "phi" and self.is_periodic:
                sides = [dr.select(i < 0, last, dr.select(i > last, 0, i)) for i in sides]
            elif name == "theta" and self.mirror:
                sides = [dr.select(i > last, last, i) for i in sides]
            around = [
                (flat * (last + 1) + dr.clip(i, 0, last), exists & (i >= 0) & (i <= last))
                for flat, exists in around
                for i in sides
            ]
        return around


def is_structured(grid: Grid) -> TypeGuard[StructuredGrid]:
    """Return whether the cells of a grid are numbered along three axes."""
    return len(grid.shape) == 3
