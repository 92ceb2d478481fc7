"""Edges of curvilinear cells: what users give, checked; and ranges of what follows from them."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import InputError
from ...units import is_quantity, plain, radians, space_unit, unit_of

FULL_CIRCLE = 2 * np.pi
# Azimuths and polar angles in single precision end where they should to this.
ANGLE_ROUNDING = 1e-6


def length_unit(lengths: tuple[Any, ...], unit: Any) -> Any:
    """Return the unit of the first lengths that have one, or the one given."""
    for values in lengths:
        if (own := unit_of(values)) is not None:
            return own
    return space_unit(unit)


def length_edges(values: Any, unit: Any, name: str) -> np.ndarray:
    """Return edges that are lengths as plain numbers in a unit."""
    if is_quantity(values) or unit_of(values) is not None:
        return increasing(plain(values, unit, f"{name} edges"), name)
    return increasing(values, name)


def angle_edges(values: Any, name: str) -> np.ndarray:
    """Return edges that are angles in radian."""
    quantity = is_quantity(values) or unit_of(values) is not None
    return increasing(radians(values, f"{name} edges") if quantity else values, name)


def increasing(values: Any, name: str) -> np.ndarray:
    """Return cell edges as a new array of float64."""
    try:
        edges = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} edges must be numbers, got {values!r}") from error
    if edges.ndim != 1 or len(edges) < 2:
        raise InputError(
            f"{name} edges must be a 1-D array of at least two cell edges, got shape {edges.shape}"
        )
    for bad, told in ((~np.isfinite(edges), "be finite"), (_not_above(edges), "increase strictly")):
        if bad.any():
            k = int(np.flatnonzero(bad)[0])
            raise InputError(f"{name} edges must {told}; edge {k} is {edges[k]:g}")
    return edges


def _not_above(edges: np.ndarray) -> np.ndarray:
    return np.append(False, np.diff(edges) <= 0)


def radii(edges: np.ndarray, name: str) -> np.ndarray:
    """Return edges that are radii."""
    if edges[0] < 0:
        raise InputError(f"{name} edges must not be negative; the first is {edges[0]:g}")
    edges.setflags(write=False)
    return edges


def azimuths(edges: np.ndarray) -> np.ndarray:
    """Return edges that are azimuths; a circle that is closed but for rounding is closed."""
    span = edges[-1] - edges[0]
    if span > FULL_CIRCLE + ANGLE_ROUNDING:
        raise InputError(
            f"phi edges must span at most a full circle, 2 pi = 6.28319 radian; they span {span:g}."
            " Plain numbers are radian: give a Quantity for degrees"
        )
    if abs(span - FULL_CIRCLE) < ANGLE_ROUNDING:
        edges[-1] = edges[0] + FULL_CIRCLE
    edges.setflags(write=False)
    return edges


def interval_product(*intervals: tuple[float, float]) -> tuple[float, float]:
    """Return the range of the product of numbers from intervals."""
    corners = np.array([1.0])
    for interval in intervals:
        corners = np.multiply.outer(corners, np.array(interval)).ravel()
    return float(corners.min()), float(corners.max())


def cosine_range(low: float, high: float) -> tuple[float, float]:
    """Return the range of the cosine of angles from an interval."""
    ends = np.cos([low, high])
    top = np.floor(high / FULL_CIRCLE) >= np.ceil(low / FULL_CIRCLE)
    bottom = np.floor(high / FULL_CIRCLE - 0.5) >= np.ceil(low / FULL_CIRCLE - 0.5)
    return (-1.0 if bottom else float(ends.min()), 1.0 if top else float(ends.max()))


def is_closed(edges: np.ndarray) -> bool:
    """Return True if azimuths span a full circle."""
    return bool(abs(edges[-1] - edges[0] - FULL_CIRCLE) < 1e-9)
