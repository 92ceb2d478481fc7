"""Coordinate systems on the host: from a grid's own coordinates to Cartesian ones.

Spherical coordinates are (r, θ, φ) with θ from the z axis, cylindrical ones (R, φ, z); φ runs from
the x axis towards y, and angles are radians.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

# Digits of the ends of an interval, and of its width at least.
_DIGITS, _OF_WIDTH = 6, 3
CARTESIAN, SPHERICAL, CYLINDRICAL = ("x", "y", "z"), ("r", "theta", "phi"), ("R", "phi", "z")


def position(system: tuple[str, ...], coordinates: np.ndarray) -> np.ndarray:
    """Return x, y and z, shape (3, n), of points in a grid's own coordinates, shape (3, n).

    Coordinates beyond the ends of their range go on through the axis or the centre: r < 0 is the
    point opposite.
    """
    if system == SPHERICAL:
        r, theta, phi = coordinates
        radius = r * np.sin(theta)
        return np.array([radius * np.cos(phi), radius * np.sin(phi), r * np.cos(theta)])
    if system == CYLINDRICAL:
        radius, phi, z = coordinates
        return np.array([radius * np.cos(phi), radius * np.sin(phi), z])
    return coordinates


def metric(system: tuple[str, ...], coordinates: np.ndarray) -> np.ndarray:
    """Return the length per unit of each coordinate, shape (3, n): (1, r, r sin θ) or (1, R, 1)."""
    one = np.ones_like(coordinates[0])
    if system == SPHERICAL:
        return np.array([one, coordinates[0], coordinates[0] * np.sin(coordinates[1])])
    if system == CYLINDRICAL:
        return np.array([one, coordinates[0], one])
    return np.ones_like(coordinates)


def mirror_images(grid: Any) -> list[np.ndarray]:
    """Return factors of points, shape (3,) each: a mirrored cell is in two places."""
    return [np.array([1.0, 1.0, z]) for z in ((1.0, -1.0) if grid.mirror else (1.0,))]


def turns(grid: Any) -> list[np.ndarray]:
    """Return quarter turns, shape (3, 3), that take each cell to itself.

    About z where one cell goes all around the axis; about x too where it takes all angles.
    """
    if "phi" not in grid.coordinates:
        return []
    edges = dict(zip(grid.coordinates, grid.edges, strict=True))
    if not grid.is_periodic or len(edges["phi"]) - 1 > 1:
        return []
    around = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    over = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    all_angles = np.array_equal(edges.get("theta", ()), (0.0, np.pi))
    return [around, over] if all_angles else [around]


def many_valued(grid: Any) -> tuple[str, ...]:
    """Return the coordinates of which a cell has many values: all around the axis, or mirrored."""
    count = len(turns(grid))
    names = ("x", "y", "phi", "z", "theta")[: (0, 3, 5)[count]]
    return (*names, "z") if grid.mirror and "z" not in names else names


def span(low: float, high: float) -> str:
    """Return both ends of an interval as text, with digits enough to tell its width."""
    width = abs(high - low) or 1.0
    far = max(abs(low), abs(high), width)
    digits = max(_DIGITS, _OF_WIDTH + math.ceil(math.log10(far / width)))
    return f"{low:.{digits}g} … {high:.{digits}g}"


def is_uniform(edges: np.ndarray) -> bool:
    """Return True if all cells are equally wide to the rounding of the edges themselves."""
    even = np.linspace(edges[0], edges[-1], len(edges))
    rounding = 8 * np.finfo(np.float64).eps * np.max(np.abs(edges))
    return bool(np.max(np.abs(edges - even)) <= rounding)
