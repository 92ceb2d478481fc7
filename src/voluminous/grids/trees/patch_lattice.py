"""The lattices that patches lie on: from corners in space, or indices, to whole numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError
from ..arguments import as_array, check_extent
from .patch_cells import Patches

# How far a corner may be off its lattice, in cells: codes write single precision at times.
_ROUNDING = 1e-3
# Base cells along an axis whose walls are kept however few of them there are.
_MOST_WALLS = 1 << 20


@dataclass(frozen=True)
class Lattice:
    """Walls of the base cells along three axes, and patches."""

    edges: tuple[np.ndarray, ...]
    patches: Patches

    @classmethod
    def from_boxes(
        cls, edges: tuple[np.ndarray, ...], level: Any, low: Any, shape: Any, ratio: Any
    ) -> Lattice:
        """Return patches given by indices; see `PatchGrid.from_boxes`."""
        level, low = _whole(level, "level", 1), _whole(low, "low", 2)
        shape = checked_shapes(shape)
        if not len(level) == len(low) == len(shape):
            raise InputError(
                f"level, low and shape must tell of equally many patches, got {len(level)}, "
                f"{len(low)} and {len(shape)}"
            )
        if level.min() < 0:
            raise InputError(
                f"levels count from 0; that of patch {level.argmin()} is {level.min()}"
            )
        ratios = _ratios(ratio, int(level.max()))
        sizes = np.cumprod(np.concatenate([np.ones((1, 3), np.int64), ratios[::-1]]), axis=0)[::-1]
        extent = sizes[0] * [len(e) - 1 for e in edges]
        outside = ((low < 0) | ((low + shape) * sizes[level] > extent)).any(axis=1)
        if outside.any():
            raise InputError(f"patch {int(np.argmax(outside))} is not inside the domain")
        return cls(edges, Patches(np.ascontiguousarray(sizes), level, low, shape, extent))


def lattice_of(lower: Any, upper: Any, shape: Any) -> Lattice:
    """Return patches given by their corners; see `PatchGrid`."""
    lower, upper = _corners(lower, "lower"), _corners(upper, "upper")
    shape = checked_shapes(shape)
    if not len(lower) == len(upper) == len(shape):
        raise InputError(
            f"lower, upper and shape must tell of equally many patches, got {len(lower)}, "
            f"{len(upper)} and {len(shape)}"
        )
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
    return Lattice(edges, Patches(sizes, level, low, shape, extent))


def _levels(width: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the sizes of cells of each level in finest units, coarsest first, and the levels."""
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


def checked_shapes(shape: Any) -> np.ndarray:
    """Return the shapes of patches as integers (n, 3)."""
    shapes = _whole(shape, "shape", 2)
    if shapes.min() < 1:
        patch = int(np.argmax((shapes < 1).any(axis=1)))
        raise InputError(f"shape must be positive; that of patch {patch} is {shapes[patch]}")
    return shapes


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


def boxes_of_layers(
    base: tuple[int, ...], layers: Any
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return level (n + 1,), first cell and shape (n + 1, 3) of a base grid and its layers.

    Parameters
    ----------
    base : three int
        Number of cells of the base grid.
    layers : array_like of int, shape (n, 7)
        Rows ``parent, ix, iy, iz, nx, ny, nz`` as RADMC-3D has them.
    """
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
