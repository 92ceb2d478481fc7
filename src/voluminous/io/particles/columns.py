"""What particles of a file carry, and the volume made of it."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...units import parse_unit, unit_name, unit_of
from ..contract import FieldInfo
from ..lengths import round_unit
from ..names import chosen_fields

if TYPE_CHECKING:
    from ...particles import Deposit
    from ...volume import Volume

# Options of all readers of particles.
OPTIONS = {
    "unit": "unit of length of the grid; by default one in which the domain has a handy size",
    "bounds": "a box to read: (low, high) or ((x0, x1), (y0, y1), (z0, z1)) in the unit of length",
    "max_particles": "cells with more particles are split (8)",
    "cell_width": "widest cells, in smoothing lengths or widths of mesh cells (0.5 … 1.5)",
    "empty": "value of fields in cells without mass (0); nan hides them",
}
_DENSITY_UNIT = "g / cm3"


@dataclass(frozen=True)
class Column:
    """One number that each particle has.

    Attributes
    ----------
    name, place : str
        What the field is called, and where it is in the file.
    shape : tuple of int
        Of the data set that it is in.
    dtype : str
    load : callable
        Returns it for all particles, shape (n,), in its unit.
    unit : unit or None
    """

    name: str
    place: str
    shape: tuple[int, ...]
    dtype: str
    load: Callable[[], np.ndarray]
    unit: Any = None

    @property
    def info(self) -> FieldInfo:
        """What is told of it without reading."""
        return FieldInfo(self.name, self.place, self.shape, self.dtype, unit_name(self.unit))


@dataclass(frozen=True)
class Density:
    """The field that masses make.

    Attributes
    ----------
    place : str
        Where in the file masses or densities are.
    shape : tuple of int
    dtype : str
    known : bool
        The code's units are known: densities are in g / cm3.
    """

    place: str
    shape: tuple[int, ...]
    dtype: str
    known: bool = True

    @property
    def unit(self) -> Any:
        """Its unit."""
        return parse_unit(_DENSITY_UNIT if self.known else None)

    @property
    def info(self) -> FieldInfo:
        """What is told of it without reading."""
        return FieldInfo("density", self.place, self.shape, self.dtype, unit_name(self.unit))


def with_unit(values: np.ndarray, unit: Any) -> Any:
    """Return a Quantity, or plain values if there is no unit."""
    if unit is None:
        return values
    from astropy import units as u

    return u.Quantity(values, unit, copy=False, subok=True)


def placed(points: Any, masses: Any, unit: Any, **placing: Any) -> Deposit:
    """Return particles on a grid, so that their density is in g / cm3 if they have units.

    Parameters
    ----------
    points, masses : array or Quantity
    unit : unit or None
        Of length; by default one in which the domain has a handy size.
    **placing
        As for `voluminous.Volume.from_particles`.
    """
    from ...particles import deposit, particles

    if unit_of(points) is not None:
        unit = round_unit(np.ptp(points, axis=0).max()) if unit is None else unit
        points = points.to(unit)
        masses = masses.to(parse_unit(_DENSITY_UNIT) * unit**3)
    return deposit(particles(points, masses, unit), **placing)


def volume_of(
    deposit: Callable[[], Deposit],
    density: Density,
    columns: Iterable[Column],
    fields: Any,
    empty: float,
) -> Volume:
    """Return the volume with the fields asked for, which are read when they are used.

    Parameters
    ----------
    deposit : callable
        Returns the particles on a grid; called once fields are known to be there.
    density : Density
    columns : iterable of Column
    fields : None, str, sequence of str or dict
        As for `voluminous.open`.
    empty : float
        Value of fields where there is no mass.
    """
    from ...volume import Volume

    known = {c.place: c for c in columns}
    names = {density.place: "density"} | {place: c.name for place, c in known.items()}
    chosen = chosen_fields(names, fields)
    on_grid = deposit()
    volume = Volume(on_grid.grid)
    volume.meta["particles"] = len(on_grid.mass)
    for name, place in chosen.items():
        if place == density.place:
            volume[name] = Deferred(on_grid.density, np.float64, density.unit)
        else:
            load = functools.partial(_mean, on_grid, known[place], float(empty))
            volume[name] = Deferred(load, np.float64, known[place].unit)
    return volume


def _mean(on_grid: Deposit, column: Column, empty: float) -> np.ndarray:
    return on_grid.means(column.load(), empty=empty)[0]
