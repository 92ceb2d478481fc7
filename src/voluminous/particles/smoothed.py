"""Particles smoothed by a kernel: how much of each lies in the nodes of an octree.

In kernels each lane is a particle. It walks through the nodes depth first and skips those that its
sphere does not touch; it stops at leaves, and at nodes small compared with its radius. The weight
of a node is the particle's kernel summed over midpoints of the box that the node and the cube
around the kernel's support have in common.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr, from_host, get_backend
from ..grids import OctreeGrid
from ..memory import fits
from ..progress import reporter
from .deposit import Deposit, crossing, with_images
from .kernels import Kernel
from .octree import Base

if TYPE_CHECKING:
    from ..backend.device import Backend


@dataclass(frozen=True)
class OctreeNodes:
    """Nodes depth first: a split node is followed by all that is in it.

    Attributes
    ----------
    level : array of uint8, shape (nodes,)
    low : array of float64, shape (nodes, 3)
        Lower corners.
    width : array of float64, shape (3,)
        Of the base cells.
    after : array of uint32, shape (nodes,)
        The node that follows once all in a node is done with; that of a leaf is the next one.
    leaf : array of int64, shape (leaves,)
        Which nodes are leaves, in the grid's order.
    """

    level: np.ndarray
    low: np.ndarray
    width: np.ndarray
    after: np.ndarray
    leaf: np.ndarray

    @property
    def part(self) -> np.ndarray:
        """Widths of the nodes as parts of the base cells'."""
        return np.ldexp(1.0, -self.level.astype(np.int64))

    @property
    def size(self) -> int:
        """Number of nodes."""
        return len(self.level)

    def spread(self, amounts: np.ndarray) -> np.ndarray:
        """Return what leaves hold, once what each split node holds is spread evenly in it.

        Parameters
        ----------
        amounts : array of float64, shape (nodes,)
            Is changed.
        """
        for level in range(1, int(self.level.max()) + 1):
            parents = np.flatnonzero((self.level == level - 1) & ~self._is_leaf())
            if not len(parents):
                break
            own = np.flatnonzero(self.level == level)
            amounts[own] += 0.125 * amounts[parents[np.searchsorted(parents, own) - 1]]
        return amounts[self.leaf]

    def _is_leaf(self) -> np.ndarray:
        return self.after == np.arange(1, self.size + 1)


def nodes_of(grid: OctreeGrid) -> OctreeNodes:
    """Return all nodes of an octree on equally wide base cells."""
    first = grid.places.aligned_levels().astype(np.int64)
    count = grid.levels - first + 1
    leaf = np.cumsum(count) - 1
    # A leaf comes after the split nodes that begin where it does.
    level = np.repeat(first - np.cumsum(count) + count, count) + np.arange(leaf[-1] + 1)
    low, _ = grid.corners()
    width = np.array([(e[-1] - e[0]) / (len(e) - 1) for e in grid.base_edges])
    return OctreeNodes(
        level.astype(np.uint8), np.repeat(low.T, count, axis=0), width, _after(level), leaf
    )


def _after(level: np.ndarray) -> np.ndarray:
    after = np.empty(len(level), np.uint32)
    for own in range(int(level.max()) + 1):
        ends = np.append(np.flatnonzero(level <= own), len(level))
        nodes = np.flatnonzero(level == own)
        after[nodes] = ends[np.searchsorted(ends, nodes) + 1]
    return after


# A sphere of radius H stops at nodes of this part of H: there are not more than 3000 of these.
_PART = 0.25


@dataclass(frozen=True)
class OverlapPairs:
    """Particles and nodes that overlap: arrays of uint32, shape (pairs,)."""

    particle: np.ndarray
    node: np.ndarray


class Overlaps:
    """Finds pairs of spheres and nodes.

    Parameters
    ----------
    nodes : OctreeNodes
    points : array of float64, shape (n, 3)
        Centres of the spheres.
    radius : array of float64, shape (n,)
    backend : Backend
        In double precision.
    steps : int
        Into how many the part of a radius is cut again at which spheres stop.
    """

    def __init__(
        self,
        nodes: OctreeNodes,
        points: np.ndarray,
        radius: np.ndarray,
        backend: Backend,
        steps: int = 1,
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

    def pairs(self, first: int, counts: np.ndarray) -> OverlapPairs:
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
        return OverlapPairs(np.array(particle), np.array(node))

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


def packed(backend: Backend, points: np.ndarray, last: np.ndarray) -> Any:
    """Return points (n, 3) and a fourth number for each, to be gathered at once."""
    rows = np.empty((len(points), 4))
    rows[:, :3], rows[:, 3] = points, last
    return from_host(backend.Float, rows.ravel())


# Midpoints are at most this part of the support's radius apart.
_STEP = 0.25
# Where a kernel is fainter than this part of its centre it is left out, at the rim: densities fall
# by twelve decades there, which is no property of the data, and pictures in log10 show it.
_FAINT = 1e-3


class KernelWeights:
    """Parts of kernels in nodes.

    Parameters
    ----------
    overlaps : Overlaps
    kernel : Kernel
    """

    def __init__(self, overlaps: Overlaps, kernel: Kernel) -> None:
        self.overlaps, self.kernel = overlaps, kernel
        self.backend = overlaps.backend
        # Lengths are in radii of the support here: single precision is enough.
        self.single = self.backend.with_precision("single")

    def of(self, pairs: OverlapPairs) -> np.ndarray:
        """Return the weights of pairs, float32: they add up to about one for each particle."""
        UInt, over = self.backend.UInt, self.overlaps
        packet = self.backend.packet(4)
        box = dr.gather(packet, over.boxes, from_host(UInt, pairs.node))
        sphere = dr.gather(packet, over.spheres, from_host(UInt, pairs.particle))
        low, size = [], []
        for axis, width in enumerate(over.width):
            a, b = self._common(box[axis] - sphere[axis], box[3] * width, sphere[3])
            low.append(a)
            size.append(b - a)
        return np.array(self._integral(low, size))

    def _common(self, low: Any, width: Any, radius: Any) -> tuple[Any, Any]:
        """Return where the common box begins and ends along an axis, in radii from the centre."""
        a, b = (self.single.Float(v / radius) for v in (low, low + width))
        return dr.select(a > -1.0, a, -1.0), dr.select(b < 1.0, b, 1.0)

    def _integral(self, low: list[Any], size: list[Any]) -> Any:
        UInt, Float = self.single.UInt, self.single.Float
        counts = [UInt(dr.ceil(s * (1.0 / _STEP))) for s in size]
        counts = [dr.select(n > 0, n, 1) for n in counts]
        steps = [s / Float(n) for s, n in zip(size, counts, strict=True)]
        number = counts[0] * counts[1] * counts[2]

        def more(k: Any, index: list[Any], total: Any) -> Any:
            return k < number

        def add(k: Any, index: list[Any], total: Any) -> tuple[Any, list[Any], Any]:
            parts = zip(low, steps, index, strict=True)
            x, y, z = (dr.fma(Float(i) + 0.5, step, start) for start, step, i in parts)
            u = dr.sqrt(x * x + y * y + z * z)
            return k + 1, _next(index, counts), total + self.kernel.shape(u, _positive)

        nothing = dr.zeros(Float, dr.width(number))
        state = (UInt(nothing), [UInt(nothing) for _ in counts], nothing)
        total = dr.while_loop(state, more, add, label="kernel")[2]
        least = dr.opaque(Float, _FAINT * self.kernel.peak)
        total = dr.select(total < least * Float(number), 0.0, total)
        return total * (steps[0] * steps[1] * steps[2]) * self.kernel.norm


def _next(index: list[Any], counts: list[Any]) -> list[Any]:
    """Return the next place of an array of some shape, the first axis fastest."""
    i, j, k = index
    row = i + 1 == counts[0]
    layer = row & (j + 1 == counts[1])
    j = dr.select(row, j + 1, j)
    return [dr.select(row, 0, i + 1), dr.select(layer, 0, j), dr.select(layer, k + 1, k)]


def _positive(x: Any) -> Any:
    return dr.select(x > 0.0, x, 0.0)


# Pairs of a particle and a node computed at once: 200 MiB of temporary arrays.
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
