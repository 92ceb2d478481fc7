"""Spectra of stars, surfaces and backgrounds: intensities as functions of frequency."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from ..units import plain, shown
from ..value import Value
from .constants import CODATA, Constants, Reals, constants_named, in_unit
from .opacity import MICRON, listed

# Frequencies that differ by less are one: they come from wavelengths.
_ROUNDING = 1e-12
_INTENSITY = "erg / (s cm2 Hz sr)"


class Blackbody(Value):
    """What shines like a black body.

    Parameters
    ----------
    temperature : float or Quantity
        Positive; a plain number in K.
    grid : array or Quantity, shape (n,), optional
        Frequencies, plain numbers in Hz: those of a model's ``wavelength_micron.inp``, between
        which RADMC-3D interpolates the intensities of its stars; only for ``constants="radmc3d"``.

    Raises
    ------
    InputError
        If the temperature is not a positive number.
    """

    def __init__(self, temperature: Any, *, grid: Any = None) -> None:
        self.temperature = plain(temperature, "K", "temperature")
        if not (isinstance(self.temperature, float) and 0.0 < self.temperature < np.inf):
            raise InputError(f"expected one positive temperature, got {temperature!r}")
        self.grid = None if grid is None else np.sort(listed(grid, "Hz", "grid"))

    def __repr__(self) -> str:
        return f"Blackbody({self.temperature:g})"

    def intensity(self, frequency: Any, constants: str | Constants = CODATA) -> Reals:
        """Return Planck's function in erg / (s cm2 Hz sr) at frequencies (in Hz), of any shape."""
        constants = constants_named(constants)
        if self.grid is None or constants.name != "radmc3d":
            return np.asarray(constants.planck(frequency, self.temperature))
        return _linear(frequency, self.grid, constants.planck(self.grid, self.temperature))


class TabulatedSpectrum(Value):
    """A spectrum in a table; zero outside of it.

    Between the points the log of the intensity is linear in log ν; with ``constants="radmc3d"`` the
    intensity is linear in ν.

    Parameters
    ----------
    wavelengths : array or Quantity, shape (n,)
        Two or more different ones; plain numbers in micron.
    intensity : array or Quantity, shape (n,)
        Not negative; plain numbers in erg / (s cm2 Hz sr).

    Raises
    ------
    InputError
        If the numbers are not such.
    """

    def __init__(self, wavelengths: Any, intensity: Any) -> None:
        waves = listed(wavelengths, "micron", "wavelengths")
        values = listed(intensity, _INTENSITY, "intensity")
        order = np.argsort(-waves)
        if len(waves) < 2 or not (np.all(waves > 0.0) and np.all(np.diff(waves[order]) < 0.0)):
            raise InputError(
                f"expected two or more different wavelengths, got {shown(wavelengths)}"
            )
        if values.shape != waves.shape or not np.all((values >= 0.0) & (values < np.inf)):
            raise InputError(
                f"expected {len(waves)} intensities, one per wavelength, got {shown(intensity)}"
            )
        self.frequencies: Reals = CODATA.c / (MICRON * waves[order])
        self.values: Reals = values[order]

    def __repr__(self) -> str:
        first, last = (CODATA.c / MICRON / self.frequencies[[-1, 0]]).tolist()
        count = len(self.frequencies)
        return f"<TabulatedSpectrum at {count} wavelengths, {first:g} to {last:g} micron>"

    def intensity(self, frequency: Any, constants: str | Constants = CODATA) -> Reals:
        """Return the intensity in erg / (s cm2 Hz sr) at frequencies (in Hz), of any shape."""
        nu = in_unit(frequency, "Hz", "frequency")
        if constants_named(constants).name == "radmc3d":
            return _linear(nu, self.frequencies, self.values)
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = np.interp(np.log(nu), np.log(self.frequencies), np.log(self.values))
        inside = (nu >= self.frequencies[0]) & (nu <= self.frequencies[-1])
        return np.where(inside, np.nan_to_num(np.exp(logs)), 0.0)


def _linear(frequency: Any, grid: Reals, values: Reals) -> Reals:
    """Return values that are linear in ν, and zero at and beyond the ends, as RADMC-3D has them."""
    nu = in_unit(frequency, "Hz", "frequency")
    inside = (nu > grid[0] * (1.0 + _ROUNDING)) & (nu < grid[-1] * (1.0 - _ROUNDING))
    return np.where(inside, np.interp(nu, grid, values), 0.0)
