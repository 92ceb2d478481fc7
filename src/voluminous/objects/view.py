"""Where things are seen: a camera put before a grid, in pixels."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..backend import from_host
from ..units import plain

# Step of differences, as a fraction of the distance: its square and rounding over it are small.
_STEP = 1e-4


@dataclass
class View:
    """What objects need to know of a picture.

    Attributes
    ----------
    camera, grid, frame, backend : object
    channels : int
        Those of the medium, which come first.
    all_channels : int
        Those of the picture.
    intensity_unit : astropy unit or None
    picture : callable
        Gives the brightest pixel without objects.
    """

    camera: Any
    grid: Any
    frame: Any
    backend: Any
    channels: int
    all_channels: int
    intensity_unit: Any
    picture: Callable[[], float]

    @functools.cached_property
    def brightest(self) -> float:
        """The brightest pixel without objects; 1 if all are black."""
        return self.picture() or 1.0

    def length(self, value: Any, what: str) -> Any:
        """Return lengths in the volume's unit."""
        return plain(value, self.grid.unit, what)

    def place(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x and y in pixels and the depth of points (n, 3); NaN where they are not seen."""
        u, v, depth = self.camera.project(np.ascontiguousarray(points.T), self.grid)
        x, y = (
            (w - shift) / step + 0.5 * (n - 1)
            for w, shift, step, n in zip(
                (u, v), self.frame.shift, self.frame.pixel, self.frame.pixels, strict=True
            )
        )
        return x, y, depth

    def directions(self, points: np.ndarray) -> np.ndarray:
        """Return unit vectors from the observer to points (n, 3)."""
        return np.asarray(self.camera.lines_of_sight(points.T, self.grid)).T

    def rays(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return origins and directions (n, 3) of the rays through places in pixels."""
        if not len(x):
            return np.empty((0, 3)), np.empty((0, 3))
        ray = self.traced_rays(x, y)

        def stacked(parts: Any) -> np.ndarray:
            return np.stack([np.broadcast_to(np.asarray(p), x.shape) for p in parts]).T

        return stacked(ray.origin), stacked(ray.direction)

    def traced_rays(self, x: np.ndarray, y: np.ndarray) -> Any:
        """Return the rays through places in pixels as kernels see them."""
        backend, frame = self.backend, self.frame
        u, v = (
            from_host(backend.Wide, (w - 0.5 * (n - 1)) * step + shift)
            for w, shift, step, n in zip(
                (x, y), frame.shift, frame.pixel, frame.pixels, strict=True
            )
        )
        return self.camera.rays(frame.traced_vectors(backend), u, v)

    @functools.cached_property
    def observer(self) -> np.ndarray | None:
        """Where all rays begin; None at infinity."""
        return None if self.camera.parallel else self.rays(*np.zeros((2, 1)))[0][0]

    @functools.cached_property
    def axis(self) -> np.ndarray:
        """Direction of the ray through the middle of the picture."""
        middle = [np.array([0.5 * (n - 1)]) for n in self.frame.pixels]
        return self.rays(*middle)[1][0]

    def across(self, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return two unit vectors normal to directions (n, 3) and to each other.

        The first one points to the picture's middle: the image of a sphere in a flat or round
        perspective is symmetric about that line.
        """
        inward = self.axis - (direction @ self.axis)[:, None] * direction
        # In the middle any will do: the one along the axis that is farthest from the direction.
        other = np.eye(3)[np.argmin(np.abs(direction), axis=1)]
        other = other - np.sum(other * direction, axis=1, keepdims=True) * direction
        size = np.linalg.norm(inward, axis=1, keepdims=True)
        inward = np.where(size > 1e-9, inward, other)
        inward = inward / np.linalg.norm(inward, axis=1, keepdims=True)
        return inward, np.cross(direction, inward)

    def pixels_per_area(self, points: np.ndarray) -> np.ndarray:
        """Return how many pixels an area of one, facing the observer at points (n, 3), fills."""
        dx, dy = self.frame.pixel
        if self.camera.parallel:
            return np.full(len(points), 1.0 / abs(dx * dy))
        direction = self.directions(points)
        step = _STEP * self.place(points)[2][:, None]
        sides = []
        for e in self.across(direction):
            ahead, back = self.place(points + step * e), self.place(points - step * e)
            sides.append([(a - b) / (2.0 * step[:, 0]) for a, b in zip(ahead, back, strict=True)])
        (ax, ay, _), (bx, by, _) = sides
        return np.abs(ax * by - ay * bx)
