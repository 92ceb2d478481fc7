"""The cells of a Cartesian grid on the host: where they are, how large, and which is where."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend.types import Int
from ...errors import InputError
from ...geometry import is_uniform
from ...memory import check_memory
from ...packages import room
from ...units import is_quantity, plain, space_unit, unit_of
from ..arguments import check_extent, plain_points
from ..contract import CellBox, Grid

if TYPE_CHECKING:
    from ...backend.device import Backend
    from ...backend.types import Float


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

    def vertex_cells(self, vertex: Int, backend: Backend) -> list[tuple[Any, Any]]:
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

    def traced_centers(self, cell: Int, backend: Backend) -> list[Any]:
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


AXES = "xyz"


class CartesianGrid(CartesianCells, Grid):
    """Cells between planes of constant x, y and z.

    Parameters
    ----------
    x, y, z : array_like or Quantity, shape (n + 1,)
        Strictly increasing cell edges. Uniform spacing is detected, and is faster.
    unit : str or unit, optional
        Length unit of plain edges. Quantities bring their own; the x axis' is kept.

    Attributes
    ----------
    edges : tuple of three float64 arrays
        The cell edges in `unit`.
    shape : tuple of three int
        Number of cells per axis.
    unit : astropy unit or None
        Length unit; None is dimensionless.

    Raises
    ------
    InputError
        If edges are not one-dimensional, fewer than two, not finite or not increasing, or the
        domain is shorter than 1e-100 or reaches beyond 1e100.
    UnitsError
        If the axes' units cannot be converted into each other.

    Examples
    --------
    >>> CartesianGrid([0, 1, 2], [0, 1], [0, 0.5, 2]).shape
    (2, 1, 2)
    """

    kind = "cartesian"
    walk_kinds = ("cells", "dual", "coarse")
    has_blocks = cells_are_boxes = is_rectilinear = has_vertices = has_traced_centers = True

    def __init__(self, x: Float, y: Float, z: Float, *, unit: Any = None) -> None:
        self.unit = _common_unit((x, y, z), unit)
        self.edges = tuple(
            _edges(values, self.unit, name) for values, name in zip((x, y, z), AXES, strict=True)
        )
        check_extent(**dict(zip(AXES, self.edges, strict=True)))

    @classmethod
    def uniform(cls, shape: Any, bounds: Any, *, unit: Any = None) -> CartesianGrid:
        """Return a grid of equal cells.

        Parameters
        ----------
        shape : int or three int
            Number of cells per axis.
        bounds : array_like or Quantity
            ``((x0, x1), (y0, y1), (z0, z1))``, or ``(low, high)`` for a cube.
        unit : str or unit, optional
            Length unit of plain bounds.
        """
        counts = _counts(shape)
        own = unit_of(bounds)
        if isinstance(bounds, (list, tuple)) and own is None and len(bounds) == 3:
            own = unit_of(bounds[0])
            bounds = [plain(b, own, "bounds") if own is not None else b for b in bounds]
        elif own is not None:
            bounds = plain(bounds, own, "bounds")
        limits = np.asarray(plain(bounds, None, "bounds"))
        if limits.shape == (2,):
            limits = np.broadcast_to(limits, (3, 2))
        if limits.shape != (3, 2):
            raise InputError(
                "bounds must be (low, high) or ((x0, x1), (y0, y1), (z0, z1)), "
                f"got an array of shape {limits.shape}"
            )
        check_memory(
            8 * (sum(counts) + 3), f"a grid of {' x '.join(map(str, counts))} cells", "take fewer"
        )
        edges = [np.linspace(a, b, n + 1) for (a, b), n in zip(limits, counts, strict=True)]
        return cls(*edges, unit=own if own is not None else unit)

    @property
    def bounds(self) -> np.ndarray:
        """Corners of the domain, shape (3, 2), in the grid's unit."""
        return np.array([[e[0], e[-1]] for e in self.edges])

    @functools.cached_property
    def scale(self) -> float:
        """Typical cell width, in which kernels measure lengths."""
        widths = [(e[-1] - e[0]) / (len(e) - 1) for e in self.edges]
        return float(np.exp(np.mean(np.log(widths))))

    @functools.cached_property
    def is_uniform(self) -> bool:
        """True if the cells of each axis are equally wide."""
        return all(is_uniform(e) for e in self.edges)

    @functools.cached_property
    def resolution(self) -> float:
        """Width of the thinnest cell as a fraction of the domain's."""
        return min(float(np.diff(e).min() / np.ptp(e)) for e in self.edges)

    def first_cell_width(self) -> float:
        """Width in x of the first cell: what flux conservation compares a pixel with."""
        return float(self.edges[0][1] - self.edges[0][0])

    def walk(self, backend: Backend, kind: str = "cells", box: CellBox | None = None) -> Any:
        """Return the walk of rays through this grid, for a backend.

        Parameters
        ----------
        backend : Backend
            Device and precision.
        kind : {"cells", "dual", "coarse"}
            Through the cells; through the dual cells, whose corners are the centres of the cells;
            or through cubes of those.
        box : CellBox, optional
            Confine a walk through ``"cells"`` or ``"dual"`` to these cells; of dual cells, to those
            with their upper corners there, and the ones beyond the domain's last centres.

        Raises
        ------
        InputError
            If other walks are to be confined, or the box is not within the grid.
        """
        from .coarse_walk import CoarseWalk
        from .dual_walk import DualWalk
        from .walk import CartesianWalk

        kinds = {
            "cells": CartesianWalk,
            "dual": DualWalk,
            "coarse": CoarseWalk,
        }
        if box is not None:
            self._check_box(box, kind)
            confined = DualWalk if kind == "dual" else CartesianWalk
            return confined(self.edges, self.scale, backend, box=box)
        return self.on_device(backend, kind, lambda: kinds[kind](self.edges, self.scale, backend))

    def lattice(self, arrays: Sequence[np.ndarray], backend: Backend) -> list[Any]:
        lattices: list[Any] = room("rendering.sources.corner_layouts").cartesian_lattices(
            arrays, backend
        )
        return lattices

    def _check_box(self, box: CellBox, kind: str) -> None:
        if kind not in ("cells", "dual"):
            self.check_no_box(box)
        limits = zip(box.low, box.high, self.shape, strict=True)
        if not all(0 <= low < high <= n for low, high, n in limits):
            raise InputError(
                f"a box needs 0 <= low < high <= {self.shape}, got {box.low} and {box.high}"
            )

    def describe(self) -> dict[str, Any]:
        return {
            **super().describe(),
            "uniform": self.is_uniform,
        }

    def _counts(self) -> str:
        return f"{super()._counts()}, {'uniform' if self.is_uniform else 'rectilinear'}"


def _common_unit(axes: Any, unit: Any) -> Any:
    for values in axes:
        if (own := unit_of(values)) is not None:
            return own
    return space_unit(unit)


def _edges(values: Any, unit: Any, axis: str) -> np.ndarray:
    if unit_of(values) is None and not is_quantity(values):
        edges = _plain_edges(values, axis)
    else:
        edges = np.asarray(plain(values, unit, f"{axis} edges"), dtype=np.float64)
    if edges.ndim != 1 or len(edges) < 2:
        raise InputError(
            f"{axis} edges must be a 1-D array of at least two cell edges, got shape {edges.shape}"
        )
    if not np.all(np.isfinite(edges)):
        bad = int(np.flatnonzero(~np.isfinite(edges))[0])
        raise InputError(f"{axis} edges must be finite; edge {bad} is {edges[bad]}")
    if np.any(np.diff(edges) <= 0):
        bad = int(np.flatnonzero(np.diff(edges) <= 0)[0])
        raise InputError(
            f"{axis} edges must increase strictly; edge {bad} is {edges[bad]:g} and edge {bad + 1} "
            f"is {edges[bad + 1]:g}. Flip the axis (and the fields) if they decrease"
        )
    edges.setflags(write=False)
    return edges


def _plain_edges(values: Float, axis: str) -> np.ndarray:
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{axis} edges must be numbers, got {values!r}") from error


def _counts(shape: Any) -> tuple[int, ...]:
    counts = (shape,) * 3 if np.ndim(shape) == 0 else tuple(shape)
    if len(counts) != 3 or not all(
        isinstance(n, Real) and float(n) >= 1 and float(n).is_integer() for n in counts
    ):
        raise InputError(f"shape must be three positive whole numbers (nx, ny, nz), got {shape!r}")
    return tuple(int(n) for n in counts)
