"""The cells of a Cartesian grid on the host: where they are, how large, and which is where."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from ..points import plain_points


class CartesianCells:
    """What `grids.contract.Grid` asks of cells, for a grid of planes ``edges`` along three axes."""

    edges: tuple[np.ndarray, ...]
    unit: Any

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of cells per axis."""
        nx, ny, nz = (len(e) - 1 for e in self.edges)
        return nx, ny, nz

    @property
    def size(self) -> int:
        """Number of cells."""
        return int(np.prod([len(e) - 1 for e in self.edges], dtype=object))

    @property
    def centers(self) -> tuple[np.ndarray, ...]:
        """Cell centres per axis."""
        return tuple(0.5 * (e[1:] + e[:-1]) for e in self.edges)

    def cell_centers(self, first: int = 0, last: int | None = None) -> np.ndarray:
        """Return x, y and z of the centres of consecutive cells, shape (3, n)."""
        return spread(self.centers, first, self.size if last is None else last)

    def cell_sizes(self, first: int = 0, last: int | None = None) -> np.ndarray:
        """Return the widths of consecutive cells, shape (3, n)."""
        widths = tuple(np.diff(e) for e in self.edges)
        return spread(widths, first, self.size if last is None else last)

    @property
    def cell_volumes(self) -> np.ndarray:
        """Volumes of the cells, of the grid's shape."""
        x, y, z = (np.diff(e) for e in self.edges)
        volumes: np.ndarray = x[:, None, None] * y[:, None] * z
        return volumes

    @property
    def levels(self) -> np.ndarray:
        """Zeros: nothing is refined."""
        return np.broadcast_to(np.uint8(0), self.shape)

    def locate(self, points: Any) -> np.ndarray:
        """Return the flat number of the cell that each point is in, -1 outside.

        A point on a wall is in the cell above it; on the last wall of all, below it.

        Parameters
        ----------
        points : array_like or Quantity, shape (n, 3)
            x, y and z; plain numbers are in the grid's unit.
        """
        points = plain_points(points, self.unit)
        flat = np.zeros(len(points), dtype=np.int64)
        inside = np.ones(len(points), dtype=bool)
        for axis, walls in enumerate(self.edges):
            p = points[:, axis]
            inside &= (p >= walls[0]) & (p <= walls[-1])
            index = np.searchsorted(walls, p, "right") - 1
            flat = flat * (len(walls) - 1) + np.clip(index, 0, len(walls) - 2)
        return np.where(inside, flat, -1)

    @functools.cached_property
    def vertex_count(self) -> int:
        """Number of vertices."""
        return int(np.prod([len(e) for e in self.edges], dtype=object))

    def vertex_cells(self, vertex: Any, backend: Any) -> list[tuple[Any, Any]]:
        """Return the eight cells around vertices, each with where it exists (traced)."""
        from ...backend import dr

        Int, UInt = backend.Int, backend.UInt
        nx, ny, nz = (dr.opaque(Int, n) for n in self.shape)
        rows, planes = (dr.opaque(UInt, n + 1) for n in self.shape[:0:-1])
        row = backend.quotient(vertex, rows)
        k = Int(vertex - row * rows)
        layer = backend.quotient(row, planes)
        i, j = Int(layer), Int(row - layer * planes)
        found = []
        for corner in range(8):
            a, b, c = i - (corner >> 2 & 1), j - (corner >> 1 & 1), k - (corner & 1)
            there = (a >= 0) & (a < nx) & (b >= 0) & (b < ny) & (c >= 0) & (c < nz)
            found.append(((a * ny + b) * nz + c, there))
        return found

    def traced_centers(self, cell: Any, backend: Any) -> list[Any]:
        """Return x, y and z of cell centres from flat cell numbers (traced)."""
        from ...backend import dr, from_host

        UInt, Wide = backend.UInt, backend.Wide
        ny, nz = (dr.opaque(UInt, n) for n in self.shape[1:])
        row = backend.quotient(cell, nz)
        i = backend.quotient(row, ny)
        index = (i, row - i * ny, cell - row * nz)
        return [
            dr.gather(Wide, from_host(Wide, centers), k)
            for centers, k in zip(self.centers, index, strict=True)
        ]


def spread(axes: tuple[np.ndarray, ...], first: int, last: int) -> np.ndarray:
    """Return the values of three axes at consecutive cells in C order, shape (3, n).

    Whole rows of the last axis are filled, so nothing is computed per cell.
    """
    x, y, z = axes
    rows = np.arange(first // len(z), -(-last // len(z)))
    i, j = np.divmod(rows, len(y))
    filled = np.empty((3, len(rows), len(z)))
    filled[0], filled[1], filled[2] = x[i, None], y[j, None], z
    start = first - (int(rows[0]) if len(rows) else 0) * len(z)
    return filled.reshape(3, -1)[:, start : start + last - first]
