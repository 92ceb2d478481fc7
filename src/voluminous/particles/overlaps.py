"""Which nodes of an octree the spheres around particles reach into, in kernels.

Each lane is a particle, which walks through the nodes depth first and leaves out those that its
sphere does not touch. It stops at leaves, and at nodes so small that it need not tell their parts
apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..backend import dr, from_host
from .nodes import Nodes

# A sphere of radius H stops at nodes of this part of H: there are not more than 3000 of these.
_PART = 0.25


@dataclass(frozen=True)
class Pairs:
    """Particles and nodes that overlap: arrays of uint32, shape (pairs,)."""

    particle: np.ndarray
    node: np.ndarray


class Overlaps:
    """Finds pairs of spheres and nodes.

    Parameters
    ----------
    nodes : Nodes
    points : array of float64, shape (n, 3)
        Centres of the spheres.
    radius : array of float64, shape (n,)
    backend : Backend
        In double precision.
    steps : int
        Into how many the part of a radius is cut again at which spheres stop.
    """

    def __init__(
        self, nodes: Nodes, points: np.ndarray, radius: np.ndarray, backend: Any, steps: int = 1
    ) -> None:
        self.backend = backend
        self.boxes = packed(backend, nodes.low, nodes.part)
        self.spheres = packed(backend, points, radius)
        self.after = backend.UInt(nodes.after)
        self.end = dr.opaque(backend.UInt, nodes.size)
        self.width = [backend.wide(float(w)) for w in nodes.width]
        self.widest = backend.wide(float(nodes.width.max()) * steps / _PART)

    def counts(self, first: int, last: int) -> np.ndarray:
        """Return how many nodes the spheres of consecutive particles overlap."""
        own = self._own(first, last)
        nothing = dr.zeros(self.backend.UInt, last - first)
        _, count = self._walk(own, nothing, lambda node, count, found: None)
        return np.array(count)

    def pairs(self, first: int, counts: np.ndarray) -> Pairs:
        """Return the pairs of as many consecutive particles as there are counts."""
        UInt = self.backend.UInt
        own = self._own(first, first + len(counts))
        ends = np.cumsum(counts, dtype=np.int64)
        start = from_host(UInt, ends - counts)
        total = int(ends[-1])
        particle, node = dr.zeros(UInt, total), dr.zeros(UInt, total)
        dr.eval(own, start, particle, node)

        def keep(here: Any, count: Any, found: Any) -> None:
            dr.scatter(particle, own, start + count, found)
            dr.scatter(node, here, start + count, found)

        dr.eval(self._walk(own, dr.zeros(UInt, len(counts)), keep))
        return Pairs(np.array(particle), np.array(node))

    def _own(self, first: int, last: int) -> Any:
        UInt = self.backend.UInt
        return dr.arange(UInt, last - first) + dr.opaque(UInt, first)

    def _walk(self, own: Any, count: Any, keep: Any) -> Any:
        backend = self.backend
        sphere = dr.gather(backend.packet(4), self.spheres, own)

        def inside(node: Any, count: Any) -> Any:
            return node < self.end

        def step(node: Any, count: Any) -> tuple[Any, Any]:
            box = dr.gather(backend.packet(4), self.boxes, node)
            after = dr.gather(backend.UInt, self.after, node)
            touched = self._distance2(sphere, box) < sphere[3] * sphere[3]
            ends = (after == node + 1) | (box[3] * self.widest <= sphere[3])
            found = touched & ends
            keep(node, count, found)
            return dr.select(touched & ~ends, node + 1, after), count + dr.select(found, 1, 0)

        node = dr.zeros(backend.UInt, dr.width(own))
        return dr.while_loop((node, count), inside, step, label="overlaps")

    def _distance2(self, sphere: Any, box: Any) -> Any:
        total = self.backend.Wide(0.0)
        for axis, width in enumerate(self.width):
            below = box[axis] - sphere[axis]
            above = -(below + box[3] * width)
            far = dr.select(below > above, below, above)
            far = dr.select(far > 0.0, far, 0.0)
            total = dr.fma(far, far, total)
        return total


def packed(backend: Any, points: np.ndarray, last: np.ndarray) -> Any:
    """Return points (n, 3) and a fourth number for each, to be gathered at once."""
    rows = np.empty((len(points), 4))
    rows[:, :3], rows[:, 3] = points, last
    return from_host(backend.Float, rows.ravel())
