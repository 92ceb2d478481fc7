"""The arguments for particles, checked, as plain numbers in one set of units."""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ..backend.types import Float
from ..errors import InputError, check_name
from ..fields import split_unit, without_mask
from ..units import Unit, plain, space_unit, unit_of
from .octree import Base, Refinement, octree_around
from .smoothed import SmoothedDeposit

# Lengths beyond have no cubes in double precision.
LARGEST = 1e90


class Particles(NamedTuple):
    """Positions (n, 3) and masses (n,), and their units."""

    points: np.ndarray
    mass: np.ndarray
    unit: Unit
    mass_unit: Unit

    @property
    def density_unit(self) -> Unit:
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
        volumes: np.ndarray = self.mass / dense
        return volumes


def particles(positions: Any, masses: Any, unit: Unit) -> Particles:
    """Return particles as they are given to `from_particles`."""
    positions, masses = without_mask(positions), without_mask(masses)
    position_unit = unit_of(positions)
    unit = space_unit(unit) if position_unit is None else position_unit
    points = _finite(positions, unit, "positions")
    if np.ndim(points) != 2 or points.shape[1] != 3 or len(points) == 0:
        raise InputError(
            "positions must be of shape (n, 3), one row x, y, z per particle, got shape "
            f"{np.shape(points)}"
        )
    check_lengths(np.abs(points).max(), "positions")
    mass = _per_particle(masses, unit_of(masses), "masses", len(points))
    if (mass < 0).any():
        raise InputError(f"masses must not be negative; that of {_first(mass < 0)} is {mass.min()}")
    return Particles(np.ascontiguousarray(points), mass, unit, unit_of(masses))


def positive(values: Any, unit: Unit, what: str, count: int) -> np.ndarray:
    """Return positive numbers, one for each particle, in a unit."""
    array = _per_particle(without_mask(values), unit, what, count)
    if not (array > 0).all():
        raise InputError(
            f"{what} must be positive; that of {_first(array <= 0)} is {array[array <= 0][0]}; "
            "leave such particles out"
        )
    return array


def _per_particle(values: Any, unit: Unit, what: str, count: int) -> np.ndarray:
    """Return finite numbers, one for each particle; one number is that of all."""
    array = _finite(values, unit, what)
    if array.shape not in ((), (count,)):
        raise InputError(
            f"{what} must be one number per particle, shape ({count},), got shape {array.shape}"
        )
    return np.ascontiguousarray(np.broadcast_to(array, (count,)))


def _finite(values: Any, unit: Unit, what: str) -> np.ndarray:
    if isinstance(values, np.ndarray) and np.iscomplexobj(values):
        raise InputError(f"{what} must be real numbers, got complex ones")
    array = np.asarray(plain(values, unit, what), np.float64)
    if not np.isfinite(array).all():
        raise InputError(
            f"{what} must be finite; {_first(~np.isfinite(array))} is not. Leave such particles out"
        )
    return array


def _first(bad: np.ndarray) -> str:
    return f"particle {int(np.argwhere(np.atleast_1d(bad))[0][0])}"


def carried(fields: Mapping[str, Any] | None, count: int) -> dict[str, tuple[np.ndarray, Unit]]:
    """Return {name: (values, unit)} of what particles carry; vectors as their components."""
    if fields is not None and not isinstance(fields, Mapping):
        raise InputError(
            "fields must be a mapping of names to arrays, such as {'velocity': array}, got "
            f"{type(fields).__name__}"
        )
    columns: dict[str, tuple[np.ndarray, Unit]] = {}
    for name, value in (fields or {}).items():
        values, unit = split_unit(without_mask(value))
        try:
            array = np.asarray(values)
        except (TypeError, ValueError) as error:
            raise InputError(f"{name!r} must be an array of numbers: {error}") from None
        if array.dtype.kind not in "fiub":
            raise InputError(f"{name!r} must be real numbers, got dtype {array.dtype}")
        if array.shape not in ((count,), (count, 3)):
            raise InputError(
                f"{name!r} must be one value or one vector per particle, shape ({count},) or "
                f"({count}, 3), got shape {array.shape}"
            )
        names = [name] if array.ndim == 1 else [f"{name}_{axis}" for axis in "xyz"]
        for called, column in zip(names, np.atleast_2d(array.T), strict=True):
            if called in columns:
                raise InputError(
                    f"two fields are called {called!r}, one of them a component of a vector; give "
                    "one of them another name"
                )
            columns[called] = np.asarray(column, np.float64), unit
    return columns


def check_lengths(lengths: Any, what: str, smallest: float = 0.0) -> None:
    """Refuse lengths of which cubes are no numbers."""
    low, high = float(np.min(lengths)), float(np.max(lengths))
    if not smallest <= low or not high <= LARGEST:
        raise InputError(
            f"{what} must be between {smallest:g} and {LARGEST:g} in the unit of length, got {low} "
            f"to {high}; use another unit"
        )


# Smoothing length in units of the mean distance of particles: 58 are in a cubic spline then.
ETA = 1.2
# Particles of which a first guess is made.
_PARTICLES = 16


def smoothing_lengths(base: Base | None, points: np.ndarray) -> np.ndarray:
    """Return smoothing lengths h = η n^(-1/3), where n is the number density of particles.

    n is that in cells of an octree with few particles each, smoothed once with these lengths.
    η = 1.2 is the usual choice (Price 2012, J. Comput. Phys. 231, 759, section 2.2). `base` is a
    periodic domain that the points are in, or None.
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


class Kernel(NamedTuple):
    """A kernel in three dimensions.

    `shape` is f(u, positive) for 0 ≤ u ≤ 1, where ``positive(x)`` is max(x, 0), of arrays of any
    kind; `norm` is one divided by the integral of f over the unit ball; `support` is the radius of
    the support in smoothing lengths, as Price (2012) and Phantom count these.
    """

    shape: Callable[[Float, Callable[[Float], Float]], Float]
    norm: float
    support: float = 2.0

    @property
    def peak(self) -> float:
        """The value at the centre."""
        return float(self.shape(0.0, lambda x: max(x, 0.0)))


def _spline(power: int, terms: tuple[tuple[float, float], ...]) -> Callable[..., Float]:
    def shape(u: Float, positive: Callable[[Float], Float]) -> Float:
        parts = [c * _power(positive(t - u), power) for c, t in terms]
        return sum(parts[1:], parts[0])

    return shape


def _wendland(power: int, polynomial: tuple[float, ...]) -> Callable[..., Float]:
    """Return (1 − u)₊ⁿ times a polynomial, coefficients from the constant one on."""

    def shape(u: Float, positive: Callable[[Float], Float]) -> Float:
        value = functools.reduce(lambda value, c: value * u + c, reversed(polynomial), 0.0)
        return _power(positive(1.0 - u), power) * value

    return shape


def _power(x: Float, n: int) -> Float:
    return functools.reduce(operator.mul, [x] * n)


KERNELS = {
    "cubic": Kernel(_spline(3, ((1.0, 1.0), (-4.0, 0.5))), 16 / math.pi),
    "quartic": Kernel(
        _spline(4, ((1.0, 1.0), (-5.0, 0.6), (10.0, 0.2))), 15625 / (512 * math.pi), 2.5
    ),
    "quintic": Kernel(
        _spline(5, ((1.0, 1.0), (-6.0, 2 / 3), (15.0, 1 / 3))), 2187 / (40 * math.pi), 3.0
    ),
    "wendland-c2": Kernel(_wendland(4, (1.0, 4.0)), 21 / (2 * math.pi)),
    "wendland-c4": Kernel(_wendland(6, (1.0, 6.0, 35 / 3)), 495 / (32 * math.pi)),
    "wendland-c6": Kernel(_wendland(8, (1.0, 8.0, 25.0, 32.0)), 1365 / (64 * math.pi)),
}


def get_kernel(name: Any) -> Kernel:
    """Return a kernel by its name."""
    check_name("kernel", name, KERNELS)
    return KERNELS[name]
