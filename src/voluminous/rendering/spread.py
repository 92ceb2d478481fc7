"""Points of light on pixels: in one, or spread over a Gaussian."""

from __future__ import annotations

import math

import numpy as np

from ..objects.contract import REACH, Points

_PLACES = np.linspace(-REACH, REACH, (1 << 14) + 1)
_BELOW = np.array([0.5 * math.erf(z / math.sqrt(2.0)) for z in _PLACES]) / math.erf(
    REACH / math.sqrt(2.0)
)


def spread(points: Points, pixels: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the pixels that points light, which point does, and the part of its flux.

    Arrays of shape (n,).
    """
    x, share = _shares(points.x, float(points.sigma[0]))
    y, other = _shares(points.y, float(points.sigma[1]))
    weight = other[:, :, None] * share[:, None]
    inside = ((y >= 0) & (y < pixels[1]))[:, :, None] & ((x >= 0) & (x < pixels[0]))[:, None]
    owner, row, column = np.nonzero(inside & (weight > 0.0))
    pixel = y[owner, row] * pixels[0] + x[owner, column]
    return pixel, owner, weight[owner, row, column]


def _shares(place: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels in one dimension, and the part of each point's flux, shape (n, k) each."""
    nearest = np.floor(place + 0.5).astype(np.int64)[:, None]
    if sigma == 0.0:
        return nearest, np.ones(nearest.shape)
    reach = math.ceil(REACH * sigma)
    edges = np.arange(-reach, reach + 2) - 0.5 + (nearest - place[:, None])
    below = np.interp(edges / sigma, _PLACES, _BELOW)
    return nearest + np.arange(-reach, reach + 1), np.diff(below, axis=1)
