"""Derivatives on grids whose cells form three axes.

Along each coordinate: the slope and the curvature of the parabola through three neighbours. On
spherical and cylindrical grids the metric turns them into lengths. Components are Cartesian.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..geometry import SPHERICAL, metric
from ..memory import check_memory

AxisRule = Callable[[np.ndarray, np.ndarray], np.ndarray]


def differentiate(
    operation: str, values: np.ndarray, centers: Sequence[np.ndarray], keep: slice
) -> np.ndarray:
    """Return a derivative at cell centres."""

    def along(axis: int, rule: AxisRule) -> np.ndarray:
        if axis == 0:
            return rule(values, centers[0])[keep]
        turned = rule(np.moveaxis(values[keep], axis, 0), centers[axis])
        return np.moveaxis(turned, 0, axis)

    if operation == "laplacian":
        return (
            along(0, second_derivative) + along(1, second_derivative) + along(2, second_derivative)
        )
    if operation == "gradmag":
        return np.sqrt(sum(along(axis, first_derivative) ** 2 for axis in range(3)))
    return along("xyz".index(operation[-1]), first_derivative)


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
    """Return distances of neighbours, with axes to multiply fields with, and the slopes."""
    h = np.diff(x)[:, None, None]
    slope = np.diff(f, axis=0)
    slope /= h
    return h, slope


_TURN = 2.0 * np.pi


class Curvilinear:
    """A rule for `layers.whole`: derivatives in a coordinate system.

    Parameters
    ----------
    system : tuple of str
        The grid's own coordinates.
    edges : three arrays
        Walls along each axis: the azimuth goes round if they span a full turn.
    mirror : bool
        The last θ is the midplane, and beyond it everything is mirrored.
    """

    def __init__(
        self, system: tuple[str, ...], edges: Sequence[np.ndarray], mirror: bool = False
    ) -> None:
        self.system, self.mirror = system, mirror
        self.azimuth = system.index("phi")
        around = float(np.ptp(edges[self.azimuth]))
        self.periodic = len(edges[self.azimuth]) > 2 and bool(np.isclose(around, _TURN, 1e-9, 0))

    def __call__(
        self, operation: str, values: np.ndarray, centers: Sequence[np.ndarray], keep: slice
    ) -> np.ndarray:
        """Return a derivative of values (n1, n2, n3) in the layers `keep` of the first axis."""
        own = np.array(np.meshgrid(centers[0][keep], *centers[1:], indexing="ij"))
        scale = metric(self.system, own)
        first = [self._along(a, first_derivative, values, centers, keep) for a in range(3)]
        slopes = [f / h for f, h in zip(first, scale, strict=True)]
        if operation == "gradmag":
            return np.asarray(np.sqrt(sum(s * s for s in slopes)))
        if operation == "laplacian":
            second = [self._along(a, second_derivative, values, centers, keep) for a in range(3)]
            found = sum(f / (h * h) for f, h in zip(second, scale, strict=True))
            return np.asarray(found + self._bent(first, own))
        return self._component("xyz".index(operation[-1]), slopes, own)

    def _along(
        self,
        axis: int,
        rule: AxisRule,
        values: np.ndarray,
        centers: Sequence[np.ndarray],
        keep: slice,
    ) -> np.ndarray:
        if axis == 0:
            return np.asarray(rule(values, centers[0])[keep])
        turned, q = np.moveaxis(values[keep], axis, 0), centers[axis]
        if axis == self.azimuth and self.periodic:
            turned = np.concatenate([turned[-1:], turned, turned[:1]])
            q = np.concatenate([[q[-1] - _TURN], q, [q[0] + _TURN]])
            return np.moveaxis(rule(turned, q)[1:-1], 0, axis)
        if axis != self.azimuth and self.mirror:
            turned, q = np.concatenate([turned, turned[-1:]]), np.append(q, np.pi - q[-1])
            return np.moveaxis(rule(turned, q)[:-1], 0, axis)
        return np.moveaxis(rule(turned, q), 0, axis)

    def _bent(self, first: list[np.ndarray], own: np.ndarray) -> np.ndarray:
        """Return what the Laplacian has of first derivatives, because coordinates are curved."""
        if self.system == SPHERICAL:
            r, theta = own[0], own[1]
            return np.asarray(2 * first[0] / r + first[1] / (np.tan(theta) * r * r))
        return np.asarray(first[0] / own[0])

    def _component(self, axis: int, slopes: list[np.ndarray], own: np.ndarray) -> np.ndarray:
        phi = own[self.azimuth]
        round_about = (-np.sin(phi), np.cos(phi), 0.0)[axis]
        outwards = (np.cos(phi), np.sin(phi), 0.0)[axis]
        up = float(axis == 2)
        if self.system == SPHERICAL:
            sine, cosine = np.sin(own[1]), np.cos(own[1])
            radial, polar = sine * outwards + cosine * up, cosine * outwards - sine * up
            return np.asarray(slopes[0] * radial + slopes[1] * polar + slopes[2] * round_about)
        return np.asarray(slopes[0] * outwards + slopes[1] * round_about + slopes[2] * up)


Rule = Callable[[str, np.ndarray, Sequence[np.ndarray], slice], np.ndarray]

# Layers that an end of the domain needs beside its own; elsewhere one would do.
_HALO = 2
# Cells differentiated at once.
_CHUNK = 1 << 21
# Numbers of float32 that are worth keeping as such: 19 digits below the largest are still normal.
_SMALLEST, _LARGEST = 1e-19, float(np.finfo(np.float32).max)


def whole(
    operation: str,
    layers: Callable[[slice], np.ndarray],
    centers: Sequence[np.ndarray],
    rule: Rule,
) -> np.ndarray:
    """Return a derivative on all cells."""
    if layers(slice(0, 1)).dtype == np.float32:
        found, largest = _filled(np.dtype(np.float32), operation, layers, centers, rule)
        if _fits_single(largest):
            return found
        del found
    return _filled(np.dtype(np.float64), operation, layers, centers, rule)[0]


def _filled(
    dtype: np.dtype,
    operation: str,
    layers: Callable[[slice], np.ndarray],
    centers: Sequence[np.ndarray],
    rule: Rule,
) -> tuple[np.ndarray, float]:
    shape = tuple(len(c) for c in centers)
    nx, ny, nz = shape
    check_memory(
        nx * ny * nz * dtype.itemsize,
        f"{operation} of a field of {nx} x {ny} x {nz} cells",
        "crop or coarsen the volume",
    )
    out, largest = np.empty(shape, dtype), 0.0
    step = max(1, _CHUNK // (ny * nz))
    for first in range(0, nx, step):
        last = min(first + step, nx)
        part = _part(operation, layers, centers, (first, last), rule)
        largest = max(largest, _largest(part))
        out[first:last] = part
    return out, largest


def _part(
    operation: str,
    layers: Callable[[slice], np.ndarray],
    centers: Sequence[np.ndarray],
    kept: tuple[int, int],
    rule: Rule,
) -> np.ndarray:
    first, last = kept
    low, high = max(0, first - _HALO), min(last + _HALO, len(centers[0]))
    # Differences lose digits, and squares of cgs units leave the range of float32.
    values = layers(slice(low, high)).astype(np.float64)
    near = (centers[0][low:high], *centers[1:])
    return rule(operation, values, near, slice(first - low, last - low))


def in_single(values: np.ndarray) -> bool:
    """Return True if float32 is enough for values, neither too small nor too large."""
    return _fits_single(_largest(values))


def _fits_single(largest: float) -> bool:
    return largest == 0 or _SMALLEST <= largest <= _LARGEST


def _largest(values: np.ndarray) -> float:
    size = np.abs(values)
    return float(np.max(size, where=np.isfinite(size), initial=0.0))
