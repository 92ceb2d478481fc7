"""The shapes that texts can name: regions in space, and parts of the image plane."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import InputError
from ..regions import Box, Cylinder, DoubleCone, Region, Sphere
from ..units import plain
from .shape_text import ShapeReader

# Of the polygon that a circle is drawn as, which has its area; the radius is true to 1e-4.
_CORNERS = 180


def region_of(text: str) -> Region:
    """Return the region that a text describes.

    Parameters
    ----------
    text : str
        Such as ``"sphere((0, 0, 0), 100 AU) & ~box((-1, -1, 0) pc, (1, 1, 2) pc)"``: the classes
        of `voluminous.regions` in small letters, and ``cone``, one half of a double cone. Units
        follow numbers or points; numbers without are in the volume's unit.

    Raises
    ------
    InputError
        If it cannot be understood; UnknownNameError names the nearest shape or argument.
    """
    reader = ShapeReader(text, "region", _REGIONS)
    return reader.combined(reader.tree())


def polygon_of(text: str, unit: Any) -> np.ndarray:
    """Return the polygon, shape (n, 2), on the image plane that a text describes.

    Parameters
    ----------
    text : str
        ``circle(center, radius)``, ``rectangle(low, high)`` or ``polygon(point, point, …)``, such
        as ``"circle((0, 0), 0.5 pc)"``.
    unit : astropy unit or None
        Of the result, and of numbers without one.

    Raises
    ------
    InputError
        If it cannot be understood; UnknownNameError names the nearest shape or argument.
    """
    reader = ShapeReader(text, "aperture", _APERTURES)
    points = reader.called(reader.tree())
    return np.array([plain(point, unit, "aperture") for point in points(unit)])


def _cone(apex: Any, axis: Any, opening: Any, height: Any = None) -> DoubleCone:
    return DoubleCone(apex, axis, opening, height, side="up")


def _circle(center: Any, radius: Any) -> Callable[[Any], np.ndarray]:
    def points(unit: Any) -> np.ndarray:
        size = plain(radius, unit, "radius")
        if np.ndim(size) or not 0 < size < np.inf:
            raise InputError(f"radius of a circle must be positive, got {radius}")
        step = 2 * np.pi / _CORNERS
        angle = step * np.arange(_CORNERS)
        corner = size * np.sqrt(step / np.sin(step))
        around = corner * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return _plane(center, unit) + around

    return points


def _rectangle(low: Any, high: Any) -> Callable[[Any], np.ndarray]:
    def points(unit: Any) -> np.ndarray:
        (x0, y0), (x1, y1) = _plane(low, unit), _plane(high, unit)
        if not (x0 < x1 and y0 < y1):
            raise InputError(f"low must be below high along both axes, got {low} and {high}")
        return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])

    return points


def _polygon(*points: Any) -> Callable[[Any], np.ndarray]:
    # Points in one pair of parentheses may have one unit.
    given = points[0] if len(points) == 1 and np.ndim(points[0]) else points

    def corners(unit: Any) -> np.ndarray:
        if np.ndim(given[:1]) != 2 or len(given) < 3:
            raise InputError(f"a polygon has three points or more, got {given}")
        return np.array([_plane(point, unit) for point in given])

    return corners


def _plane(point: Any, unit: Any) -> np.ndarray:
    array = np.asarray(plain(point, unit, "point"))
    if array.shape != (2,) or not np.all(np.isfinite(array)):
        raise InputError(f"a point on the image plane is two numbers, got {point}")
    return array


_REGIONS: dict[str, Callable[..., Region]] = {
    "box": Box,
    "sphere": Sphere,
    "cylinder": Cylinder,
    "cone": _cone,
    "doublecone": DoubleCone,
}
_APERTURES = {"circle": _circle, "rectangle": _rectangle, "polygon": _polygon}
