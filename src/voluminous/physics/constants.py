"""Physical constants in CGS units: CODATA's, and the digits that RADMC-3D has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import check_name
from ..units import as_quantity, is_quantity, plain

Reals = NDArray[np.float64]


@dataclass(frozen=True)
class Constants:
    """Constants of nature in CGS units.

    Some numbers follow from others; RADMC-3D has them as literals of few digits, which do not
    agree with each other, so each formula has its own.

    Attributes
    ----------
    name : str
        ``"codata"`` or ``"radmc3d"``.
    c, h, k : float
        Speed of light (cm/s), Planck's constant (erg s), Boltzmann's constant (erg/K).
    proton_mass : float
        Mass in g of a molecule of weight 1: the atomic mass unit, in RADMC-3D the proton's mass.
    planck_factor, planck_exponent : float
        2h/c² and h/k in Planck's function.
    boltzmann, partition : float
        hc/k in cm K, in populations and in partition functions.
    opacity_c : float
        Speed of light (cm/s) that turns the wavelengths of opacity tables into frequencies.
    """

    name: str
    c: float
    h: float
    k: float
    proton_mass: float
    planck_factor: float
    planck_exponent: float
    boltzmann: float
    partition: float
    opacity_c: float

    def planck(self, frequency: Any, temperature: Any) -> Reals:
        """Return Planck's function 2hν³/c² / (exp(hν/kT) - 1), full of digits at both ends.

        Parameters
        ----------
        frequency : array_like or Quantity
            Plain numbers in Hz.
        temperature : array_like or Quantity
            Plain numbers in K; the two are broadcast.

        Returns
        -------
        numpy.ndarray
            In erg / (s cm2 Hz sr); 0 where the frequency or the temperature is not positive.
        """
        nu, t = in_unit(frequency, "Hz", "frequency"), in_unit(temperature, "K", "temperature")
        with np.errstate(all="ignore"):  # both ends are limits: exp overflows, 0 / 0
            value = self.planck_factor * nu**3 / np.expm1(self.planck_exponent * nu / t)
        return np.where((nu > 0.0) & (t > 0.0), value, 0.0)


def in_unit(values: Any, unit: str | None, what: str) -> Reals:
    """Return plain numbers in a unit, of any shape; frequencies of wavelengths, and vice versa."""
    values = as_quantity(values)
    if is_quantity(values) and unit in ("micron", "Hz"):
        from astropy import units as u

        if values.unit.is_equivalent(unit, u.spectral()):
            values = values.to(unit, u.spectral())
    return np.asarray(plain(values, unit, what), dtype=np.float64)


_C, _H, _K = 2.99792458e10, 6.62607015e-27, 1.380649e-16

CODATA = Constants(
    name="codata",
    c=_C,
    h=_H,
    k=_K,
    proton_mass=1.66053906892e-24,  # atomic mass unit, CODATA 2022; the others are exact
    planck_factor=2.0 * _H / _C**2,
    planck_exponent=_H / _K,
    boltzmann=_H * _C / _K,
    partition=_H * _C / _K,
    opacity_c=_C,
)

RADMC3D = Constants(
    name="radmc3d",
    c=2.99792458e10,
    h=6.6262e-27,
    k=1.3807e-16,
    proton_mass=1.6726e-24,
    planck_factor=1.47455e-47,
    planck_exponent=4.7989e-11,
    boltzmann=float(np.float32(1.4387519)),  # a literal of single precision
    partition=6.6262e-27 * 2.99792458e10 / 1.3807e-16,
    opacity_c=2.9979e10,
)

_NAMED = {constants.name: constants for constants in (CODATA, RADMC3D)}


def constants_named(name: str | Constants) -> Constants:
    """Return the constants of a name, ``"codata"`` or ``"radmc3d"``; constants as they are.

    Raises
    ------
    UnknownNameError
        If there are none of that name.
    """
    if isinstance(name, Constants):
        return name
    check_name("set of constants", name, _NAMED)
    return _NAMED[name]
