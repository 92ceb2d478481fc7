"""The vertices of the cells of patches: a lattice for every tile of so many cells of a patch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .patch_cells import Patches
from .vertices import VertexNumbers, corner_numbers

# Cells along each side of a tile: 1.2 vertices per cell, of which neighbours are near in memory.
_SIDE = 16
# Cells numbered at once.
_CHUNK = 1 << 20


def patch_vertices(patches: Patches) -> VertexNumbers:
    """Return the numbers of the vertices of all cells that are seen."""
    tiles = -(-patches.shape // _SIDE)
    ends = np.cumsum(tiles.prod(axis=1))
    starts = ends - tiles.prod(axis=1)
    size, total = int(patches.ends[-1]), int(ends[-1])
    seen, tile, chunks = np.zeros(total, bool), np.empty(size, np.uint32), range(0, size, _CHUNK)
    for begin in chunks:
        patch, index = patches.indices(begin, min(begin + _CHUNK, size))
        x, y, z = index // _SIDE
        _, ny, nz = tiles[patch].T
        here = starts[patch] + (x * ny + y) * nz + z
        tile[begin : begin + len(here)] = here
        seen[here] = True
    lattices = PatchLattices.of(patches, tiles, np.flatnonzero(seen))
    number = np.cumsum(seen) - 1
    first = np.concatenate([[0], np.cumsum(lattices.points.prod(axis=0))])
    cells = np.empty((size, 2), np.uint32)
    for begin in chunks:
        part = slice(begin, min(begin + _CHUNK, size))
        own = number[tile[part]]
        _, index = patches.indices(part.start, part.stop)
        cells[part] = corner_numbers(first[own], index % _SIDE, lattices.points[:, own], 1)
    return VertexNumbers(cells, first, lattices)


@dataclass(frozen=True)
class PatchLattices:
    """Lattices over tiles of patches; see `vertex_numbers.Lattices`.

    Attributes
    ----------
    low, step, points : array of int64, shape (3, n)
    """

    low: np.ndarray
    step: np.ndarray
    points: np.ndarray

    @classmethod
    def of(cls, patches: Patches, tiles: np.ndarray, some: np.ndarray) -> PatchLattices:
        """Return the lattices of some tiles.

        Parameters
        ----------
        patches : Patches
        tiles : array of int, shape (patches, 3)
            How many tiles patches have along each axis.
        some : array of int, shape (n,)
            Numbers of tiles: patch after patch, in C order.
        """
        counts = tiles.prod(axis=1)
        ends = np.cumsum(counts)
        patch = np.searchsorted(ends, some, side="right")
        row, z = np.divmod(some - (ends - counts)[patch], tiles[patch, 2])
        begin = np.stack([*np.divmod(row, tiles[patch, 1]), z]) * _SIDE
        step = patches.sizes[patches.level[patch]].T
        low = (patches.low[patch].T + begin) * step
        return cls(low, step, np.minimum(patches.shape[patch].T - begin, _SIDE) + 1)

    def boxes(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return first points, spacings, and points per axis of consecutive lattices."""
        some = slice(first, last)
        return self.low[:, some], self.step[:, some], self.points[:, some]
