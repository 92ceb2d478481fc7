"""What is in a dump of Phantom, whichever way it was written: native, or in HDF5."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import FileFormatError, unknown_name
from .columns import with_unit

# Types of particles as Phantom counts them.
TYPES = {"gas": 1, "boundary": 3, "star": 4, "dark_matter": 5, "bulge": 6, "dust": 7}
_AXES = "xyz"


@dataclass(frozen=True)
class Property:
    """One number for each particle: where it is, what it is in the file, and how to read it."""

    place: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    load: Callable[[], np.ndarray]


@dataclass
class Source:
    """A dump.

    Attributes
    ----------
    header : dict of array
        Numbers of each tag.
    particles, sinks : dict of Property
        By Phantom's tags, vectors as components (x, vx, Bx …).
    mass_place : str
        Where the mass of particles is.
    left_out : dict of str
        Why what else is beside the particles can be no field.
    """

    header: dict[str, np.ndarray]
    particles: dict[str, Property]
    sinks: dict[str, Property]
    mass_place: str
    left_out: dict[str, str]
    kind: int = 1

    def number(self, tag: str, default: float | None = None) -> float:
        """Return the first number of a tag, finite."""
        value = float(self.header[tag][0]) if tag in self.header else default
        if value is None or not np.isfinite(value):
            raise FileFormatError(f"the header has no number {tag!r}")
        return value

    @property
    def units(self) -> tuple[float, float, float] | None:
        """The code's units of length, mass and time in cgs; None if they are not told."""
        length, mass, time = (self.number(tag, 0.0) for tag in ("udist", "umass", "utime"))
        return (length, mass, time) if min(length, mass, time) > 0 else None

    def choose(self, particle_type: Any) -> None:
        """Choose particles of one type.

        Raises
        ------
        UnknownNameError
            If there are none.
        """
        self.kind = TYPES.get(particle_type, particle_type)
        masses = self.header.get("massoftype", np.zeros(0))
        if not isinstance(self.kind, int) or not 1 <= self.kind <= len(masses):
            raise unknown_name("particle type", str(particle_type), TYPES)

    @functools.cached_property
    def live(self) -> np.ndarray:
        """Which particles are of the type, and not accreted."""
        live = np.asarray(self.raw("h") > 0)
        if "itype" in self.particles:
            live &= np.abs(self.raw("itype")) == self.kind
        elif self.kind != 1:
            live[:] = False
        if not live.any():
            raise FileFormatError(f"there are no live particles of type {self.kind}")
        return live

    def raw(self, tag: str) -> np.ndarray:
        """Return what all particles have."""
        if tag not in self.particles:
            raise FileFormatError(f"particles have no {tag!r}")
        return self.particles[tag].load()

    def values(self, tag: str, factor: float = 1.0) -> np.ndarray:
        """Return what live particles have, float64."""
        return self.raw(tag)[self.live].astype(np.float64) * factor

    def points(self) -> Any:
        """Return positions, shape (n, 3): a Quantity if units are known."""
        points = np.stack([self.values(axis) for axis in _AXES], axis=1)
        return self._scaled(points, (1, 0, 0), "cm")

    def lengths(self) -> Any:
        """Return smoothing lengths."""
        return self._scaled(self.values("h"), (1, 0, 0), "cm")

    def masses(self) -> Any:
        """Return masses; those of particles that were split are smaller by powers of two."""
        mass = float(self.header["massoftype"][self.kind - 1])
        if not 0 < mass < np.inf:
            raise FileFormatError(f"massoftype of type {self.kind} is {mass}, expected more than 0")
        masses = np.full(np.count_nonzero(self.live), mass)
        if "apr_level" in self.particles:
            masses *= np.exp2(1 - self.values("apr_level"))
        return self._scaled(masses, (0, 1, 0), "g")

    def _scaled(self, values: np.ndarray, powers: tuple[int, int, int], unit: str) -> Any:
        factor, own = self.factor(powers, unit)
        return with_unit(values * factor, own)

    def factor(self, powers: tuple[int, int, int], unit: str) -> tuple[float, Any]:
        """Return the factor from the code's numbers to a unit, and that; 1 and None if unknown."""
        if self.units is None:
            return 1.0, None
        from astropy import units as u

        target = u.Unit(unit)
        cgs = u.cm ** powers[0] * u.g ** powers[1] * u.s ** powers[2]
        value = float(np.prod([base**p for base, p in zip(self.units, powers, strict=True)]))
        return (value * float(cgs.to(target)) if any(powers) else 1.0), target
