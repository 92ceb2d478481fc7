"""Geometry on the host: coordinate systems, and the angles of cameras.

Spherical coordinates are (r, θ, φ) with θ from the z axis, cylindrical ones (R, φ, z); φ runs from
the x axis towards y, and angles are radians. Cameras have an inclination, an azimuth and a position
angle in degrees, as RADMC-3D defines them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .errors import InputError

# Digits of the ends of an interval, and of its width at least.
_DIGITS, _OF_WIDTH = 6, 3
# From where a first picture is taken: obliquely above, in degrees.
FIRST_INCL, FIRST_PHI = 60.0, 30.0
CARTESIAN, SPHERICAL, CYLINDRICAL = ("x", "y", "z"), ("r", "theta", "phi"), ("R", "phi", "z")


def position(system: tuple[str, ...], coordinates: np.ndarray) -> np.ndarray:
    """Return x, y and z, shape (3, n), of points in a grid's own coordinates, shape (3, n).

    Coordinates beyond the ends of their range go on through the axis or the centre: r < 0 is the
    point opposite.
    """
    if system == SPHERICAL:
        r, theta, phi = coordinates
        radius = r * np.sin(theta)
        return np.array([radius * np.cos(phi), radius * np.sin(phi), r * np.cos(theta)])
    if system == CYLINDRICAL:
        radius, phi, z = coordinates
        return np.array([radius * np.cos(phi), radius * np.sin(phi), z])
    return coordinates


def metric(system: tuple[str, ...], coordinates: np.ndarray) -> np.ndarray:
    """Return the length per unit of each coordinate, shape (3, n): (1, r, r sin θ) or (1, R, 1)."""
    one = np.ones_like(coordinates[0])
    if system == SPHERICAL:
        return np.array([one, coordinates[0], coordinates[0] * np.sin(coordinates[1])])
    if system == CYLINDRICAL:
        return np.array([one, coordinates[0], one])
    return np.ones_like(coordinates)


def unit_vectors(system: tuple[str, ...], native: np.ndarray) -> np.ndarray:
    """Return unit vectors along coordinates at points given by these (3, n), shape (3, 3, n)."""
    if system == SPHERICAL:
        _, theta, phi = native
        (st, ct), (sp, cp) = (np.sin(theta), np.cos(theta)), (np.sin(phi), np.cos(phi))
        zero = np.zeros_like(sp)
        return np.stack([[st * cp, st * sp, ct], [ct * cp, ct * sp, -st], [-sp, cp, zero]])
    if system == CYLINDRICAL:
        s, c, zero = np.sin(native[1]), np.cos(native[1]), np.zeros_like(native[1])
        return np.stack([[c, s, zero], [-s, c, zero], [zero, zero, zero + 1]])
    return np.broadcast_to(np.eye(3)[..., None], (3, 3, native.shape[1]))


def mirror_images(grid: Any) -> list[np.ndarray]:
    """Return factors of points, shape (3,) each: a mirrored cell is in two places."""
    return [np.array([1.0, 1.0, z]) for z in ((1.0, -1.0) if grid.mirror else (1.0,))]


def turns(grid: Any) -> list[np.ndarray]:
    """Return quarter turns, shape (3, 3), that take each cell to itself.

    About z where one cell goes all around the axis; about x too where it takes all angles.
    """
    if "phi" not in grid.coordinates:
        return []
    edges = dict(zip(grid.coordinates, grid.edges, strict=True))
    if not grid.is_periodic or len(edges["phi"]) - 1 > 1:
        return []
    around = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    over = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    all_angles = np.array_equal(edges.get("theta", ()), (0.0, np.pi))
    return [around, over] if all_angles else [around]


def many_valued(grid: Any) -> tuple[str, ...]:
    """Return the coordinates of which a cell has many values: all around the axis, or mirrored."""
    count = len(turns(grid))
    names = ("x", "y", "phi", "z", "theta")[: (0, 3, 5)[count]]
    return (*names, "z") if grid.mirror and "z" not in names else names


def span(low: float, high: float) -> str:
    """Return both ends of an interval as text, with digits enough to tell its width."""
    width = abs(high - low) or 1.0
    far = max(abs(low), abs(high), width)
    digits = max(_DIGITS, _OF_WIDTH + math.ceil(math.log10(far / width)))
    return f"{low:.{digits}g} … {high:.{digits}g}"


def is_uniform(edges: np.ndarray) -> bool:
    """Return True if all cells are equally wide to the rounding of the edges themselves."""
    even = np.linspace(edges[0], edges[-1], len(edges))
    rounding = 8 * np.finfo(np.float64).eps * np.max(np.abs(edges))
    return bool(np.max(np.abs(edges - even)) <= rounding)


def cosine_sine(degrees: float) -> tuple[float, float]:
    """Return cosine and sine, exact at multiples of 90 degrees.

    cos(90°) is 6e-17 in floating point, and a ray that should run along a cell wall would drift
    through it.
    """
    quarter, rest = divmod(float(degrees) % 360.0, 90.0)
    if rest == 0.0:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(quarter) % 4]
    angle = np.deg2rad(float(degrees))
    return float(np.cos(angle)), float(np.sin(angle))


def image_axes(incl: float, phi: float, posang: float) -> np.ndarray:
    """Return the image's x axis, its y axis and the direction to the observer, shape (3, 3).

    ``incl = 0`` looks down the z axis with x to the right and y up; z points up otherwise. The
    rotations are those of RADMC-3D's camera: position angle in the image plane, then inclination
    about x, then azimuth about z.

    Parameters
    ----------
    incl, phi, posang : float
        Angles in degrees.
    """
    rotation = _about_z(phi) @ _about_x(incl) @ _about_z(posang)
    return np.asarray(rotation.T)


def _about_z(degrees: float) -> np.ndarray:
    c, s = cosine_sine(degrees)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def _about_x(degrees: float) -> np.ndarray:
    c, s = cosine_sine(degrees)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def angles_towards(direction: np.ndarray) -> tuple[float, float]:
    """Return (incl, phi) in degrees of an observer who is seen in `direction` from the object."""
    if not np.all(np.isfinite(direction)) or not np.any(direction):
        raise InputError(f"a view direction must be a finite, non-zero vector, got {direction}")
    x, y, z = _unit(direction)
    incl = float(np.rad2deg(np.arctan2(np.hypot(x, y), z)))
    # arctan2 keeps a signed zero: along the axis phi is 0 by convention.
    phi = 0.0 if x == 0.0 and y == 0.0 else float(np.rad2deg(np.arctan2(-x, -y)))
    return incl, phi


def position_angle(incl: float, phi: float, up: np.ndarray) -> float:
    """Return the position angle (degrees) that turns `up` upwards in the image."""
    if not np.any(up):
        raise InputError(f"up must be a non-zero vector, got {up}")
    x_axis, y_axis, _ = image_axes(incl, phi, 0.0)
    upwards = _unit(up)
    across, along = float(np.dot(upwards, x_axis)), float(np.dot(upwards, y_axis))
    if np.hypot(across, along) < 1e-12:
        raise InputError(f"up must not be parallel to the line of sight, got {up}")
    # The image's y axis in unrotated image coordinates is (sin posang, cos posang).
    return float(np.rad2deg(np.arctan2(across, along)))


def _unit(vector: np.ndarray) -> np.ndarray:
    # Squares of numbers such as 1e200 or 1e-200 are not in the range of floats.
    scaled = np.asarray(vector, dtype=np.float64) / np.abs(vector).max()
    return np.asarray(scaled / np.linalg.norm(scaled))
