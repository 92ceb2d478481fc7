"""Octrees and patches larger than memory, in parts of consecutive cells in which rays wait."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..expressions.interval import Interval
from ..fields import coordinate_extremes, held_dtype
from ..grids.contract import CellBox
from ..grids.trees.ghosts import LeavesWithGhosts
from .chunks import CartesianChunks

if TYPE_CHECKING:
    from ..grids.trees.parts import Parts
    from ..media.contract import Medium
    from ..schemes.base import Scheme
    from .prefetch import Prefetch
    from .tracer import BlockTracer

# Bytes of a ray's place in a tree: on the host, and before and after a block.
_WAITING = 240
# Where fields are interpolated: cells with those around per cell, bytes of a cell's corners, place
# and slopes, and of all else while they are computed.
_GHOSTS, _CORNERS, _STENCILS = 1.3, 150, 300 << 20


class TreeParts(CartesianChunks):
    """Consecutive cells of an octree, or of patches, in which rays wait to be drawn."""

    parts: Parts
    # Parts that one task draws.
    groups: Parts
    # By the first cell of a part: it with others around, and the chunks that all these are in.
    _leaves: OrderedDict[int, LeavesWithGhosts]
    _touched: dict[int, np.ndarray]

    def plan(self, medium: Medium, scheme: Scheme, pixels: tuple[int, int]) -> None:
        self._leaves, self._touched = OrderedDict(), {}
        super().plan(medium, scheme, pixels)

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "_leaves": OrderedDict()}

    def _divide(self, per_cell: float, others: int, pixels: tuple[int, int]) -> None:
        # Where rays wait: on the host, and before and after a block. Tables of where cells are.
        others += _WAITING * pixels[0] * pixels[1] + 2 * self.grid.tree.entries.nbytes
        if self.dual:
            per_cell, others = _GHOSTS * (per_cell + _CORNERS), others + _STENCILS
        super()._divide(per_cell, others, pixels)
        (most,) = self.side
        self.parts = self.groups = self.grid.parts(most)
        if len(self.parts.low) > self.most_tasks:
            self.groups = self.grid.parts(max(most, 2 * self.grid.size // self.most_tasks))

    @property
    def geometry(self) -> tuple[np.ndarray, ...]:
        return (*self.grid.base_edges, self.grid.levels, self.parts.low, self.parts.high)

    def blocks(
        self, parallel: bool, origin: np.ndarray, direction: np.ndarray
    ) -> Iterator[CellBox]:
        view = origin.mean(axis=1), direction if parallel else None
        rank = np.empty(len(self.groups.low), np.int64)
        rank[self.groups.front_to_back(*view)] = np.arange(len(rank))
        order = self.parts.front_to_back(*view)
        for k in order[np.argsort(rank[self._group(self.parts.ends[order])], kind="stable")]:
            yield CellBox((int(self.parts.ends[k]),), (int(self.parts.ends[k + 1]),))

    def _groups(self, boxes: Sequence[CellBox]) -> list[Any]:
        return [int(self._group(box.low[0])) for box in boxes]

    def _group(self, cell: Any) -> Any:
        return np.searchsorted(self.groups.ends, cell, "right") - 1

    def extent(self, box: CellBox) -> np.ndarray:
        k = np.searchsorted(self.parts.ends, box.low[0])
        return np.stack([self.parts.low[k], self.parts.high[k]], axis=-1)

    def _ends(self, box: CellBox) -> list[np.ndarray]:
        return list(self.extent(box))

    def ranges_of_chunks(self, names: Any) -> dict[str, Interval]:
        grids = {}
        for name in names:
            ends: Any
            if name in self.volume:
                ends = np.moveaxis(self.volume.extremes(name), -1, 0)
            else:
                ends = coordinate_extremes(self.grid, name)
            if self.dual:  # chunks beside one that shows something are needed, too
                ends = np.min(ends[0]), np.max(ends[1])
            grids[name] = Interval(*(np.asarray(end, np.float64) for end in ends))
        return grids

    def coefficients(
        self, tracer: BlockTracer, box: CellBox, rays: int
    ) -> tuple[Callable[[slice], Any], np.ndarray | None]:
        if not self.dual:
            return super().coefficients(tracer, box, rays)
        leaves = self.leaves(box)
        within = tracer.source.within_leaves(leaves, self.around_leaves(tracer.chunks, leaves))
        return (within.group if len(tracer.groups) > 1 else lambda group: within), None

    def cells(self, box: CellBox) -> tuple[tuple[int, ...], tuple[int, ...]]:
        return box.low, box.high

    def _chunks_of(self, box: CellBox) -> Any:
        if not self.dual:
            return super()._chunks_of(box)
        first, side = box.low[0], self.volume.store.chunks[0]
        if first not in self._touched:
            own, ghosts = np.arange(first // side, -(-box.high[0] // side)), self.leaves(box).ghosts
            self._touched[first] = np.unique(np.concatenate([own, ghosts // side]))
        return self._touched[first]

    def leaves(self, box: CellBox) -> LeavesWithGhosts:
        """Return a part with the leaves around it that interpolated fields need."""
        first, last = box.low[0], box.high[0]
        if first not in self._leaves:
            while len(self._leaves) > 1:  # that of the part before, and of the next
                self._leaves.popitem(last=False)
            self._leaves[first] = LeavesWithGhosts(self.grid, first, last)
        return self._leaves[first]

    def around_leaves(self, chunks: Prefetch, leaves: LeavesWithGhosts) -> dict[str, np.ndarray]:
        """Return fields in a part and, after it, in the ghosts around it."""
        own = ((leaves.first,), (leaves.first + leaves.own,))
        side, ghosts = self.volume.store.chunks[0], leaves.ghosts
        groups = np.split(ghosts, np.flatnonzero(np.diff(ghosts // side)) + 1)
        groups = [group for group in groups if len(group)]
        ends = [((int(group[0]),), (int(group[-1]) + 1,)) for group in groups]
        fields = {}
        for name in self.used:
            for low, high in (own, *ends):
                chunks.ahead(name, low, high)
            values = np.empty(leaves.size, held_dtype(self.volume.dtype(name)))
            values[: leaves.own] = chunks.box(name, *own)
            end = leaves.own
            for group, (low, high) in zip(groups, ends, strict=True):
                values[end : end + len(group)] = chunks.box(name, low, high)[group - low[0]]
                end += len(group)
            fields[name] = values
        return fields
