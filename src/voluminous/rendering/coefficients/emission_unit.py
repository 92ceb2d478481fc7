"""Emission in a unit of its own, a power of two: single precision holds it, and no bits change."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def unit_near(size: float) -> float:
    """Return a power of two near a size, so that no bits change; one where there is no size."""
    if not 0.0 < size < np.inf:
        return 1.0
    return 2.0 ** float(np.clip(np.round(np.log2(size)), -1000, 1000))


def fits_single(size: float) -> bool:
    """Return True if single precision holds numbers of a size, and much smaller and larger ones."""
    return size == 0.0 or 2.0**-90 < size < 2.0**90


def in_units_of(unit: float, values: np.ndarray) -> np.ndarray:
    """Return values times a unit: in double precision where single may not hold them."""
    if unit == 1.0:
        return values
    return values * (values.dtype.type(unit) if fits_single(unit) else np.float64(unit))


def before(background: np.ndarray, emission: np.ndarray, through: np.ndarray) -> np.ndarray:
    """Return what is seen before a background, in double precision where single may not hold it."""
    total: np.ndarray = emission + through * background
    fits = fits_single(float(np.max(np.abs(background))))
    return total.astype(emission.dtype) if fits else total


def channels_last(planes: Sequence[np.ndarray]) -> np.ndarray:
    """Return planes side by side along a last axis.

    One assignment each: 1 ms for three of 800 × 800, where `numpy.stack` takes 4.
    """
    if len(planes) == 1:
        return planes[0][..., None]
    result = np.empty((*planes[0].shape, len(planes)), planes[0].dtype)
    for c, plane in enumerate(planes):
        result[..., c] = plane
    return result
