"""Common parts of the particle readers: options, columns, and the resulting volume."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...deferred import Deferred
from ...errors import FileFormatError
from ...units import parse_unit, unit_of
from ..axes import round_unit
from ..contract import FieldChoice, FieldInfo, Reader, UnitLike
from ..names import chosen_fields, field_name

if TYPE_CHECKING:
    from ...particles import Deposit
    from ...volume import Volume

OPTIONS = {
    "unit": "unit of length of the grid; by default one in which the domain has a handy size",
    "bounds": "a box to read: (low, high) or ((x0, x1), (y0, y1), (z0, z1)) in the unit of length",
    "max_particles": "cells with more particles are split (8)",
    "cell_width": "widest cells, in smoothing lengths or widths of mesh cells (0.5 … 1.5)",
    "empty": "value of fields in cells without mass (0); nan hides them",
}
DENSITY_UNIT = "g / cm3"
# Start of a word in a CamelCase name.
_WORD = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|[\s_]+")
# SWIFT uses plurals.
_SINGULAR = {
    **{f"{stem}ies": f"{stem}y" for stem in ("densit", "velocit", "energ", "entrop", "metallicit")},
    **{f"{word}s": word for word in ("temperature", "pressure", "potential", "length", "rate")},
    "fractions": "fraction",
    "masses": "mass",
}


@dataclass(frozen=True)
class ParticleColumn:
    """One scalar per particle."""

    info: FieldInfo
    load: Callable[[], np.ndarray]  # returns the values of all particles, shape (n,), in `unit`


class ParticleFile:
    """The particles in a file. Without code units, values are dimensionless."""

    density: FieldInfo  # the density field made from the masses; its place is that of the masses
    meta: dict[str, Any]

    def columns(self) -> list[ParticleColumn]:
        """Return the columns that can become fields."""
        raise NotImplementedError

    def points(self) -> Any:
        """Return positions, shape (n, 3); a Quantity if the code units are given."""
        raise NotImplementedError

    def masses(self) -> Any:
        raise NotImplementedError

    def sizes(self) -> dict[str, Any]:
        """Return the arguments of `from_particles` that set the particle sizes."""
        raise NotImplementedError

    def domain(self, points: Any, sizes: Mapping[str, Any]) -> dict[str, Any]:
        """Return the arguments of `from_particles` that set the domain."""
        return {}


class ParticleReader(Reader):
    """Base of particle readers: `particles` opens the file with the options named in `opening`."""

    opening: tuple[str, ...] = ()

    def particles(self, path: Path, **options: Any) -> ParticleFile:
        raise NotImplementedError

    def read(
        self,
        path: Path,
        fields: FieldChoice = None,
        *,
        empty: float = 0.0,
        unit: UnitLike = None,
        **options: Any,
    ) -> Volume:
        from ...volume import Volume

        opening, placing = _split(options, self.opening)
        found = self.particles(path, **opening)
        columns = {c.info.place: c for c in found.columns()}
        names = {found.density.place: "density"} | {p: c.info.name for p, c in columns.items()}
        chosen = chosen_fields(names, fields)
        on_grid = _deposit(found, parse_unit(unit), placing)
        volume = Volume(on_grid.grid)
        volume.meta.update({"particles": len(on_grid.mass)} | found.meta)
        for name, place in chosen.items():
            if place == found.density.place:
                volume[name] = Deferred(on_grid.density, np.float64, found.density.unit)
            else:
                column = columns[place]
                load = functools.partial(_mean, on_grid, column, float(empty))
                volume[name] = Deferred(load, np.float64, column.info.unit)
        return volume

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        found = self.particles(path, **_split(options, self.opening)[0])
        return (found.density, *(column.info for column in found.columns()))


def _split(
    options: Mapping[str, Any], names: tuple[str, ...]
) -> tuple[dict[str, Any], dict[str, Any]]:
    inside = {name: value for name, value in options.items() if name in names}
    return inside, {name: value for name, value in options.items() if name not in names}


def _deposit(found: ParticleFile, unit: Any, placing: dict[str, Any]) -> Deposit:
    from ...particles import deposit, particles

    points, sizes, masses = found.points(), found.sizes(), found.masses()
    if placing.get("bounds") is None:
        placing = placing | found.domain(points, sizes)
    if unit_of(points) is not None:
        unit = round_unit(np.ptp(points, axis=0).max()) if unit is None else unit
        points = points.to(unit)
        masses = masses.to(parse_unit(DENSITY_UNIT) * unit**3)
    return deposit(particles(points, masses, unit), **sizes, **placing)


def _mean(on_grid: Deposit, column: ParticleColumn, empty: float) -> np.ndarray:
    return on_grid.means(column.load(), empty=empty)[0]


def with_unit(values: np.ndarray, unit: str) -> Any:
    """Return a Quantity, or plain values if there is no unit."""
    if not unit:
        return values
    from astropy import units as u

    return u.Quantity(values, unit, copy=False, subok=True)


def number(attributes: Any, *names: str) -> float | None:
    """Return the first existing attribute that is one finite number; None if there is none."""
    for name in names:
        if name in attributes:
            values = np.ravel(attributes[name])
            if values.size != 1 or values.dtype.kind not in "fiub" or not np.isfinite(values[0]):
                raise FileFormatError(f"{name} must be a number, got {attributes[name]!r}")
            return float(values[0])
    return None


def common_name(name: str) -> str:
    """Return the common name of a particle property from a code's name.

    Examples
    --------
    >>> common_name("InternalEnergies"), common_name("StarFormationRate"), common_name("Velocities")
    ('internal_energy', 'star_formation_rate', 'velocity')
    """
    words = [word.lower() for word in _WORD.split(name) if word]
    common = "_".join(_SINGULAR.get(word, word) for word in words)
    return field_name(common.removeprefix("gfm_"))
