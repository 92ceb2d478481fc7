"""Parts of space, to measure in: boxes, spheres, cylinders, double cones, and combinations.

Lengths are Quantities, or plain numbers in the volume's unit.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .errors import InputError
from .units import Unit, as_given, degrees, is_quantity, plain, unit_of
from .value import Value


class Region(Value):
    """A part of space. Regions combine with ``&`` (both), ``|`` (either) and ``~`` (outside)."""

    def inside(self, points: np.ndarray, unit: Unit) -> np.ndarray:
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

    def beyond(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        """Return a lower bound of the distance outside; inside minus one of the depth.

        It finds cells that are larger than a region, or a part of it. Without this method only the
        corners and centres of cells are tested.

        Parameters
        ----------
        points, unit
            See `inside`.

        Returns
        -------
        float64 array, shape (n,)
        """
        return np.full(np.shape(points)[1], np.inf)

    @property
    def bounded(self) -> bool:
        """Whether `beyond` is such a bound everywhere."""
        return False

    def __and__(self, other: Region) -> Region:
        return _Combined(np.logical_and, np.maximum, self, other)

    def __or__(self, other: Region) -> Region:
        return _Combined(np.logical_or, np.minimum, self, other)

    def __invert__(self) -> Region:
        return _Outside(self)


class _Combined(Region):
    def __init__(self, both: np.ufunc, farther: np.ufunc, first: Region, second: Region) -> None:
        for part in (first, second):
            if not isinstance(part, Region):
                raise InputError(f"a region combines with another region, got {part!r}")
        self.both, self.farther, self.parts = both, farther, (first, second)

    def inside(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        return np.asarray(self.both(*(part.inside(points, unit) for part in self.parts)))

    def beyond(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        return np.asarray(self.farther(*(part.beyond(points, unit) for part in self.parts)))

    @property
    def bounded(self) -> bool:
        return all(part.bounded for part in self.parts)


class _Outside(Region):
    def __init__(self, region: Region) -> None:
        self.region = region

    def inside(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        return ~self.region.inside(points, unit)

    def beyond(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        return -self.region.beyond(points, unit)

    @property
    def bounded(self) -> bool:
        return self.region.bounded


class _Solid(Region):
    """Base of regions with a `beyond` of their own."""

    bounded = True

    def inside(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        return self.beyond(points, unit) <= 0.0


class Box(_Solid):
    """What is between two corners.

    Parameters
    ----------
    low, high : three floats or Quantity
    """

    def __init__(self, low: Any, high: Any) -> None:
        self.low, self.high = _point(low, "low"), _point(high, "high")
        if _alike(low, high):  # else it depends on the volume's unit
            self._corners(unit_of(low))

    def _corners(self, unit: Unit) -> tuple[np.ndarray, np.ndarray]:
        low, high = plain(self.low, unit, "low"), plain(self.high, unit, "high")
        if not np.all(low < high):
            raise InputError(
                f"low must be below high along all axes, got {self.low} and {self.high}"
            )
        return low, high

    def beyond(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        low, high = (corner[:, None] for corner in self._corners(unit))
        return np.asarray(np.maximum(low - points, points - high).max(axis=0))


class Sphere(_Solid):
    """What is within a distance of a point.

    Parameters
    ----------
    center : three floats or Quantity
    radius : float or Quantity
    """

    def __init__(self, center: Any, radius: Any) -> None:
        self.center, self.radius = _point(center, "center"), _length(radius, "radius")

    def beyond(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        away = points - plain(self.center, unit, "center")[:, None]
        return np.asarray(np.linalg.norm(away, axis=0) - plain(self.radius, unit, "radius"))


class Cylinder(_Solid):
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

    def _ends(self, unit: Unit) -> tuple[np.ndarray, np.ndarray]:
        start, end = plain(self.start, unit, "start"), plain(self.end, unit, "end")
        if np.array_equal(start, end):
            raise InputError(f"start and end of a cylinder must differ, got {self.start} twice")
        return start, end

    def beyond(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        start, end = self._ends(unit)
        height, across = _along(points, start, end - start)
        above = np.maximum(-height, height - np.linalg.norm(end - start))
        return np.asarray(np.maximum(above, across - plain(self.radius, unit, "radius")))


class DoubleCone(_Solid):
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

    def beyond(self, points: np.ndarray, unit: Unit) -> np.ndarray:
        height, across = _along(points, plain(self.apex, unit, "apex"), self.axis)
        height = {"both": np.abs(height), "up": height, "down": -height}[self.side]
        angle = np.radians(self.opening)
        beyond = across * np.cos(angle) - height * np.sin(angle)
        if self.height is not None:
            beyond = np.maximum(beyond, height - plain(self.height, unit, "height"))
        return np.asarray(beyond)


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
