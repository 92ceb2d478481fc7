"""Octrees of Cartesian cells, unbalanced and up to 30 levels deep."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from ...errors import InputError
from ...memory import check_memory
from ..cartesian.grid import CartesianGrid
from .cells import TreeCells
from .octree_order import (
    DEEPEST,
    Places,
    checked_choice,
    checked_flags,
    checked_levels,
    flags_from_levels,
    levels_from_flags,
    levels_of_leaves,
    merged,
    split_levels,
)
from .octree_tree import octree_tree
from .octree_vertices import octree_vertices
from .parts import Parts, parts_of_octree
from .tree import NONE, Tree
from .vertices import VertexNumbers

# Per cell: for what a function is asked, and its box; for its level and its parent.
_ASKED_BYTES, _BOX_BYTES, _CELL_BYTES = 180, 48, 12
# Cells whose boxes are looked at together: temporary arrays stay small.
_SOME = 1 << 18


class OctreeGrid(TreeCells):
    """Cells between planes of constant x, y and z, some of them split into eight, again and again.

    Fields are flat, in the order of the leaves: base cells with x fastest, each depth first, the
    eight children of a node with x fastest. That is RADMC-3D's order.

    Parameters
    ----------
    x, y, z : array_like or Quantity, shape (n + 1,)
        Strictly increasing walls of the base cells.
    refined : array_like of bool or int, shape (nodes,), optional
        One flag per node, depth first in the same order: 1 if it is split, 0 if it is a leaf. By
        default nothing is split.
    unit : str or unit, optional
        Length unit of plain edges. Quantities bring their own; the x axis' is kept.

    Attributes
    ----------
    levels : array of uint8, shape (leaves,)
        How often each leaf's base cell was split.
    base_edges : tuple of three float64 arrays
        Walls of the base cells in `unit`.
    parents : array of int64 or None
        Of a grid made by `refine`: for each leaf, the leaf of the grid before that it is part of;
        ``field[grid.parents]`` carries a field over.

    Raises
    ------
    InputError
        If edges cannot be used, the flags are no tree over these base cells, or it is deeper than
        30 levels.
    UnitsError
        If the axes' units cannot be converted into each other.

    Examples
    --------
    >>> grid = OctreeGrid([0, 1, 2], [0, 1], [0, 1], [0, 1] + 8 * [0])
    >>> grid.shape, grid.cells_per_level
    ((9,), (1, 8))
    """

    kind = "octree"
    places: Places

    def __init__(self, x: Any, y: Any, z: Any, refined: Any = None, *, unit: Any = None) -> None:
        base = CartesianGrid(x, y, z, unit=unit)
        self.unit, self.base_edges = base.unit, base.edges
        if refined is None:
            levels = np.zeros(base.size, np.uint8)
        else:
            levels = levels_from_flags(checked_flags(refined), base.size, 8)
        self._set_levels(levels)

    def _set_levels(self, levels: np.ndarray, parents: np.ndarray | None = None) -> None:
        levels.setflags(write=False)
        self.levels, self.parents = levels, parents
        self.places = Places(levels)
        self.extent = np.array(self.base_shape, np.int64) << self.places.deepest

    def _with_levels(self, levels: np.ndarray, parents: np.ndarray | None = None) -> OctreeGrid:
        grid = type(self).__new__(type(self))
        grid.unit, grid.base_edges = self.unit, self.base_edges
        grid._set_levels(levels, parents)
        return grid

    @classmethod
    def from_levels(cls, x: Any, y: Any, z: Any, levels: Any, *, unit: Any = None) -> OctreeGrid:
        """Return the octree whose leaves, in their order, have these levels.

        Parameters
        ----------
        x, y, z, unit
            As for the class.
        levels : array_like of int, shape (leaves,)

        Raises
        ------
        InputError
            If no octree on these base cells has such leaves.
        """
        base = cls(x, y, z, unit=unit)
        levels = checked_levels(levels)
        cells, whole = Places(levels).total()
        if cells != base.size or not whole:
            raise InputError(
                f"levels do not describe {base.size} base cells: the leaves fill {cells} of them"
                f"{'' if whole else ' and a part of one more'}"
            )
        return base._with_levels(levels)

    @classmethod
    def from_leaves(
        cls, x: Any, y: Any, z: Any, level: Any, index: Any, *, unit: Any = None
    ) -> tuple[OctreeGrid, np.ndarray]:
        """Return an octree from its leaves in any order, and their order in it.

        Parameters
        ----------
        x, y, z, unit
            As for the class.
        level : array_like of int, shape (n,)
            How often each leaf's base cell was split.
        index : array_like of int, shape (n, 3)
            Which cell of its level it is along x, y and z, counted from 0 across the domain.

        Returns
        -------
        grid : OctreeGrid
        order : array of int64, shape (n,)
            ``field[order]`` is a field in the order of the grid, if `field` is in that of `level`.

        Raises
        ------
        InputError
            If leaves overlap, or leave a part of the domain empty; the first place is named.
        """
        base = cls(x, y, z, unit=unit)
        levels, order = levels_of_leaves(base.base_shape, level, index)
        return base._with_levels(levels), order

    @classmethod
    def from_function(
        cls,
        x: Any,
        y: Any,
        z: Any,
        refine: Callable[..., Any],
        levels: int,
        *,
        unit: Any = None,
    ) -> OctreeGrid:
        """Return an octree refined where a function says so.

        Parameters
        ----------
        x, y, z, unit
            As for the class.
        refine : callable
            Called as ``refine(x, y, z, size)`` once per level, with the centres of all its cells
            and their largest widths, arrays in the grid's unit; returns which to split, one boolean
            for each.
        levels : int
            Deepest level, 30 at most.

        Raises
        ------
        InputError
            If `refine` cannot be called or returns anything else, or `levels` is no such number.
        MemoryNeededError
            If there would be more cells than fit.
        """
        if not callable(refine):
            raise InputError(f"refine must be a function of (x, y, z, size), got {refine!r}")
        if not isinstance(levels, (int, np.integer)) or not 0 <= levels <= DEEPEST:
            raise InputError(f"levels must be a whole number from 0 to {DEEPEST}, got {levels!r}")
        grid = cls(x, y, z, unit=unit)
        for level in range(int(levels)):
            where = grid._asked(refine, level)
            if not where.any():
                break
            grid = grid._with_levels(split_levels(grid.levels, where, 8))
        return grid

    def _asked(self, refine: Callable[..., Any], level: int) -> np.ndarray:
        here = np.flatnonzero(self.levels == level)
        check_memory(
            _ASKED_BYTES * len(here) + _BOX_BYTES * self.size,
            f"asking which of {len(here)} cells of level {level} to split",
            "split fewer cells, or fewer levels",
        )
        where = np.zeros(self.size, bool)
        low, size = (part[:, here] for part in self.boxes(0, self.size))
        centers = 0.5 * (self.position(low) + self.position(low + size))
        chosen = refine(*centers, self.widths(low, size).max(axis=0))
        where[here] = checked_choice(chosen, len(here), "what refine returns")
        self._check_split(int(np.count_nonzero(where)))
        return where

    def _check_split(self, count: int) -> None:
        cells = self.size + 7 * count
        check_memory(_CELL_BYTES * cells, f"an octree of {cells} cells", "split fewer cells")

    def refine(self, where: Any) -> OctreeGrid:
        """Return a grid with some leaves split into eight.

        Parameters
        ----------
        where : array_like of bool, shape (leaves,)

        Returns
        -------
        OctreeGrid
            Its `parents` tell which leaf of this grid each of its leaves is part of.
        """
        where = checked_choice(where, self.size, "where")
        if self.places.deepest >= DEEPEST and where[self.levels == DEEPEST].any():
            raise InputError(f"leaves of level {DEEPEST} cannot be split")
        self._check_split(int(np.count_nonzero(where)))
        parents = np.repeat(np.arange(self.size), np.where(where, 8, 1))
        return self._with_levels(split_levels(self.levels, where, 8), parents)

    @property
    def refined(self) -> np.ndarray:
        """The split flags of all nodes, depth first; uint8."""
        return flags_from_levels(self.levels, self.places)

    @functools.cached_property
    def tree(self) -> Tree:
        return octree_tree(self.base_shape, self.places)

    @functools.cached_property
    def vertex_numbers(self) -> VertexNumbers:
        return octree_vertices(self)

    def pruned(self, visible: Any) -> Tree:
        """Return the tree with holes for leaves that show nothing, as large as can be.

        Parameters
        ----------
        visible : array_like of bool, shape (leaves,)
            Eight siblings of which none is visible become one hole, and so on: rays cross it in
            one step.
        """
        number = np.where(np.asarray(visible, bool), np.arange(self.size), NONE)
        levels, number = merged(self.places, number, 8, NONE)
        return octree_tree(self.base_shape, Places(levels), number)

    @functools.cached_property
    def level_sizes(self) -> np.ndarray:
        deepest = self.places.deepest
        sizes = 1 << (deepest - np.arange(deepest + 1, dtype=np.int64))
        return np.broadcast_to(sizes[:, None], (deepest + 1, 3))

    def boxes(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        return self.places.boxes(self.base_shape, first, last)

    def surface(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        (begin, _), (low, size) = self.boxes(first, first + 1), self.boxes(last - 1, last)
        end, found = low + size, []  # parts are boxes
        for k in range(first, last, _SOME):
            low, size = self.boxes(k, min(k + _SOME, last))
            outer = ((low == begin) | (low + size == end)).any(axis=0)
            found.append((low[:, outer], size[:, outer]))
        low, size = (np.concatenate(each, axis=1) for each in zip(*found, strict=True))
        return low, size

    def parts(self, most: int) -> Parts:
        return parts_of_octree(self, most)
