"""Particles smoothed by a kernel: how much of each lies in the nodes of an octree.

In kernels each lane is a particle. It walks through the nodes depth first and skips those that its
sphere does not touch; it stops at leaves, and at nodes small compared with its radius. The weight
of a node is the particle's kernel summed over midpoints of the box that the node and the cube
around the kernel's support have in common.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..backend import dr, from_host, get_backend
from ..backend.functions import loop
from ..backend.types import Float, Int
from ..grids import OctreeGrid
from ..memory import fits
from ..progress import reporter
from .deposit import Deposit, crossing, with_images
from .octree import Base

if TYPE_CHECKING:
    from .inputs import Kernel


class OctreeNodes(NamedTuple):
    """Nodes depth first: a split node is followed by all that is in it."""

    level: np.ndarray  # uint8, (nodes,)
    low: np.ndarray  # lower corners, (nodes, 3)
    width: np.ndarray  # of the base cells, (3,)
    after: np.ndarray  # the node that follows once all in a node is done with; uint32, (nodes,)
    leaf: np.ndarray  # which nodes are leaves, in the grid's order, (leaves,)

    @property
    def part(self) -> np.ndarray:
        """Widths of the nodes as parts of the base cells'."""
        return np.ldexp(1.0, -self.level.astype(np.int64))

    @property
    def size(self) -> int:
        """Number of nodes."""
        return len(self.level)

    def spread(self, amounts: np.ndarray) -> np.ndarray:
        """Return the amounts in the leaves, once that of each split node is spread evenly in it.

        `amounts` (nodes,) is changed.
        """
        split = self.after != np.arange(1, self.size + 1)
        for level in range(1, int(self.level.max()) + 1):
            parents, level_nodes = (
                (self.level == level - 1) & split,
                np.flatnonzero(self.level == level),
            )
            if len(level_nodes):
                parent = np.flatnonzero(parents)
                amounts[level_nodes] += (
                    0.125 * amounts[parent[np.searchsorted(parent, level_nodes) - 1]]
                )
        return np.take(amounts, self.leaf)


def nodes_of(grid: OctreeGrid) -> OctreeNodes:
    """Return all nodes of an octree on equally wide base cells."""
    first = grid.places.aligned_levels().astype(np.int64)
    count = grid.levels - first + 1
    leaf = np.cumsum(count) - 1
    # A leaf comes after the split nodes that begin where it does.
    level = np.repeat(first - np.cumsum(count) + count, count) + np.arange(leaf[-1] + 1)
    after = np.empty(len(level), np.uint32)
    for depth in range(int(level.max()) + 1):
        ends, nodes = np.flatnonzero(level <= depth), np.flatnonzero(level == depth)
        after[nodes] = np.append(ends, len(level))[np.searchsorted(ends, nodes) + 1]
    low, _ = grid.corners()
    width = np.array([(e[-1] - e[0]) / (len(e) - 1) for e in grid.base_edges])
    low = np.repeat(low.T, count, axis=0)
    return OctreeNodes(level.astype(np.uint8), low, width, after, leaf)


# A sphere of radius H stops at nodes of this part of H: there are not more than 3000 of these.
_PART = 0.25
# Midpoints are at most this part of the support's radius apart.
_STEP = 0.25
# Where a kernel is fainter than this part of its centre it is left out, at the rim: densities fall
# by twelve decades there, which is no property of the data, and pictures in log10 show it.
_FAINT = 1e-3


class Overlaps:
    """Pairs of spheres and nodes, and the parts of kernels in nodes.

    The spheres have centres `points` (n, 3) and radii `radius` (n,). They stop at nodes that are
    `steps` times smaller than usual.
    """

    def __init__(
        self,
        nodes: OctreeNodes,
        points: np.ndarray,
        radius: np.ndarray,
        kernel: Kernel,
        steps: int = 1,
    ) -> None:
        # The same on all machines: results do not depend on what GPU there is.
        self.backend = backend = get_backend("cpu", "double")
        # Lengths are in radii of the support in kernels: single precision is enough.
        self.single, self.kernel = backend.with_precision("single"), kernel
        self.boxes, self.spheres = (
            from_host(backend.Float, np.column_stack(rows).ravel())
            for rows in ((nodes.low, nodes.part), (points, radius))
        )
        self.after = backend.UInt(nodes.after)
        self.end = dr.opaque(backend.UInt, nodes.size)
        self.width = [backend.wide(float(w)) for w in nodes.width]
        self.widest = backend.wide(float(nodes.width.max()) * steps / _PART)

    def counts(self, first: int, last: int) -> np.ndarray:
        """Return how many nodes the spheres of consecutive particles overlap."""
        number = dr.arange(self.backend.UInt, last - first) + dr.opaque(self.backend.UInt, first)
        return np.array(self._walk(number, lambda node, count, overlap: None)[1])

    def pairs(self, first: int, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the particle and the node of each pair, of as many particles as counts."""
        UInt, total = self.backend.UInt, int(counts.sum(dtype=np.int64))
        number = dr.arange(UInt, len(counts)) + dr.opaque(UInt, first)
        start = from_host(UInt, np.cumsum(counts, dtype=np.int64) - counts)
        particle, node = dr.zeros(UInt, total), dr.zeros(UInt, total)
        dr.eval(number, start, particle, node)

        def store(here: Int, count: Int, overlap: Any) -> None:
            dr.scatter(particle, number, start + count, overlap)
            dr.scatter(node, here, start + count, overlap)

        dr.eval(self._walk(number, store))
        return np.array(particle), np.array(node)

    def _walk(self, number: Int, store: Callable[[Int, Int, Any], None]) -> tuple[Int, Int]:
        UInt, packet = self.backend.UInt, self.backend.packet(4)
        sphere = dr.gather(packet, self.spheres, number)

        def step(node: Int, count: Int) -> tuple[Int, Int]:
            box = dr.gather(packet, self.boxes, node)
            after = dr.gather(UInt, self.after, node)
            distance2 = self.backend.Wide(0.0)
            for axis, width in enumerate(self.width):
                below = box[axis] - sphere[axis]
                above = -(below + box[3] * width)
                far = dr.select(below > above, below, above)
                far = dr.select(far > 0.0, far, 0.0)
                distance2 = dr.fma(far, far, distance2)
            touched = distance2 < sphere[3] * sphere[3]
            ends = (after == node + 1) | (box[3] * self.widest <= sphere[3])
            store(node, count, touched & ends)
            deeper = dr.select(touched & ~ends, node + 1, after)
            return deeper, count + dr.select(touched & ends, 1, 0)

        state = dr.zeros(UInt, dr.width(number)), dr.zeros(UInt, dr.width(number))
        inside = lambda node, count: node < self.end  # noqa: E731
        walked: tuple[Int, Int] = loop(state, inside, step, label="overlaps")
        return walked

    def weights(self, particle: np.ndarray, node: np.ndarray) -> np.ndarray:
        """Return the weights of pairs, float32: they add up to about one for each particle."""
        single, UInt, packet = self.single, self.backend.UInt, self.backend.packet(4)
        box = dr.gather(packet, self.boxes, from_host(UInt, node))
        sphere = dr.gather(packet, self.spheres, from_host(UInt, particle))
        lows, steps, counts = [], [], []
        for axis, width in enumerate(self.width):
            low = box[axis] - sphere[axis]
            a, b = (single.Float(v / sphere[3]) for v in (low, low + box[3] * width))
            a, b = dr.select(a > -1.0, a, -1.0), dr.select(b < 1.0, b, 1.0)
            count = single.UInt(dr.ceil((b - a) * (1.0 / _STEP)))
            counts.append(dr.select(count > 0, count, 1))
            lows.append(a)
            steps.append((b - a) / single.Float(counts[-1]))
        number = counts[0] * counts[1] * counts[2]

        def add(k: Int, index: list[Int], total: Float) -> tuple[Int, list[Int], Float]:
            places = zip(lows, steps, index, strict=True)
            x, y, z = (dr.fma(single.Float(i) + 0.5, step, low) for low, step, i in places)
            u = dr.sqrt(x * x + y * y + z * z)
            value = self.kernel.shape(u, lambda x: dr.select(x > 0.0, x, 0.0))
            i, j, layer = index  # the first axis fastest
            row = i + 1 == counts[0]
            full = row & (j + 1 == counts[1])
            j = dr.select(row, j + 1, j)
            following = [dr.select(row, 0, i + 1), dr.select(full, 0, j)]
            return k + 1, [*following, dr.select(full, layer + 1, layer)], total + value

        nothing = dr.zeros(single.Float, dr.width(number))
        state = (single.UInt(nothing), [single.UInt(nothing) for _ in counts], nothing)
        more = lambda k, index, total: k < number  # noqa: E731
        total = loop(state, more, add, label="kernel")[2]
        least = dr.opaque(single.Float, _FAINT * self.kernel.peak)
        total = dr.select(total < least * single.Float(number), 0.0, total)
        return np.array(total * (steps[0] * steps[1] * steps[2]) * self.kernel.norm)


# Pairs of a particle and a node computed at once: 200 MiB of temporary arrays.
_PAIRS = 1 << 22
# Bytes of pairs that are cached for further fields; more are computed again for each.
_CACHED = 1 << 30

# A range of particles, their numbers of nodes, and these nodes and their weights.
Pairs = tuple[slice, np.ndarray, np.ndarray, np.ndarray]


class SmoothedDeposit(Deposit):
    """Each particle is spread over the nodes that its kernel overlaps.

    The weight of a node is the kernel's integral over it. The weights of a particle are divided by
    their sum, so that nothing is lost where the domain ends; unless there are particles outside of
    it: then what kernels have outside is outside. `radius` (n,) is that of the kernels' support;
    kernels are resolved `steps` times finer than usual.
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
        self.overlaps = Overlaps(self.nodes, near, radius[self.owner], kernel, steps)
        self.counts = self.overlaps.counts(0, len(near))
        needed = 8 * int(self.counts.sum(dtype=np.int64))
        self.cached: list[Pairs] | None = None
        if needed < _CACHED and fits(2 * needed):
            self.cached = list(self._pairs())
        self.norm = np.zeros(len(mass))
        for part, counts, _, weight in self.cached or self._pairs():
            owner = np.repeat(self.owner[part], counts)
            self.norm += np.bincount(owner, weight, len(mass))
        self.norm[self.norm == 0] = 1.0
        if not base.periodic and not base.inside(points).all():
            self.norm[crossing(base, points, radius)] = 1.0

    def _pairs(self) -> Iterator[Pairs]:
        ends = np.cumsum(self.counts, dtype=np.int64)
        first, report = 0, reporter()
        while first < len(ends):
            done = ends[first - 1] if first else 0
            last = max(int(np.searchsorted(ends, done + _PAIRS, "right")), first + 1)
            part, counts = slice(first, last), self.counts[first:last]
            particle, node = self.overlaps.pairs(first, counts)
            yield part, counts, node, self.overlaps.weights(particle, node)
            first = last
            report(last, len(ends))

    def amounts(self, *carried: np.ndarray) -> list[np.ndarray]:
        sums = [np.zeros(self.nodes.size) for _ in carried]
        parts = [(values / self.norm)[self.owner] for values in carried]
        for part, counts, node, weight in self.cached or self._pairs():
            for total, values in zip(sums, parts, strict=True):
                # A value that is missing does not count where nothing of its particle is.
                shares, nothing = np.repeat(values[part], counts), np.zeros(len(node))
                amount = np.multiply(weight, shares, out=nothing, where=weight > 0)
                total += np.bincount(node, amount, self.nodes.size)
        return [self.nodes.spread(total) for total in sums]
