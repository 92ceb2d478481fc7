"""Cylindrical grids: cells between cylinders, half planes and planes."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...geometry import CYLINDRICAL
from ..arguments import check_extent, plain_points
from .edges import (
    angle_edges,
    azimuths,
    cosine_range,
    increasing,
    interval_product,
    length_edges,
    length_unit,
    radii,
)
from .grid import CurvilinearGrid


class CylindricalGrid(CurvilinearGrid):
    """Cells between cylinders of constant R, half planes of constant φ and planes of constant z.

    The axis is the z axis, φ the azimuth from the +x axis towards +y. Fields have the shape
    ``(nR, nphi, nz)``.

    Parameters
    ----------
    R : array_like or Quantity, shape (nR + 1,)
        Strictly increasing radii of the cells' walls. Inside the first one is empty space, unless
        it is zero.
    phi : array_like or Quantity, shape (nphi + 1,)
        Azimuths of the walls; plain numbers are radian. They span a full circle, which is then
        closed, or a wedge: the rest is empty.
    z : array_like or Quantity, shape (nz + 1,)
        Strictly increasing heights of the walls.
    refined : array_like of bool or int, shape (nodes,), optional
        One flag per node of an octree in R, φ and z, depth first with R fastest: 1 if it is split
        in the middles of its coordinates, 0 if it is a leaf. An azimuth of one cell that closes
        upon itself is not split. Fields are then flat, in the order of the leaves.
    unit : str or unit, optional
        Length unit of plain radii and heights. Quantities bring their own; that of R is kept.

    Attributes
    ----------
    edges : tuple of three float64 arrays
        R and z in `unit`, phi in radian.
    shape : tuple of three int
        Number of cells per axis.
    unit : astropy unit or None
        Length unit; None is dimensionless.

    Raises
    ------
    InputError
        If edges are not one-dimensional, fewer than two, not finite or not increasing; if lengths
        are not within 1e-100 to 1e100, a radius is negative or φ wider than a circle.
    UnitsError
        If units cannot be converted.

    Examples
    --------
    >>> CylindricalGrid([0, 1, 2], [0, 3.14159265, 6.2831853], [-1, 0, 1]).shape
    (2, 2, 2)
    """

    coordinates = CYLINDRICAL
    kind = "cylindrical"
    walk_kinds: tuple[str, ...] = ("cells", "dual")  # RADMC-3D has no cylindrical grids

    def __init__(self, R: Any, phi: Any, z: Any, *, refined: Any = None, unit: Any = None) -> None:
        self.unit = length_unit((R, z), unit)
        heights = increasing(length_edges(z, self.unit, "z"), "z")
        heights.setflags(write=False)
        self.edges = (
            radii(length_edges(R, self.unit, "R"), "R"),
            azimuths(angle_edges(phi, "phi")),
            heights,
        )
        check_extent(R=self.edges[0], z=heights)
        self._refine(refined)

    @property
    def bounds(self) -> np.ndarray:
        R, phi, z = ((e[0], e[-1]) for e in self.edges)
        quarter = (phi[0] - 0.5 * np.pi, phi[1] - 0.5 * np.pi)
        across = [interval_product(R, cosine_range(*ends)) for ends in (phi, quarter)]
        return np.array([*across, z])

    def _volumes(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        dR, dphi, dz = high - low
        volumes: np.ndarray = 0.5 * dR * (low[0] + high[0]) * dphi * dz
        return volumes

    def cell_sizes(self, first: int = 0, last: int | None = None) -> np.ndarray:
        low, high = self.spans(first, last)
        dR, dphi, dz = high - low
        return np.stack([dR, 0.5 * (low[0] + high[0]) * dphi, dz])

    def basis(self, first: int = 0, last: int | None = None) -> np.ndarray:
        _, phi, _ = self.native_centers(first, last)
        s, c, zero = np.sin(phi), np.cos(phi), np.zeros_like(phi)
        return np.stack([[c, s, zero], [-s, c, zero], [zero, zero, zero + 1]])

    def position(self, native: np.ndarray) -> np.ndarray:
        R, phi, z = native
        return np.stack([R * np.cos(phi), R * np.sin(phi), z])

    def native(self, points: Any) -> np.ndarray:
        x, y, z = plain_points(points, self.unit).T
        return np.stack([np.hypot(x, y), self._azimuth(x, y, self.edges[1]), z])

    @property
    def resolution(self) -> float:
        R, phi, z = self.edges
        high = np.diff(z).min() / max(abs(z[0]), abs(z[-1]))
        return min(np.min(np.diff(R) / R[1:]), np.diff(phi).min(), high)
