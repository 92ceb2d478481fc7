"""Which ray: a pixel, or a point of the image plane."""

from __future__ import annotations

import numbers
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError
from ...units import plain


@dataclass(frozen=True)
class Place:
    """A point of the image plane, and the pixel that it is in or next to.

    Attributes
    ----------
    pixel : (int, int)
        ix, iy.
    offset : (float, float)
        From the pixel's centre, in pixels.
    at : (float, float)
        Image-plane coordinates.
    """

    pixel: tuple[int, int]
    offset: tuple[float, float]
    at: tuple[float, float]

    @classmethod
    def of(cls, pixel: Any, at: Any, frame: Any, unit: Any) -> Place:
        """Return what a user asks for: one of the two.

        Parameters
        ----------
        unit : unit or None
            Of the image plane.

        Raises
        ------
        InputError
            If both or none are given, or there is no such pixel.
        UnitsError
            If `at` is in a unit that does not fit.
        """
        if (pixel is None) == (at is None):
            raise InputError("say which ray: pixel=(ix, iy), or at=(u, v) on the image plane")
        if pixel is not None:
            ix, iy = _checked(pixel, frame.pixels)
            u, v = (float(c[i]) for c, i in zip(frame.coordinates(), (ix, iy), strict=True))
            return cls((ix, iy), (0.0, 0.0), (u, v))
        u, v = _point(at, unit)
        steps = zip((u, v), frame.shift, frame.pixel, frame.pixels, strict=True)
        x, y = ((c - shift) / step + 0.5 * (n - 1) for c, shift, step, n in steps)
        ix, iy = (
            int(np.clip(np.floor(c + 0.5), 0, n - 1))
            for c, n in zip((x, y), frame.pixels, strict=True)
        )
        return cls((ix, iy), (x - ix, y - iy), (u, v))


def _checked(pixel: Any, pixels: tuple[int, int]) -> tuple[int, int]:
    listed = isinstance(pixel, (list, tuple)) or np.ndim(pixel) == 1
    pair = tuple(pixel) if listed and len(pixel) == 2 else ()
    whole = all(isinstance(i, numbers.Integral) for i in pair)
    if not pair or not whole or not all(0 <= i < n for i, n in zip(pair, pixels, strict=True)):
        raise InputError(
            "pixel must be two whole numbers (ix, iy), counted from 0 at the lower left corner of "
            f"the image of {pixels[0]} x {pixels[1]} pixels, got {pixel!r}"
        )
    return int(pair[0]), int(pair[1])


def _point(at: Any, unit: Any) -> tuple[float, float]:
    point = np.asarray(plain(at, unit, "at"))
    if point.shape != (2,) or not np.all(np.isfinite(point)):
        raise InputError(f"at must be two finite numbers (u, v) on the image plane, got {at!r}")
    return float(point[0]), float(point[1])
