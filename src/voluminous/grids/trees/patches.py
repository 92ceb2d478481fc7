"""Nested rectangular patches of Cartesian cells, as block-structured codes write them."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from ...errors import InputError
from ...memory import check_memory
from ...units import plain, space_unit, unit_of
from ..arguments import as_array
from ..cartesian.grid import CartesianGrid
from .cells import TreeCells
from .octree_order import DEEPEST
from .patch_lattice import Lattice, boxes_of_layers, lattice_of
from .patch_vertices import patch_vertices
from .tree import Tree
from .vertices import VertexNumbers

# Double precision must tell places in the middle of finest cells apart.
_LONGEST = 1 << 50
# Cells are counted in 32 bits; a byte for the level of each is what a grid takes at least.
_MOST_CELLS = (1 << 32) - 1


class PatchGrid(TreeCells):
    """Rectangular patches of cells, of which the finest one at a place counts.

    The cells of a patch are equal; those of a finer one are smaller by a whole number, along each
    axis its own. Patches may overlap, and cover each other. Where no patch is, there is a hole:
    rays cross it as they cross vacuum. Nothing is resampled.

    A field is a list of arrays, one per patch, index ``[ix, iy, iz]``: hidden cells are ignored. As
    one flat array it has the cells that are seen, patch after patch, each in C order.

    Parameters
    ----------
    lower, upper : array_like or Quantity, shape (n, 3)
        Corners of the patches.
    shape : array_like of int, shape (n, 3) or (3,)
        Number of cells of each patch along x, y and z; three numbers are those of all.
    unit : str or unit, optional
        Length unit of plain corners.

    Attributes
    ----------
    patches : Patches
        Where they are, as whole numbers.
    levels : array of uint8, shape (cells,)
        Level of each cell: 0 for the largest cells.

    Raises
    ------
    InputError
        If cells are no multiples of each other, a patch is not aligned with the cells around it, or
        begins inside a coarser cell; the patch is named.

    Examples
    --------
    >>> grid = PatchGrid([[0, 0, 0], [0, 0, 0]], [[4, 4, 4], [1, 1, 1]], [[4, 4, 4], [2, 2, 2]])
    >>> grid.cells_per_level
    (63, 8)
    """

    kind = "patches"

    def __init__(self, lower: Any, upper: Any, shape: Any, *, unit: Any = None) -> None:
        self.unit = next(filter(None, map(unit_of, (lower, upper))), None) or space_unit(unit)
        shape = _of_each(shape, lower, "lower")
        _check_count(shape)
        lower, upper = (
            plain(c, self.unit, name) if unit_of(c) is not None else c
            for c, name in ((lower, "lower"), (upper, "upper"))
        )
        self._set(lattice_of(lower, upper, shape))

    def _set(self, lattice: Lattice) -> None:
        self.base_edges, self.patches = lattice.edges, lattice.patches
        self.extent = self.patches.extent
        if len(self.patches.sizes) > DEEPEST + 1:
            raise InputError(f"patches can have {DEEPEST + 1} levels at most")
        if self.extent.max() > _LONGEST:
            raise InputError(
                f"the domain is {self.extent.max()} of the finest cells long; {_LONGEST} are the "
                "most that double precision tells apart"
            )
        self.patches.check_alignment()
        self.levels = np.repeat(self.patches.level, self.patches.visible).astype(np.uint8)
        self.levels.setflags(write=False)

    @classmethod
    def from_boxes(
        cls,
        x: Any,
        y: Any,
        z: Any,
        level: Any,
        low: Any,
        shape: Any,
        ratio: Any = 2,
        *,
        unit: Any = None,
    ) -> PatchGrid:
        """Return the grid of patches given by the indices of their cells.

        Parameters
        ----------
        x, y, z : array_like or Quantity, shape (n + 1,)
            Walls of the cells of level 0 in the whole domain; they need not be evenly spaced.
        level : array_like of int, shape (n,)
            Level of each patch.
        low : array_like of int, shape (n, 3)
            The first cell of each patch, counted in cells of its level from the domain's corner.
        shape : array_like of int, shape (n, 3) or (3,)
            Number of cells of each patch; three numbers are those of all.
        ratio : int or array_like of int, shape (levels - 1,) or (levels - 1, 3)
            How many cells of each level make one of the level before, along each axis.
        unit : str or unit, optional
            Length unit of plain edges.
        """
        base = CartesianGrid(x, y, z, unit=unit)
        shape = _of_each(shape, low, "low")
        _check_count(shape)
        grid = cls.__new__(cls)
        grid.unit = base.unit
        grid._set(Lattice.from_boxes(base.edges, level, low, shape, ratio))
        return grid

    @classmethod
    def from_layers(cls, x: Any, y: Any, z: Any, layers: Any, *, unit: Any = None) -> PatchGrid:
        """Return RADMC-3D's layered grid: a base grid, and layers that halve some of its cells.

        Parameters
        ----------
        x, y, z : array_like or Quantity, shape (n + 1,)
            Walls of the base grid, which is the first patch.
        layers : array_like of int, shape (n, 7)
            Per layer ``parent, ix, iy, iz, nx, ny, nz``: it covers nx, ny, nz cells of its parent
            from ix, iy, iz on, counted from 1. Parent 0 is the base grid, k the layer of row k - 1.
        unit : str or unit, optional
            Length unit of plain edges.
        """
        base = CartesianGrid(x, y, z, unit=unit)
        level, low, shape = boxes_of_layers(base.shape, layers)
        x, y, z = base.edges
        return cls.from_boxes(x, y, z, level, low, shape, 2, unit=base.unit)

    @property
    def level_sizes(self) -> np.ndarray:
        return self.patches.sizes

    @property
    def hidden_cells(self) -> int:
        """Number of cells of patches that finer ones hide."""
        return int(self.patches.volumes.sum()) - self.size

    @functools.cached_property
    def tree(self) -> Tree:
        return self.patches.tree

    @functools.cached_property
    def vertex_numbers(self) -> VertexNumbers:
        return patch_vertices(self.patches)

    def boxes(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        return self.patches.boxes(first, last)

    def pack(self, value: Any) -> np.ndarray:
        shapes = self.patches.shape
        if np.ndim(value[0] if isinstance(value, (list, tuple)) and len(value) else 0) != 3:
            array = np.asarray(value)
            if array.shape == self.shape:
                return array
            if array.ndim != 4:
                raise InputError(
                    f"a field is a list of {len(shapes)} arrays, one per patch, or a flat array of "
                    f"the {self.size} cells that are seen; got an array of shape {array.shape}"
                )
            value = array
        if len(value) != len(shapes):
            raise InputError(f"a field is one array per patch: {len(shapes)}, got {len(value)}")
        parts = [self._seen(k, np.asarray(part)) for k, part in enumerate(value)]
        return np.concatenate(parts)

    def _seen(self, patch: int, array: np.ndarray) -> np.ndarray:
        patches = self.patches
        shape = tuple(int(n) for n in patches.shape[patch])
        if array.shape != shape:
            turned = "; transpose it (index is [ix, iy, iz])" if array.T.shape == shape else ""
            raise InputError(
                f"the array of patch {patch} must have its shape {shape}, got {array.shape}{turned}"
            )
        flat = array.reshape(-1)
        if patches.hidden[patch]:
            return flat[patches.seen_cells(patch)]
        return flat[: patches.visible[patch]]

    def unpack(self, flat: np.ndarray) -> list[np.ndarray]:
        """Return a flat field as one array per patch; hidden cells are NaN, or zero.

        Raises
        ------
        InputError
            If it has not one value for each cell that is seen.
        """
        flat, patches = np.asarray(flat), self.patches
        if flat.shape != self.shape:
            raise InputError(
                f"a flat field has one value for each of the {self.size} cells that are seen; got "
                f"an array of shape {flat.shape}"
            )
        lacking = np.nan if flat.dtype.kind == "f" else 0
        parts = np.split(flat, patches.ends[:-1])
        arrays = []
        for patch, part in enumerate(parts):
            whole = np.full(patches.volumes[patch], lacking, flat.dtype)
            where = patches.seen_cells(patch) if patches.hidden[patch] else slice(0, len(part))
            whole[where] = part
            arrays.append(whole.reshape(patches.shape[patch]))
        return arrays

    def describe(self) -> dict[str, Any]:
        told = {"patches": len(self.patches.level), "hidden_cells": self.hidden_cells}
        return {**super().describe(), **told}


def _of_each(shape: Any, corners: Any, name: str) -> np.ndarray:
    """Return the shape of each of the patches with corners (n, 3), where one is given for all."""
    shapes, patches = as_array(shape, "shape"), as_array(corners, name).shape[:1]
    return np.broadcast_to(shapes, (*patches, 3)) if shapes.shape == (3,) and patches else shapes


def _check_count(shape: Any) -> None:
    try:
        count = float(np.prod(np.asarray(shape, dtype=float).reshape(-1, 3), axis=1).sum())
    except (TypeError, ValueError):
        return  # what is wrong is told where shapes are looked at
    if count > _MOST_CELLS:
        raise InputError(f"patches of {count:.3g} cells in all are too many: {_MOST_CELLS} at most")
    if count > 0:
        check_memory(int(count), f"a grid of {count:.0f} cells", "use a coarser one")
