"""A part of an image: what counts of each pixel."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from ..units import plain
from .shapes import polygon_of

# A pixel that a polygon cuts is looked at in so many places along each axis.
_FINE = 16
# Sides of polygons pass through pixels that they touch but for rounding, in pixels.
_SLACK = 1e-6


class Aperture:
    """What counts of an image: all of it (None), a polygon, or a number for each pixel.

    Polygons may be texts, such as ``"circle((0, 0), 0.5 pc)"``; see `polygon_of`.

    Raises
    ------
    InputError
        If it is neither, or has not the image's shape.
    """

    def __init__(self, aperture: Any, frame: Any, unit: Any) -> None:
        self.frame = frame
        shape = frame.pixels[::-1]
        self.polygon: np.ndarray | None = None
        self.counts: np.ndarray | None = None
        if aperture is None:
            return
        if isinstance(aperture, str):
            aperture = polygon_of(aperture, unit)
        array = np.asarray(plain(aperture, unit, "aperture"))
        if array.shape == shape:
            if not np.all((array >= 0) & (array <= 1)):  # nor NaN
                raise InputError("aperture counts from 0 to 1 of each pixel, or is true or false")
            self.counts = array
        elif array.ndim == 2 and array.shape[1] == 2 and len(array) > 2:
            if not np.all(np.isfinite(array)):
                raise InputError("the corners of an aperture must be finite numbers")
            self.polygon = array
        else:
            raise InputError(
                "aperture must be a polygon, shape (n, 2) with n > 2, or have the image's shape "
                f"{shape}, got shape {array.shape}"
            )

    def weights(self) -> np.ndarray:
        """Return what counts of each pixel, shape (ny, nx)."""
        if self.counts is not None:
            return self.counts
        if self.polygon is None:
            return np.ones(self.frame.pixels[::-1])
        return self._covered(self.polygon)

    def _covered(self, polygon: np.ndarray) -> np.ndarray:
        from matplotlib.path import Path

        x, y = np.meshgrid(*self.frame.coordinates())
        outline, size = Path(polygon), np.array(self.frame.pixel)
        centers = np.stack([x, y], axis=-1)
        parts = outline.contains_points(centers.reshape(-1, 2)).reshape(x.shape).astype(float)
        cut = _cut((polygon - centers[0, 0]) / size + 0.5, self.frame.pixels)
        steps = (np.arange(_FINE) + 0.5) / _FINE - 0.5
        within = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2) * size
        points = centers[cut][:, None] + within
        inside = outline.contains_points(points.reshape(-1, 2))
        parts[cut] = inside.reshape(-1, _FINE**2).mean(axis=1)
        return parts


def _cut(polygon: np.ndarray, pixels: tuple[int, int]) -> np.ndarray:
    """Return which pixels (ny, nx), of size one from zero on, a polygon's sides pass through."""
    nx, ny = pixels
    (ax, ay), (bx, by) = (part.T[..., None] for part in (polygon, np.roll(polygon, -1, axis=0)))
    row = np.arange(ny)
    # Where a side enters and leaves a row of pixels; a level one is there from end to end.
    low, high = np.minimum(ay, by), np.maximum(ay, by)
    ends = [np.clip(row + side, low, high) for side in (0, 1)]
    rise = np.where(ay == by, 1.0, by - ay)
    place = [
        np.where(ay == by, level, ax + (y - ay) / rise * (bx - ax))
        for level, y in zip((ax, bx), ends, strict=True)
    ]
    there = (low <= row + 1 + _SLACK) & (high >= row - _SLACK)
    first = np.clip(np.floor(np.minimum(*place) - _SLACK), 0, nx).astype(int)
    last = np.clip(np.floor(np.maximum(*place) + _SLACK) + 1, 0, nx).astype(int)
    count, rows = np.zeros((ny, nx + 1), int), np.broadcast_to(row, there.shape)
    np.add.at(count, (rows[there], first[there]), 1)
    np.add.at(count, (rows[there], last[there]), -1)
    return count[:, :nx].cumsum(axis=1) > 0
