"""The mean column of a box over a pixel, by slices: an independent, slow way."""

from __future__ import annotations

import itertools

import numpy as np

_GAUSS = np.array([-1.0, 1.0]) / np.sqrt(3.0)


def mean_column(axes, center, size, low, high):
    """Return the part of a box whose shadow is in the rectangle from `low` to `high`.

    Slices of constant z are parallelograms that move evenly with z: what they share with the
    rectangle is a quadratic between the z at which a corner of one crosses a line of the other, and
    two points of Gauss integrate it.

    Parameters
    ----------
    axes : array, shape (2, 3)
        From space to the plane.
    """
    faces = np.abs(np.linalg.det([np.delete(axes, k, 1) for k in range(3)]))
    order = [*np.delete(range(3), np.argmax(faces)), np.argmax(faces)]
    axes, center, size = axes[:, order], center[order], size[order]
    places = _breaks(axes, center, size, low, high)
    total = 0.0
    for a, b in itertools.pairwise(places):
        for g in _GAUSS:
            z = 0.5 * (a + b) + 0.5 * (b - a) * g
            total += 0.5 * (b - a) * _area(_slice(axes, center, size, z), low, high)
    face = abs(np.linalg.det(axes[:, :2])) * size[0] * size[1]
    return total / (face * size[2])


def _slice(axes, center, size, z):
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.5 * size[:2]
    middle = axes[:, :2] @ center[:2] + axes[:, 2] * z
    return middle + corners @ axes[:, :2].T


def _breaks(axes, center, size, low, high):
    first, last = center[2] - 0.5 * size[2], center[2] + 0.5 * size[2]
    found, way = [first, last], axes[:, 2]
    start = _slice(axes, center, size, 0.0)
    for corner in start:
        for a in range(2):
            if abs(way[a]) > 1e-14:
                found += [(line[a] - corner[a]) / way[a] for line in (low, high)]
    for k in range(4):
        edge = start[(k + 1) % 4] - start[k]
        pace = edge[0] * way[1] - edge[1] * way[0]
        if abs(pace) > 1e-14:
            for corner in [(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])]:
                away = np.asarray(corner) - start[k]
                found.append((edge[0] * away[1] - edge[1] * away[0]) / pace)
    return np.unique(np.clip(found, first, last))


def _area(polygon, low, high):
    """Return the area that a polygon shares with a rectangle (Sutherland & Hodgman 1974)."""
    points = list(polygon)
    for a, sign, limit in ((0, 1, low[0]), (0, -1, high[0]), (1, 1, low[1]), (1, -1, high[1])):
        kept = []
        for p, q in zip(points, points[1:] + points[:1], strict=True):
            dp, dq = sign * (p[a] - limit), sign * (q[a] - limit)
            if dp >= 0:
                kept.append(p)
            if dp * dq < 0:
                kept.append(p + (q - p) * (dp / (dp - dq)))
        points = kept
    if len(points) < 3:
        return 0.0
    x, y = np.array(points).T
    return 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
