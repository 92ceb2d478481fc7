"""Particles near the walls of a periodic domain appear again beyond the opposite ones."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from ..memory import check_memory
from .base import Base

# Memory that an image takes: its place, whose it is, in which cell it lies.
_IMAGE_BYTES = 100


def with_images(base: Base, points: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points that reach into the domain, and which particle each of them is.

    Parameters
    ----------
    base : Base
        Of a periodic one the points are in it.
    points : array, shape (n, 3)
    reach : array, shape (n,)

    Returns
    -------
    points : array, shape (m, 3)
        Those that reach into the domain; of a periodic one with their images that do.
    owner : array of int64, shape (m,)
    """
    size = np.ptp(base.bounds, axis=1)
    found, owners = [], []
    for shift in _shifts(base, reach):
        # From so many boxes away only particles come that reach over all of those in between.
        owner = np.flatnonzero(reach > ((np.abs(shift) - 1) * size).max())
        moved = points[owner] + shift * size
        near = reaching(base, moved, reach[owner])
        found.append(moved[near])
        owners.append(owner[near])
    return np.concatenate(found), np.concatenate(owners)


def _shifts(base: Base, reach: np.ndarray) -> Iterator[np.ndarray]:
    if not base.periodic:
        return iter([np.zeros(3)])
    size = np.ptp(base.bounds, axis=1)
    images = int(np.prod(1 + 2 * reach[:, None] / size, axis=1).sum())
    advice = "smoothing lengths are many times as long as the periodic box; check their unit"
    check_memory(_IMAGE_BYTES * images, f"{images} images of particles", advice)
    most = np.maximum(np.ceil(reach.max() / size), 1).astype(int)
    every = itertools.product(*(range(-n, n + 1) for n in most))
    return map(np.array, sorted(every, key=lambda shift: sum(map(abs, shift))))


def reaching(base: Base, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return which spheres around points touch the domain."""
    low, high = base.bounds.T
    away = np.maximum(np.maximum(low - points, points - high), 0.0)
    touched: np.ndarray = (away * away).sum(axis=1) < reach * reach
    return touched | base.inside(points)


def crossing(base: Base, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return which spheres around points reach over a wall of the domain."""
    low, high = base.bounds.T
    margin = np.minimum(points - low, high - points).min(axis=1)
    over: np.ndarray = margin < reach
    return over
