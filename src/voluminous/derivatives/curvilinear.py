"""Differences on spherical and cylindrical grids whose cells form three axes.

Along each coordinate they are those of `differences`, of parabolas through three neighbours; the
metric turns them into lengths. Components are Cartesian, as everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry import SPHERICAL, metric
from .differences import Rule, first_derivative, second_derivative

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
        self, axis: int, rule: Rule, values: np.ndarray, centers: Sequence[np.ndarray], keep: slice
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
