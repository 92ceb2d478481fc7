"""How much of a pixel a straight strip covers: exact for one whose ends are far away."""

from __future__ import annotations

import numpy as np

# A pixel's shadow is a trapezium; along an axis its flanks are upright, here nearly so.
_UPRIGHT = 1e-5


def strip_coverage(distance: np.ndarray, normal: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Return the parts of pixels of side 1 that lie in strips.

    Parameters
    ----------
    distance : array, shape (n,)
        From the pixel's centre to the middle of the strip.
    normal : array, shape (n, 2)
        Unit vectors across the strips.
    width : array, shape (n,)
    """
    large = np.max(np.abs(normal), axis=1)
    small = np.maximum(np.min(np.abs(normal), axis=1), _UPRIGHT)
    half = 0.5 * width
    part = _below(distance + half, large, small) - _below(distance - half, large, small)
    return np.asarray(np.clip(part, 0.0, 1.0))


def _below(place: np.ndarray, large: np.ndarray, small: np.ndarray) -> np.ndarray:
    """Return the area of a square of side 1 below a line at a distance from its centre.

    The square's extent along the normal is the sum of two uniform distributions, of the widths
    `large` and `small`: their distribution function is a second difference of squares.
    """
    outer, inner = 0.5 * (large + small), 0.5 * (large - small)
    squares = [np.maximum(place + edge, 0.0) ** 2 for edge in (outer, inner, -inner, -outer)]
    area = (squares[0] - squares[1] - squares[2] + squares[3]) / (2.0 * large * small)
    return np.where(place >= outer, 1.0, area)  # not but for rounding


def nearest_on_segments(
    points: np.ndarray, begin: np.ndarray, end: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the distances (n,) from points to segments in a plane, and unit vectors across.

    Beyond an end these point away from it: ends are round.
    """
    side, away = end - begin, points - begin
    square = np.sum(side**2, axis=1)
    part = np.sum(away * side, axis=1) / np.where(square > 0.0, square, 1.0)
    off = away - np.clip(part, 0.0, 1.0)[:, None] * side
    distance = np.hypot(*off.T)
    length = np.sqrt(np.where(square > 0.0, square, 1.0))[:, None]
    across = np.stack([-side[:, 1], side[:, 0]], axis=1) / length
    across = np.where((square > 0.0)[:, None], across, [1.0, 0.0])
    outward = off / np.where(distance > 0.0, distance, 1.0)[:, None]
    return distance, np.where((distance > 1e-9)[:, None], outward, across)
