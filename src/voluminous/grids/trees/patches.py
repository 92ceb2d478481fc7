"""Nested rectangular patches of Cartesian cells, as block-structured codes write them."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from ...errors import InputError
from ...memory import check_memory
from ...units import plain, space_unit, unit_of
from ..arguments import as_array, check_extent
from ..cartesian.grid import CartesianGrid
from .cells import TreeCells
from .octree_order import DEEPEST
from .parts import Parts, parts_of_patches
from .patch_cells import Patches, patch_vertices
from .tree import Tree
from .vertices import VertexNumbers

# Double precision must tell places in the middle of finest cells apart.
_LONGEST = 1 << 50
# Cells are counted in 32 bits; a byte for the level of each is what a grid takes at least.
_MOST_CELLS = (1 << 32) - 1
# How far a corner may be off its lattice, in cells: codes write single precision at times.
_ROUNDING = 1e-3
# Base cells along an axis whose walls are stored however few of them there are.
_MOST_WALLS = 1 << 20


class PatchGrid(TreeCells):
    """Rectangular patches of cells, of which the finest one at a place counts.

    The cells of a patch are equal; those of a finer one are smaller by a whole number, along each
    axis its own. Patches may overlap, and cover each other. Where no patch is, there is a hole:
    rays cross it as they cross vacuum. Nothing is resampled.

    A field is a list of arrays, one per patch, index ``[ix, iy, iz]``; covered cells are ignored.
    As one flat array it has the cells that are seen, patch after patch, each in C order.

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
    patches: Patches

    def __init__(self, lower: Any, upper: Any, shape: Any, *, unit: Any = None) -> None:
        self.unit = next(filter(None, map(unit_of, (lower, upper))), None) or space_unit(unit)
        shape = _of_each(shape, lower, "lower")
        lower, upper = (
            plain(c, self.unit, name) if unit_of(c) is not None else c
            for c, name in ((lower, "lower"), (upper, "upper"))
        )
        self._set(*_from_corners(_corners(lower, "lower"), _corners(upper, "upper"), shape))

    def _set(self, edges: tuple[np.ndarray, ...], patches: Patches) -> None:
        self.base_edges, self.patches, self.extent = edges, patches, patches.extent
        if len(patches.sizes) > DEEPEST + 1:
            raise InputError(f"patches can have {DEEPEST + 1} levels at most")
        if self.extent.max() > _LONGEST:
            raise InputError(
                f"the domain is {self.extent.max()} of the finest cells long; {_LONGEST} are the "
                "most that double precision tells apart"
            )
        patches.check_alignment()
        self.levels = np.repeat(patches.level, patches.visible).astype(np.uint8)
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
        level, low = _whole(level, "level", 1), _whole(low, "low", 2)
        _check_lengths("level, low and shape", level, low, shape)
        if level.min() < 0:
            raise InputError(
                f"levels count from 0; that of patch {level.argmin()} is {level.min()}"
            )
        sizes = np.ones((int(level.max()) + 1, 3), np.int64)
        sizes[:-1] = np.cumprod(_ratios(ratio, len(sizes) - 1)[::-1], axis=0)[::-1]
        extent = sizes[0] * base.shape
        outside = ((low < 0) | ((low + shape) * sizes[level] > extent)).any(axis=1)
        if outside.any():
            raise InputError(f"patch {int(np.argmax(outside))} is not inside the domain")
        grid = cls.__new__(cls)
        grid.unit = base.unit
        grid._set(base.edges, Patches(sizes, level, low, shape, extent))
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
        level, low, shape = _boxes_of_layers(base.shape, layers)
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

    def surface(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        return self.patches.surface(first, last)

    def parts(self, most: int) -> Parts:
        return parts_of_patches(self, most)

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
        if patches.covered[patch]:
            return np.asarray(flat[patches.seen_cells(patch)])
        return flat[: patches.visible[patch]]

    def unpack(self, flat: np.ndarray) -> list[np.ndarray]:
        """Return a flat field as one array per patch; covered cells are NaN, or zero.

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
            where = patches.seen_cells(patch) if patches.covered[patch] else slice(0, len(part))
            whole[where] = part
            arrays.append(whole.reshape(patches.shape[patch]))
        return arrays

    def describe(self) -> dict[str, Any]:
        described = {"patches": len(self.patches.level), "hidden_cells": self.hidden_cells}
        return {**super().describe(), **described}


def _of_each(shape: Any, corners: Any, name: str) -> np.ndarray:
    """Return the shape of each of the patches with corners (n, 3), where one is given for all."""
    shapes, patches = as_array(shape, "shape"), as_array(corners, name).shape[:1]
    if shapes.shape == (3,) and patches:
        shapes = np.broadcast_to(shapes, (*patches, 3))
    shapes = _whole(shapes, "shape", 2)
    if shapes.min() < 1:
        patch = int(np.argmax((shapes < 1).any(axis=1)))
        raise InputError(f"shape must be positive; that of patch {patch} is {shapes[patch]}")
    count = float(np.prod(shapes.astype(float), axis=1).sum())
    if count > _MOST_CELLS:
        raise InputError(f"patches of {count:.3g} cells in all are too many: {_MOST_CELLS} at most")
    check_memory(int(count), f"a grid of {count:.0f} cells", "use a coarser one")
    return shapes


def _check_lengths(names: str, *arrays: np.ndarray) -> None:
    first, second, third = map(len, arrays)
    if not first == second == third:
        raise InputError(
            f"{names} must tell of equally many patches, got {first}, {second} and {third}"
        )


def _from_corners(
    lower: np.ndarray, upper: np.ndarray, shape: np.ndarray
) -> tuple[tuple[np.ndarray, ...], Patches]:
    _check_lengths("lower, upper and shape", lower, upper, shape)
    empty = (upper <= lower).any(axis=1)
    if empty.any():
        raise InputError(f"patch {int(np.argmax(empty))}: upper must be greater than lower")
    width = (upper - lower) / shape
    sizes, level = _levels(width)
    start, end = lower.min(axis=0), upper.max(axis=0)
    check_extent(**{name: np.array([a, b]) for name, a, b in zip("xyz", start, end, strict=True)})
    finest = width[level == len(sizes) - 1][0]
    extent = np.round((end - start) / finest).astype(np.int64)
    finest = (end - start) / extent
    index = (lower - start) / (finest * sizes[level])
    low = np.round(index).astype(np.int64)
    off = (np.abs(index - low) > _ROUNDING).any(axis=1)
    if off.any():
        patch = int(np.argmax(off))
        raise InputError(
            f"patch {patch} begins {index[patch].tolist()} of its cells from the domain's lower "
            "corner: these must be whole numbers, so that cells line up"
        )
    counts = extent // sizes[0]
    # Walls of base cells are kept one by one: too many of a wide domain with little in it.
    few = counts.max() <= max(_MOST_WALLS, shape.max())
    if (extent % sizes[0]).any() or not few:
        counts = np.ones(3, np.int64)
    edges = tuple(np.linspace(a, b, n + 1) for a, b, n in zip(start, end, counts, strict=True))
    return edges, Patches(sizes, level, low, shape, extent)


def _levels(width: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    finest = width.min(axis=0)
    ratio = width / finest
    size = np.round(ratio).astype(np.int64)
    off = (np.abs(ratio - size) > _ROUNDING * size).any(axis=1)
    if off.any():
        patch = int(np.argmax(off))
        raise InputError(
            f"cells of patch {patch} are {ratio[patch].tolist()} times as wide as the finest ones: "
            "these must be whole numbers"
        )
    sizes, level = np.unique(-size, axis=0, return_inverse=True)
    sizes = -sizes
    if (sizes[:-1] % sizes[1:]).any():
        raise InputError(
            f"cells of each level must consist of cells of the next, got sizes {sizes.tolist()} "
            "in units of the finest"
        )
    return sizes, level.reshape(-1)


def _corners(values: Any, name: str) -> np.ndarray:
    corners = as_array(values, name, np.float64)
    if corners.ndim != 2 or corners.shape[1] != 3 or not len(corners):
        raise InputError(f"{name} must have shape (n, 3), got {corners.shape}")
    bad = ~np.isfinite(corners).all(axis=1)
    if bad.any():
        raise InputError(f"{name} must be finite; that of patch {int(np.argmax(bad))} is not")
    return corners


def _whole(values: Any, name: str, axes: int) -> np.ndarray:
    array = as_array(values, name)
    wanted = "(n,)" if axes == 1 else "(n, 3)"
    fits = array.ndim == axes and array.size and (axes == 1 or array.shape[1] == 3)
    if not fits or array.dtype.kind not in "iu":
        raise InputError(
            f"{name} must be integers of shape {wanted}, got {array.dtype} of shape {array.shape}"
        )
    return array.astype(np.int64)


def _ratios(ratio: Any, levels: int) -> np.ndarray:
    ratios = as_array(ratio, "ratio")
    if ratios.size == 0 and levels == 0:  # a base grid alone
        return np.ones((0, 3), np.int64)
    if ratios.ndim == 1:
        ratios = ratios[:, None]
    fits = ratios.ndim == 0 or (ratios.ndim == 2 and ratios.shape[1] in (1, 3))
    if not fits or ratios.dtype.kind not in "iu" or (ratios < 1).any():
        raise InputError(
            "ratio must be positive integers: one, or one per level, or of shape (levels, 3), got "
            f"{ratio!r}"
        )
    if ratios.ndim == 2 and len(ratios) < levels:
        raise InputError(f"ratio must tell of {levels} levels, got {len(ratios)}")
    whole = np.broadcast_to(ratios, (max(levels, len(np.atleast_2d(ratios))), 3))
    return whole[:levels].astype(np.int64)


def _boxes_of_layers(
    base: tuple[int, ...], layers: Any
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return level (n + 1,), first cell and shape (n + 1, 3) of a base grid and its layers."""
    rows = as_array(layers, "layers")
    if not rows.size:  # the base grid alone
        rows = np.zeros((0, 7), np.int64)
    if rows.ndim != 2 or rows.shape[1] != 7 or rows.dtype.kind not in "iu":
        raise InputError(
            "layers must be rows of seven integers (parent, ix, iy, iz, nx, ny, nz), got "
            f"{rows.dtype} of shape {rows.shape}"
        )
    count = len(rows) + 1
    level = np.zeros(count, np.int64)
    low, shape = np.zeros((count, 3), np.int64), np.zeros((count, 3), np.int64)
    shape[0] = base
    for k, (parent, *numbers) in enumerate(rows.tolist(), start=1):
        if not 0 <= parent < k:
            raise InputError(f"layer {k} must have a parent from 0 to {k - 1}, got {parent}")
        first, cells = np.array(numbers[:3]) - 1, np.array(numbers[3:])
        if (first < 0).any() or (cells < 1).any() or (first + cells > shape[parent]).any():
            raise InputError(
                f"layer {k} covers cells {(first + 1).tolist()} to {(first + cells).tolist()} of "
                f"its parent {parent}, which has {shape[parent].tolist()}"
            )
        level[k] = level[parent] + 1
        low[k], shape[k] = 2 * (low[parent] + first), 2 * cells
    return level, low, shape
