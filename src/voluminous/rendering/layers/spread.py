"""Points of light on pixels: in one, or spread over a Gaussian."""

from __future__ import annotations

import math

import numpy as np

from ...objects.contract import REACH, PointLights

# The integral of a Gaussian, at equal steps: between them it is linear to 1e-8.
_STEPS = 1 << 14
_BELOW = np.array(
    [math.erf(REACH * (2.0 * k / _STEPS - 1.0) / math.sqrt(2.0)) for k in range(_STEPS + 1)]
)
_BELOW *= 0.5 / _BELOW[-1]
_RISE = np.append(np.diff(_BELOW), 0.0)


def spread(
    points: PointLights, flux: np.ndarray, pixels: tuple[int, int]
) -> tuple[np.ndarray, int]:
    """Return what points of light add to some rows of a picture, and which is the first of them.

    Parameters
    ----------
    flux : array, shape (n, channel)
        Of each point, as it is seen.
    pixels : (int, int)
        Size of the picture: what is outside is lost.

    Returns
    -------
    array, shape (channel, rows, nx)
    int
    """
    (nx, ny), (width, height) = pixels, points.sigma.tolist()
    x, share = _shares(points.x, width, nx)
    y, other = _shares(points.y, height, ny)
    first, last = int(y.min(initial=ny)), int(y.max(initial=0))
    count = max(last + 1 - first, 0)
    # Points run fastest, and are many: NumPy is three times slower with the PSF in this place.
    place = ((y - first) * nx)[:, None] + x
    light = [
        np.bincount(place.ravel(), ((f * other)[:, None] * share).ravel(), count * nx)
        for f in np.ascontiguousarray(flux.T)
    ]
    return np.reshape(light, (len(light), count, nx)), first


def _shares(place: np.ndarray, sigma: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels in one dimension, and the part of each point's flux, shape (k, n) each.

    Outside of the picture these are pixels at its edge, with no part.
    """
    nearest, reach = np.floor(place + 0.5), math.ceil(REACH * sigma)
    pixel = nearest.astype(np.int64) + np.arange(-reach, reach + 1)[:, None]
    share = np.ones(pixel.shape) if sigma == 0.0 else _parts(nearest - place, sigma, reach)
    inside = (pixel >= 0) & (pixel < count)
    return np.clip(pixel, 0, count - 1), np.where(inside, share, 0.0)


def _parts(offset: np.ndarray, sigma: float, reach: int) -> np.ndarray:
    """Return the parts of Gaussians in pixels around the one of their middle, shape (k, n)."""
    edges = np.arange(-reach, reach + 2)[:, None] - 0.5 + offset
    step = np.clip((edges / sigma + REACH) * (0.5 * _STEPS / REACH), 0.0, _STEPS)
    number = step.astype(np.int64)
    return np.diff(_BELOW.take(number) + (step - number) * _RISE.take(number), axis=0)
