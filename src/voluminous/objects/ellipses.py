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
        place, reach, size = self._rounded(x + 1j * y, owner)
        distance = np.abs(place)
        covered = np.where(distance + reach <= 1.0, 1.0, 0.0)
        edge = np.flatnonzero((distance + reach > 1.0) & (distance - reach < 1.0))
        corners = place[edge] + self._turned(_CORNERS[:, None], owner[edge])
        # Corners run clockwise where b is to the right of a: both signs turn.
        covered[edge] = np.clip(disc_in_polygon(corners) * size[edge], 0.0, 1.0)
        some = np.flatnonzero(covered > _LEAST * np.minimum(np.abs(size), 1.0))
        return owner[some], x[some], y[some], covered[some]

    def _rounded(
        self, pixel: np.ndarray, owner: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the middles of pixels where the ellipse is the unit circle.

        Also half the longest diagonal of pixels there, and twice the area of a and b.
        """
        place = self._turned(pixel - self.center[owner], owner)
        with np.errstate(invalid="ignore", divide="ignore"):
            reach = np.max(np.abs(self._turned(_CORNERS[:2, None], slice(None))), axis=0)
        return place, reach[owner], cross(self.a, self.b)[owner]

    def _turned(self, way: np.ndarray, owner: np.ndarray | slice) -> np.ndarray:
        """Return ways in pixels as ways where the ellipse is the unit circle."""
        a, b = self.a[owner], self.b[owner]
        return np.asarray((cross(way, b) + 1j * cross(a, way)) / cross(a, b))

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return how far points are from the centres: 1 on the ellipse; NaN for none."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.abs(self._turned(points - self.center, slice(None)))


def disc_in_polygon(corners: np.ndarray) -> np.ndarray:
    """Return the area of the unit disc within polygons, positive if corners run anticlockwise.

    Each side makes a triangle with the centre; the disc is a triangle between two sectors of it.

    Parameters
    ----------
    corners : complex array, shape (k, n)
        One polygon per column.
    """
    begin, end = corners, np.roll(corners, -1, axis=0)
    side = end - begin
    square, middle = np.abs(side) ** 2, (begin.conj() * side).real
    root = np.sqrt(np.maximum(middle**2 - square * (np.abs(begin) ** 2 - 1.0), 0.0))
    first, last = (_along(begin, end, (w - middle) / square) for w in (-root, root))
    # The triangle is empty where the side misses the disc.
    sectors = np.angle(begin.conj() * first) + np.angle(last.conj() * end)
    return np.asarray(0.5 * np.sum(cross(first, last) + sectors, axis=0))


def _along(begin: np.ndarray, end: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Return points between two others; exactly these at the ends, which may be the centre."""
    between = begin + np.clip(part, 0.0, 1.0) * (end - begin)
    return np.where(part <= 0.0, begin, np.where(part >= 1.0, end, between))


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the signed area between two vectors."""
    return np.asarray(a.real * b.imag - a.imag * b.real)
