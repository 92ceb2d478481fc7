"""How much of a pixel an ellipse covers, exactly: the area of a circle within a parallelogram.

Points of the picture are complex numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .windows import window_pixels

_CORNERS = np.array([-0.5 - 0.5j, 0.5 - 0.5j, 0.5 + 0.5j, -0.5 + 0.5j])
# Less of a pixel, or of the ellipse, is nothing.
_LEAST = 1e-9
# Pixels looked at together: what is made on the way fits into the processor's cache.
_TOGETHER = 4096


@dataclass
class Ellipses:
    """Ellipses ``center + a cos φ + b sin φ``, in pixels; complex arrays of shape (n,)."""

    center: np.ndarray
    a: np.ndarray
    b: np.ndarray

    def coverage(
        self, pixels: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return which ellipse, x, y and the covered part of all pixels that are touched.

        Where the centre is NaN there is none.
        """
        c, across = self.center, np.hypot(self.a.real, self.b.real)
        along = np.hypot(self.a.imag, self.b.imag)
        owner, x, y = window_pixels(
            c.real - across, c.real + across, c.imag - along, c.imag + along, pixels
        )
        pixels_of, covered = self._pixels(), np.empty(len(owner))
        for first in range(0, len(owner), _TOGETHER):
            part = slice(first, first + _TOGETHER)
            covered[part] = pixels_of.covered(owner[part], x[part], y[part])
        some = np.flatnonzero(covered > pixels_of.least.take(owner))
        return owner.take(some), x.take(some), y.take(some), covered.take(some)

    def _pixels(self) -> _Pixels:
        with np.errstate(invalid="ignore", divide="ignore"):
            right, up = self._turned(np.array([1.0, 1.0j])[:, None])
            corners = self._turned(_CORNERS[:, None])
        x, y = self.center.real.copy(), self.center.imag.copy()
        return _Pixels(x, y, right, up, corners, cross(self.a, self.b))

    def _turned(self, way: np.ndarray) -> np.ndarray:
        a, b = self.a, self.b
        return np.asarray((cross(way, b) + 1j * cross(a, way)) / cross(a, b))

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return how far points are from the centres: 1 on the ellipse; NaN for none."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.abs(self._turned(points - self.center))


@dataclass
class _Pixels:
    """Pixels as they are where ellipses are unit circles, one per ellipse of centre x and y."""

    x: np.ndarray
    y: np.ndarray
    right: np.ndarray
    up: np.ndarray
    corners: np.ndarray
    size: np.ndarray

    def __post_init__(self) -> None:
        self.reach = np.max(np.abs(self.corners[:2]), axis=0)
        self.least = _LEAST * np.minimum(np.abs(self.size), 1.0)

    def covered(self, owner: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        place = (x - self.x.take(owner)) * self.right.take(owner)
        place += (y - self.y.take(owner)) * self.up.take(owner)
        distance, reach = np.abs(place), self.reach.take(owner)
        found = np.where(distance + reach <= 1.0, 1.0, 0.0)
        edge = np.flatnonzero((distance + reach > 1.0) & (distance - reach < 1.0))
        owner = owner.take(edge)
        area = disc_in_polygon(place.take(edge) + self.corners.take(owner, axis=1))
        # Corners run clockwise where b is to the right of a: both signs turn.
        found[edge] = np.clip(area * self.size.take(owner), 0.0, 1.0)
        return found


def disc_in_polygon(corners: np.ndarray) -> np.ndarray:
    """Return the area of the unit disc within polygons, positive if corners run anticlockwise.

    Each side makes a triangle with the centre; the disc is a triangle between two sectors of it.
    Places on a side count from the foot of the perpendicular from the centre.

    Parameters
    ----------
    corners : complex array, shape (k, n)
        One polygon per column.
    """
    side = np.roll(corners, -1, axis=0) - corners
    length = np.abs(side)
    distance = cross(corners, side) / length
    begin = (corners.real * side.real + corners.imag * side.imag) / length
    end = begin + length
    reach = np.sqrt(np.maximum(1.0 - distance**2, 0.0))
    # Nothing is between them where the side misses the disc.
    first, last = np.clip(-reach, begin, end), np.clip(reach, begin, end)
    square, inner = distance**2, distance * (last - first)
    sectors = np.arctan2(distance * length, square + begin * end)
    sectors -= np.arctan2(inner, square + first * last)
    return np.asarray(0.5 * np.sum(inner + sectors, axis=0))


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the signed area between two vectors."""
    return np.asarray(a.real * b.imag - a.imag * b.real)
