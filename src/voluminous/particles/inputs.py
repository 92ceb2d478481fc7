"""The arguments for particles, checked, as plain numbers in one set of units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError
from ..fields import split_unit, without_mask
from ..units import Unit, plain, space_unit, unit_of
from .kernels import get_kernel
from .octree import Base, Refinement, octree_around
from .smoothed import SmoothedDeposit

_COMPONENTS = "xyz"
# Lengths beyond have no cubes in double precision.
LARGEST = 1e90


@dataclass(frozen=True)
class Particles:
    """Positions and masses.

    Attributes
    ----------
    points : array of float64, shape (n, 3)
    mass : array of float64, shape (n,)
    unit, mass_unit : astropy unit or None
    """

    points: np.ndarray
    mass: np.ndarray
    unit: Unit
    mass_unit: Any

    @property
    def density_unit(self) -> Any:
        """Unit of mass per volume, None if it has none."""
        if self.mass_unit is None and self.unit is None:
            return None
        from astropy import units as u

        one = u.dimensionless_unscaled
        return (self.mass_unit or one) / (self.unit or one) ** 3

    def volumes(self, volume: Any, density: Any) -> np.ndarray:
        """Return the volumes of cells that are given by volume, or by density."""
        count = len(self.mass)
        if density is None:
            cubed = None if self.unit is None else self.unit**3
            return positive(volume, cubed, "volume", count)
        dense = positive(density, self.density_unit, "density", count)
        if not (self.mass > 0).all():
            raise InputError("cells of a mesh need positive masses: their volume is mass / density")
        return self.mass / dense


def particles(positions: Any, masses: Any, unit: Unit) -> Particles:
    """Return particles as they are given to `from_particles`."""
    positions, masses = without_mask(positions), without_mask(masses)
    own = unit_of(positions)
    unit = space_unit(unit) if own is None else own
    points = _real(positions, unit, "positions")
    if np.ndim(points) != 2 or points.shape[1] != 3 or len(points) == 0:
        raise InputError(
            "positions must be of shape (n, 3), one row x, y, z per particle, got shape "
            f"{np.shape(points)}"
        )
    _check_finite(points, "positions")
    check_lengths(np.abs(points).max(), "positions")
    mass_unit = unit_of(masses)
    mass = per_particle(_real(masses, mass_unit, "masses"), "masses", len(points))
    if (mass < 0).any():
        raise InputError(f"masses must not be negative; that of {_first(mass < 0)} is {mass.min()}")
    return Particles(np.ascontiguousarray(points), mass, unit, mass_unit)


def per_particle(values: Any, what: str, count: int) -> np.ndarray:
    """Return finite numbers, one for each particle; one number is that of all."""
    array = np.asarray(values, np.float64)
    if array.shape not in ((), (count,)):
        raise InputError(
            f"{what} must be one number per particle, shape ({count},), got shape {array.shape}"
        )
    _check_finite(array, what)
    return np.ascontiguousarray(np.broadcast_to(array, (count,)))


def positive(values: Any, unit: Unit, what: str, count: int) -> np.ndarray:
    """Return positive numbers, one for each particle, in a unit."""
    array = per_particle(_real(without_mask(values), unit, what), what, count)
    if not (array > 0).all():
        raise InputError(
            f"{what} must be positive; that of {_first(array <= 0)} is {array[array <= 0][0]}; "
            "leave such particles out"
        )
    return array


def carried(fields: Mapping[str, Any] | None, count: int) -> dict[str, tuple[np.ndarray, Any]]:
    """Return name → values and unit of what particles carry; vectors as their components."""
    if fields is not None and not isinstance(fields, Mapping):
        raise InputError(
            "fields must be a mapping of names to arrays, such as {'velocity': array}, got "
            f"{type(fields).__name__}"
        )
    found: dict[str, tuple[np.ndarray, Any]] = {}
    for name, value in (fields or {}).items():
        values, unit = split_unit(without_mask(value))
        for own, numbers in _components(name, _array(name, values), count):
            if own in found:
                raise InputError(
                    f"two fields are called {own!r}, one of them a component of a vector; give "
                    "one of them another name"
                )
            found[own] = np.asarray(numbers, np.float64), unit
    return found


def _array(name: Any, values: Any) -> np.ndarray:
    try:
        array = np.asarray(values)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name!r} must be an array of numbers: {error}") from None
    if array.dtype.kind not in "fiub":
        raise InputError(f"{name!r} must be real numbers, got dtype {array.dtype}")
    return array


def _components(name: Any, array: np.ndarray, count: int) -> list[tuple[Any, np.ndarray]]:
    """Return names and numbers: one of each, or one of each axis for vectors."""
    if array.shape == (count,):
        return [(name, array)]
    if array.shape == (count, 3):
        return [(f"{name}_{axis}", array[:, k]) for k, axis in enumerate(_COMPONENTS)]
    raise InputError(
        f"{name!r} must be one value or one vector per particle, shape ({count},) or "
        f"({count}, 3), got shape {array.shape}"
    )


def check_lengths(lengths: Any, what: str, smallest: float = 0.0) -> None:
    """Refuse lengths of which cubes are no numbers."""
    low, high = float(np.min(lengths)), float(np.max(lengths))
    if not smallest <= low or not high <= LARGEST:
        raise InputError(
            f"{what} must be between {smallest:g} and {LARGEST:g} in the unit of length, got {low} "
            f"to {high}; use another unit"
        )


def _real(values: Any, unit: Unit, what: str) -> Any:
    """Return plain numbers in a unit; of complex ones the imaginary part would be lost."""
    if isinstance(values, np.ndarray) and np.iscomplexobj(values):
        raise InputError(f"{what} must be real numbers, got complex ones")
    return plain(values, unit, what)


def _check_finite(array: np.ndarray, what: str) -> None:
    if not np.isfinite(array).all():
        raise InputError(
            f"{what} must be finite; {_first(~np.isfinite(array))} is not. Leave such particles out"
        )


def _first(bad: np.ndarray) -> str:
    return f"particle {int(np.argwhere(np.atleast_1d(bad))[0][0])}"


# Smoothing length in units of the mean distance of particles: 58 are in a cubic spline then.
ETA = 1.2
# Particles of which a first guess is made.
_PARTICLES = 16


def smoothing_lengths(base: Base | None, points: np.ndarray) -> np.ndarray:
    """Return smoothing lengths h = η n^(-1/3), where n is the number density of particles.

    n is that in cells of an octree with few particles each, smoothed once with these lengths.

    Parameters
    ----------
    base : Base or None
        A periodic domain that the points are in; None if it is not.
    points : array, shape (n, 3)

    Notes
    -----
    η = 1.2 is the usual choice (Price 2012, J. Comput. Phys. 231, 759, section 2.2).
    """
    if base is None:
        base = Base.around(np.stack([points.min(axis=0), points.max(axis=0)], axis=1))
    one = np.ones(len(points))
    grid = octree_around(base, points, Refinement(_PARTICLES, 0 * one))
    leaf = grid.locate(points)
    number = np.bincount(leaf, minlength=grid.size) / grid.cell_volumes
    first = ETA * number[leaf] ** (-1 / 3)
    kernel = get_kernel("cubic")
    deposit = SmoothedDeposit(base, grid, points, one, kernel.support * first, kernel)
    lengths: np.ndarray = ETA * deposit.density()[leaf] ** (-1 / 3)
    return lengths
