"""A part of an image: what counts of each pixel."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from ..units import plain

# A pixel that a polygon cuts is looked at in so many places along each axis.
_FINE = 16


class Aperture:
    """What counts of an image: all of it (None), a polygon, or a number for each pixel.

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
        array = np.asarray(plain(aperture, unit, "aperture"))
        if array.shape == shape:
            if array.min() < 0 or array.max() > 1:
                raise InputError("aperture counts from 0 to 1 of each pixel, or is true or false")
            self.counts = array
        elif array.ndim == 2 and array.shape[1] == 2 and len(array) > 2:
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
        """Return the parts of pixels that are inside of a polygon."""
        from matplotlib.path import Path

        nx, ny = self.frame.pixels
        x, y = (
            (c[:, None] + ((np.arange(_FINE) + 0.5) / _FINE - 0.5) * step).ravel()
            for c, step in zip(self.frame.coordinates(), self.frame.pixel, strict=True)
        )
        outline, rows = Path(polygon), np.empty((ny, nx))
        for j in range(ny):
            lines = np.meshgrid(x, y[j * _FINE : (j + 1) * _FINE])
            inside = outline.contains_points(np.stack(lines, axis=-1).reshape(-1, 2))
            rows[j] = inside.reshape(_FINE, nx, _FINE).mean(axis=(0, 2))
        return rows
