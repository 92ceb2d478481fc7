"""Grids of cells between planes of constant x, y and z."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend.types import Int, Mask
from ...errors import InputError
from ...geometry import CARTESIAN, is_uniform
from ...memory import check_memory
from ...units import is_count, is_listed, plain, unit_of
from ..arguments import cell_edges, check_extent, length_unit, plain_points
from ..contract import CellBox, check_walk, on_device
from ..structured import StructuredGrid

if TYPE_CHECKING:
    from ...backend.device import Backend
    from .walk import CartesianWalk


class CartesianGrid(StructuredGrid):
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
    dual_layout = "cells"

    def __init__(self, x: Any, y: Any, z: Any, *, unit: Any = None) -> None:
        self.unit = length_unit((x, y, z), unit)
        axes = zip(CARTESIAN, (x, y, z), strict=True)
        self.edges = tuple(cell_edges(values, self.unit, name) for name, values in axes)
        for edges in self.edges:
            edges.setflags(write=False)
        check_extent(**dict(zip(CARTESIAN, self.edges, strict=True)))

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

    def native(self, points: Any) -> np.ndarray:
        return np.asarray(plain_points(points, self.unit).T)

    def cell_centers(self, first: int = 0, last: int | None = None) -> np.ndarray:
        return self.spread(self.centers, first, last)

    def cell_sizes(self, first: int = 0, last: int | None = None) -> np.ndarray:
        return self.spread([np.diff(e) for e in self.edges], first, last)

    @property
    def cell_volumes(self) -> np.ndarray:
        """Volumes of the cells, of the grid's shape."""
        x, y, z = (np.diff(e) for e in self.edges)
        volumes: np.ndarray = x[:, None, None] * y[:, None] * z
        return volumes

    def vertex_cells(self, vertex: Int, backend: Backend) -> list[tuple[Int, Mask]]:
        return super().vertex_cells(vertex, backend)[::-1]  # their sum has the same bits as ever

    def first_cell_width(self) -> float:
        """Width in x of the first cell: what flux conservation compares a pixel with."""
        return float(self.edges[0][1] - self.edges[0][0])

    def walk(
        self, backend: Backend, kind: str = "cells", box: CellBox | None = None
    ) -> CartesianWalk:
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
        from .dual_walk import CoarseWalk, DualWalk
        from .walk import CartesianWalk

        kinds: dict[str, type[CartesianWalk]] = {
            "cells": CartesianWalk,
            "dual": DualWalk,
            "coarse": CoarseWalk,
        }
        if box is not None:
            check_walk(self, kind, list(kinds), box if kind == "coarse" else None)
            limits = zip(box.low, box.high, self.shape, strict=True)
            if not all(0 <= low < high <= n for low, high, n in limits):
                raise InputError(
                    f"a box needs 0 <= low < high <= {self.shape}, got {box.low} and {box.high}"
                )
            confined = DualWalk if kind == "dual" else CartesianWalk
            return confined(self.edges, self.scale, backend, box=box)
        check_walk(self, kind, list(kinds), None)
        return on_device(self, backend, kind, lambda: kinds[kind](self.edges, self.scale, backend))

    def describe(self) -> dict[str, Any]:
        return {**super().describe(), "uniform": self.is_uniform}

    def _counts(self) -> str:
        return f"{super()._counts()}, {'uniform' if self.is_uniform else 'rectilinear'}"


def _counts(shape: Any) -> tuple[int, ...]:
    counts = tuple(shape) if is_listed(shape) else (shape,) * 3
    if len(counts) != 3 or not all(is_count(n, 10**30) for n in counts):
        raise InputError(f"shape must be three positive whole numbers (nx, ny, nz), got {shape!r}")
    return tuple(int(n) for n in counts)
