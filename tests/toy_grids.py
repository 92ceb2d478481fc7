"""A grid of nobody's own: the cells of a Cartesian grid in any order, flat as the leaves of a tree.

What is right on it is right on any grid that keeps `grids.contract`, and known from the original.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import voluminous as vm
from voluminous.backend import dr
from voluminous.grids.contract import BoxGrid, VertexGrid, check_walk
from voluminous.rendering.sources.corner_layouts import CornerPackets


class ShuffledWalk:
    """The original's walk; it tells the flat grid's cell numbers."""

    def __init__(self, walk, number, backend):
        self.walk, self.backend = walk, backend
        self.number = backend.UInt(number.astype(np.uint32))

    def __getattr__(self, name):
        return getattr(self.walk, name)

    def next(self, track, cursor):
        segment, cursor = self.walk.next(track, cursor)
        cell = dr.gather(self.backend.UInt, self.number, segment.cell, segment.active)
        return replace(segment, cell=cell), cursor


class ShuffledGrid(BoxGrid, VertexGrid):
    """The cells of `original` in another order: cell k is the original's cell `order[k]`."""

    kind = "shuffled"

    def __init__(self, original, seed=0):
        self.original, self.size = original, original.size
        self.order = np.random.default_rng(seed).permutation(self.size)
        self.number = np.argsort(self.order)
        self.shape, self.unit, self.scale = (self.size,), original.unit, original.scale
        self.bounds, self.vertex_count = original.bounds, original.vertex_count
        self.needs_double = original.needs_double
        self.first_cell_width = original.first_cell_width
        self.cell_volumes = original.cell_volumes.ravel()[self.order]
        self.levels = np.zeros(self.size, np.uint8)
        self._walks = {}

    def shuffled(self, field):
        """Return a field of the original on this grid."""
        return np.asarray(field).ravel()[self.order]

    def cell_centers(self, first=0, last=None):
        return self.original.cell_centers()[:, self.order[first:last]]

    def cell_sizes(self, first=0, last=None):
        return self.original.cell_sizes()[:, self.order[first:last]]

    def locate(self, points):
        found = self.original.locate(points)
        return np.where(found >= 0, self.number[found], -1)

    def vertex_cells(self, vertex, backend):
        number = backend.UInt(self.number.astype(np.uint32))
        return [
            (dr.gather(backend.UInt, number, backend.UInt(cell), there), there)
            for cell, there in self.original.vertex_cells(vertex, backend)
        ]

    def walk(self, backend, kind="cells", box=None):
        check_walk(self, kind, ["cells", "substeps"], box)
        key = (backend.device, backend.precision, kind)
        if key not in self._walks:
            walk = self.original.walk(backend, kind)
            self._walks[key] = ShuffledWalk(walk, self.number, backend)
        return self._walks[key]

    def describe(self):
        return {**self.original.describe(), "shape": [self.size]}

    def __repr__(self):
        return f"<ShuffledGrid of {self.size} cells>"


class LinearCells(vm.OctreeGrid):
    """An octree in which a field is linear in x within each cell, and jumps between cells.

    `rise` (cells,): by how much it changes from one side of a cell to the other.
    """

    rise = 0.0

    def walk_through(self, tree, backend, kind="cells"):
        walk = super().walk_through(tree, backend, kind)
        walk.continuous = False
        return walk

    def dual_layout(self, arrays, backend, sums):
        ends = np.repeat([-0.5, 0.5], 4)
        steps = np.multiply.outer(np.broadcast_to(self.rise, self.shape), ends)
        corners = [(array[:, None] + steps).ravel() for array in arrays]
        return [CornerPackets(backend.Float(c), 1.0, backend.packet(4)) for c in corners]
