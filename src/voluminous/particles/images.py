"""Particles near the walls of a periodic domain appear again beyond the opposite ones."""

from __future__ import annotations

import itertools

import numpy as np

from .base import Base


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
    shifts = itertools.product((0, -1, 1), repeat=3) if base.periodic else [(0, 0, 0)]
    found, owners = [], []
    for shift in shifts:
        moved = points + np.array(shift) * np.ptp(base.bounds, axis=1)
        owner = np.flatnonzero(reaching(base, moved, reach))
        found.append(moved[owner])
        owners.append(owner)
    return np.concatenate(found), np.concatenate(owners)


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
