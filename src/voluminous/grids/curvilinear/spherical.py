"""Spherical grids: cells between spheres, cones and half planes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...geometry import SPHERICAL
from ..arguments import check_extent, plain_points
from .edges import (
    ANGLE_ROUNDING,
    angle_edges,
    azimuths,
    cosine_range,
    interval_product,
    length_edges,
    length_unit,
    radii,
)
from .grid import CurvilinearGrid

if TYPE_CHECKING:
    from ...backend.types import Float

MIDPLANE = 0.5 * np.pi


class SphericalGrid(CurvilinearGrid):
    """Cells between spheres of constant r, cones of constant θ and half planes of constant φ.

    The centre is at x = y = z = 0, θ is the angle from the +z axis, φ the azimuth from the +x axis
    towards +y. Fields have the shape ``(nr, ntheta, nphi)``.

    Parameters
    ----------
    r : array_like or Quantity, shape (nr + 1,)
        Strictly increasing radii of the cells' walls. Inside the first one is empty space; if it is
        zero the innermost cells meet in the centre.
    theta : array_like or Quantity, shape (ntheta + 1,), optional
        Angles of the walls, from 0 to π at most; plain numbers are radian. Cones that are left open
        at the poles are empty. By default one cell over all angles.
    phi : array_like or Quantity, shape (nphi + 1,), optional
        Azimuths of the walls, in radian. They span a full circle, which is then closed, or a wedge:
        the rest is empty. By default one cell all around.
    mirror : bool, optional
        The last θ edge is the midplane, π/2, and what is above it is also below, mirrored: RADMC-3D
        takes every grid that ends there in this way.
    refined : array_like of bool or int, shape (nodes,), optional
        One flag per node of an octree in r, θ and φ, depth first with r fastest: 1 if it is split
        in the middles of its coordinates, 0 if it is a leaf. An axis with one cell that closes upon
        itself is not split. Fields are then flat, in the order of the leaves.
    unit : str or unit, optional
        Length unit of plain radii. A quantity brings its own.

    Attributes
    ----------
    edges : tuple of three float64 arrays
        r in `unit`, theta and phi in radian.
    shape : tuple of three int
        Number of cells per axis.
    unit : astropy unit or None
        Length unit; None is dimensionless.

    Raises
    ------
    InputError
        If edges are not one-dimensional, fewer than two, not finite or not increasing; if lengths
        are not within 1e-100 to 1e100, a radius is negative, θ outside 0 … π, φ wider than a
        circle, or a mirror not at π/2.
    UnitsError
        If units cannot be converted.

    Examples
    --------
    >>> import numpy as np
    >>> SphericalGrid(np.geomspace(1, 100, 11), np.linspace(0, np.pi, 7))
    <SphericalGrid 10x6x1 cells, r: 1 … 100, theta: 0 … 3.14159, phi: 0 … 6.28319>
    """

    coordinates = SPHERICAL
    kind = "spherical"

    def __init__(
        self,
        r: Any,
        theta: Float = (0.0, np.pi),
        phi: Float = (0.0, 2 * np.pi),
        *,
        mirror: bool = False,
        refined: Any = None,
        unit: Any = None,
    ) -> None:
        if not isinstance(mirror, (bool, np.bool_)):
            raise InputError(f"mirror must be True or False, got {mirror!r}")
        self.unit, self.mirror = length_unit((r,), unit), bool(mirror)
        self.edges = (
            radii(length_edges(r, self.unit, "r"), "r"),
            _polar_angles(angle_edges(theta, "theta"), self.mirror),
            azimuths(angle_edges(phi, "phi")),
        )
        check_extent(r=self.edges[0])
        self._refine(refined)

    @property
    def bounds(self) -> np.ndarray:
        r, theta, phi = ((e[0], e[-1]) for e in self.edges)
        low, high = theta
        if self.mirror:
            high = np.pi - low
        sine = cosine_range(low - MIDPLANE, high - MIDPLANE)
        quarter = (phi[0] - MIDPLANE, phi[1] - MIDPLANE)
        return np.array(
            [
                interval_product(r, sine, cosine_range(*phi)),
                interval_product(r, sine, cosine_range(*quarter)),
                interval_product(r, cosine_range(low, high)),
            ]
        )

    def _volumes(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        (r0, a, _), (r1, b, _), (dr, dtheta, dphi) = low, high, high - low
        shell = dr * (r1 * r1 + r1 * r0 + r0 * r0) / 3
        # cos a - cos b as a product: a difference would lose digits near the axis.
        zone = 2 * np.sin(0.5 * (a + b)) * np.sin(0.5 * dtheta)
        volumes: np.ndarray = shell * zone * dphi
        return 2 * volumes if self.mirror else volumes

    def cell_sizes(self, first: int = 0, last: int | None = None) -> np.ndarray:
        low, high = self.spans(first, last)
        (dr, dtheta, dphi), (r, theta, _) = high - low, 0.5 * (low + high)
        return np.stack([dr, r * dtheta, r * np.sin(theta) * dphi])

    def basis(self, first: int = 0, last: int | None = None) -> np.ndarray:
        _, theta, phi = self.native_centers(first, last)
        (st, ct), (sp, cp) = (np.sin(theta), np.cos(theta)), (np.sin(phi), np.cos(phi))
        outwards = [st * cp, st * sp, ct]
        southwards = [ct * cp, ct * sp, -st]
        return np.stack([outwards, southwards, [-sp, cp, np.zeros_like(sp)]])

    def position(self, native: np.ndarray) -> np.ndarray:
        r, theta, phi = native
        across = r * np.sin(theta)
        return np.stack([across * np.cos(phi), across * np.sin(phi), r * np.cos(theta)])

    def native(self, points: Any) -> np.ndarray:
        x, y, z = plain_points(points, self.unit).T
        z = np.abs(z) if self.mirror else z
        across = np.hypot(x, y)
        phi = self._azimuth(x, y, self.edges[2])
        return np.stack([np.hypot(across, z), np.arctan2(across, z), phi])

    @property
    def resolution(self) -> float:
        r, theta, phi = self.edges
        return min(np.min(np.diff(r) / r[1:]), np.diff(theta).min(), np.diff(phi).min())


def _polar_angles(edges: np.ndarray, mirror: bool) -> np.ndarray:
    """Return θ edges; ends that are a pole or the midplane but for rounding are."""
    if edges[0] < -ANGLE_ROUNDING or edges[-1] > np.pi + ANGLE_ROUNDING:
        raise InputError(
            f"theta edges must lie between 0 and pi radian, got {edges[0]:g} … {edges[-1]:g}. "
            "Plain numbers are radian, from the +z axis: give a Quantity for degrees"
        )
    for end, special in ((0, 0.0), (-1, np.pi), (-1, MIDPLANE)):
        if abs(edges[end] - special) < ANGLE_ROUNDING:
            edges[end] = special
    if mirror and edges[-1] != MIDPLANE:
        raise InputError(
            "mirror=True needs a last theta edge at the midplane, pi/2 = 1.570796 radian; "
            f"it is {edges[-1]:g}"
        )
    edges.setflags(write=False)
    return edges
