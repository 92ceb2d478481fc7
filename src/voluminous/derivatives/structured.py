"""Derivatives on grids whose cells form three axes.

Along each coordinate: the slope and the curvature of the parabola through three neighbours. On
spherical and cylindrical grids the metric turns them into lengths. Components are Cartesian.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..geometry import CARTESIAN, SPHERICAL, metric
from ..memory import check_memory

if TYPE_CHECKING:
    from ..grids.structured import StructuredGrid

AxisRule = Callable[[np.ndarray, np.ndarray], np.ndarray]
_TURN = 2.0 * np.pi
# Layers that an end of the domain needs beside its own; elsewhere one would do.
_HALO = 2
# Cells differentiated at once.
_CHUNK = 1 << 21
# Numbers of float32 that are worth keeping as such: 19 digits below the largest are still normal.
_SMALLEST, _LARGEST = 1e-19, float(np.finfo(np.float32).max)


def first_derivative(f: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return ∂f/∂x along the first axis: the slope of the parabola, at its middle or its ends.

    Two cells have one slope, for both; one cell has none: zero.
    """
    out = np.zeros_like(f)
    if len(x) < 3:
        out += np.diff(f, axis=0) / np.diff(x)[0] if len(x) == 2 else 0.0
        return out
    h, slope = _slopes(f, x)
    before, after = h[:-1] / (h[:-1] + h[1:]), h[1:] / (h[:-1] + h[1:])
    out[1:-1] = after * slope[:-1]
    out[1:-1] += before * slope[1:]
    out[0] = slope[0] - before[0] * (slope[1] - slope[0])
    out[-1] = slope[-1] + after[-1] * (slope[-1] - slope[-2])
    return out


def second_derivative(f: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return ∂²f/∂x² along the first axis: that of the parabola, which an end cell shares.

    One cell or two have none: zero.
    """
    out = np.zeros_like(f)
    if len(x) < 3:
        return out
    h, slope = _slopes(f, x)
    out[1:-1] = np.diff(slope, axis=0)
    out[1:-1] *= 2 / (h[:-1] + h[1:])
    out[0], out[-1] = out[1], out[-2]
    return out


def _slopes(f: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    h = np.diff(x)[:, None, None]
    slope = np.diff(f, axis=0)
    slope /= h
    return h, slope


@dataclass
class DifferentiatedLayers:
    """Values (n1, n2, n3) at the centres of some layers of a grid.

    `keep` are the layers of the first axis to differentiate; the others serve as neighbours.
    """

    grid: StructuredGrid
    values: np.ndarray
    centers: list[np.ndarray]
    keep: slice

    def derivative(self, operation: str) -> np.ndarray:
        """Return ``gradmag`` |∇f|, ``laplacian`` ∇²f, or ``grad.x``, ``grad.y``, ``grad.z``."""
        system = self.grid.coordinates
        if operation.startswith("grad.") and system == CARTESIAN:
            return self._along("xyz".index(operation[-1]), first_derivative)
        own, scale = np.empty(0), np.ones(3)
        if system != CARTESIAN:
            own = np.array(
                np.meshgrid(self.centers[0][self.keep], *self.centers[1:], indexing="ij")
            )
            scale = metric(system, own)
        if operation == "laplacian":
            second = [self._along(a, second_derivative) for a in range(3)]
            total = sum(f / (h * h) for f, h in zip(second, scale, strict=True))
            return np.asarray(total if system == CARTESIAN else total + self._bent(own))
        first = [self._along(a, first_derivative) for a in range(3)]
        slopes = [f / h for f, h in zip(first, scale, strict=True)]
        if operation == "gradmag":
            return np.asarray(np.sqrt(sum(s * s for s in slopes)))
        return self._component("xyz".index(operation[-1]), slopes, own)

    def _along(self, axis: int, rule: AxisRule) -> np.ndarray:
        if axis == 0:
            return rule(self.values, self.centers[0])[self.keep]
        turned, q = np.moveaxis(self.values[self.keep], axis, 0), self.centers[axis]
        name, inner = self.grid.coordinates[axis], slice(None)
        # The azimuth goes round; beyond the midplane everything may be mirrored.
        if name == "phi" and self.grid.is_periodic and len(q) > 1:
            turned = np.concatenate([turned[-1:], turned, turned[:1]])
            q, inner = np.concatenate([[q[-1] - _TURN], q, [q[0] + _TURN]]), slice(1, -1)
        elif name == "theta" and self.grid.mirror:
            turned, q = np.concatenate([turned, turned[-1:]]), np.append(q, np.pi - q[-1])
            inner = slice(None, -1)
        return np.moveaxis(rule(turned, q)[inner], 0, axis)

    def _bent(self, own: np.ndarray) -> np.ndarray:
        radial = self._along(0, first_derivative)
        if self.grid.coordinates == SPHERICAL:
            r, theta = own[0], own[1]
            polar = self._along(1, first_derivative)
            return np.asarray(2 * radial / r + polar / (np.tan(theta) * r * r))
        return np.asarray(radial / own[0])

    def _component(self, axis: int, slopes: list[np.ndarray], own: np.ndarray) -> np.ndarray:
        phi = own[self.grid.coordinates.index("phi")]
        round_about = (-np.sin(phi), np.cos(phi), 0.0)[axis]
        outwards = (np.cos(phi), np.sin(phi), 0.0)[axis]
        up = float(axis == 2)
        if self.grid.coordinates == SPHERICAL:
            sine, cosine = np.sin(own[1]), np.cos(own[1])
            radial, polar = sine * outwards + cosine * up, cosine * outwards - sine * up
            return np.asarray(slopes[0] * radial + slopes[1] * polar + slopes[2] * round_about)
        return np.asarray(slopes[0] * outwards + slopes[1] * round_about + slopes[2] * up)


def whole(
    operation: str, layers: Callable[[slice], np.ndarray], grid: StructuredGrid
) -> np.ndarray:
    """Return a derivative on all cells of what `layers` returns for layers of the first axis.

    It is float32 if that is what is differentiated, and if the result is neither too small nor too
    large for it (as of 1e-20 g/cm³ over a parsec in cm), else float64.
    """
    if layers(slice(0, 1)).dtype == np.float32:
        found, largest = _filled(np.dtype(np.float32), operation, layers, grid)
        if largest == 0 or _SMALLEST <= largest <= _LARGEST:
            return found
        del found
    return _filled(np.dtype(np.float64), operation, layers, grid)[0]


def _filled(
    dtype: np.dtype, operation: str, layers: Callable[[slice], np.ndarray], grid: StructuredGrid
) -> tuple[np.ndarray, float]:
    centers = [0.5 * (edges[1:] + edges[:-1]) for edges in grid.edges]
    nx, ny, nz = shape = tuple(len(c) for c in centers)
    check_memory(
        nx * ny * nz * dtype.itemsize,
        f"{operation} of a field of {nx} x {ny} x {nz} cells",
        "crop or coarsen the volume",
    )
    out, largest = np.empty(shape, dtype), 0.0
    step = max(1, _CHUNK // (ny * nz))
    for first in range(0, nx, step):
        last = min(first + step, nx)
        low, high = max(0, first - _HALO), min(last + _HALO, nx)
        # Differences lose digits, and squares of cgs units leave the range of float32.
        values = layers(slice(low, high)).astype(np.float64)
        near = [centers[0][low:high], *centers[1:]]
        part = DifferentiatedLayers(grid, values, near, slice(first - low, last - low)).derivative(
            operation
        )
        largest = max(largest, _largest(part))
        out[first:last] = part
    return out, largest


def in_single(values: np.ndarray) -> bool:
    """Return True if float32 is enough for values, neither too small nor too large."""
    largest = _largest(values)
    return largest == 0 or _SMALLEST <= largest <= _LARGEST


def _largest(values: np.ndarray) -> float:
    size = np.abs(values)
    return float(np.max(size, where=np.isfinite(size), initial=0.0))
