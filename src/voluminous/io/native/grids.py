"""Conversion of grids to plain arrays and back, exact to the bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...errors import FileFormatError, InputError, UnitsError
from ...units import parse_unit, unit_name
from ..contract import UnitLike

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
    writers: dict[str, Callable[[Any], PlainGrid]] = {
        "cartesian": lambda g: PlainGrid("cartesian", _C_ORDER, _edges("xyz", g.edges)),
        "octree": _octree,
        "patches": _patches,
        "spherical": lambda g: _curvilinear("spherical", g, mirror=g.mirror),
        "cylindrical": lambda g: _curvilinear("cylindrical", g),
    }
    if grid.kind not in writers:
        raise InputError(f"a native file holds the grids of voluminous, got {type(grid).__name__}")
    found = writers[grid.kind](grid)
    found.attributes |= {"unit": exact_name(grid.unit), "cells": grid.size}
    return found


def _edges(names: Any, edges: Any) -> dict[str, np.ndarray]:
    return dict(zip(names, edges, strict=True))


def _octree(grid: Any) -> PlainGrid:
    arrays = {**_edges("xyz", grid.base_edges), "levels": grid.levels}
    return PlainGrid("octree", _DEPTH_FIRST, arrays, {"split": [0, 1, 2]})


def _curvilinear(kind: str, grid: Any, **attributes: Any) -> PlainGrid:
    arrays = _edges(grid.coordinates, grid.edges)
    if grid.is_structured:
        return PlainGrid(kind, _C_ORDER, arrays, attributes)
    arrays["levels"], attributes["split"] = grid.levels, list(grid.places.axes)
    return PlainGrid(kind, _DEPTH_FIRST, arrays, attributes)


def _patches(grid: Any) -> PlainGrid:
    patches = grid.patches
    if (grid.divisions != patches.sizes[0]).any():  # the walls of the coarsest cells are not stored
        lower, upper = (grid.position(corner.T).T for corner in patches.corners)
        corners = {"lower": lower, "upper": upper, "shape": patches.shape}
        return PlainGrid("patches", _PATCH_AFTER_PATCH + _CORNERS, corners)
    arrays = _edges("xyz", grid.base_edges)
    arrays |= {"level": patches.level, "low": patches.low, "shape": patches.shape}
    arrays["ratio"] = patches.sizes[:-1] // patches.sizes[1:]
    return PlainGrid("patches", _PATCH_AFTER_PATCH + _BOXES, arrays)


def grid_of(plain: PlainGrid) -> Any:
    """Return the grid of a `PlainGrid`; inverse of `plain_grid`."""
    makers = {
        "cartesian": _make_cartesian,
        "octree": _make_octree,
        "patches": _make_patches,
        "spherical": _make_curvilinear,
        "cylindrical": _make_curvilinear,
    }
    if plain.type not in makers:
        raise FileFormatError(f"/grid has the type {plain.type!r}, expected {', '.join(makers)}")
    try:
        unit = parse_unit(plain.attributes.get("unit", ""))
        grid = makers[plain.type](plain, unit)
    except KeyError as error:
        raise FileFormatError(f"/grid of type {plain.type!r} lacks {error}") from error
    except (InputError, UnitsError) as error:
        raise FileFormatError(f"/grid of type {plain.type!r}: {error}") from error
    if grid.size != plain.attributes.get("cells"):
        raise FileFormatError(
            f"/grid makes {grid.size} cells, but says {plain.attributes.get('cells')}"
        )
    return grid


def _make_cartesian(plain: PlainGrid, unit: UnitLike) -> Any:
    from ...grids import CartesianGrid

    return CartesianGrid(*(plain.arrays[axis] for axis in "xyz"), unit=unit)


def _make_octree(plain: PlainGrid, unit: UnitLike) -> Any:
    from ...grids import OctreeGrid

    x, y, z, levels = (plain.arrays[name] for name in ("x", "y", "z", "levels"))
    return OctreeGrid.from_levels(x, y, z, levels, unit=unit)


def _make_patches(plain: PlainGrid, unit: UnitLike) -> Any:
    from ...grids import PatchGrid

    arrays = plain.arrays
    shape = np.asarray(arrays["shape"])
    _check_patches(shape, int(plain.attributes["cells"]))
    if "lower" in arrays:
        return PatchGrid(arrays["lower"], arrays["upper"], shape, unit=unit)
    x, y, z, level, low, ratio = (arrays[name] for name in ("x", "y", "z", "level", "low", "ratio"))
    return PatchGrid.from_boxes(x, y, z, level, low, shape, ratio, unit=unit)


def _check_patches(shape: np.ndarray, cells: int) -> None:
    """Refuse invalid patches: each of their cells must be a visible cell or contain one."""
    largest = np.prod(shape.astype(float), axis=-1).max(initial=0.0)
    if not largest <= cells:
        raise FileFormatError(
            f"/grid has a patch of {largest:g} cells, but {cells} cells are seen of all"
        )


def _make_curvilinear(plain: PlainGrid, unit: UnitLike) -> Any:
    from ...grids import CylindricalGrid, SphericalGrid

    spherical = plain.type == "spherical"
    kind: Any = SphericalGrid if spherical else CylindricalGrid
    more = {"mirror": bool(plain.attributes.get("mirror"))} if spherical else {}
    edges = [plain.arrays[name] for name in kind.coordinates]
    grid = kind(*edges, refined=_flags(plain.arrays, plain.attributes), unit=unit, **more)
    levels = plain.arrays.get("levels")
    if levels is not None and not np.array_equal(grid.levels, levels):
        raise FileFormatError("/grid/levels do not describe a refined grid on these base cells")
    return grid


def _flags(arrays: Mapping[str, Any], attributes: dict[str, Any]) -> Any:
    if "levels" not in arrays:
        return None
    from ...grids.trees.octree_order import Places, checked_levels, flags_from_levels

    levels = checked_levels(arrays["levels"])
    split = sorted({int(axis) for axis in np.ravel(attributes["split"])})
    if not split or not set(split) <= {0, 1, 2}:
        raise FileFormatError(f"/grid must split some of the axes 0, 1 and 2, got {split}")
    return flags_from_levels(levels, Places(levels, tuple(split)))


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
