"""Cameras of the twin: which rays belong to which point of the image plane.

The formulas are those of RADMC-3D's manual and of its behaviour: a camera at infinity
(orthographic) and a local observer (perspective) with a flat or a spherical screen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

DEGREES_PER_RADIAN_OF_ZENITH = 57.295780  # RADMC-3D's rounded 180/pi, used for zenith only


@dataclass(frozen=True)
class Rays:
    """Straight rays ``origin + t * direction``, t growing towards the observer.

    ``origins`` and ``directions`` have shape (R, 3), the directions unit length; the rays come
    from infinity and end at ``t_end`` (0 at a local observer, infinity otherwise).
    """

    origins: np.ndarray
    directions: np.ndarray
    t_end: float


@dataclass(frozen=True)
class Camera:
    """A camera; lengths in the grid's unit, angles in degrees.

    ``observer is None`` means at infinity. For a local observer ``half_size`` and ``centre`` are
    in radians and ``incl``, ``phi`` are not used: it looks at ``point``.
    """

    nx: int
    ny: int
    half_size: tuple[float, float]
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    incl: float = 0.0
    phi: float = 0.0
    posang: float = 0.0
    centre: tuple[float, float] = (0.0, 0.0)
    observer: tuple[float, float, float] | None = None
    projection: int = 1
    zenith: float = 0.0

    @classmethod
    def from_case(cls, case) -> Camera:
        """Make the camera of a reference case from its ``camera`` dictionary."""
        given = dict(case.camera)
        given["centre"] = given.pop("zoomcenter", (0.0, 0.0))
        for not_a_camera in ("type", "fluxcons"):
            given.pop(not_a_camera)
        return cls(**given)

    @property
    def pixel_size(self) -> tuple[float, float]:
        """Width and height of a pixel."""
        return 2 * self.half_size[0] / self.nx, 2 * self.half_size[1] / self.ny

    def pixel_centres(self, iy, ix) -> tuple[np.ndarray, np.ndarray]:
        """Return image-plane coordinates (px, py) of the centres of pixels [iy, ix]."""
        width, height = self.pixel_size
        px = self.centre[0] + (ix - (self.nx - 1) / 2) * width
        py = self.centre[1] + (iy - (self.ny - 1) / 2) * height
        return px, py

    def rays(self, px: np.ndarray, py: np.ndarray) -> Rays:
        """Return the rays through points (px, py), each of shape (R,), of the image plane."""
        if self.observer is None:
            return self._rays_from_infinity(px, py)
        return self._rays_to_observer(px, py)

    def _rays_from_infinity(self, px, py) -> Rays:
        incl, phi = np.radians(self.incl), np.radians(self.phi)
        turn = (np.sin(incl), np.cos(incl)), (np.sin(phi), np.cos(phi))
        plane = np.stack([*self._position_angle(px, py), np.zeros_like(px)], axis=-1)
        towards_observer = _to_world(np.array([[0.0, 0.0, 1.0]]), *turn)
        origins = _to_world(plane, *turn) + np.array(self.point)
        return Rays(origins, np.broadcast_to(towards_observer, origins.shape), np.inf)

    def _rays_to_observer(self, px, py) -> Rays:
        x, y, z = self._flat_screen(px, py) if self.projection == 1 else _sphere(px, py)
        zenith = self.zenith / DEGREES_PER_RADIAN_OF_ZENITH
        y, z = np.cos(zenith) * y - np.sin(zenith) * z, np.sin(zenith) * y + np.cos(zenith) * z
        directions = np.stack([*self._position_angle(x, y), z], axis=-1)
        directions = _to_world(directions, *self._look_at())
        return Rays(np.broadcast_to(np.array(self.observer), directions.shape), directions, 0.0)

    @staticmethod
    def _flat_screen(px, py):
        norm = np.sqrt(px**2 + py**2 + 1)
        return -px / norm, -py / norm, 1 / norm

    def _look_at(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return (sin, cos) of the inclination and of phi of the line from observer to point."""
        to_point = np.array(self.point) - np.array(self.observer)
        across = np.hypot(to_point[0], to_point[1])
        sin_incl = across / np.linalg.norm(to_point)
        cos_incl = np.sqrt(1 - sin_incl**2) * (-1 if to_point[2] > 0 else 1)
        if across == 0:
            return (sin_incl, cos_incl), (0.0, 1.0)
        return (sin_incl, cos_incl), (to_point[0] / across, to_point[1] / across)

    def _position_angle(self, x, y):
        angle = np.radians(self.posang)
        return np.cos(angle) * x + np.sin(angle) * y, -np.sin(angle) * x + np.cos(angle) * y


def _sphere(px, py):
    q = np.hypot(px, py)
    sin_q_over_q = np.where(q > 0, np.sin(q) / np.where(q > 0, q, 1.0), 1.0)
    return -px * sin_q_over_q, -py * sin_q_over_q, np.cos(q)


def _to_world(v: np.ndarray, incl: tuple[float, float], phi: tuple[float, float]) -> np.ndarray:
    """Rotate camera-axes vectors (R, 3) by inclination about x, then by phi about z."""
    x, y, z = v[:, 0], v[:, 1], v[:, 2]
    (sin_i, cos_i), (sin_p, cos_p) = incl, phi
    y, z = cos_i * y - sin_i * z, sin_i * y + cos_i * z
    return np.stack([cos_p * x + sin_p * y, -sin_p * x + cos_p * y, z], axis=-1)
