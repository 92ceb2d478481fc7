"""Camera angles: inclination, azimuth and position angle, as RADMC-3D defines them."""

from __future__ import annotations

import numpy as np

from .errors import InputError


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
