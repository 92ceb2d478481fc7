"""Grids of a yt data set: cell positions as integer indices on the lattice of each level."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...errors import InputError
from ...grids import OctreeGrid, PatchGrid
from ...memory import check_memory
from ..axes import round_unit
from ..contract import UnitLike
from ..leaves import ABSENT, GRIDS, grid_of_blocks, placed_values, tree_of_leaves
from .fields import Field
from .source import YtSource, plain_values

if TYPE_CHECKING:
    from ...grids.contract import Grid

# The kind of grid, and the yt axes that correspond to its coordinates.
GEOMETRIES = {
    "cartesian": ("cartesian", ("x", "y", "z")),
    "cylindrical": ("cylindrical", ("r", "theta", "z")),
    "polar": ("cylindrical", ("r", "theta", "z")),
    "spherical": ("spherical", ("r", "theta", "phi")),
    "geographic": ("spherical", ("altitude", "latitude", "longitude")),
    "internal_geographic": ("spherical", ("depth", "latitude", "longitude")),
}
_TREES = {**GRIDS, "cartesian": OctreeGrid}
_LENGTHS = ("x", "y", "z", "r", "altitude", "depth")
# Axes that run in the opposite direction.
_TURNED = ("latitude", "depth")
_DEGREE = math.pi / 180
# Tolerance for grid corners relative to the lattice, in cells.
_ROUNDING = 0.05
# A region that fills less than 1 / `_SPARSE` of its box is not extended to the whole box.
_SPARSE = 8
_FEW = 1 << 16
# Returns the values of a field in a yt unit, in the form that a volume takes.
Load = Callable[[Field, Any], Any]


def code_numbers(values: Any) -> np.ndarray:
    """Return lengths as plain numbers in code units; yt stores angles as such lengths too."""
    if hasattr(values, "units"):
        values = values.to("code_length").d if not values.units.is_dimensionless else values.d
    return np.asarray(values, dtype=np.float64)


def length_unit(ds: Any, width: float, unit: UnitLike = None) -> tuple[Any, float]:
    """Return a length unit, and the code unit in it; `width` is in code units."""
    from astropy import units as u

    code = ds.quan(1.0, "code_length")
    if unit is None:
        unit = round_unit(width * float(code.to("cm")) * u.cm)
    unit = u.Unit(unit)
    name = {"solRad": "Rsun"}.get(str(unit), str(unit))
    try:  # use yt's parsec, so that 4 kpc in yt are exactly 4 kpc here
        return unit, float(code.to(name))
    except Exception:  # yt raises various exceptions for an unknown name
        return unit, float(code.to("cm")) * u.cm.to(unit)


class YtLattice(NamedTuple):
    """The cells of all levels, in the coordinates and axis order of our grids."""

    kind: str
    unit: UnitLike  # of lengths
    walls: list[np.ndarray]  # the walls of the cells of level 0, ascending
    sizes: np.ndarray  # number of cells of each level per level-0 cell, along each axis
    axes: list[int]  # yt axis for each of ours
    turned: list[bool]  # our axes that run in the opposite direction
    uneven: bool  # cells of one grid with widths of their own

    @property
    def counts(self) -> np.ndarray:
        """Number of level-0 cells along each axis."""
        return np.array([len(w) - 1 for w in self.walls])

    def boxes(self, level: np.ndarray, low: np.ndarray, shape: np.ndarray | int = 1) -> np.ndarray:
        """Convert the first cells (n, 3) of boxes, or cells, from yt's axis order to ours."""
        shape = np.broadcast_to(shape, low.shape)[:, self.axes]
        low = low[:, self.axes].astype(np.int64)
        ends = self.counts * self.sizes[level]
        return np.where(self.turned, ends - low - shape, low)

    def edges(self, level: int, low: np.ndarray, high: np.ndarray) -> list[np.ndarray]:
        """Return the cell walls of a level from `low` to `high`."""
        return [
            np.interp(np.arange(a, b + 1) / size, np.arange(len(w)), w)
            for w, size, a, b in zip(self.walls, self.sizes[level], low, high, strict=True)
        ]

    def array(self, values: np.ndarray) -> np.ndarray:
        """Convert an array from yt's axes to ours."""
        turned = tuple(np.flatnonzero(self.turned).tolist())
        return np.flip(np.asarray(values).transpose(self.axes), turned)


def lattice_of(ds: Any, unit: UnitLike = None) -> YtLattice:
    """Return the lattice of a data set."""
    if str(ds.geometry) not in GEOMETRIES:
        raise InputError(f"cells of geometry {str(ds.geometry)!r} cannot be used")
    kind, names = GEOMETRIES[str(ds.geometry)]
    order = [str(name) for name in ds.coordinates.axis_order]
    axes = [order.index(name) for name in names]
    grids = list(getattr(ds.index, "grids", ()))
    widths = getattr(grids[0], "cell_widths", None) if grids else None
    if widths is not None and len(grids) > 1:
        raise InputError("cells of uneven widths in several grids cannot be used")
    low, high = (code_numbers(e) for e in (ds.domain_left_edge, ds.domain_right_edge))
    walls = []
    for name, a in zip(names, axes, strict=True):
        w = np.linspace(low[a], high[a], int(ds.domain_dimensions[a]) + 1)
        if widths is not None:
            w = low[a] + np.append(0.0, np.cumsum(code_numbers(widths[a])))
        walls.append(_converted(ds, name, w)[:: -1 if name in _TURNED else 1])
    extents = [np.ptp(w) for w, name in zip(walls, names, strict=True) if name in _LENGTHS]
    unit, factor = length_unit(ds, max(extents), unit)
    walls = [
        np.ascontiguousarray(w) * (factor if name in _LENGTHS else 1.0)
        for w, name in zip(walls, names, strict=True)
    ]
    turned = [name in _TURNED for name in names]
    return YtLattice(kind, unit, walls, _sizes(ds)[:, axes], axes, turned, widths is not None)


def _converted(ds: Any, name: str, walls: np.ndarray) -> np.ndarray:
    if name in ("latitude", "longitude"):
        return (90 - walls if name == "latitude" else walls) * _DEGREE
    if name == "altitude":
        return walls + float(code_numbers(getattr(ds, "surface_height", 0)))
    if name == "depth":
        return float(code_numbers(getattr(ds, "outer_radius", walls.max()))) - walls
    return walls


def _sizes(ds: Any) -> np.ndarray:
    """Return the number of cells of each level per level-0 cell, in yt's axis order."""
    counts = np.asarray(ds.domain_dimensions)
    if not hasattr(ds.index, "grid_levels"):
        return np.left_shift(1, np.arange(31))[:, None] * np.ones(3, np.int64)
    level = np.asarray(ds.index.grid_levels).reshape(-1)
    edges = code_numbers(ds.index.grid_left_edge), code_numbers(ds.index.grid_right_edge)
    widths = (edges[1] - edges[0]) / np.asarray(ds.index.grid_dimensions)
    base = code_numbers(ds.domain_width) / counts
    sizes = [np.ones(3, np.int64)]
    for depth in range(1, int(level.max(initial=0)) + 1):
        here = np.flatnonzero(level == depth)
        if len(here):
            size = np.round(base / widths[here[0]]).astype(np.int64)
        else:  # a level without grids
            size = sizes[-1] * np.where(counts > 1, ds.refine_by, 1)
        sizes.append(np.maximum(size, 1))
    return np.array(sizes)


def grid_boxes(ds: Any, lattice: YtLattice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return level (n,), first cell and number of cells (n, 3) of each grid of a data set."""
    index = ds.index
    level = np.asarray(index.grid_levels).reshape(-1).astype(np.int64)
    shape = np.asarray(index.grid_dimensions).astype(np.int64)
    width = code_numbers(ds.domain_width) / ds.domain_dimensions
    place = (code_numbers(index.grid_left_edge) - code_numbers(ds.domain_left_edge)) / width
    place *= lattice.sizes[level][:, np.argsort(lattice.axes)]
    low = np.round(place).astype(np.int64) * (not lattice.uneven)
    off = (np.abs(place - low) > _ROUNDING).any(axis=1)
    if off.any() and not lattice.uneven:
        bad = int(np.argmax(off))
        raise InputError(f"grid {bad} begins {place[bad].tolist()} cells from the domain's corner")
    return level, lattice.boxes(level, low, shape), shape[:, lattice.axes]


def layout(source: YtSource, lattice: YtLattice) -> tuple[Grid, Load]:
    """Return the grid of a source's cells, and a function that loads a field onto it.

    There is no resampling. Cells of one level become a regular grid; grids of several levels become
    patches, or a tree in curvilinear coordinates; octrees remain octrees.
    """
    ratios, kind = lattice.sizes[1:] // lattice.sizes[:-1], GRIDS[lattice.kind]
    whole_grids = source.whole and source.kind == "grids"
    if whole_grids:
        level, low, shape = grid_boxes(source.ds, lattice)
        if not level.any():
            grid, arrange = grid_of_blocks(
                kind, lattice.walls, level, low, shape, unit=lattice.unit
            )
            return grid, lambda field, unit: arrange(_blocks(source, lattice, field, unit))
    cells = [(level, lattice.boxes(level, index)) for level, index in source.cells()]
    if not sum(len(level) for level, _ in cells):
        raise InputError("the region has no cells; is it inside the domain?")
    level, index = map(np.concatenate, zip(*cells, strict=True))
    base, low, high = _box(level, index, lattice)
    if whole_grids and lattice.kind == "cartesian":
        base, low, high = 0, np.zeros(3, np.int64), lattice.counts
    edges, ratio = lattice.edges(base, low, high), lattice.sizes // lattice.sizes[base]
    if level.min() == level.max() == base:
        grid = kind(*edges, unit=lattice.unit)
        number = np.ravel_multi_index(tuple((index - low).T), tuple(high - low))
    elif source.kind == "grids" and lattice.kind == "cartesian":
        patches = _patches(source, lattice, edges, base, low, high)
        place = (index - low * ratio[level]) * patches.patches.sizes[level - base]
        grid, number = patches, patches.tree.find(place.T).number
    else:
        tree, index = _TREES[lattice.kind], index - low * ratio[level]
        grid, order = tree_of_leaves(tree, edges, level - base, index, ratios, unit=lattice.unit)
        return grid, lambda field, unit: placed_values(source.values(field, unit), order)
    if (number < 0).any():
        raise InputError("yt tells of a cell that is in no grid; is the region of this data set?")
    order = np.full(grid.size, ABSENT, np.int32 if grid.size < 1 << 31 else np.int64)
    order[number] = np.arange(len(number))

    def load(field: Field, unit: UnitLike) -> np.ndarray:
        return placed_values(source.values(field, unit), order).reshape(grid.shape)

    return grid, load


def _blocks(
    source: YtSource, lattice: YtLattice, field: Field, unit: UnitLike
) -> Iterator[np.ndarray]:
    for part in source.ds.index.grids:
        cached = set(part.field_data)
        values = lattice.array(plain_values(part[field], unit))
        for key in set(part.field_data) - cached:
            del part.field_data[key]  # otherwise it lives as long as the data set
        yield values


def _box(
    level: np.ndarray, index: np.ndarray, lattice: YtLattice
) -> tuple[int, np.ndarray, np.ndarray]:
    """Return level, first cell and last cell of the box around the cells.

    The level is that of the largest cell, or a coarser one if the cells are sparse.
    """
    base = int(level.min())
    sizes = lattice.sizes // lattice.sizes[base]
    ends = [index[level == k] // sizes[k] for k in np.unique(level)]
    low = np.min([cells.min(axis=0) for cells in ends], axis=0)
    high = np.max([cells.max(axis=0) for cells in ends], axis=0) + 1
    most = max(_SPARSE * len(level), _FEW)
    while base > 0 and np.prod((high - low).astype(float)) > most:
        ratio = lattice.sizes[base] // lattice.sizes[base - 1]
        base, low, high = base - 1, low // ratio, -(-high // ratio)
    return base, low, high


def _patches(
    source: YtSource,
    lattice: YtLattice,
    edges: list[np.ndarray],
    base: int,
    low: np.ndarray,
    high: np.ndarray,
) -> PatchGrid:
    """Return the parts of the grids of level `base` and finer that lie in a box of cells."""
    level, first, shape = grid_boxes(source.ds, lattice)
    ratio = lattice.sizes // lattice.sizes[base]
    last = np.minimum(first + shape, high * ratio[level])
    first = np.maximum(first, low * ratio[level])
    inside = (level >= base) & (first < last).all(axis=1)
    level, first, shape = level[inside], first[inside], (last - first)[inside]
    advice = "choose a smaller region, such as ds.box(left, right)"
    check_memory(16 * int(shape.prod(axis=1).sum()), "reading the grids", advice)
    sizes = ratio[base : int(level.max()) + 1]
    first, (x, y, z) = first - low * ratio[level], edges
    ratios = sizes[1:] // sizes[:-1]
    return PatchGrid.from_boxes(x, y, z, level - base, first, shape, ratios, unit=lattice.unit)
