"""A tree of blocks over the cells of a refined grid: from a place to the cell that contains it.

*Places* are whole numbers: along each axis the domain is ``extent`` finest units long, and every
wall of every cell lies at a whole number of them. Which coordinate belongs to a place is the
geometry's business; the tree knows integers only, so the same tree serves Cartesian and curvilinear
grids.

The root block divides the domain into equal *entries*; an entry is either all that one needs to
know of the cells in it, or points to a block of smaller entries. Blocks of one level have the same
shape, so a place is enough to tell which of its entries is meant. An entry is one word::

    kind (3 bits) | number (29 bits)

Kind 0 is a block, which starts at entry `number`; `ABSENT` is a hole, where there is no cell. The
other kinds mean what the tree's *numbering* (`Halved`, or that of patches) says. Many cells may
share an entry (a uniform stretch of the grid), and an entry may be a part of a larger cell: trees
are therefore small beside their cells, and mostly flat.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:
    from ...backend.device import Backend

NUMBER_BITS = 29
NUMBER_MASK = (1 << NUMBER_BITS) - 1
# The number of a place where there is no cell.
NONE = NUMBER_MASK
# The kind of entries that are no blocks, of which a numbering may use others too.
PLAIN = 4
ABSENT = np.uint32(PLAIN << NUMBER_BITS | NONE)


@dataclass(frozen=True)
class Found:
    """Cells found on the host: numbers (n,), -1 for holes; lower corners and sizes (3, n)."""

    number: np.ndarray
    low: np.ndarray
    size: np.ndarray


class Numbering(Protocol):
    """What the entries of a tree mean that are no blocks."""

    def cells(
        self, entry: np.ndarray, place: np.ndarray, unit: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return numbers (n,) and sizes (3, n) of the cells around places (3, n).

        Parameters
        ----------
        entry : array of uint32, shape (n,)
        place : array of int64, shape (3, n)
        unit : array of int64, shape (3, n)
            Size of the entries.
        """

    def traced(self, tree: Tree, backend: Backend) -> Any:
        """Return the same for kernels; see `trees.lookup`."""


@dataclass(frozen=True)
class Tree:
    """Blocks of entries.

    Attributes
    ----------
    extent : array of int64, shape (3,)
        Size of the domain in finest units.
    units : array of int64, shape (K, 3)
        Size of an entry of each tree level, the root first. Each divides the one before; the
        root's last entries may reach beyond the domain.
    entries : array of uint32
        All blocks, the root first; within a block the first axis runs fastest.
    numbering : Numbering
        What entries mean.
    holes : bool
        There are places without a cell.
    bricks : tuple of three int
        The root is laid out in bricks of 2^bricks entries, so that neighbours are near in memory:
        within a brick, and from brick to brick, the first axis runs fastest.
    """

    extent: np.ndarray
    units: np.ndarray
    entries: np.ndarray
    numbering: Any
    holes: bool = False
    bricks: tuple[int, ...] = (0, 0, 0)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of the root's entries along each axis."""
        nx, ny, nz = (int(n) for n in -(-self.extent // self.units[0]))
        return nx, ny, nz

    @property
    def padding(self) -> np.ndarray:
        """How far the root reaches beyond the domain's upper end along each axis, (3,)."""
        padding: np.ndarray = self.units[0] * self.shape - self.extent
        return padding

    @property
    def ratios(self) -> np.ndarray:
        """Shapes of the blocks below the root, (K - 1, 3)."""
        ratios: np.ndarray = self.units[:-1] // self.units[1:]
        return ratios

    @property
    def nbytes(self) -> int:
        """Memory in bytes."""
        return int(self.entries.nbytes)

    def root_place(self, index: np.ndarray) -> np.ndarray:
        """Return where the root's entries with indices (3, n) are."""
        bits = np.array(self.bricks)[:, None]
        size = 1 << bits[:, 0]
        # Shifts in place of divisions: a third of the time.
        brick = _flat(index >> bits, np.array(self.shape) // size)
        return brick * size.prod() + _flat(index & ((1 << bits) - 1), size)

    def find(self, place: np.ndarray) -> Found:
        """Return the cells that contain places inside the domain, an integer array (3, n)."""
        place = np.asarray(place, np.int64)
        entry, level = self.descend(place)
        number, size = self.numbering.cells(entry, place, self.units[level].T)
        return Found(number, place // size * size, size)

    def descend(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the entries around places (3, n) that are no blocks, and their tree levels."""
        level = np.zeros(place.shape[1], np.uint8)
        entry = self.entries[self.root_place(place // self.units[0][:, None])]
        for unit, ratio in zip(self.units[1:], self.ratios, strict=True):
            below = np.flatnonzero(entry >> NUMBER_BITS == 0)
            if len(below) == 0:
                break
            level[below] += 1
            local = place[:, below] // unit[:, None] % ratio[:, None]
            entry[below] = self.entries[entry[below] + _flat(local, ratio)]
        return entry, level


def _flat(index: np.ndarray, shape: np.ndarray) -> np.ndarray:
    flat: np.ndarray = index[0] + shape[0] * (index[1] + shape[1] * index[2])
    return flat
