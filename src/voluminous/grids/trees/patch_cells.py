"""The cells of nested patches: which are hidden by finer ones, and how the others are numbered.

Cells are numbered patch after patch, in C order within a patch (the last axis fastest), hidden ones
left out. The number of a cell in a patch that is seen entirely follows from its place; those of
the other patches are looked up.
"""

from __future__ import annotations

import functools
import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError
from .patch_tree import Boxes, expanded, patch_entries
from .tree import ABSENT, NONE, NUMBER_BITS, NUMBER_MASK, PLAIN, Tree

# Marks patches that are seen partly: the numbers of their cells are looked up.
TABLED = 1 << 31
_CELLS = 1 << 18


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
    def _named(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[int, ...]]:
        """Units, entries and bricks of the tree that names patches; where its levels start."""
        order = np.argsort(self.level, kind="stable")
        low, high = self.corners
        boxes = Boxes(low[order], high[order], self.level[order], order)
        return patch_entries(boxes, self.extent, int(self.volumes.sum()))

    @functools.cached_property
    def tree(self) -> Tree:
        """From places to cells."""
        units, entries, _, bricks = self._named
        holes = bool((entries == ABSENT).any())
        return Tree(self.extent, units, entries, PatchNumbering(self), holes, bricks)

    @functools.cached_property
    def visible(self) -> np.ndarray:
        """Number of cells of each patch that no finer one hides."""
        units, entries, starts, _ = self._named
        total = np.zeros(len(self.level))
        for unit, first, last in zip(units, starts[:-1], starts[1:], strict=True):
            words = entries[first:last]
            name = words[(words >> NUMBER_BITS == PLAIN) & (words != ABSENT)] & NUMBER_MASK
            count = np.bincount(name, minlength=len(self.level))
            total += count * (unit / self.sizes[self.level]).prod(axis=1)
        return np.round(total).astype(np.int64)

    @functools.cached_property
    def ends(self) -> np.ndarray:
        """Number of the cell after the last one of each patch."""
        return np.cumsum(self.visible)

    @functools.cached_property
    def hidden(self) -> np.ndarray:
        """True for patches that are seen partly."""
        hidden: np.ndarray = (self.visible > 0) & (self.visible < self.volumes)
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
        # Some patches at a time: temporary arrays stay small.
        parts = np.cumsum(self.volumes[partly]) // _CELLS
        bounds = np.flatnonzero(np.diff(parts, prepend=-1, append=-1))
        found = [self._numbered(partly[a:b]) for a, b in itertools.pairwise(bounds)]
        return np.concatenate([np.zeros(0, np.uint32), *found])

    def _numbered(self, some: np.ndarray) -> np.ndarray:
        """Return `numbers` of some patches that are seen partly."""
        low, high = self.low[some, ::-1], (self.low + self.shape)[some, ::-1]
        which, index = expanded(low, high)  # the last axis fastest
        patch = some[which]
        place = index[::-1] * self.sizes[self.level[patch]].T
        named, _ = self.tree.descend(place)
        seen = named == (PLAIN << NUMBER_BITS | patch)
        before = np.cumsum(self.visible[some]) - self.visible[some]
        first = (self.ends - self.visible)[some] - before
        return np.where(seen, first[which] + np.cumsum(seen) - 1, NONE).astype(np.uint32)

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
        cell = np.arange(first, last)
        patch = np.searchsorted(self.ends, cell, side="right")
        local = cell - (self.ends - self.visible)[patch]
        for partly in np.unique(patch[self.hidden[patch]]):
            here = patch == partly
            local[here] = self.seen_cells(partly)[local[here]]
        ny, nz = self.shape[patch, 1], self.shape[patch, 2]
        index = np.stack([local // (ny * nz), local // nz % ny, local % nz])
        size = self.sizes[self.level[patch]].T
        return (index + self.low[patch].T) * size, size

    def seen_cells(self, patch: int) -> np.ndarray:
        """Return the cells that are seen of a patch which is seen partly, in C order."""
        first = self.first_slots[patch]
        return np.flatnonzero(self.numbers[first : first + self.volumes[patch]] != NONE)

    def check_alignment(self) -> None:
        """Refuse patches that begin or end inside a cell of a coarser patch below them."""
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
        size = self.sizes[self.level[below]]
        cut = (first < last).all(axis=1) & ((first % size != 0) | (last % size != 0)).any(axis=1)
        if cut.any():
            other = int(below[cut][0])
            raise InputError(
                f"patch {patch} (level {self.level[patch]}) begins or ends inside a cell of patch "
                f"{other} (level {self.level[other]}): finer patches must consist of whole coarse "
                "cells"
            )


@dataclass(frozen=True)
class PatchNumbering:
    """Entries that name the patch whose cells they are covered by; see `tree.Numbering`."""

    patches: Patches

    def cells(
        self, entry: np.ndarray, place: np.ndarray, unit: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return numbers and sizes of the cells around places; a hole is its entry."""
        hole, patches = entry == ABSENT, self.patches
        patch = np.where(hole, 0, entry & NUMBER_MASK)
        size = patches.sizes[patches.level[patch]].T
        index = place // size - patches.low[patch].T
        ny, nz = patches.shape[patch, 1], patches.shape[patch, 2]
        local = (index[0] * ny + index[1]) * nz + index[2]
        number = local + (patches.ends - patches.visible)[patch]
        partly = patches.hidden[patch] & ~hole
        number[partly] = patches.numbers[(local + patches.first_slots[patch])[partly]]
        return np.where(hole, -1, number), np.where(hole, unit, size)

    def traced(self, tree: Tree, backend: Any) -> Any:
        """Return the same for kernels."""
        from .patch_lookup import TracedPatches

        return TracedPatches(self.patches, tree, backend)
