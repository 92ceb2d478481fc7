"""Parts of space, to measure in: boxes, spheres, cylinders, double cones, and combinations.

Lengths are Quantities, or plain numbers in the volume's unit.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .errors import InputError
from .units import as_given, is_quantity, plain, unit_of
from .value import Value


class Region(Value):
    """A part of space. Regions combine with ``&`` (both), ``|`` (either) and ``~`` (outside)."""

    def inside(self, points: np.ndarray, unit: Any) -> np.ndarray:
        """Return which points are inside.

        Parameters
        ----------
        points : array, shape (3, n)
        unit : astropy unit or None
            Of their coordinates.

        Returns
        -------
        array of bool, shape (n,)
        """
        raise NotImplementedError

    def beyond(self, points: np.ndarray, unit: Any) -> np.ndarray:
        """Return how far outside points are at least; negative inside: at least how deep.

        Cells that are larger than a region, or a part of it, are found by it. Without this method
        a region is looked for at the cells' corners and middles.

        Parameters
        ----------
        points, unit
            See `inside`.

        Returns
        -------
        float64 array, shape (n,)
        """
        return np.full(np.shape(points)[1], np.inf)

    def __and__(self, other: Region) -> Region:
        return _Combined(np.logical_and, np.maximum, self, other)

    def __or__(self, other: Region) -> Region:
        return _Combined(np.logical_or, np.minimum, self, other)

    def __invert__(self) -> Region:
        return _Outside(self)


class _Combined(Region):
    def __init__(self, rule: Any, farther: Any, first: Region, second: Region) -> None:
        for part in (first, second):
            if not isinstance(part, Region):
                raise InputError(f"a region combines with another region, got {part!r}")
        self.rule, self.farther, self.first, self.second = rule, farther, first, second

    def inside(self, points: np.ndarray, unit: Any) -> np.ndarray:
        found: np.ndarray = self.rule(
            self.first.inside(points, unit), self.second.inside(points, unit)
        )
        return found

    def beyond(self, points: np.ndarray, unit: Any) -> np.ndarray:
        found: np.ndarray = self.farther(
            self.first.beyond(points, unit), self.second.beyond(points, unit)
        )
        return found


class _Outside(Region):
    def __init__(self, region: Region) -> None:
        self.region = region

    def inside(self, points: np.ndarray, unit: Any) -> np.ndarray:
        return ~self.region.inside(points, unit)

    def beyond(self, points: np.ndarray, unit: Any) -> np.ndarray:
        return -self.region.beyond(points, unit)


class Box(Region):
    """What is between two corners.

    Parameters
    ----------
    low, high : three floats or Quantity
    """

    def __init__(self, low: Any, high: Any) -> None:
        self.low, self.high = _point(low, "low"), _point(high, "high")
        if _alike(low, high):  # else it depends on the volume's unit
            self._corners(unit_of(low))

    def _corners(self, unit: Any) -> tuple[np.ndarray, np.ndarray]:
        low, high = plain(self.low, unit, "low"), plain(self.high, unit, "high")
        if not np.all(low < high):
            raise InputError(
                f"low must be below high along all axes, got {self.low} and {self.high}"
            )
        return low, high

    def inside(self, points: np.ndarray, unit: Any) -> np.ndarray:
        low, high = (corner[:, None] for corner in self._corners(unit))
        return np.all((points >= low) & (points <= high), axis=0)

    def beyond(self, points: np.ndarray, unit: Any) -> np.ndarray:
        low, high = (corner[:, None] for corner in self._corners(unit))
        return np.asarray(np.maximum(low - points, points - high).max(axis=0))


class Sphere(Region):
    """What is within a distance of a point.

    Parameters
    ----------
    center : three floats or Quantity
    radius : float or Quantity
    """

    def __init__(self, center: Any, radius: Any) -> None:
        self.center, self.radius = _point(center, "center"), _length(radius, "radius")

    def inside(self, points: np.ndarray, unit: Any) -> np.ndarray:
        away = points - plain(self.center, unit, "center")[:, None]
        limit = plain(self.radius, unit, "radius")
        return np.asarray(np.einsum("an,an->n", away, away) <= limit**2)

    def beyond(self, points: np.ndarray, unit: Any) -> np.ndarray:
        away = points - plain(self.center, unit, "center")[:, None]
        return np.asarray(np.linalg.norm(away, axis=0) - plain(self.radius, unit, "radius"))


class Cylinder(Region):
    """What is within a distance of a line between two points.

    Parameters
    ----------
    start, end : three floats or Quantity
        The middles of its ends.
    radius : float or Quantity
    """

    def __init__(self, start: Any, end: Any, radius: Any) -> None:
        self.start, self.end = _point(start, "start"), _point(end, "end")
        self.radius = _length(radius, "radius")
        if _alike(start, end):  # else it depends on the volume's unit
            self._ends(unit_of(start))

    def _ends(self, unit: Any) -> tuple[np.ndarray, np.ndarray]:
        start, end = plain(self.start, unit, "start"), plain(self.end, unit, "end")
        if np.array_equal(start, end):
            raise InputError(f"start and end of a cylinder must differ, got {self.start} twice")
        return start, end

    def inside(self, points: np.ndarray, unit: Any) -> np.ndarray:
        start, end = self._ends(unit)
        height, across = _along(points, start, end - start)
        between = (height >= 0) & (height <= np.linalg.norm(end - start))
        return between & (across <= plain(self.radius, unit, "radius"))

    def beyond(self, points: np.ndarray, unit: Any) -> np.ndarray:
        start, end = self._ends(unit)
        height, across = _along(points, start, end - start)
        above = np.maximum(-height, height - np.linalg.norm(end - start))
        return np.asarray(np.maximum(above, across - plain(self.radius, unit, "radius")))


class DoubleCone(Region):
    """Two cones with one apex: the lobes of an outflow.

    Parameters
    ----------
    apex : three floats or Quantity
    axis : three floats
        Any vector along it.
    opening : float or Quantity
        The angle between axis and surface; plain numbers are degrees.
    height : float or Quantity, optional
        How far each of them goes; by default they never end.
    side : {"both", "up", "down"}
        Both lobes, or the one towards or away from `axis`.
    """

    def __init__(
        self, apex: Any, axis: Any, opening: Any, height: Any = None, side: str = "both"
    ) -> None:
        from .units import degrees

        self.apex, self.axis = _point(apex, "apex"), plain(_point(axis, "axis"), None, "axis")
        self.opening = degrees(opening, "opening")
        self.height = None if height is None else _length(height, "height")
        if not np.any(self.axis):
            raise InputError("axis must be a vector that is not zero")
        if not 0 < self.opening <= 90:
            raise InputError(f"opening must be an angle up to 90 degrees, got {opening!r}")
        if side not in ("both", "up", "down"):
            raise InputError(f"side must be 'both', 'up' or 'down', got {side!r}")
        self.side = side

    def inside(self, points: np.ndarray, unit: Any) -> np.ndarray:
        height, across = _along(points, plain(self.apex, unit, "apex"), self.axis)
        cosine = np.cos(np.radians(self.opening)) * np.hypot(height, across)
        found = np.abs(height) >= cosine
        if self.height is not None:
            found &= np.abs(height) <= plain(self.height, unit, "height")
        if self.side != "both":
            found &= (height >= 0) == (self.side == "up")
        return np.asarray(found)

    def beyond(self, points: np.ndarray, unit: Any) -> np.ndarray:
        height, across = _along(points, plain(self.apex, unit, "apex"), self.axis)
        height = {"both": np.abs(height), "up": height, "down": -height}[self.side]
        angle = np.radians(self.opening)
        found = across * np.cos(angle) - height * np.sin(angle)
        if self.height is not None:
            found = np.maximum(found, height - plain(self.height, unit, "height"))
        return np.asarray(found)


def _along(points: np.ndarray, origin: np.ndarray, axis: np.ndarray) -> tuple[Any, Any]:
    away, axis = points - origin[:, None], axis / np.linalg.norm(axis)
    height = axis @ away
    return height, np.linalg.norm(away - axis[:, None] * height, axis=0)


def _alike(first: Any, second: Any) -> bool:
    return (unit_of(first) is None) == (unit_of(second) is None)


def _point(value: Any, what: str) -> Any:
    unit = unit_of(value)
    array = np.asarray(plain(value, unit, what))
    if array.shape != (3,) or not np.all(np.isfinite(array)):
        raise InputError(f"{what} must be three finite numbers, got {value!r}")
    return array if unit is None else array * unit


def _length(value: Any, what: str) -> Any:
    value = as_given(value, what)
    number = plain(value, unit_of(value), what)
    if np.ndim(number) or not 0 < number < np.inf:
        raise InputError(f"{what} must be positive, got {value!r}")
    return value if is_quantity(value) else number
