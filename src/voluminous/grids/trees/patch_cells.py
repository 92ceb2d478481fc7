"""The cells of nested patches: which are covered by finer ones, and how the others are numbered.

Cells are numbered patch after patch, in C order within a patch (the last axis fastest);
covered ones are left out. The number of a cell in a patch that is seen entirely follows from its
place; those of the other patches are looked up.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr, from_host
from ...backend.types import Float, Int, Mask
from ...errors import InputError
from .patch_tree import PatchBoxes, PatchEntries, patch_entries
from .tree import ABSENT, NONE, NUMBER_BITS, NUMBER_MASK, PLAIN, Cell, Orientation, Tree
from .vertices import VertexNumbers, corner_numbers

if TYPE_CHECKING:
    from ...backend.device import Backend

# Parts of cells that are rounding.
_PART = 1e-9
# Marks patches that are seen partly: the numbers of their cells are looked up.
_TABLED = 1 << 31
# Cells along each side of a tile with vertices of its own: 1.2 vertices per cell, of which
# neighbours are near in memory.
_SIDE = 16
# Cells whose vertices are numbered at once.
_CHUNK = 1 << 20


@dataclass(frozen=True)
class Patches:
    """Patches on the lattices of their levels.

    Attributes
    ----------
    sizes : array of int64, shape (levels, 3)
        Size of a cell of each level in finest units.
    level : array of int64, shape (n,)
    low, shape : array of int64, shape (n, 3)
        First cell of each patch, counted in cells of its level, and its number of cells.
    extent : array of int64, shape (3,)
        Size of the domain in finest units.
    """

    sizes: np.ndarray
    level: np.ndarray
    low: np.ndarray
    shape: np.ndarray
    extent: np.ndarray

    @property
    def corners(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corners in finest units, (n, 3)."""
        size = self.sizes[self.level]
        return self.low * size, (self.low + self.shape) * size

    @functools.cached_property
    def volumes(self) -> np.ndarray:
        """Number of cells of each patch, covered ones included."""
        volumes: np.ndarray = self.shape.prod(axis=1)
        return volumes

    @functools.cached_property
    def _entries(self) -> PatchEntries:
        order = np.argsort(self.level, kind="stable")
        low, high = self.corners
        boxes = PatchBoxes(low[order], high[order], self.level[order], order)
        return patch_entries(boxes, self.extent, int(self.volumes.sum()))

    @functools.cached_property
    def tree(self) -> Tree:
        entries = self._entries
        numbering = PatchNumbering(self)
        tree = Tree(self.extent, entries.units, entries.entries, numbering, True, entries.clusters)
        # What the root has beyond the domain is absent, but no hole. Whole numbers of any size.
        absent = sum(
            int(np.count_nonzero(words == ABSENT)) * math.prod(unit.tolist())
            for unit, words in entries.levels()
        )
        inside, whole = self.extent.tolist(), (self.extent + tree.padding).tolist()
        return replace(tree, holes=absent > math.prod(whole) - math.prod(inside))

    @functools.cached_property
    def _shown(self) -> np.ndarray:
        """How much of each patch no finer one hides, in cells; whole numbers, if all is well."""
        total = np.zeros(len(self.level))
        for unit, words in self._entries.levels():
            name = words[_names(words)] & NUMBER_MASK
            count = np.bincount(name, minlength=len(self.level))
            total += count * (unit / self.sizes[self.level]).prod(axis=1)
        return total

    @functools.cached_property
    def visible(self) -> np.ndarray:
        """Number of cells of each patch that no finer one hides."""
        return np.round(self._shown).astype(np.int64)

    @functools.cached_property
    def ends(self) -> np.ndarray:
        """Number of the cell after the last one of each patch."""
        return np.cumsum(self.visible)

    @functools.cached_property
    def covered(self) -> np.ndarray:
        """True for patches that are seen partly."""
        covered: np.ndarray = (self._shown > _PART) & (self._shown < self.volumes - _PART)
        return covered

    @functools.cached_property
    def first_slots(self) -> np.ndarray:
        """Where the cells of each patch start in `numbers`, for those that are seen partly."""
        volumes = np.where(self.covered, self.volumes, 0)
        first: np.ndarray = np.cumsum(volumes) - volumes
        return first

    @functools.cached_property
    def numbers(self) -> np.ndarray:
        """Numbers of all cells of patches that are seen partly, in C order; NONE where covered."""
        partly = np.flatnonzero(self.covered)
        seen = self._seen(int(self.volumes[partly].sum()))
        if np.count_nonzero(seen) > self._shown[partly].sum() + _PART * len(seen):
            counts = np.add.reduceat(seen, self.first_slots[partly], dtype=np.int64)
            cut = int(partly[np.argmax(counts - self._shown[partly])])
            self._check_cuts(np.flatnonzero(self.level > self.level[cut]), np.array([cut]))
        visible = self.visible[partly]
        skipped = self.ends[partly] - np.cumsum(visible)  # cells of other patches before
        number = np.repeat(skipped.astype(np.uint32), visible)
        number += np.arange(len(number), dtype=np.uint32)
        numbers = np.full(len(seen), NONE, np.uint32)
        numbers[seen] = number
        return numbers

    def _seen(self, count: int) -> np.ndarray:
        """Return which cells of patches that are seen partly are seen: those that entries name.

        All that entries hold of the patches of a level at once, cell by cell within them: a fifth
        of the time that asking the tree for every cell takes.
        """
        seen = np.zeros(count, bool)
        for depth, (unit, words) in enumerate(self._entries.levels()):
            chosen = np.flatnonzero(_names(words))
            chosen = chosen[self.covered[words[chosen] & NUMBER_MASK]]
            for some, index in self._entries.located(depth, chosen):
                patch = (words[some] & NUMBER_MASK).astype(np.int64)
                for level in np.unique(self.level[patch]).tolist():
                    here = self.level[patch] == level
                    begin = index[:, here] * unit[:, None]
                    for slot in self._slots(level, patch[here], begin, unit):
                        seen[slot] = True
        return seen

    def _slots(
        self, level: int, patch: np.ndarray, begin: np.ndarray, unit: np.ndarray
    ) -> list[np.ndarray]:
        size, (ny, nz) = self.sizes[level], self.shape[patch, 1:].T
        slots = [self.first_slots[patch]]
        for axis, stride in enumerate((ny * nz, nz, 1)):
            # An entry may begin, or end, inside a cell, of which the rest is in another.
            first = begin[axis] // size[axis]
            last = (begin[axis] + unit[axis] - 1) // size[axis]
            counts = range(int((last - first).max(initial=0)) + 1)
            cells = [np.minimum(first + k, last) - self.low[patch, axis] for k in counts]
            slots = [slot + cell * stride for slot in slots for cell in cells]
        return slots

    @functools.cached_property
    def rows(self) -> np.ndarray:
        """Per patch: ``start + i sx + j sy + k`` numbers its cells, as (start, sx, sy, what).

        Indices are those of the level's cells across the domain; sums are modulo 2^32. What is the
        level, and `_TABLED` if that number is a place in `numbers`.
        """
        ny, nz = self.shape[:, 1], self.shape[:, 2]
        start = np.where(self.covered, self.first_slots, self.ends - self.visible)
        start = start - (self.low[:, 0] * ny + self.low[:, 1]) * nz - self.low[:, 2]
        what = self.level | np.where(self.covered, _TABLED, 0)
        return (np.stack([start, ny * nz, nz, what], axis=1) & 0xFFFFFFFF).astype(np.uint32)

    def boxes(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Return lower corners and sizes of consecutive cells in finest units, int64 (3, n)."""
        patch, index = self.indices(first, last)
        size = self.sizes[self.level].T[:, patch]
        return (index + self.low.T[:, patch]) * size, size

    def indices(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the patches of consecutive cells, and indices in these, int64 (n,) and (3, n)."""
        begin, end = np.searchsorted(self.ends, [first, last - 1], side="right")
        some = slice(begin, end + 1)
        starts = (self.ends - self.visible)[some]
        stops = np.minimum(self.ends[some], last)
        counts = stops - np.maximum(starts, first)
        # Cells of a patch follow each other: a fifth of the time of looking up what each is in.
        patch = np.repeat(np.arange(begin, end + 1), counts)
        local = np.arange(first, last) - np.repeat(starts, counts)
        for k in np.flatnonzero(self.covered[some]):
            here = slice(stops[k] - counts[k] - first, stops[k] - first)
            local[here] = self.seen_cells(begin + k)[local[here]]
        row, z = np.divmod(local, self.shape[patch, 2])
        return patch, np.stack([*np.divmod(row, self.shape[patch, 1]), z])

    def surface(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Return boxes of those of consecutive cells without all neighbours in their own patch."""
        found = []
        begin, end = np.searchsorted(self.ends, [first, last - 1], side="right")
        for patch in range(begin, end + 1):
            start = self.ends[patch] - self.visible[patch]
            number = start + np.arange(self.visible[patch])
            if self.covered[patch]:
                slot = self.first_slots[patch]
                number = self.numbers[slot : slot + self.volumes[patch]]
            elif not len(number):
                continue
            own = ((number >= first) & (number < last)).reshape(self.shape[patch])
            inner = np.pad(own, 1)
            for axis in range(3):
                lines = np.moveaxis(inner, axis, 0)
                lines[1:-1] &= lines[2:] & lines[:-2]
            index = np.nonzero(own & ~inner[1:-1, 1:-1, 1:-1])
            size = self.sizes[self.level[patch]][:, None]
            low = (np.stack(index) + self.low[patch][:, None]) * size
            found.append((low, np.broadcast_to(size, low.shape)))
        low, size = (np.concatenate(each, axis=1) for each in zip(*found, strict=True))
        return low, size

    def seen_cells(self, patch: int) -> np.ndarray:
        """Return the cells that are seen of a patch which is seen partly, in C order."""
        first = self.first_slots[patch]
        return np.flatnonzero(self.numbers[first : first + self.volumes[patch]] != NONE)

    def check_alignment(self) -> None:
        """Refuse patches that begin or end inside a cell of a coarser patch around them."""
        low, high = self.corners
        for level in range(1, len(self.sizes)):
            here, coarse = np.flatnonzero(self.level == level), self.sizes[level - 1]
            cut = ((low[here] % coarse != 0) | (high[here] % coarse != 0)).any(axis=1)
            for patch in here[cut]:
                self._check_cuts(np.array([patch]), np.flatnonzero(self.level < level))
        for level in range(2, len(self.sizes)):
            finer, size = self.level >= level, self.sizes[level - 2]
            if (low[finer] % size).any() or (high[finer] % size).any():
                # That is well if there is a patch of the level between around them.
                _ = self.numbers  # refuses cells that are seen partly
                return

    def _check_cuts(self, fine: np.ndarray, coarse: np.ndarray) -> None:
        low, high = self.corners
        first = np.maximum(low[fine], low[coarse])
        last = np.minimum(high[fine], high[coarse])
        size = self.sizes[self.level[coarse]]
        inside = ((first % size != 0) | (last % size != 0)).any(axis=1)
        cut = np.flatnonzero((first < last).all(axis=1) & inside)
        if len(cut):
            patch, other = (int(p[cut[0] % len(p)]) for p in (fine, coarse))
            raise InputError(
                f"patch {patch} (level {self.level[patch]}) begins or ends inside a cell of patch "
                f"{other} (level {self.level[other]}): finer patches must consist of whole coarse "
                "cells"
            )


def _names(words: np.ndarray) -> np.ndarray:
    named: np.ndarray = (words >> NUMBER_BITS == PLAIN) & (words != ABSENT)
    return named


@dataclass(frozen=True)
class PatchNumbering:
    """Entries that name the patch whose cells they are covered by; see `tree.Numbering`."""

    patches: Patches

    def cells(
        self, entry: np.ndarray, place: np.ndarray, unit: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        hole, patches = entry == ABSENT, self.patches
        patch = np.where(hole, 0, entry & NUMBER_MASK)
        size = patches.sizes[patches.level[patch]].T
        index = place // size - patches.low[patch].T
        ny, nz = patches.shape[patch, 1], patches.shape[patch, 2]
        local = (index[0] * ny + index[1]) * nz + index[2]
        number = local + (patches.ends - patches.visible)[patch]
        partly = patches.covered[patch] & ~hole
        number[partly] = patches.numbers[(local + patches.first_slots[patch])[partly]]
        return np.where(hole, -1, number), np.where(hole, unit, size)

    def traced(self, tree: Tree, backend: Backend) -> TracedPatches:
        return TracedPatches(self.patches, tree, backend)


class TracedPatches:
    """From an entry to the cell around a place, by what is known of the entry's patch.

    Places are in finest units. Ratios of refinement being any, indices are found by multiplying
    with rounded numbers: places are moved to the middle of their finest unit first, so that
    rounding changes no index.
    """

    def __init__(self, patches: Patches, tree: Tree, backend: Backend) -> None:
        self.backend, self.holes = backend, tree.holes
        self.rows = from_host(backend.UInt, patches.rows.reshape(-1))
        self.Four = backend.module.Array4u
        self.tabled = bool(patches.covered.any())
        self.numbers = backend.UInt(patches.numbers) if self.tabled else None
        self.blocks = _blocks(patches, tree, backend)
        # Of indices beyond 32 bits the lowest 32 are wanted.
        small = int(tree.extent.max()) < 1 << 32
        self.Whole: Any = backend.UInt if small else dr.uint64_array_t(backend.UInt)
        # Per axis and level: the size of a cell, one over it, and how many make the domain.
        self.alike = bool((patches.sizes == patches.sizes[:, :1]).all())
        self.sizes = [
            [
                (
                    backend.opaque(float(size)),
                    backend.opaque(1.0 / size),
                    dr.opaque(backend.UInt, int(length // size) & 0xFFFFFFFF),
                )
                for size in column
            ]
            for column, length in zip(patches.sizes.T, tree.extent, strict=True)
        ]
        # Per axis: sizes of the tree's entries, one over these, and entries per entry above.
        units = tree.units.T.astype(float)
        self.per_root = [backend.opaque(1.0 / u[0]) for u in units]
        self.unit = [from_host(backend.Float, u) for u in units]
        self.per_unit = [from_host(backend.Float, 1.0 / u) for u in units]
        ratios = np.concatenate([[tree.shape], tree.ratios]).astype(np.uint32)
        self.ratios = [from_host(backend.UInt, r) for r in ratios.T]

    def located(self, place: list[Float]) -> list[Float]:
        return [dr.floor(p) + 0.5 for p in place]

    def root(self, place: list[Float]) -> list[Int]:
        return [self.backend.UInt(p * i) for p, i in zip(place, self.per_root, strict=True)]

    def slot(self, place: list[Float], level: Int, sense: Orientation) -> Int:
        Float, UInt = self.backend.Float, self.backend.UInt
        slot, stride, level = UInt(0), UInt(1), UInt(level)
        for axis, p in enumerate(place):
            per_unit = dr.gather(Float, self.per_unit[axis], level)
            per_outer = dr.gather(Float, self.per_unit[axis], level - 1)
            ratio = dr.gather(UInt, self.ratios[axis], level)
            local = self._index(p * per_unit) - self._index(p * per_outer) * ratio
            slot = slot + _unmirrored(local, ratio, sense.flip[axis]) * stride
            stride = stride * ratio
        return slot

    def cell(
        self, entry: Int, place: list[Float], level: Int, sense: Orientation, active: Mask
    ) -> Cell:
        """Return the cells around places, from leaf entries of a tree level.

        Of lanes that are not active anything may be returned.
        """
        UInt, patch = self.backend.UInt, entry & NUMBER_MASK
        hole = patch == NONE if self.holes else None
        patch = patch if hole is None else dr.select(hole, 0, patch)
        *row, what = dr.gather(self.Four, self.rows, patch)
        size, per_size, count = self._sizes_of_level(what & (_TABLED - 1))
        if hole is not None:  # a hole is as large as its entry
            here = UInt(level)
            for sizes, units in ((size, self.unit), (per_size, self.per_unit)):
                for axis, unit in enumerate(units):
                    own = dr.gather(self.backend.Float, unit, here)
                    sizes[axis] = dr.select(hole, own, sizes[axis])
        index = [dr.floor(p * s) for p, s in zip(place, per_size, strict=True)]
        low = [i * s for i, s in zip(index, size, strict=True)]
        i, j, k = (
            _unmirrored(self._index(own), n, flip)
            for own, n, flip in zip(index, count, sense.flip, strict=True)
        )
        number = row[0] + i * row[1] + j * row[2] + k
        if self.tabled:
            tabled = active & (what >= _TABLED)
            tabled = tabled if hole is None else tabled & ~hole
            number = dr.select(tabled, dr.gather(UInt, self.numbers, number, tabled), number)
        number = number if hole is None else dr.select(hole, NONE, number)
        cell = Cell(number, low, size[:1] if self.alike and hole is None else size)
        if self.blocks is None:
            return cell
        strides = (row[1], row[2], UInt(1))
        # All bits or none: modulo 2^32, the stride or minus it.
        cell.strides = [(s ^ flip) - flip for s, flip in zip(strides, sense.flip, strict=True)]
        cell.end = [
            # Halves keep quotients of whole numbers away from these, however they are rounded.
            dr.fma(dr.floor(dr.fma(own, per_block, 0.5 * per_block)), n, n) * s
            for own, s, (n, per_block) in zip(index, size, self.blocks, strict=True)
        ]
        return cell

    def sizes_of(self, cell: Cell) -> list[Float]:
        return cell.size * (3 // len(cell.size))

    def _sizes_of_level(self, level: Int) -> tuple[list[Float], list[Float], list[Int]]:
        """Return sizes, one over them, and how many make the domain (modulo 2^32), per axis.

        There are few levels: choosing takes an operation for each, looking up as long as ten.
        """
        found = []
        for levels in self.sizes:
            chosen = levels[-1]
            for k, values in enumerate(levels[:-1]):
                chosen = tuple(
                    dr.select(level == k, v, c) for v, c in zip(values, chosen, strict=True)
                )
            found.append(chosen)
        size, per_size, count = (list(values) for values in zip(*found, strict=True))
        if self.alike:
            size, per_size = [size[0]] * 3, [per_size[0]] * 3
        return size, per_size, count

    def _index(self, index: Float) -> Int:
        return self.backend.UInt(self.Whole(index))


def _blocks(patches: Patches, tree: Tree, backend: Backend) -> list[tuple[Float, Float]] | None:
    """Return the shape of patches, and one over it, where they are blocks of one shape.

    Those of each level are on a lattice of their own, as they are in Athena++ and FLASH. None where
    they are not, or where some of their cells are not to be seen.
    """
    shape, counts = patches.shape[0], tree.extent // patches.sizes
    uneven = (patches.shape != shape).any() or (patches.low % shape).any()
    if uneven or (counts % shape).any() or patches.covered.any() or tree.holes:
        return None
    return [(backend.opaque(float(n)), backend.opaque(1.0 / n)) for n in shape]


def _unmirrored(index: Int, count: Int, flip: Int) -> Int:
    """Return indices below a count, counted from the other end where `flip` has all bits set."""
    return (index ^ flip) + (count & flip)


def patch_vertices(patches: Patches) -> VertexNumbers:
    """Return the numbers of the vertices of all cells that are seen: a lattice for every tile."""
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
    some = np.flatnonzero(seen)
    patch = np.searchsorted(ends, some, side="right")
    row, z = np.divmod(some - starts[patch], tiles[patch, 2])
    corner = np.stack([*np.divmod(row, tiles[patch, 1]), z]) * _SIDE
    step = patches.sizes[patches.level[patch]].T
    points = np.minimum(patches.shape[patch].T - corner, _SIDE) + 1
    lattices = TileLattices((patches.low[patch].T + corner) * step, step, points)
    number = np.cumsum(seen) - 1
    first = np.concatenate([[0], np.cumsum(points.prod(axis=0))])
    cells = np.empty((size, 2), np.uint32)
    for begin in chunks:
        part = slice(begin, min(begin + _CHUNK, size))
        own = number[tile[part]]
        _, index = patches.indices(part.start, part.stop)
        cells[part] = corner_numbers(first[own], index % _SIDE, points[:, own], 1)
    return VertexNumbers(cells, first, lattices)


@dataclass(frozen=True)
class TileLattices:
    """Lattices over tiles of patches, see `vertices.Lattices`: arrays of int64, shape (3, n)."""

    low: np.ndarray
    step: np.ndarray
    points: np.ndarray

    def boxes(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        some = slice(first, last)
        return self.low[:, some], self.step[:, some], self.points[:, some]
