"""Points of light: how much of each comes through, and the pixels that it is added to."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...objects.contract import Layers, PointLights
from .pairs import with_channels
from .spread import spread

if TYPE_CHECKING:
    from ..job import Planes
    from .stretches import Stretches


def seen_through(
    points: PointLights, layers: Layers, drawing: Stretches
) -> tuple[np.ndarray, np.ndarray]:
    """Return how much of each point of light comes through what is in front, and how far it is off.

    Returns
    -------
    array, shape (n, channel or 1)
    array, shape (n, 1) or (n, 0)
        Nothing, if the scheme does not tell.
    """
    nx, ny = drawing.job.frame.pixels
    x, y = (np.clip(np.floor(w + 0.5), 0, n - 1) for w, n in ((points.x, nx), (points.y, ny)))
    pixel = (y * nx + x).astype(np.int64)
    found = drawing.to(pixel, points.x - x, points.y - y, points.depth)
    in_front = _in_front(pixel, points.depth, layers)
    through = with_channels(found.transparency, points.flux.shape[1], 1.0) * in_front
    return through, found.error[:, 1:2] * in_front


def _in_front(pixel: np.ndarray, depth: np.ndarray, layers: Layers) -> np.ndarray:
    """Return what layers in the pixels of points, in front of them, let through, shape (n, 1)."""
    if not len(layers.pixel):
        return np.ones((len(pixel), 1))
    order = np.lexsort((layers.depth, layers.pixel))
    sorted_pixel, sorted_depth = layers.pixel[order], layers.depth[order]
    theta = np.append(1.0 - layers.opacity[order], 1.0)
    first = np.searchsorted(sorted_pixel, pixel)
    # Points and layers in one order: how many layers of all pixels come before each point.
    everything = np.lexsort(
        (np.concatenate([sorted_depth, depth]), np.concatenate([sorted_pixel, pixel]))
    )
    before = np.cumsum(everything < len(order))
    place = np.empty(len(everything), np.int64)
    place[everything] = before
    last = place[len(order) :]
    product = np.multiply.reduceat(theta, np.stack([first, last], axis=1).reshape(-1))[::2]
    return np.where(last > first, product, 1.0)[:, None]


def shine(planes: Planes, points: PointLights, through: np.ndarray, unsure: np.ndarray) -> None:
    """Add points of light to the pixels that they are in, or are spread over; errors likewise."""
    ny, nx, _ = planes.emission.shape
    light, first = spread(points, points.flux * through, (nx, ny))
    rows = slice(first, first + light.shape[1])
    for channel, total in enumerate(light):
        planes.emission[rows, :, channel] += total
    if planes.error is not None and unsure.size:
        brightest = np.abs(points.flux).max(axis=1, keepdims=True)
        wrong, _ = spread(points, brightest * unsure, (nx, ny))
        planes.error[rows] += wrong[0]
