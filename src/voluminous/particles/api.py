"""`Volume.from_particles`: a volume of particles, whatever they stand for."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Real
from typing import Any

from ..errors import InputError
from ..progress import Progress, with_progress
from ..units import Unit
from ..volume import Volume
from .deposition import deposit
from .inputs import carried, particles

# Name of the field that the masses make.
_DENSITY = "density"


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
    for (name, (_, own)), mean in zip(values.items(), means, strict=True):
        made[name] = mean
        made.set_unit(name, own)
    return made
