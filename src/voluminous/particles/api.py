"""`Volume.from_particles`: which deposit, on which octree, how fine."""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Integral, Real
from typing import Any

import numpy as np

from ..errors import InputError
from ..grids import CartesianGrid
from ..memory import check_memory
from ..progress import Progress, with_progress
from ..units import Unit, plain
from ..volume import Volume
from .deposit import CellsDeposit, Deposit
from .inputs import LARGEST, Particles, carried, check_lengths, get_kernel, particles, positive
from .inputs import smoothing_lengths as estimated_lengths
from .octree import DEEPEST, Base, Refinement, octree_around
from .smoothed import SmoothedDeposit

# Name of the field that the masses make.
_DENSITY = "density"
# Widest cells of few particles and of many: in smoothing lengths, and in cube roots of mesh cells'
# volumes. Columns of an SPH disc differ by 1.3 and 2.6 % from the kernels' own, with 6 and 2 cells
# per particle; those of a Voronoi mesh by 8.6 and 13 % from exact ones, with 28 and 6.
_SMOOTHED_WIDTHS, _MESH_WIDTHS, _FEW = (1.0, 1.5), (0.5, 1.0), 50_000
# How many times finer than usual particles are resolved, however small cells are: 729 places each.
_FINEST = 8
# Kernels that reach over so many periodic boxes are the same everywhere, to 0.4 % for the narrowest
# one: broader ones would only need more images.
_BROADEST = 3.0
# Memory that a particle takes: coordinates, keys, their sorting.
_PARTICLE_BYTES = 300


@with_progress
def from_particles(
    positions: Any,
    masses: Any,
    *,
    smoothing_length: Any = None,
    volume: Any = None,
    density: Any = None,
    fields: Mapping[str, Any] | None = None,
    kernel: str = "cubic",
    bounds: Any = None,
    periodic: bool = False,
    max_particles: int = 8,
    cell_width: float | None = None,
    min_level: int = 0,
    max_level: int = 20,
    empty: float = 0.0,
    unit: Unit = None,
    progress: Progress = None,
) -> Volume:
    """Return a volume of particles, on an octree that is fine where they are.

    Parameters
    ----------
    positions : array_like or Quantity, shape (n, 3)
        In any order.
    masses : float, array_like or Quantity, shape (n,)
        One number is the mass of all. Ones make ``density`` a number density.
    smoothing_length : float, array_like or Quantity, optional
        h of each particle (SPH): it is spread over the cells that its kernel overlaps.
    volume, density : array_like or Quantity, optional
        Volume of each particle, or its density (then its volume is mass / density), for particles
        that are the cells of a moving mesh: each place belongs to the nearest one. Give one of
        these, or smoothing lengths, or nothing: then smoothing lengths are 1.2 mean distances
        of the particles.
    fields : mapping, optional
        Name → what particles carry: arrays or Quantities of shape (n,), or (n, 3) for vectors,
        which become ``name_x``, ``name_y``, ``name_z``.
    kernel : str
        ``"cubic"`` (M4, support 2 h), ``"quartic"`` (M5, 2.5 h), ``"quintic"`` (M6, 3 h),
        ``"wendland-c2"``, ``"wendland-c4"`` or ``"wendland-c6"`` (2 h).
    bounds : array_like or Quantity, optional
        ``(low, high)`` or ``((x0, x1), (y0, y1), (z0, z1))`` of the volume; by default all that
        particles reach.
    periodic : bool
        The bounds are a periodic box. Kernels broader than six of its longest sides are cut to
        these: they are the same everywhere.
    max_particles : int
        A cell with more is split, unless it is narrower than a smoothing length, or than the cell
        of the mesh.
    cell_width : float, optional
        Cells are no wider than this many smoothing lengths, or cube roots of mesh cells' volumes,
        of the particles at whose places they are, or around them: at the corners of the cube in
        their spheres. By default 1.5, or 1 for mesh cells; of up to 50 000 particles 1, or 0.5;
        of smaller ones there are as many more places.
    min_level, max_level : int
        How often base cells are split at least and at most; 20 is the deepest possible.
    empty : float
        The value of `fields` in cells without mass, where the density is zero. NaN hides them.
    unit : str or unit, optional
        Length unit of plain positions.
    progress
        As for `render`.

    Returns
    -------
    Volume
        On an `OctreeGrid`, with the field ``density`` (mass per volume of each cell) and `fields`:
        the mass-weighted means of what the particles in a cell carry. Give what is per mass
        (velocity, specific energy, temperature); what is per volume or per particle should be
        divided by density or mass before, and multiplied afterwards. ``meta["particles"]`` is
        their number.

    Raises
    ------
    InputError
        If arrays do not fit together, are not finite, two fields have the same name, an option is
        not what is asked for, or no particle is inside of `bounds`.
    UnitsError
        If a unit cannot be converted.
    UnknownNameError
        For a kernel that does not exist.
    MemoryNeededError
        If there is not enough memory for so many particles.

    Notes
    -----
    What particles carry is conserved to rounding: ``sum(density * cell_volumes)`` is the sum of the
    masses, ``sum(density * velocity_x * cell_volumes)`` that of the momenta. Where `bounds`
    leave particles out, it is what lies inside that counts: a part of those at the walls.

    A particle's weight in a cell is the integral of its kernel over the cell, by midpoints at most
    an eighth of the support's diameter apart, divided by the sum of its weights; within smaller
    cells that are there for others it is spread evenly. The same particles give the
    same bits, for any number of threads.

    Examples
    --------
    >>> import numpy as np, voluminous as vm
    >>> positions = np.random.default_rng(1).normal(size=(1000, 3))
    >>> volume = vm.Volume.from_particles(positions, 0.5, fields={"velocity": positions}, unit="pc")
    >>> volume.fields
    ('density', 'velocity_x', 'velocity_y', 'velocity_z')
    >>> float(np.sum(volume.array("density") * volume.grid.cell_volumes).round(9))
    500.0
    """
    given = particles(positions, masses, unit)
    values = carried(fields, len(given.mass))
    if _DENSITY in values:
        raise InputError("the field 'density' is made of masses and cells; leave it out of fields")
    on_grid = deposit(
        given,
        smoothing_length=smoothing_length,
        volume=volume,
        density=density,
        kernel=kernel,
        bounds=bounds,
        periodic=periodic,
        max_particles=max_particles,
        cell_width=cell_width,
        min_level=min_level,
        max_level=max_level,
    )
    if not isinstance(empty, Real):
        raise InputError(f"empty must be a number, NaN for missing values, got {empty!r}")
    means = on_grid.means(*(v for v, _ in values.values()), empty=empty)
    made = Volume(on_grid.grid, {_DENSITY: on_grid.density()})
    made.set_unit(_DENSITY, given.density_unit)
    made.meta["particles"] = len(given.mass)
    for (name, (_, stated)), mean in zip(values.items(), means, strict=True):
        made[name] = mean
        made.set_unit(name, stated)
    return made


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
    _check_options(max_particles, cell_width, min_level, max_level, periodic)
    count = len(given.mass)
    advice = "give a part of them, or use a machine with more memory"
    check_memory(count * _PARTICLE_BYTES, f"placing {count} particles on a grid", advice)
    smooth, points = get_kernel(kernel), given.points
    base = None if bounds is None else Base.within(_limits(bounds, given.unit), periodic)
    if base is not None:
        points = base.wrapped(points)
        if not base.inside(points).any():
            raise InputError(f"no particle is inside of bounds {base.bounds.tolist()}")
    elif periodic:
        raise InputError("a periodic domain needs bounds=((x0, x1), (y0, y1), (z0, z1))")
    # The scale on which each particle is resolved, and how far it reaches.
    mesh = volume is not None or density is not None
    if mesh:
        if smoothing_length is not None or (volume is not None and density is not None):
            raise InputError(
                "give one of smoothing_length (SPH), volume or density (cells of a mesh); what "
                "else particles have may be among fields"
            )
        volumes = given.volumes(volume, density)
        size = reach = np.cbrt(volumes)
    else:
        if smoothing_length is None:
            size = estimated_lengths(base if periodic else None, points)
        else:
            size = positive(smoothing_length, given.unit, "smoothing_length", count)
        reach = smooth.support * size
        if base is not None and periodic:
            reach = np.minimum(reach, _BROADEST * np.ptp(base.bounds, axis=1).max())
    check_lengths(size, "sizes of particles", 1 / LARGEST)
    if base is None:  # cells of a mesh end half a width outside
        margin = (0.5 * reach if mesh else reach)[:, None]
        ends = [(points - margin).min(axis=0), (points + margin).max(axis=0)]
        base = Base.around(np.stack(ends, axis=1))
    widths = _MESH_WIDTHS if mesh else _SMOOTHED_WIDTHS
    width = cell_width or widths[count > _FEW]
    steps = min(max(1, math.ceil(widths[0] / width)), _FINEST)
    rule = Refinement(max_particles, size, width * size, reach, min_level, max_level, steps)
    grid = octree_around(base, points, rule, given.unit)
    if mesh:  # the cells of a mesh are longer here and there than they are wide
        return CellsDeposit(base, grid, points, given.mass, volumes, 3 * reach)
    return SmoothedDeposit(base, grid, points, given.mass, reach, smooth, steps)


def _limits(bounds: Any, unit: Unit) -> np.ndarray:
    box = CartesianGrid.uniform(1, bounds, unit=unit)
    limits: np.ndarray = box.bounds
    if box.unit != unit:
        from astropy import units as u

        limits = plain(u.Quantity(limits, box.unit), unit, "bounds")
    check_lengths(np.ptp(limits, axis=1), "widths of bounds", 1 / LARGEST)
    return limits


def _check_options(
    max_particles: Any, cell_width: Any, min_level: Any, max_level: Any, periodic: Any
) -> None:
    if not isinstance(max_particles, Integral) or max_particles < 1:
        raise InputError(f"max_particles must be a whole number, at least 1, got {max_particles!r}")
    width = float(cell_width) if isinstance(cell_width, Real) else 0.0
    if cell_width is not None and not 0 < width < float("inf"):
        raise InputError(f"cell_width must be a positive, finite number, got {cell_width!r}")
    whole = all(isinstance(level, Integral) for level in (min_level, max_level))
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
