"""The cells of nested patches: which are hidden by finer ones, and how the others are numbered.

Cells are numbered patch after patch, in C order within a patch (the last axis fastest), hidden ones
left out. The number of a cell in a patch that is seen entirely follows from its place; those of
the other patches are looked up.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace

import numpy as np

from ...errors import InputError
from .patch_numbering import TABLED, PatchNumbering
from .patch_tree import PatchBoxes, PatchEntries, patch_entries
from .tree import ABSENT, NONE, NUMBER_BITS, NUMBER_MASK, PLAIN, Tree

# Parts of cells that are rounding.
_PART = 1e-9


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
        """Number of cells of each patch, hidden ones included."""
        volumes: np.ndarray = self.shape.prod(axis=1)
        return volumes

    @functools.cached_property
    def _named(self) -> PatchEntries:
        order = np.argsort(self.level, kind="stable")
        low, high = self.corners
        boxes = PatchBoxes(low[order], high[order], self.level[order], order)
        return patch_entries(boxes, self.extent, int(self.volumes.sum()))

    @functools.cached_property
    def tree(self) -> Tree:
        """From places to cells."""
        named = self._named
        tree = Tree(
            self.extent, named.units, named.entries, PatchNumbering(self), True, named.bricks
        )
        # What the root has beyond the domain is absent, but no hole. Whole numbers of any size.
        absent = sum(
            int(np.count_nonzero(words == ABSENT)) * math.prod(unit.tolist())
            for unit, words in named.levels()
        )
        inside, whole = self.extent.tolist(), (self.extent + tree.padding).tolist()
        return replace(tree, holes=absent > math.prod(whole) - math.prod(inside))

    @functools.cached_property
    def _shown(self) -> np.ndarray:
        """How much of each patch no finer one hides, in cells; whole numbers, if all is well."""
        total = np.zeros(len(self.level))
        for unit, words in self._named.levels():
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
    def hidden(self) -> np.ndarray:
        """True for patches that are seen partly."""
        hidden: np.ndarray = (self._shown > _PART) & (self._shown < self.volumes - _PART)
        return hidden

    @functools.cached_property
    def first_slots(self) -> np.ndarray:
        """Where the cells of each patch start in `numbers`, for those that are seen partly."""
        volumes = np.where(self.hidden, self.volumes, 0)
        first: np.ndarray = np.cumsum(volumes) - volumes
        return first

    @functools.cached_property
    def numbers(self) -> np.ndarray:
        """Numbers of all cells of patches that are seen partly, in C order; NONE where hidden."""
        partly = np.flatnonzero(self.hidden)
        seen = self._seen(int(self.volumes[partly].sum()))
        if np.count_nonzero(seen) > self._shown[partly].sum() + _PART * len(seen):
            self._refuse_cut_cells(partly, seen)
        visible = self.visible[partly]
        skipped = self.ends[partly] - np.cumsum(visible)  # cells of other patches before
        found = np.repeat(skipped.astype(np.uint32), visible)
        found += np.arange(len(found), dtype=np.uint32)
        numbers = np.full(len(seen), NONE, np.uint32)
        numbers[seen] = found
        return numbers

    def _seen(self, count: int) -> np.ndarray:
        """Return which cells of patches that are seen partly are seen: those that entries name.

        All that entries hold of a patch at once, cell by cell within them: a fifth of the time that
        asking the tree for every cell takes.
        """
        seen, named = np.zeros(count, bool), self._named
        for depth, (unit, words) in enumerate(named.levels()):
            chosen = np.flatnonzero(_names(words))
            chosen = chosen[self.hidden[words[chosen] & NUMBER_MASK]]
            for some, index in named.located(depth, chosen):
                patch = (words[some] & NUMBER_MASK).astype(np.int64)
                levels = self.level[patch]
                for level in np.unique(levels).tolist():
                    here = np.flatnonzero(levels == level)
                    self._see(seen, level, patch[here], index[:, here], unit)
        return seen

    def _see(
        self, seen: np.ndarray, level: int, patch: np.ndarray, index: np.ndarray, unit: np.ndarray
    ) -> None:
        """Mark the cells of patches of one level in entries of one size, given by their indices."""
        size = self.sizes[level]
        ny, nz = self.shape[patch, 1], self.shape[patch, 2]
        rows = [self.first_slots[patch]]
        for axis, stride in enumerate((ny * nz, nz, 1)):
            # An entry may begin, or end, inside a cell, of which the rest is in another.
            first = index[axis] * unit[axis] // size[axis]
            last = ((index[axis] + 1) * unit[axis] - 1) // size[axis]
            counts = range(int((last - first).max(initial=0)) + 1)
            local = [np.minimum(first + k, last) - self.low[patch, axis] for k in counts]
            rows = [row + cell * stride for row in rows for cell in local]
        for row in rows:
            seen[row] = True

    @functools.cached_property
    def rows(self) -> np.ndarray:
        """Per patch: ``start + i sx + j sy + k`` numbers its cells, as (start, sx, sy, what).

        Indices are those of the level's cells across the domain; sums are modulo 2^32. What is the
        level, and `TABLED` if that number is a place in `numbers`.
        """
        ny, nz = self.shape[:, 1], self.shape[:, 2]
        start = np.where(self.hidden, self.first_slots, self.ends - self.visible)
        start = start - (self.low[:, 0] * ny + self.low[:, 1]) * nz - self.low[:, 2]
        what = self.level | np.where(self.hidden, TABLED, 0)
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
        for k in np.flatnonzero(self.hidden[some]):
            here = slice(stops[k] - counts[k] - first, stops[k] - first)
            local[here] = self.seen_cells(begin + k)[local[here]]
        row, z = np.divmod(local, self.shape[patch, 2])
        return patch, np.stack([*np.divmod(row, self.shape[patch, 1]), z])

    def seen_cells(self, patch: int) -> np.ndarray:
        """Return the cells that are seen of a patch which is seen partly, in C order."""
        first = self.first_slots[patch]
        return np.flatnonzero(self.numbers[first : first + self.volumes[patch]] != NONE)

    def check_alignment(self) -> None:
        """Refuse patches that begin or end inside a cell of a coarser patch around them."""
        self._check_levels()
        low, high = self.corners
        for level in range(2, len(self.sizes)):
            finer, size = self.level >= level, self.sizes[level - 2]
            if (low[finer] % size).any() or (high[finer] % size).any():
                # That is well if there is a patch of the level between around them.
                _ = self.numbers  # refuses cells that are seen partly
                return

    def _check_levels(self) -> None:
        """Refuse patches that are not made of whole cells of the next coarser level."""
        low, high = self.corners
        for level in range(1, len(self.sizes)):
            here = np.flatnonzero(self.level == level)
            coarse = self.sizes[level - 1]
            cut = ((low[here] % coarse != 0) | (high[here] % coarse != 0)).any(axis=1)
            for patch in here[cut]:
                self._check_patch(int(patch), low, high)

    def _check_patch(self, patch: int, low: np.ndarray, high: np.ndarray) -> None:
        below = np.flatnonzero(self.level < self.level[patch])
        first, last = np.maximum(low[below], low[patch]), np.minimum(high[below], high[patch])
        cut = _cuts(first, last, self.sizes[self.level[below]])
        if cut.any():
            self._refuse(patch, int(below[cut][0]))

    def _refuse_cut_cells(self, partly: np.ndarray, seen: np.ndarray) -> None:
        """Name a patch of which cells are seen partly, and one that hides the rest."""
        counts = np.add.reduceat(seen, self.first_slots[partly], dtype=np.int64)
        other = int(partly[np.argmax(counts - self._shown[partly])])
        low, high = self.corners
        above = np.flatnonzero(self.level > self.level[other])
        first, last = np.maximum(low[above], low[other]), np.minimum(high[above], high[other])
        self._refuse(int(above[_cuts(first, last, self.sizes[self.level[other]])][0]), other)

    def _refuse(self, patch: int, other: int) -> None:
        raise InputError(
            f"patch {patch} (level {self.level[patch]}) begins or ends inside a cell of patch "
            f"{other} (level {self.level[other]}): finer patches must consist of whole coarse "
            "cells"
        )


def _cuts(first: np.ndarray, last: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return which boxes (n, 3) are not empty, and begin or end inside cells of a size."""
    inside = (first % size != 0) | (last % size != 0)
    cut: np.ndarray = (first < last).all(axis=1) & inside.any(axis=1)
    return cut


def _names(words: np.ndarray) -> np.ndarray:
    named: np.ndarray = (words >> NUMBER_BITS == PLAIN) & (words != ABSENT)
    return named
