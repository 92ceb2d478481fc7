"""Spherical and cylindrical grids: cells between surfaces of constant coordinates."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...geometry import CYLINDRICAL, SPHERICAL, metric, position
from ..arguments import cell_edges, check_extent, length_unit, plain_points
from ..contract import CellBox, check_walk, on_device
from ..structured import StructuredGrid
from .surfaces import ANGLE_ROUNDING, FULL_CIRCLE, MIDPLANE, SurfaceGrid, is_closed

if TYPE_CHECKING:
    from ...backend.device import Backend
    from .approach import Approach
    from .surfaces import Surfaces
    from .walk import CurvilinearWalk


class CurvilinearGrid(SurfaceGrid, StructuredGrid):
    """Cells between surfaces of constant coordinates; see `SphericalGrid`, `CylindricalGrid`.

    `edges`: the cell walls: lengths in `unit`, angles in radian; `coordinates`: names of the grid's
    own coordinates; `unit`: length unit; None is dimensionless.
    """

    coordinates: tuple[str, str, str]
    dual_layout = "dual vertices"
    _walk_kinds: tuple[str, ...] = ("cells", "substeps", "dual")
    edges: tuple[np.ndarray, np.ndarray, np.ndarray]
    unit: Any
    _refined: type[CurvilinearGrid] | None = None

    def __new__(cls, *arguments: Any, refined: Any = None, **options: Any) -> CurvilinearGrid:
        """Return a grid that is refined, if split flags are given."""
        return super().__new__(cls if refined is None else cls._refined or cls)

    def _finish(self, refined: Any) -> None:
        """Check the domain; grids that are refined take split flags."""
        lengths = dict(zip(self.coordinates, self.edges, strict=True))
        check_extent(**{n: e for n, e in lengths.items() if n not in ("theta", "phi")})
        for edges in self.edges:
            edges.setflags(write=False)

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
        return position(self.coordinates, native)

    def cell_sizes(self, first: int = 0, last: int | None = None) -> np.ndarray:
        low, high = self.spans(first, last)
        return np.asarray((high - low) * metric(self.coordinates, 0.5 * (low + high)))

    def _azimuth(self, x: np.ndarray, y: np.ndarray, edges: np.ndarray) -> np.ndarray:
        angle = np.mod(np.arctan2(y, x) - edges[0], FULL_CIRCLE)
        return np.asarray(edges[0] + np.where(angle >= FULL_CIRCLE, 0.0, angle))

    @property
    def is_periodic(self) -> bool:
        """True if azimuth spans a full circle."""
        return is_closed(self.edges[self.coordinates.index("phi")])

    def walk(
        self, backend: Backend, kind: str = "cells", box: CellBox | None = None
    ) -> CurvilinearWalk:
        from .field_walk import CurvilinearFieldWalk, dual_walls
        from .walk import CurvilinearWalk

        def make() -> CurvilinearWalk:
            if kind == "dual":
                return CurvilinearFieldWalk(self, dual_walls(self), backend)
            return CurvilinearWalk(self, self.edges, backend, kind == "substeps")

        check_walk(self, kind, self._walk_kinds, box)
        return on_device(self, backend, kind, make)

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
        theta: Any = (0.0, np.pi),
        phi: Any = (0.0, 2 * np.pi),
        *,
        mirror: bool = False,
        refined: Any = None,
        unit: Any = None,
    ) -> None:
        if not isinstance(mirror, (bool, np.bool_)):
            raise InputError(f"mirror must be True or False, got {mirror!r}")
        self.unit, self.mirror = length_unit((r,), unit), bool(mirror)
        self.edges = (
            _radii(r, self.unit, "r"),
            _polar_angles(cell_edges(theta, "rad", "theta"), self.mirror),
            _azimuths(phi),
        )
        self._finish(refined)

    def families(
        self, edges: tuple[np.ndarray, ...], backend: Backend
    ) -> tuple[list[Surfaces], Callable[..., Approach]]:
        from .approach import approach_centre
        from .families import Cones, HalfPlanes, Shells

        r = edges[0] / self.scale
        cones, planes = Cones(edges[1], self.mirror, backend), HalfPlanes(edges[2], backend)
        approach = functools.partial(approach_centre, outer=backend.wide(r[-1]))
        return [Shells(r, backend), cones, planes], approach

    @property
    def bounds(self) -> np.ndarray:
        r, theta, phi = ((e[0], e[-1]) for e in self.edges)
        low, high = theta
        if self.mirror:
            high = np.pi - low
        sine = _cosine_range(low - MIDPLANE, high - MIDPLANE)
        quarter = (phi[0] - MIDPLANE, phi[1] - MIDPLANE)
        return np.array(
            [
                _interval_product(r, sine, _cosine_range(*phi)),
                _interval_product(r, sine, _cosine_range(*quarter)),
                _interval_product(r, _cosine_range(low, high)),
            ]
        )

    def _volumes(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        (r0, a, _), (r1, b, _), (dr, dtheta, dphi) = low, high, high - low
        shell = dr * (r1 * r1 + r1 * r0 + r0 * r0) / 3
        # cos a - cos b as a product: a difference would lose digits near the axis.
        zone = 2 * np.sin(0.5 * (a + b)) * np.sin(0.5 * dtheta)
        volumes: np.ndarray = shell * zone * dphi
        return 2 * volumes if self.mirror else volumes

    def native(self, points: Any) -> np.ndarray:
        x, y, z = plain_points(points, self.unit).T
        z = np.abs(z) if self.mirror else z
        across = np.hypot(x, y)
        phi = self._azimuth(x, y, self.edges[2])
        return np.stack([np.hypot(across, z), np.arctan2(across, z), phi])

    @property
    def resolution(self) -> float:
        r, theta, phi = self.edges
        return float(min(np.min(np.diff(r) / r[1:]), np.diff(theta).min(), np.diff(phi).min()))


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
    _walk_kinds: tuple[str, ...] = ("cells", "dual")  # RADMC-3D has no cylindrical grids

    def __init__(self, R: Any, phi: Any, z: Any, *, refined: Any = None, unit: Any = None) -> None:
        self.unit = length_unit((R, z), unit)
        self.edges = _radii(R, self.unit, "R"), _azimuths(phi), cell_edges(z, self.unit, "z")
        self._finish(refined)

    def families(
        self, edges: tuple[np.ndarray, ...], backend: Backend
    ) -> tuple[list[Surfaces], Callable[..., Approach]]:
        from .approach import approach_axis
        from .families import HalfPlanes, Planes, Tubes

        R, z = edges[0] / self.scale, edges[2] / self.scale
        limits = [backend.wide(v) for v in (R[-1], z[0], z[-1])]
        approach = functools.partial(
            approach_axis, **dict(zip(("outer", "low", "high"), limits, strict=True))
        )
        return [Tubes(R, backend), HalfPlanes(edges[1], backend), Planes(z, backend)], approach

    @property
    def bounds(self) -> np.ndarray:
        R, phi, z = ((e[0], e[-1]) for e in self.edges)
        quarter = (phi[0] - MIDPLANE, phi[1] - MIDPLANE)
        across = [_interval_product(R, _cosine_range(*ends)) for ends in (phi, quarter)]
        return np.array([*across, z])

    def _volumes(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        dR, dphi, dz = high - low
        volumes: np.ndarray = 0.5 * dR * (low[0] + high[0]) * dphi * dz
        return volumes

    def native(self, points: Any) -> np.ndarray:
        x, y, z = plain_points(points, self.unit).T
        return np.stack([np.hypot(x, y), self._azimuth(x, y, self.edges[1]), z])

    @property
    def resolution(self) -> float:
        R, phi, z = self.edges
        high = np.diff(z).min() / max(abs(z[0]), abs(z[-1]))
        return float(min(np.min(np.diff(R) / R[1:]), np.diff(phi).min(), high))


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
    return edges


def _radii(values: Any, unit: Any, name: str) -> np.ndarray:
    edges = cell_edges(values, unit, name)
    if edges[0] < 0:
        raise InputError(f"{name} edges must not be negative; the first is {edges[0]:g}")
    return edges


def _azimuths(values: Any) -> np.ndarray:
    """Return edges that are azimuths; a circle that is closed but for rounding is closed."""
    edges = cell_edges(values, "rad", "phi")
    span = edges[-1] - edges[0]
    if span > FULL_CIRCLE + ANGLE_ROUNDING:
        raise InputError(
            f"phi edges must span at most a full circle, 2 pi = 6.28319 radian; they span {span:g}."
            " Plain numbers are radian: give a Quantity for degrees"
        )
    if abs(span - FULL_CIRCLE) < ANGLE_ROUNDING:
        edges[-1] = edges[0] + FULL_CIRCLE
    return edges


def _interval_product(*intervals: tuple[float, float]) -> tuple[float, float]:
    corners = np.array([1.0])
    for interval in intervals:
        corners = np.multiply.outer(corners, np.array(interval)).ravel()
    return float(corners.min()), float(corners.max())


def _cosine_range(low: float, high: float) -> tuple[float, float]:
    ends = np.cos([low, high])
    top = np.floor(high / FULL_CIRCLE) >= np.ceil(low / FULL_CIRCLE)
    bottom = np.floor(high / FULL_CIRCLE - 0.5) >= np.ceil(low / FULL_CIRCLE - 0.5)
    return (-1.0 if bottom else float(ends.min()), 1.0 if top else float(ends.max()))
