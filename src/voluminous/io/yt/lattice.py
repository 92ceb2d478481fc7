"""Where the cells of a data set are: whole numbers on the lattice of each level."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError
from ..lengths import round_unit
from .coordinates import GEOMETRIES, code_numbers

# How far corners of grids may be off the lattice, in cells.
_ROUNDING = 0.05


@dataclass(frozen=True)
class Lattice:
    """The cells of all levels, in the coordinates and the order of axes of our grids.

    Attributes
    ----------
    kind : {"cartesian", "spherical", "cylindrical"}
    unit : unit
        Of lengths.
    walls : tuple of three float64 arrays
        The walls of the cells of level 0, ascending.
    sizes : array of int64, shape (levels, 3)
        How many cells of each level make one of level 0, along each axis.
    axes : tuple of int
        Which axis of yt each of ours is.
    turned : tuple of bool
        Which of ours run the other way.
    """

    kind: str
    unit: Any
    walls: tuple[np.ndarray, ...]
    sizes: np.ndarray
    axes: tuple[int, ...]
    turned: tuple[bool, ...]

    @property
    def counts(self) -> np.ndarray:
        """Cells of level 0 along each axis."""
        return np.array([len(w) - 1 for w in self.walls])

    def cells(self, level: np.ndarray, index: np.ndarray) -> np.ndarray:
        """Return indices of cells in our order of axes, from those of yt (n, 3)."""
        return self.boxes(level, index, np.ones(3, np.int64))

    def boxes(self, level: np.ndarray, low: np.ndarray, shape: np.ndarray) -> np.ndarray:
        """Return the first cells (n, 3) of boxes in our order of axes, from those of yt."""
        found = low[:, self.axes].astype(np.int64)
        shape = np.broadcast_to(shape, low.shape)[:, self.axes]
        for axis in np.flatnonzero(self.turned):
            end = self.counts[axis] * self.sizes[level, axis]
            found[:, axis] = end - found[:, axis] - shape[:, axis]
        return found

    def edges(self, level: int, low: np.ndarray, high: np.ndarray) -> list[np.ndarray]:
        """Return the walls of the cells of a level from `low` to `high`."""
        return [
            np.interp(np.arange(a, b + 1) / size, np.arange(len(w)), w)
            for w, size, a, b in zip(self.walls, self.sizes[level], low, high, strict=True)
        ]

    def array(self, values: np.ndarray) -> np.ndarray:
        """Return an array over yt's axes with ours."""
        steps = tuple(slice(None, None, -1 if t else None) for t in self.turned)
        return values.transpose(self.axes)[steps]


def lattice_of(ds: Any, unit: Any = None) -> Lattice:
    """Return the lattice of a data set.

    Parameters
    ----------
    ds : yt Dataset
    unit : unit, optional
        Unit of length; by default one of which the domain is at least one wide.

    Raises
    ------
    InputError
        If its geometry is not known.
    """
    if str(ds.geometry) not in GEOMETRIES:
        raise InputError(f"cells of geometry {str(ds.geometry)!r} cannot be used")
    kind, ours = GEOMETRIES[str(ds.geometry)]
    order = [str(name) for name in ds.coordinates.axis_order]
    axes = tuple(order.index(axis.name) for axis in ours)
    widths = _base_widths(ds)
    walls = [axis.walls(ds, _walls(ds, a, widths)) for axis, a in zip(ours, axes, strict=True)]
    lengths = [np.ptp(w) for w, axis in zip(walls, ours, strict=True) if axis.length]
    unit, factor = length_unit(ds, max(lengths), unit)
    return Lattice(
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


def length_unit(ds: Any, width: float, unit: Any = None) -> tuple[Any, float]:
    """Return a unit of length, and the code's unit of length in it; `width` is in the latter."""
    from astropy import units as u

    code = ds.quan(1.0, "code_length")
    if unit is None:
        unit = round_unit(width * float(code.to("cm")) * u.cm)
    unit = u.Unit(unit)
    name = {"solRad": "Rsun"}.get(str(unit), str(unit))
    try:  # yt's own parsec: what was 4 kpc there is 4 kpc here, to the last digit
        return unit, float(code.to(name))
    except Exception:  # whatever yt raises over a name that it does not know
        return unit, float(code.to("cm")) * u.cm.to(unit)


def grid_boxes(ds: Any, lattice: Lattice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return level (n,), first cell and number of cells (n, 3) of the grids of a data set.

    Raises
    ------
    InputError
        If a grid does not lie on the lattice of its level.
    """
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
    """Return how many cells of each level make one of level 0, in yt's order of axes."""
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
    """Return the widths of cells along each axis where they differ, of a data set of one grid."""
    grids: Any = getattr(ds.index, "grids", ())
    if len(grids) == 0 or getattr(grids[0], "cell_widths", None) is None:
        return None
    if len(grids) > 1:
        raise InputError("cells of uneven widths in several grids cannot be used")
    return grids[0].cell_widths


def _walls(ds: Any, axis: int, widths: Any) -> np.ndarray:
    """Return the walls of the cells of level 0 along an axis of yt, in the code's unit."""
    low, high = (float(code_numbers(e)[axis]) for e in (ds.domain_left_edge, ds.domain_right_edge))
    if widths is None:
        return np.linspace(low, high, int(ds.domain_dimensions[axis]) + 1)
    return low + np.append(0.0, np.cumsum(code_numbers(widths[axis])))
