"""Particles that are smoothed by a kernel: the parts of each in the nodes of an octree."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..backend import get_backend
from ..grids import OctreeGrid
from ..memory import fits
from ..progress import reporter
from .base import Base
from .deposit import Deposit
from .images import crossing, with_images
from .kernels import Kernel
from .nodes import nodes_of
from .overlaps import Overlaps
from .weights import KernelWeights

# Pairs of a particle and a node that are worked on at once: 200 MiB of temporary arrays.
_PAIRS = 1 << 22
# Bytes of pairs that are kept for further fields; more are found again for each.
_KEPT = 1 << 30


class SmoothedDeposit(Deposit):
    """Each particle is spread over the nodes that its kernel overlaps.

    The weight of a node is the kernel's integral over it. The weights of a particle are divided by
    their sum, so that nothing is lost where the domain ends; unless there are particles outside of
    it: then what kernels have outside is outside.

    Parameters
    ----------
    base : Base
    grid : OctreeGrid
        On these base cells.
    points : array, shape (n, 3)
    mass, radius : array, shape (n,)
        Masses, and the radii of the kernels' support.
    kernel : Kernel
    steps : int
        How many times finer than usual kernels are told apart; see `Overlaps`.
    """

    def __init__(
        self,
        base: Base,
        grid: OctreeGrid,
        points: np.ndarray,
        mass: np.ndarray,
        radius: np.ndarray,
        kernel: Kernel,
        steps: int = 1,
    ) -> None:
        super().__init__(grid, mass)
        near, owner = with_images(base, points, radius)
        # Neighbours in the order walk through the same nodes.
        order = np.argsort(grid.locate(near), kind="stable")
        near, self.owner = near[order], owner[order]
        self.nodes = nodes_of(grid)
        # The same on all machines: results do not depend on what GPU there is.
        backend = get_backend("cpu", "double")
        overlaps = Overlaps(self.nodes, near, radius[self.owner], backend, steps)
        self.overlaps, self.weights = overlaps, KernelWeights(overlaps, kernel)
        self.counts = overlaps.counts(0, len(near))
        pairs = int(self.counts.sum(dtype=np.int64))
        self.kept: list[Any] | None = [] if 8 * pairs < _KEPT and fits(16 * pairs) else None
        self.norm = self._norm(len(mass))
        if not base.periodic and not base.inside(points).all():
            self.norm[crossing(base, points, radius)] = 1.0

    def _norm(self, count: int) -> np.ndarray:
        norm = np.zeros(count)
        for first, counts, node, weight in self._found():
            owner = np.repeat(self.owner[first : first + len(counts)], counts)
            norm += np.bincount(owner, weight, count)
            if self.kept is not None:
                self.kept.append((first, counts, node, weight))
        norm[norm == 0] = 1.0
        return norm

    def _found(self) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
        """Yield a first point, numbers of nodes for it and those that follow, nodes, weights."""
        ends = np.cumsum(self.counts, dtype=np.int64)
        first, report = 0, reporter()
        while first < len(ends):
            done = ends[first - 1] if first else 0
            last = max(int(np.searchsorted(ends, done + _PAIRS, "right")), first + 1)
            counts = self.counts[first:last]
            pairs = self.overlaps.pairs(first, counts)
            yield first, counts, pairs.node, self.weights.of(pairs)
            first = last
            report(last, len(ends))

    def amounts(self, *carried: np.ndarray) -> list[np.ndarray]:
        sums = [np.zeros(self.nodes.size) for _ in carried]
        parts = [(values / self.norm)[self.owner] for values in carried]
        for first, counts, node, weight in self.kept if self.kept is not None else self._found():
            for total, part in zip(sums, parts, strict=True):
                own = np.repeat(part[first : first + len(counts)], counts)
                # A value that is missing does not count where nothing of its particle is.
                amount = np.multiply(weight, own, out=np.zeros(len(own)), where=weight > 0)
                total += np.bincount(node, amount, self.nodes.size)
        return [self.nodes.spread(total) for total in sums]
