"""Cell positions of a yt data set as integer indices on the lattice of each level."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...grids import CartesianGrid, CylindricalGrid, OctreeGrid, PatchGrid, SphericalGrid
from ...memory import check_memory
from ..axes import round_unit
from ..contract import UnitLike
from ..leaves import ABSENT, placed_values, tree_of_leaves
from .source import YtSource, plain_values

if TYPE_CHECKING:
    from ...grids.contract import Grid

_DEGREE = math.pi / 180


@dataclass(frozen=True)
class YtAxis:
    """One of our coordinates: the corresponding yt axis and the conversion from it."""

    name: str
    length: bool = True
    turned: bool = False
    of: Callable[[Any, np.ndarray], np.ndarray] | None = None

    def walls(self, ds: Any, values: np.ndarray) -> np.ndarray:
        """Convert walls from yt's coordinate to this one."""
        return values if self.of is None else self.of(ds, values)


_THETA = YtAxis("latitude", False, True, lambda ds, x: (90 - x) * _DEGREE)
_PHI = YtAxis("longitude", False, False, lambda ds, x: x * _DEGREE)
GEOMETRIES: dict[str, tuple[str, tuple[YtAxis, ...]]] = {
    "cartesian": ("cartesian", (YtAxis("x"), YtAxis("y"), YtAxis("z"))),
    "cylindrical": ("cylindrical", (YtAxis("r"), YtAxis("theta", False), YtAxis("z"))),
    "polar": ("cylindrical", (YtAxis("r"), YtAxis("theta", False), YtAxis("z"))),
    "spherical": ("spherical", (YtAxis("r"), YtAxis("theta", False), YtAxis("phi", False))),
    "geographic": (
        "spherical",
        (YtAxis("altitude", of=lambda ds, x: x + _radius(ds, "surface_height", 0)), _THETA, _PHI),
    ),
    "internal_geographic": (
        "spherical",
        (
            YtAxis("depth", True, True, lambda ds, x: _radius(ds, "outer_radius", x.max()) - x),
            _THETA,
            _PHI,
        ),
    ),
}


def code_numbers(values: Any) -> np.ndarray:
    """Return lengths as plain numbers in code units; yt stores angles as such lengths too."""
    if hasattr(values, "units"):
        values = values.to("code_length").d if not values.units.is_dimensionless else values.d
    return np.asarray(values, dtype=np.float64)


def _radius(ds: Any, name: str, otherwise: float) -> float:
    return float(code_numbers(getattr(ds, name, otherwise)))


# Tolerance for grid corners relative to the lattice, in cells.
_ROUNDING = 0.05


@dataclass(frozen=True)
class YtLattice:
    """The cells of all levels, in the coordinates and axis order of our grids."""

    kind: str
    unit: UnitLike  # of lengths
    walls: tuple[np.ndarray, ...]  # the walls of the cells of level 0, ascending
    sizes: np.ndarray  # number of cells of each level per level-0 cell, along each axis
    axes: tuple[int, ...]  # yt axis for each of ours
    turned: tuple[bool, ...]  # our axes that run in the opposite direction

    @property
    def counts(self) -> np.ndarray:
        """Number of level-0 cells along each axis."""
        return np.array([len(w) - 1 for w in self.walls])

    def cells(self, level: np.ndarray, index: np.ndarray) -> np.ndarray:
        """Convert cell indices (n, 3) from yt's axis order to ours."""
        return self.boxes(level, index, np.ones(3, np.int64))

    def boxes(self, level: np.ndarray, low: np.ndarray, shape: np.ndarray) -> np.ndarray:
        """Convert the first cells (n, 3) of boxes from yt's axis order to ours."""
        found = low[:, self.axes].astype(np.int64)
        shape = np.broadcast_to(shape, low.shape)[:, self.axes]
        for axis in np.flatnonzero(self.turned):
            end = self.counts[axis] * self.sizes[level, axis]
            found[:, axis] = end - found[:, axis] - shape[:, axis]
        return found

    def edges(self, level: int, low: np.ndarray, high: np.ndarray) -> list[np.ndarray]:
        """Return the cell walls of a level from `low` to `high`."""
        return [
            np.interp(np.arange(a, b + 1) / size, np.arange(len(w)), w)
            for w, size, a, b in zip(self.walls, self.sizes[level], low, high, strict=True)
        ]

    def array(self, values: np.ndarray) -> np.ndarray:
        """Convert an array from yt's axes to ours."""
        steps = tuple(slice(None, None, -1 if t else None) for t in self.turned)
        return values.transpose(self.axes)[steps]


def lattice_of(ds: Any, unit: UnitLike = None) -> YtLattice:
    """Return the lattice of a data set."""
    if str(ds.geometry) not in GEOMETRIES:
        raise InputError(f"cells of geometry {str(ds.geometry)!r} cannot be used")
    kind, ours = GEOMETRIES[str(ds.geometry)]
    order = [str(name) for name in ds.coordinates.axis_order]
    axes = tuple(order.index(axis.name) for axis in ours)
    widths = _base_widths(ds)
    walls = [axis.walls(ds, _walls(ds, a, widths)) for axis, a in zip(ours, axes, strict=True)]
    lengths = [np.ptp(w) for w, axis in zip(walls, ours, strict=True) if axis.length]
    unit, factor = length_unit(ds, max(lengths), unit)
    return YtLattice(
        kind,
        unit,
        tuple(
            np.ascontiguousarray(w[:: -1 if axis.turned else 1]) * (factor if axis.length else 1.0)
            for w, axis in zip(walls, ours, strict=True)
        ),
        _sizes(ds)[:, axes],
        axes,
        tuple(axis.turned for axis in ours),
    )


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


def grid_boxes(ds: Any, lattice: YtLattice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return level (n,), first cell and number of cells (n, 3) of each grid of a data set."""
    index = ds.index
    level = np.asarray(index.grid_levels).reshape(-1).astype(np.int64)
    shape = np.asarray(index.grid_dimensions).astype(np.int64)
    width = code_numbers(ds.domain_width) / ds.domain_dimensions
    inverse = np.argsort(lattice.axes)
    place = (code_numbers(index.grid_left_edge) - code_numbers(ds.domain_left_edge)) / width
    place *= lattice.sizes[level][:, inverse]
    low = np.round(place).astype(np.int64)
    off = (np.abs(place - low) > _ROUNDING).any(axis=1)
    if off.any() and not _is_uneven(ds):
        bad = int(np.argmax(off))
        raise InputError(f"grid {bad} begins {place[bad].tolist()} cells from the domain's corner")
    if _is_uneven(ds):
        low[:] = 0
    return level, lattice.boxes(level, low, shape), shape[:, lattice.axes]


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


def _is_uneven(ds: Any) -> bool:
    return _base_widths(ds) is not None


def _base_widths(ds: Any) -> Any:
    """Return the cell widths along each axis if they are uneven, for a data set of one grid."""
    grids: Any = getattr(ds.index, "grids", ())
    if len(grids) == 0 or getattr(grids[0], "cell_widths", None) is None:
        return None
    if len(grids) > 1:
        raise InputError("cells of uneven widths in several grids cannot be used")
    return grids[0].cell_widths


def _walls(ds: Any, axis: int, widths: Any) -> np.ndarray:
    """Return the level-0 cell walls along a yt axis, in code units."""
    low, high = (float(code_numbers(e)[axis]) for e in (ds.domain_left_edge, ds.domain_right_edge))
    if widths is None:
        return np.linspace(low, high, int(ds.domain_dimensions[axis]) + 1)
    return low + np.append(0.0, np.cumsum(code_numbers(widths[axis])))


# Returns the values of a yt field (a tuple) in a yt unit, in the form that a volume takes.
Load = Callable[[tuple[str, str], Any], Any]
_REGULAR: dict[str, Any] = {
    "cartesian": CartesianGrid,
    "spherical": SphericalGrid,
    "cylindrical": CylindricalGrid,
}
_TREES: dict[str, Any] = {**_REGULAR, "cartesian": OctreeGrid}
# A region that fills less than 1 / `_SPARSE` of its box is not extended to the whole box.
_SPARSE = 8
_FEW = 1 << 16
_ADVICE = "choose a smaller region, such as ds.box(left, right)"


def layout(source: YtSource, lattice: YtLattice) -> tuple[Any, Load]:
    """Return the grid of a source's cells, and a function that loads a field onto it.

    There is no resampling. Cells of one level become a regular grid; grids of several levels become
    patches, or a tree in curvilinear coordinates; octrees remain octrees.
    """
    if source.whole and source.kind == "grids":
        level, low, shape = grid_boxes(source.ds, lattice)
        if not level.any() and shape.prod(axis=1).sum() == lattice.counts.prod():
            return _joined(source, lattice, low)
        if lattice.kind == "cartesian":
            return _patches(source, lattice, 0, np.zeros(3, np.int64), lattice.counts)
    level, index = _all_cells(source, lattice)
    base, low, high = _box(level, index, lattice)
    if level.min() == level.max() == base:
        number = np.ravel_multi_index(tuple((index - low).T), tuple(high - low))
        grid = _REGULAR[lattice.kind](*lattice.edges(base, low, high), unit=lattice.unit)
        return _scattered(source, grid, number)
    if source.kind == "grids" and lattice.kind == "cartesian":
        return _patches(source, lattice, base, low, high)
    return _tree(source, lattice, level - base, index, (base, low, high))


def _all_cells(source: YtSource, lattice: YtLattice) -> tuple[np.ndarray, np.ndarray]:
    """Return level and index of all cells."""
    found = [(level, lattice.cells(level, index)) for level, index in source.cells()]
    if not sum(len(level) for level, _ in found):
        raise InputError("the region has no cells; is it inside the domain?")
    levels, indices = zip(*found, strict=True)
    return np.concatenate(levels), np.concatenate(indices)


def _box(
    level: np.ndarray, index: np.ndarray, lattice: YtLattice
) -> tuple[int, np.ndarray, np.ndarray]:
    """Return level, first cell and last cell of the box around the cells.

    The level is that of the largest cell, or a coarser one if the cells are sparse.
    """
    base = int(level.min())
    sizes = lattice.sizes // lattice.sizes[base]
    ends = [(index[level == k] // sizes[k], k) for k in np.unique(level)]
    low = np.min([cells.min(axis=0) for cells, _ in ends], axis=0)
    high = np.max([cells.max(axis=0) for cells, _ in ends], axis=0) + 1
    most = max(_SPARSE * len(level), _FEW)
    while base > 0 and np.prod((high - low).astype(float)) > most:
        ratio = lattice.sizes[base] // lattice.sizes[base - 1]
        base, low, high = base - 1, low // ratio, -(-high // ratio)
    return base, low, high


def _joined(source: YtSource, lattice: YtLattice, low: np.ndarray) -> tuple[Any, Load]:
    grid = _REGULAR[lattice.kind](*lattice.walls, unit=lattice.unit)

    def load(field: tuple[str, str], unit: UnitLike) -> np.ndarray:
        whole = np.empty(grid.shape)
        for part, first in zip(source.ds.index.grids, low, strict=True):
            kept = set(part.field_data)
            values = lattice.array(plain_values(part[field], unit))
            for key in set(part.field_data) - kept:
                del part.field_data[key]  # otherwise it lives as long as the data set
            x, y, z = (slice(a, a + n) for a, n in zip(first, values.shape, strict=True))
            whole[x, y, z] = values
        return whole

    return grid, load


def _patches(
    source: YtSource, lattice: YtLattice, base: int, low: np.ndarray, high: np.ndarray
) -> tuple[Any, Load]:
    """Return the parts of the grids of level `base` and finer that lie in a box of cells."""
    level, first, shape = grid_boxes(source.ds, lattice)
    ratio = lattice.sizes // lattice.sizes[base]
    last = np.minimum(first + shape, high * ratio[level])
    first = np.maximum(first, low * ratio[level])
    inside = (level >= base) & (first < last).all(axis=1)
    level, first, last = level[inside], first[inside], last[inside]
    check_memory(16 * int((last - first).prod(axis=1).sum()), "reading the grids", _ADVICE)
    sizes = ratio[base : int(level.max()) + 1]
    x, y, z = lattice.edges(base, low, high)
    grid = PatchGrid.from_boxes(
        x,
        y,
        z,
        level - base,
        first - low * ratio[level],
        last - first,
        sizes[1:] // sizes[:-1],
        unit=lattice.unit,
    )

    def numbers(levels: np.ndarray, indices: np.ndarray) -> np.ndarray:
        place = (lattice.cells(levels, indices) - low * ratio[levels]).T
        found: np.ndarray = grid.tree.find(place * grid.patches.sizes[levels - base].T).number
        return found

    return _scattered(source, grid, np.concatenate([numbers(*c) for c in source.cells()]))


def _tree(
    source: YtSource,
    lattice: YtLattice,
    level: np.ndarray,
    index: np.ndarray,
    box: tuple[int, np.ndarray, np.ndarray],
) -> tuple[Any, Load]:
    base, low, high = box
    ratio = lattice.sizes // lattice.sizes[base]
    ratios = lattice.sizes[1:] // lattice.sizes[:-1]
    axes = np.flatnonzero((ratios == 2).all(axis=0)) if len(ratios) else np.arange(3)
    halved = np.where(np.isin(np.arange(3), axes), 1 << np.arange(len(ratio))[:, None], 1)
    if (lattice.sizes != halved).any():
        raise InputError(
            "refined cells in these coordinates must be halves of the coarser ones, along the same "
            f"axes; levels make {lattice.sizes.tolist()} cells of one"
        )
    grid, order = tree_of_leaves(
        _TREES[lattice.kind],
        lattice.edges(base, low, high),
        level,
        index - low * ratio[level + base],
        axes.tolist(),
        unit=lattice.unit,
    )
    return grid, lambda field, unit: placed_values(source.values(field, unit), order)


def _scattered(source: YtSource, grid: Grid, number: np.ndarray) -> tuple[Any, Load]:
    """Return the grid and a loader that assigns values by cell number; other cells are missing."""
    if (number < 0).any():
        raise InputError("yt tells of a cell that is in no grid; is the region of this data set?")
    small = np.int32 if grid.size < np.iinfo(np.int32).max else np.int64
    order = np.full(grid.size, ABSENT, small)
    order[number] = np.arange(len(number))

    def load(field: tuple[str, str], unit: UnitLike) -> np.ndarray:
        return placed_values(source.values(field, unit), order).reshape(grid.shape)

    return grid, load
