"""Particles deposited on a grid: which method, on which octree, how fine."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

import numpy as np

from ..errors import InputError
from ..grids import CartesianGrid
from ..memory import check_memory
from ..units import Unit, plain
from .cells import CellsDeposit
from .deposit import Deposit
from .inputs import (
    LARGEST,
    Particles,
    check_lengths,
    positive,
    smoothing_lengths,
)
from .kernels import get_kernel
from .octree import DEEPEST, Base, Refinement, octree_around
from .smoothed import SmoothedDeposit

# Widest cells of few particles and of many: in smoothing lengths, and in cube roots of mesh cells'
# volumes. Columns of an SPH disc differ by 1.3 and 2.6 % from the kernels' own, with 6 and 2 cells
# per particle; those of a Voronoi mesh by 8.6 and 13 % from exact ones, with 28 and 6.
_SMOOTHED_WIDTHS, _MESH_WIDTHS, _FEW = (1.0, 1.5), (0.5, 1.0), 50_000
# How many times finer than usual particles are looked at, however small cells are: 729 places each.
_FINEST = 8
# Kernels that reach over so many periodic boxes are the same everywhere, to 0.4 % for the narrowest
# one: broader ones would only need more images.
_BROADEST = 3.0


@dataclass(frozen=True)
class _Sizes:
    """What kind of particles they are.

    Attributes
    ----------
    size : array, shape (n,)
        The scale on which a particle is resolved.
    reach : array, shape (n,)
        How far it reaches.
    volume : array or None, shape (n,)
        Of the cells of a mesh; None for particles that are smoothed.
    """

    size: np.ndarray
    reach: np.ndarray
    volume: np.ndarray | None = None

    @property
    def cell_width(self) -> float:
        return self._widths[len(self.size) > _FEW]

    def steps(self, cell_width: float) -> int:
        return min(max(1, math.ceil(self._widths[0] / cell_width)), _FINEST)

    @property
    def _widths(self) -> tuple[float, float]:
        return _SMOOTHED_WIDTHS if self.volume is None else _MESH_WIDTHS


def deposit(
    given: Particles,
    *,
    smoothing_length: Any = None,
    volume: Any = None,
    density: Any = None,
    kernel: str = "cubic",
    bounds: Any = None,
    periodic: bool = False,
    max_particles: int = 8,
    cell_width: float | None = None,
    min_level: int = 0,
    max_level: int = DEEPEST,
) -> Deposit:
    """Return particles placed on an octree; parameters are those of `from_particles`."""
    check_options(max_particles, cell_width, min_level, max_level, periodic)
    check_count(len(given.mass))
    smooth, box = get_kernel(kernel), _box(bounds, periodic, given.unit)
    points = given.points if box is None else _placed(box, given.points)
    if volume is not None or density is not None:
        sizes = _of_mesh(given, smoothing_length, volume, density)
    else:
        sizes = _of_kernels(given, smoothing_length, smooth.support, box, points)
    check_lengths(sizes.size, "sizes of particles", 1 / LARGEST)
    base = _around(points, sizes) if box is None else box
    width = cell_width or sizes.cell_width
    widest, steps = width * sizes.size, sizes.steps(width)
    rule = Refinement(max_particles, sizes.size, widest, sizes.reach, min_level, max_level, steps)
    grid = octree_around(base, points, rule, given.unit)
    if sizes.volume is None:
        return SmoothedDeposit(base, grid, points, given.mass, sizes.reach, smooth, steps)
    # The cells of a mesh are longer here and there than they are wide.
    return CellsDeposit(base, grid, points, given.mass, sizes.volume, 3 * sizes.reach)


def _box(bounds: Any, periodic: bool, unit: Unit) -> Base | None:
    if bounds is not None:
        return Base.within(_limits(bounds, unit), periodic)
    if periodic:
        raise InputError("a periodic domain needs bounds=((x0, x1), (y0, y1), (z0, z1))")
    return None


def _placed(box: Base, points: np.ndarray) -> np.ndarray:
    points = box.wrapped(points)
    if not box.inside(points).any():
        raise InputError(f"no particle is inside of bounds {box.bounds.tolist()}")
    return points


def _of_mesh(given: Particles, smoothing_length: Any, volume: Any, density: Any) -> _Sizes:
    if smoothing_length is not None or (volume is not None and density is not None):
        raise InputError(
            "give one of smoothing_length (SPH), volume or density (cells of a mesh); what else "
            "particles have may be among fields"
        )
    volumes = given.volumes(volume, density)
    size = np.cbrt(volumes)
    return _Sizes(size, size, volumes)


def _of_kernels(
    given: Particles, length: Any, support: float, box: Base | None, points: np.ndarray
) -> _Sizes:
    if length is None:
        h = smoothing_lengths(box if box is not None and box.periodic else None, points)
    else:
        h = positive(length, given.unit, "smoothing_length", len(points))
    radius = support * h
    if box is not None and box.periodic:
        radius = np.minimum(radius, _BROADEST * np.ptp(box.bounds, axis=1).max())
    return _Sizes(h, radius)


def _around(points: np.ndarray, sizes: _Sizes) -> Base:
    """Return the domain of all that particles reach; cells of a mesh end half a width outside."""
    reach = sizes.reach if sizes.volume is None else 0.5 * sizes.reach
    low = (points - reach[:, None]).min(axis=0)
    high = (points + reach[:, None]).max(axis=0)
    return Base.around(np.stack([low, high], axis=1))


def _limits(bounds: Any, unit: Unit) -> np.ndarray:
    box = CartesianGrid.uniform(1, bounds, unit=unit)
    limits: np.ndarray = box.bounds
    if box.unit != unit:
        from astropy import units as u

        limits = plain(u.Quantity(limits, box.unit), unit, "bounds")
    check_lengths(np.ptp(limits, axis=1), "widths of bounds", 1 / LARGEST)
    return limits


# Memory that a particle takes: coordinates, keys, their sorting.
_PARTICLE_BYTES = 300


def check_options(
    max_particles: Any, cell_width: Any, min_level: Any, max_level: Any, periodic: Any
) -> None:
    """Refuse options that cannot be; they are those of `from_particles`."""
    if not isinstance(max_particles, Integral) or max_particles < 1:
        raise InputError(f"max_particles must be a whole number, at least 1, got {max_particles!r}")
    width = float(cell_width) if isinstance(cell_width, Real) else 0.0
    if cell_width is not None and not 0 < width < float("inf"):
        raise InputError(f"cell_width must be a positive, finite number, got {cell_width!r}")
    levels = (min_level, max_level)
    whole = all(isinstance(level, Integral) for level in levels)
    if not whole or not 0 <= min_level <= max_level <= DEEPEST:
        raise InputError(
            f"expected whole numbers, 0 <= min_level <= max_level <= {DEEPEST}, got "
            f"{min_level!r}, {max_level!r}"
        )
    if np.ndim(periodic) or periodic not in (True, False):
        raise InputError(
            f"periodic must be True, all axes, or False, got {periodic!r}; a box that is periodic "
            "along some axes is not known"
        )


def check_count(count: int) -> None:
    """Refuse more particles than there is memory for."""
    advice = "give a part of them, or use a machine with more memory"
    check_memory(count * _PARTICLE_BYTES, f"placing {count} particles on a grid", advice)
