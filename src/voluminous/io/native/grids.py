"""Conversion of grids to plain arrays and back, exact to the bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError, InputError, UnitsError
from ...grids.contract import BoxGrid
from ...grids.structured import is_structured
from ...units import parse_unit, unit_name

if TYPE_CHECKING:
    from ...grids.contract import Grid

_C_ORDER = "a field has three axes, in the order of the edges (the last one fastest in memory)"
_DEPTH_FIRST = (
    "a field is flat, one value per leaf: base cells with the first axis fastest, each depth "
    "first, the children of a cell with the first axis fastest; 'levels' says how often the base "
    "cell around a leaf was halved along the axes 'split'"
)
_PATCH_AFTER_PATCH = (
    "a field is flat: patch after patch, each with the last axis fastest, without the cells that "
    "finer patches (of equal level: later ones) hide"
)
_BOXES = (
    "; x, y, z are the walls of the cells of level 0; a patch has 'shape' cells of its 'level' "
    "from cell 'low' on, counted from the domain's corner; 'ratio' cells of each level make one "
    "of the level before"
)
_CORNERS = "; a patch has 'shape' cells between the corners 'lower' and 'upper'"


@dataclass
class PlainGrid:
    """The arrays and attributes that define a grid."""

    type: str
    order: str
    arrays: dict[str, np.ndarray]
    attributes: dict[str, Any] = field(default_factory=dict)


def plain_grid(grid: Any) -> PlainGrid:
    """Return a grid as plain arrays."""
    if grid.kind in ("cartesian", "spherical", "cylindrical"):
        plain = PlainGrid(grid.kind, _C_ORDER, dict(zip(grid.coordinates, grid.edges, strict=True)))
        if grid.kind == "spherical":
            plain.attributes["mirror"] = grid.mirror
        if not is_structured(grid):
            plain.order, plain.arrays["levels"] = _DEPTH_FIRST, grid.levels
            plain.attributes["split"] = list(grid.places.axes)
    elif grid.kind == "octree":
        plain = PlainGrid("octree", _DEPTH_FIRST, dict(zip("xyz", grid.base_edges, strict=True)))
        plain.arrays["levels"], plain.attributes["split"] = grid.levels, [0, 1, 2]
    elif grid.kind == "patches":
        patches = grid.patches
        plain = PlainGrid("patches", _PATCH_AFTER_PATCH, {"shape": patches.shape})
        if (grid.divisions == patches.sizes[0]).all():
            plain.order += _BOXES
            plain.arrays |= dict(zip("xyz", grid.base_edges, strict=True))
            plain.arrays |= {"level": patches.level, "low": patches.low}
            plain.arrays["ratio"] = patches.sizes[:-1] // patches.sizes[1:]
        else:  # the walls of the coarsest cells are not stored
            plain.order += _CORNERS
            for name, corner in zip(("lower", "upper"), patches.corners, strict=True):
                plain.arrays[name] = grid.position(corner.T).T
    else:
        raise InputError(f"a native file holds the grids of voluminous, got {type(grid).__name__}")
    plain.attributes |= {"unit": exact_name(grid.unit), "cells": grid.size}
    return plain


def grid_of(plain: PlainGrid) -> Grid:
    """Return the grid of a `PlainGrid`; inverse of `plain_grid`."""
    makers: dict[str, Callable[..., Grid]] = {
        "cartesian": _cartesian,
        "octree": _octree,
        "patches": _patches,
        "spherical": _curvilinear,
        "cylindrical": _curvilinear,
    }
    if plain.type not in makers:
        raise FileFormatError(f"/grid has the type {plain.type!r}, expected {', '.join(makers)}")
    cells = plain.attributes.get("cells")
    try:
        unit = parse_unit(plain.attributes.get("unit", ""))
        grid = makers[plain.type](plain, plain.arrays, unit)
    except KeyError as error:
        raise FileFormatError(f"/grid of type {plain.type!r} lacks {error}") from error
    except (InputError, UnitsError) as error:
        raise FileFormatError(f"/grid of type {plain.type!r}: {error}") from error
    if grid.size != cells:
        raise FileFormatError(f"/grid makes {grid.size} cells, but says {cells}")
    return grid


def _cartesian(plain: PlainGrid, arrays: dict[str, np.ndarray], unit: Any) -> Grid:
    from ...grids import CartesianGrid

    return CartesianGrid(arrays["x"], arrays["y"], arrays["z"], unit=unit)


def _octree(plain: PlainGrid, arrays: dict[str, np.ndarray], unit: Any) -> Grid:
    from ...grids import OctreeGrid

    x, y, z, levels = (arrays[name] for name in ("x", "y", "z", "levels"))
    return OctreeGrid.from_levels(x, y, z, levels, unit=unit)


def _patches(plain: PlainGrid, arrays: dict[str, np.ndarray], unit: Any) -> Grid:
    from ...grids import PatchGrid

    shape, cells = np.asarray(arrays["shape"]), int(plain.attributes["cells"])
    # Each cell of a patch is visible, or contains a visible one.
    largest = np.prod(shape.astype(float), axis=-1).max(initial=0.0)
    if not largest <= cells:
        raise FileFormatError(
            f"/grid has a patch of {largest:g} cells, but {cells} cells are seen of all"
        )
    if "lower" in arrays:
        return PatchGrid(arrays["lower"], arrays["upper"], shape, unit=unit)
    x, y, z, level, low, ratio = (arrays[name] for name in ("x", "y", "z", "level", "low", "ratio"))
    return PatchGrid.from_boxes(x, y, z, level, low, shape, ratio, unit=unit)


def _curvilinear(plain: PlainGrid, arrays: dict[str, np.ndarray], unit: Any) -> Grid:
    from ...grids import CylindricalGrid, SphericalGrid
    from ...grids.trees.octree_order import Places, checked_levels, flags_from_levels

    spherical = plain.type == "spherical"
    kind: Any = SphericalGrid if spherical else CylindricalGrid
    more = {"mirror": bool(plain.attributes.get("mirror"))} if spherical else {}
    edges = [arrays[name] for name in kind.coordinates]
    if "levels" not in arrays:
        plain_edges: Grid = kind(*edges, unit=unit, **more)
        return plain_edges
    levels = checked_levels(arrays["levels"])
    split = tuple(sorted({int(axis) for axis in np.ravel(plain.attributes["split"])}))
    if not split or not {*split} <= {0, 1, 2}:
        raise FileFormatError(f"/grid must split some of the axes 0, 1 and 2, got {split}")
    flags = flags_from_levels(levels, Places(levels, split))
    grid: BoxGrid = kind(*edges, refined=flags, unit=unit, **more)
    if not np.array_equal(grid.levels, levels):
        raise FileFormatError("/grid/levels do not describe a refined grid on these base cells")
    return grid


def exact_name(unit: Any) -> str:
    """Return a unit name that `parse_unit` converts back to the same unit.

    Examples
    --------
    >>> exact_name(parse_unit("0.5 kpc")), exact_name(parse_unit("0.123456789012 pc"))
    ('0.5 kpc', '0.123456789012 pc')
    """
    name = unit_name(unit)
    try:
        if parse_unit(name) == unit:
            return name
    except UnitsError:
        pass
    from astropy import units as u

    whole = u.CompositeUnit(1, unit.bases, unit.powers)
    return f"{float(unit.scale)!r} {whole}".strip()
