"""Parts of images to measure in, and texts such as ``circle((0, 0), 1 pc)``."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..cameras import Frame
from ..errors import InputError
from ..regions import read_shape
from ..units import Unit, plain

# Corners of the polygon that represents a circle, of equal area; its radius is accurate to 1e-4.
_CORNERS = 180


def polygon_of(text: str, unit: Unit) -> np.ndarray:
    """Return the polygon, shape (n, 2), on the image plane that a text describes.

    ``circle(center, radius)``, ``rectangle(low, high)`` or ``polygon(point, point, …)``, such as
    ``"circle((0, 0), 0.5 pc)"``; in `unit`, which numbers without one are in.
    """

    def plane(point: Any) -> np.ndarray:
        array = np.asarray(plain(point, unit, "point"))
        if array.shape != (2,) or not np.all(np.isfinite(array)):
            raise InputError(f"a point on the image plane is two numbers, got {point}")
        return array

    def circle(center: Any, radius: Any) -> np.ndarray:
        size = plain(radius, unit, "radius")
        if np.ndim(size) or not 0 < size < np.inf:
            raise InputError(f"radius of a circle must be positive, got {radius}")
        step = 2 * np.pi / _CORNERS
        angle = step * np.arange(_CORNERS)
        corner = size * np.sqrt(step / np.sin(step))
        around: np.ndarray = corner * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        around += plane(center)
        return around

    def rectangle(low: Any, high: Any) -> np.ndarray:
        (x0, y0), (x1, y1) = plane(low), plane(high)
        if not (x0 < x1 and y0 < y1):
            raise InputError(f"low must be below high along both axes, got {low} and {high}")
        return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])

    def polygon(*points: Any) -> np.ndarray:
        if len(points) < 3:
            raise InputError(f"a polygon has three points or more, got {points}")
        return np.array(list(map(plane, points)))

    shapes = {"circle": circle, "rectangle": rectangle, "polygon": polygon}
    corners: np.ndarray = read_shape(text, "aperture", shapes)
    return corners


# A pixel that a polygon cuts is sampled at so many places along each axis.
_FINE = 16
# Sides of polygons pass through pixels that they touch but for rounding, in pixels.
_SLACK = 1e-6


def aperture_weights(aperture: Any, frame: Frame, unit: Unit) -> np.ndarray:
    """Return what counts of each pixel, shape (ny, nx): from all of it to a polygon or its text."""
    shape = frame.pixels[::-1]
    if aperture is None:
        return np.ones(shape)
    if isinstance(aperture, str):
        aperture = polygon_of(aperture, unit)
    array = np.asarray(plain(aperture, unit, "aperture"))
    if array.shape == shape:
        if not np.all((array >= 0) & (array <= 1)):  # nor NaN
            raise InputError("aperture counts from 0 to 1 of each pixel, or is true or false")
        return array
    if array.ndim != 2 or array.shape[1] != 2 or len(array) < 3:
        raise InputError(
            "aperture must be a polygon, shape (n, 2) with n > 2, or have the image's shape "
            f"{shape}, got shape {array.shape}"
        )
    if not np.all(np.isfinite(array)):
        raise InputError("the corners of an aperture must be finite numbers")
    from matplotlib.path import Path

    outline, size = Path(array), np.array(frame.pixel)
    centers = np.stack(np.meshgrid(*frame.coordinates()), axis=-1)
    weights = outline.contains_points(centers.reshape(-1, 2)).reshape(shape).astype(float)
    cut = _cut((array - centers[0, 0]) / size + 0.5, frame.pixels)
    steps = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    within = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2) * size
    points = centers[cut][:, None] + within
    weights[cut] = outline.contains_points(points.reshape(-1, 2)).reshape(-1, _FINE**2).mean(axis=1)
    return weights


def _cut(polygon: np.ndarray, pixels: tuple[int, int]) -> np.ndarray:
    """Return which pixels (ny, nx) the sides of a polygon pass through; pixels have size 1."""
    nx, ny = pixels
    (ax, ay), (bx, by) = (part.T[..., None] for part in (polygon, np.roll(polygon, -1, axis=0)))
    row = np.arange(ny)
    # Where a side enters and leaves a row of pixels; a level one is there from end to end.
    low, high = np.minimum(ay, by), np.maximum(ay, by)
    rise = np.where(ay == by, 1.0, by - ay)
    place = [
        np.where(ay == by, level, ax + (np.clip(row + side, low, high) - ay) / rise * (bx - ax))
        for level, side in ((ax, 0), (bx, 1))
    ]
    there = (low <= row + 1 + _SLACK) & (high >= row - _SLACK)
    first = np.clip(np.floor(np.minimum(*place) - _SLACK), 0, nx).astype(int)
    last = np.clip(np.floor(np.maximum(*place) + _SLACK) + 1, 0, nx).astype(int)
    count, rows = np.zeros((ny, nx + 1), int), np.broadcast_to(row, there.shape)
    np.add.at(count, (rows[there], first[there]), 1)
    np.add.at(count, (rows[there], last[there]), -1)
    return count[:, :nx].cumsum(axis=1) > 0
