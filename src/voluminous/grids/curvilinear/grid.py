"""What spherical and cylindrical grids share on the host."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...packages import room
from ..contract import CellBox, Grid
from .corners import cells_around
from .edges import FULL_CIRCLE, is_closed

if TYPE_CHECKING:
    from ...backend.device import Backend


class CurvilinearGrid(Grid):
    """Cells between surfaces of constant coordinates; see `SphericalGrid`, `CylindricalGrid`.

    Attributes
    ----------
    edges : tuple of three float64 arrays
        The cell walls: lengths in `unit`, angles in radian.
    coordinates : tuple of str
        Names of the grid's own coordinates.
    unit : astropy unit or None
        Length unit; None is dimensionless.
    """

    coordinates: tuple[str, str, str]
    walk_kinds: tuple[str, ...] = ("cells", "substeps", "dual")
    cells_are_boxes = has_vertices = True
    edges: tuple[np.ndarray, np.ndarray, np.ndarray]
    unit: Any
    _refined: type[CurvilinearGrid] | None = None

    def __new__(cls, *arguments: Any, refined: Any = None, **options: Any) -> CurvilinearGrid:
        """Return a grid that is refined, if split flags are given."""
        return super().__new__(cls if refined is None else cls._refined or cls)

    def _refine(self, refined: Any) -> None:
        """Take split flags; of grids that are refined."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of cells per axis."""
        a, b, c = (len(e) - 1 for e in self.edges)
        return a, b, c

    @property
    def size(self) -> int:
        """Number of cells."""
        return int(np.prod(self.shape, dtype=object))

    @property
    def centers(self) -> tuple[np.ndarray, ...]:
        """Middles of the cells along each axis; where they are refined, of the base cells."""
        return tuple(0.5 * (e[1:] + e[:-1]) for e in self.edges)

    @functools.cached_property
    def levels(self) -> np.ndarray:
        """Level of refinement of the cells: zeros."""
        return np.zeros(self.shape, np.uint8)

    @property
    def scale(self) -> float:
        """Typical cell width, in which kernels measure lengths."""
        radii = self.edges[0]
        return float(radii[-1] - radii[0]) / (len(radii) - 1)

    @property
    def resolution(self) -> float:
        """Return the smallest width of a cell compared with the numbers it is computed from.

        Distances count from the closest approach to the centre or the axis: what counts is a
        cell's width compared with its distance from there, so radii may span many decades.
        """
        raise NotImplementedError

    def native_centers(self, first: int = 0, last: int | None = None) -> np.ndarray:
        low, high = self.spans(first, last)
        return 0.5 * (low + high)

    def spans(self, first: int = 0, last: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        cells = np.arange(first, self.size if last is None else last)
        index = np.unravel_index(cells, self.shape)
        low = np.stack([e[i] for e, i in zip(self.edges, index, strict=True)])
        return low, np.stack([e[i + 1] for e, i in zip(self.edges, index, strict=True)])

    @functools.cached_property
    def cell_volumes(self) -> np.ndarray:
        """Volumes of the cells, exact; a mirrored cell counts its image."""
        return self._volumes(*self.spans()).reshape(self.shape)

    def _volumes(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        raise NotImplementedError

    def cell_centers(self, first: int = 0, last: int | None = None) -> np.ndarray:
        return self.position(self.native_centers(first, last))

    def position(self, native: np.ndarray) -> np.ndarray:
        """Return x, y and z (3, n) of points given by the grid's own coordinates."""
        raise NotImplementedError

    def native(self, points: Any) -> np.ndarray:
        """Return the grid's own coordinates (3, n) of points (n, 3), as `locate` takes them."""
        raise NotImplementedError

    def locate(self, points: Any) -> np.ndarray:
        native = self.native(points)
        index, inside = [], np.ones(native.shape[1], bool)
        for edges, value in zip(self.edges, native, strict=True):
            found = np.searchsorted(edges, value, side="right") - 1
            found = np.where(value == edges[-1], len(edges) - 2, found)
            inside &= (value >= edges[0]) & (value <= edges[-1])
            index.append(np.clip(found, 0, len(edges) - 2))
        return np.where(inside, np.ravel_multi_index(index, self.shape), -1)

    def _azimuth(self, x: np.ndarray, y: np.ndarray, edges: np.ndarray) -> np.ndarray:
        angle = np.mod(np.arctan2(y, x) - edges[0], FULL_CIRCLE)
        return edges[0] + np.where(angle >= FULL_CIRCLE, 0.0, angle)

    @property
    def vertex_count(self) -> int:
        """Number of vertices: one more than cells along each axis."""
        return int(np.prod([n + 1 for n in self.shape], dtype=object))

    @property
    def is_periodic(self) -> bool:
        """True if azimuth spans a full circle."""
        return is_closed(self.edges[self.coordinates.index("phi")])

    def vertex_cells(self, lane: Any, backend: Backend) -> list[tuple[Any, Any]]:
        return cells_around(self, lane, backend)

    def lattice(self, arrays: Sequence[np.ndarray], backend: Backend) -> list[Any]:
        lattices: list[Any] = room("rendering.sources.corner_layouts").curvilinear_lattices(
            self, arrays, backend
        )
        return lattices

    def walk(self, backend: Backend, kind: str = "cells", box: CellBox | None = None) -> Any:
        from .walks import make_walk

        self.check_no_box(box)
        if kind not in self.walk_kinds:
            raise InputError(
                f"a {self.kind} grid has no walk of the kind {kind!r}, only "
                f"{', '.join(map(repr, self.walk_kinds))}; use scheme='first-order'"
            )
        return self.on_device(backend, kind, lambda: make_walk(self, backend, kind))

    def describe(self) -> dict[str, Any]:
        return {
            **super().describe(),
            "extent": {
                name: [float(e[0]), float(e[-1])]
                for name, e in zip(self.coordinates, self.edges, strict=True)
            },
            "mirror": self.mirror,
        }

    @property
    def bounds(self) -> np.ndarray:
        """CellBox around the domain, shape (3, 2), in the grid's unit."""
        raise NotImplementedError
