"""The narrowest cell that a ray meets in a curvilinear grid, to divide pixels.

On spherical grids it is RADMC-3D's size of a cell, as seen from where the ray enters it. Of
cylindrical grids, which RADMC-3D has none of, it is the least of a cell's widths along R, φ and z.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...backend import dr, from_host
from ...grids.contract import Ray
from .drawing import reverse
from .narrowest import Narrowest

# Relative and angular sizes that cells count as at least, and at most.
_THINNEST = 0.003
_LEAST_ANGLE, _MOST_ANGLE = 0.05, 0.3
# Of the innermost radius: what a ray counts as meeting that passes through the cavity.
_OF_CAVITY = 0.05


@dataclass
class Sight:
    """Rays as a centre sees them.

    Attributes
    ----------
    closest : array
        How near they come.
    arrive : array
        Where they enter the sphere around all, counted from there: negative.
    polar : array
        Absolute z component of the direction.
    """

    closest: Any
    arrive: Any
    polar: Any


class NarrowestOfSphere(Narrowest):
    """The rule for spherical grids; widths in units of the grid's scale.

    RADMC-3D follows rays towards the camera, and cells look different from their other ends.

    Parameters
    ----------
    backward : bool
        Rays run towards the camera.
    """

    def __init__(self, grid: Any, backend: Any, backward: bool) -> None:
        super().__init__(grid, backend)
        self.backward = backward
        self.unit = grid.scale
        r = grid.edges[0] / grid.scale
        self.inner, self.outer = backend.wide(r[0]), backend.wide(r[-1])
        # Cells that differ in φ only are alike, of grids that are not refined.
        self.alike = dr.opaque(backend.UInt, grid.shape[2] if grid.is_structured else 1)
        low, high = _profile(grid)
        across = np.minimum(np.minimum(low[1] + high[1], 2 * np.pi - low[1] - high[1]) / 2, 1.0)
        polar = high[1] - low[1]
        # Width along r, and angles along θ and φ (sic: RADMC-3D takes θ's for both).
        self.sizes = _packets(
            backend,
            0.5 * (low[0] + high[0]) / grid.scale,
            _depth(low[0], high[0]) / grid.scale,
            np.clip(polar, _LEAST_ANGLE, _MOST_ANGLE),
            np.clip(across * polar, _LEAST_ANGLE, _MOST_ANGLE),
        )

    def along(self, ray: Ray) -> np.ndarray:
        return super().along(ray if self.backward else reverse(ray))

    def sight(self, ray: Ray) -> Sight:
        to_scale = self.backend.wide(1.0 / self.grid.scale)
        origin = [o * to_scale for o in ray.origin]
        way = -sum(o * d for o, d in zip(origin, ray.direction, strict=True))
        nearest = [dr.fma(way, d, o) for o, d in zip(origin, ray.direction, strict=True)]
        square = sum(n * n for n in nearest)
        arrive = -dr.sqrt(dr.maximum(self.outer * self.outer - square, 0.0))
        own = self.backend.Float
        return Sight(own(dr.sqrt(square)), own(arrive), own(dr.abs(ray.direction[2])))

    def before(self, sight: Sight, count: int) -> Any:
        inner = self.backend.Float(self.inner)
        return dr.select(sight.closest <= inner, _OF_CAVITY * inner, np.inf)

    def width(self, cursor: Any, segment: Any, sight: Sight) -> Any:
        kind = self.backend.quotient(segment.cell, self.alike)
        radius, depth, along_theta, along_phi = dr.gather(
            self.backend.packet(4), self.sizes, kind, segment.active
        )
        across, around = radius * along_theta, radius * along_phi
        way = segment.begin + sight.arrive
        distance = dr.sqrt(dr.fma(way, way, sight.closest * sight.closest))
        upright = dr.abs(way) / distance
        tilted = dr.lerp(around, across, sight.polar) * upright
        width = dr.minimum(dr.minimum(across, around), tilted)
        return dr.maximum(depth, width)


class NarrowestOfCylinder(Narrowest):
    """Widths along R, φ and z, with the limits that RADMC-3D has for spherical grids."""

    def __init__(self, grid: Any, backend: Any) -> None:
        super().__init__(grid, backend)
        self.unit = grid.scale
        low, high = grid.spans()
        middle = 0.5 * (low[0] + high[0])
        around = middle * np.clip(high[1] - low[1], _LEAST_ANGLE, _MOST_ANGLE)
        width = np.minimum(np.minimum(_depth(low[0], high[0]), around), high[2] - low[2])
        self.widths = from_host(backend.Float, width / grid.scale)
        self.widest = float(width.max() / grid.scale)

    def before(self, sight: Any, count: int) -> Any:
        return dr.full(self.backend.Float, self.widest, count)

    def width(self, cursor: Any, segment: Any, sight: Any) -> Any:
        return dr.gather(self.backend.Float, self.widths, segment.cell, segment.active)


def _profile(grid: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return where cells begin and end along r and θ, (2, n): one of all that are alike."""
    if not grid.is_structured:
        low, high = grid.spans()
        return low[:2], high[:2]
    walls = grid.edges[:2]
    low, high = (
        np.stack([w.ravel() for w in np.meshgrid(*(e[part] for e in walls), indexing="ij")])
        for part in (slice(None, -1), slice(1, None))
    )
    return low, high


def _depth(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    depth: np.ndarray = np.maximum(high - low, _THINNEST * 0.5 * (low + high))
    return depth


def _packets(backend: Any, *columns: np.ndarray) -> Any:
    return from_host(backend.Float, np.stack(columns, axis=1).reshape(-1))
