"""Common parts of the particle readers: options, columns, and the resulting volume."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FileFormatError
from ...units import parse_unit, unit_of
from ..axes import round_unit
from ..contract import Contents, ContentsReader, FieldInfo, StoredField
from ..names import field_name

if TYPE_CHECKING:
    from ...grids.contract import Grid
    from ...particles import Deposit

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


class ParticleFile:
    """The particles in a file. Without code units, values are dimensionless.

    The first of `fields` is the density, made from the masses at its place; the others load one
    number for each particle.
    """

    fields: list[StoredField]
    meta: dict[str, Any]

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


class ParticleReader(ContentsReader):
    """Base of particle readers: `particles` opens the file with the options named in `opening`."""

    opening: tuple[str, ...] = ()

    def particles(self, path: Path, **options: Any) -> ParticleFile:
        raise NotImplementedError

    def contents(self, path: Path, **options: Any) -> Contents:
        unit, empty = options.pop("unit", None), float(options.pop("empty", 0.0))
        file = self.particles(path, **{n: options.pop(n) for n in self.opening if n in options})
        on_grid = functools.cache(lambda: _deposit(file, parse_unit(unit), options))
        meta: dict[str, Any] = {}

        def mean(values: Callable[[], np.ndarray]) -> np.ndarray:
            return on_grid().means(values(), empty=empty)[0]

        def grid(chosen: Any) -> Grid:
            meta.update({"particles": len(on_grid().mass)} | file.meta)
            return on_grid().grid

        loads: list[Callable[[], np.ndarray]] = [lambda: on_grid().density()]
        loads += [functools.partial(mean, column.load) for column in file.fields[1:]]
        fields = [
            replace(f, dtype=np.dtype("f8"), load=load)
            for f, load in zip(file.fields, loads, strict=True)
        ]
        return Contents(fields, grid, meta)

    def info(self, path: Path, **options: Any) -> tuple[FieldInfo, ...]:
        opening = {name: options[name] for name in self.opening if name in options}
        return tuple(f.info for f in self.particles(path, **opening).fields)


def _deposit(file: ParticleFile, unit: Any, placing: dict[str, Any]) -> Deposit:
    from ...particles import deposit, particles

    points, sizes, masses = file.points(), file.sizes(), file.masses()
    if placing.get("bounds") is None:
        placing = placing | file.domain(points, sizes)
    if unit_of(points) is not None:
        unit = round_unit(np.ptp(points, axis=0).max()) if unit is None else unit
        points = points.to(unit)
        masses = masses.to(parse_unit(DENSITY_UNIT) * unit**3)
    return deposit(particles(points, masses, unit), **sizes, **placing)


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
