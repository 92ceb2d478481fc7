"""Opacities of dust: absorption and scattering in cm²/g of dust, as functions of frequency."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from os import PathLike
from typing import Any

import numpy as np

from ..errors import InputError, check_name
from ..units import shown
from ..value import Value
from .constants import CODATA, Constants, Reals, constants_named, in_unit
from .published import POWER_LAWS, TABLES

_CM2_G = "cm2 / g"
MICRON = 1e-4
"""A micron in cm."""
# How the columns of tables are called.
_COLUMNS = {
    "wavelengths": ("wavelength", "wavelengths", "wave", "wav", "lambda", "lam"),
    "absorption": ("kappa_abs", "kabs", "k_abs", "absorption", "kappa", "opacity"),
    "scattering": ("kappa_scat", "kappa_sca", "ksca", "kscat", "k_sca", "scattering"),
    "asymmetry": ("g", "gsca", "asymmetry", "<cos>"),
}
# The ends of a power law in micron: beyond the shorter one opacities are constant.
_POWER_LAW = np.array([1e-6, 1e8])
# In RADMC-3D opacities fall to zero over this relative width beyond the global wavelengths.
_RAMP, _LEAST = 1e-4, 1e-90


class Opacity(Value):
    """The opacity of one kind of dust, tabulated over wavelengths.

    Between the points log κ is linear in log ν. Beyond the longest wavelength the power law of the
    last two points goes on; beyond the shortest one the opacity is constant.

    Parameters
    ----------
    wavelengths : array or Quantity, shape (n,)
        At least two, rising or falling; plain numbers in micron.
    absorption : array or Quantity, shape (n,)
        Per mass of dust; plain numbers in cm²/g.
    scattering : array or Quantity, shape (n,), optional
        Likewise; none by default.
    name : str, optional
        For labels and errors.
    asymmetry : array, shape (n,), optional
        Mean cosine of the scattering angle.
    grid : array or Quantity, shape (m,), optional
        Frequencies, plain numbers in Hz: those of a model's ``wavelength_micron.inp``. With them,
        and ``constants="radmc3d"``, RADMC-3D's rules hold: κ is linear in ν inside the table,
        outside of it linear in ν between values on the grid, and zero outside of the grid. The
        opacities of a model that was opened from a folder of RADMC-3D have it.

    Raises
    ------
    InputError
        If a table is not of n numbers, is not monotonic, or has negative opacities.

    Examples
    --------
    >>> dust = Opacity([100, 1000], [10.0, 0.1])
    >>> float(dust.absorption(2.99792458e14 / 3000).round(6))
    0.011111
    """

    def __init__(
        self,
        wavelengths: Any,
        absorption: Any,
        scattering: Any = None,
        name: str = "",
        asymmetry: Any = None,
        *,
        grid: Any = None,
    ) -> None:
        what = f"opacity {name}".rstrip()
        waves = listed(wavelengths, "micron", f"{what}: wavelengths")
        if len(waves) < 2 or not np.all(np.isfinite(waves) & (waves > 0.0)):
            raise InputError(
                f"{what}: expected two or more positive wavelengths, got {shown(wavelengths)}"
            )
        rising = np.diff(waves) > 0.0
        if not (rising.all() or (np.diff(waves) < 0.0).all()):
            raise InputError(f"{what}: wavelengths must rise, or fall, from each to the next")
        order = slice(None, None, -1 if rising.all() else 1)  # frequencies rise
        columns = {"absorption": absorption, "scattering": scattering, "asymmetry": asymmetry}
        rows = {}
        for label, given in columns.items():
            unit = None if label == "asymmetry" else _CM2_G
            row = np.zeros(len(waves)) if given is None else listed(given, unit, f"{what}: {label}")
            low, high = (-1.0, 1.0) if label == "asymmetry" else (0.0, sys.float_info.max)
            if row.shape != waves.shape or not np.all((row >= low) & (row <= high)):
                raise InputError(
                    f"{what}: {label} must be one finite number, {low:g} or more"
                    f"{' and 1 at most' * (high == 1.0)}, for each of the {len(waves)} "
                    f"wavelengths, got {shown(given)}"
                )
            rows[label] = row[order]
        self.name = str(name)
        self.wavelengths: Reals = waves[order]
        self.grid: Reals | None = None
        if grid is not None:
            self.grid = np.sort(listed(grid, "Hz", f"{what}: grid"))
        self._rows = rows

    def __repr__(self) -> str:
        first, last = self.wavelengths[[-1, 0]].tolist()
        named = f"Opacity {self.name}".rstrip()
        return f"<{named}: {len(self.wavelengths)} wavelengths, {first:g} to {last:g} micron>"

    def absorption(self, frequency: Any, constants: str | Constants = CODATA) -> Reals:
        """Return the absorption opacity in cm²/g at frequencies (in Hz), of any shape."""
        return self._at("absorption", frequency, constants_named(constants))

    def scattering(self, frequency: Any, constants: str | Constants = CODATA) -> Reals:
        """Return the scattering opacity in cm²/g at frequencies (in Hz); zero if none was given."""
        return self._at("scattering", frequency, constants_named(constants))

    def extinction(self, frequency: Any, constants: str | Constants = CODATA) -> Reals:
        """Return the sum of absorption and scattering in cm²/g at frequencies (in Hz)."""
        return self.absorption(frequency, constants) + self.scattering(frequency, constants)

    def albedo(self, frequency: Any, constants: str | Constants = CODATA) -> Reals:
        """Return the part of the extinction that is scattering, from 0 to 1; 0 where it is none."""
        lost = self.extinction(frequency, constants)
        return self.scattering(frequency, constants) / np.where(lost > 0.0, lost, 1.0)

    def asymmetry(self, frequency: Any) -> Reals:
        """Return the mean cosine of the scattering angle: linear in log ν, constant beyond."""
        nu = CODATA.opacity_c / (MICRON * self.wavelengths)
        found = np.interp(np.log(_frequencies(frequency)), np.log(nu), self._rows["asymmetry"])
        return np.asarray(found)

    def _at(self, label: str, frequency: Any, constants: Constants) -> Reals:
        nu = _frequencies(frequency)
        own, kappa = constants.opacity_c / (MICRON * self.wavelengths), self._rows[label]
        if constants.name == "radmc3d" and self.grid is not None:
            return _as_radmc3d(nu, own, kappa, self.grid)
        return _power_laws(np.minimum(nu, own[-1]), own, kappa)

    @classmethod
    def open(cls, path: str | PathLike[str], name: str | None = None) -> Opacity:
        """Return the opacity in a file of RADMC-3D or optool, or in a plain table.

        Parameters
        ----------
        path : path
            ``dustkappa_NAME.inp``, ``dustkapscatmat_NAME.inp`` (its angles are left out), or a text
            with the columns wavelength (micron), absorption, scattering, asymmetry: two or more of
            them. Lines that begin with ``#``, ``!`` or ``;`` are comments.
        name : str, optional
            The one in the file's name by default.

        Raises
        ------
        FileFormatError
            If it is another file, or a damaged one.
        """
        from .opacity_files import read

        return read(path, name)

    @classmethod
    def from_table(cls, table: Any, name: str = "") -> Opacity:
        """Return the opacity in a table of astropy, or in a dictionary of columns.

        Columns are called ``wavelength`` (``lambda``, ``lam`` …), ``kappa_abs`` (``kabs``,
        ``absorption``, ``kappa`` …), ``kappa_scat`` (``ksca``, ``scattering`` …), ``g``. Those
        without a unit are in micron and cm²/g.

        Raises
        ------
        InputError
            If there are no wavelengths, or no absorption.
        """
        columns = getattr(table, "colnames", table)
        if not isinstance(columns, (list, Mapping)):
            raise InputError(
                "expected a table of astropy or a dictionary of columns, got "
                f"{type(table).__name__}"
            )
        names = {str(column).lower(): column for column in columns}
        found = {}
        for argument, known in _COLUMNS.items():
            column = next((names[one] for one in known if one in names), None)
            if column is not None:
                values = table[column]
                has_unit = getattr(values, "unit", None) is not None
                found[argument] = (
                    values.quantity
                    if has_unit and hasattr(values, "quantity")
                    else (values if has_unit else np.asarray(values, dtype=np.float64))
                )
            elif argument in ("wavelengths", "absorption"):
                raise InputError(
                    f"the table has no column of {argument}: expected one called "
                    f"{' or '.join(known[:3])}, got {', '.join(map(str, names.values()))}"
                )
        return cls(**found, name=name)

    @classmethod
    def power_law(cls, kappa: Any, wavelength: Any, beta: float, name: str = "") -> Opacity:
        """Return the absorption κ(λ) = `kappa` · (λ / `wavelength`)^-`beta`, without scattering.

        Parameters
        ----------
        kappa : float or Quantity
            Per mass of dust; a plain number in cm²/g.
        wavelength : float or Quantity
            Plain number in micron.
        beta : float
            The opacity index.
        name : str, optional
            For labels and errors.
        """
        (at,) = listed([wavelength], "micron", "wavelength").tolist()
        (value,) = listed([kappa], _CM2_G, "kappa").tolist()
        (beta,) = listed([beta], None, "beta").tolist()
        if not (at > 0.0 and value >= 0.0 and np.isfinite(beta)):
            raise InputError(
                f"expected a positive wavelength, an opacity and an index, got {wavelength!r}, "
                f"{kappa!r}, {beta!r}"
            )
        return cls(_POWER_LAW, value * (_POWER_LAW / at) ** -beta, name=name)

    @classmethod
    def published(cls, name: str) -> Opacity:
        """Return an opacity from the literature, per mass of dust.

        Parameters
        ----------
        name : str
            * ``"draine-2003"``: carbonaceous and silicate grains of the diffuse medium, R_V = 3.1
              (Weingartner & Draine 2001, Li & Draine 2001, Draine 2003, ARA&A 41, 241), with
              scattering, 0.1 micron to 1 cm. Thinned out: within 2 % of the full table.
            * ``"ossenkopf-henning-1994"``: grains with thin ice mantles that coagulated for 1e5
              years at 1e6 cm⁻³ (Ossenkopf & Henning 1994, A&A 291, 943, table 1), 1 to 1300 micron.
            * ``"beckwith-1990"``: 10 cm²/g (ν / 1 THz), discs (Beckwith et al. 1990, AJ 99, 924).
            * ``"hildebrand-1983"``: 10 cm²/g (250 micron / λ)², clouds (Hildebrand 1983, QJRAS 24,
              267), of the far infrared and beyond.

        Raises
        ------
        UnknownNameError
            If there is none of that name.
        """
        check_name("published opacity", name, (*TABLES, *POWER_LAWS))
        if name in POWER_LAWS:
            return cls.power_law(*POWER_LAWS[name], name=name)
        waves, absorption, *others = np.array(
            [row.split() for row in TABLES[name].split(";")], dtype=np.float64
        ).T
        columns = dict(zip(("scattering", "asymmetry"), others, strict=False))
        return cls(waves, absorption, **columns, name=name)


def listed(values: Any, unit: str | None, what: str) -> Reals:
    """Return a list of plain numbers in a unit."""
    found = in_unit(values, unit, what)
    if found.ndim != 1:
        raise InputError(f"{what}: expected a list of numbers, got shape {found.shape}")
    return found


def _frequencies(frequency: Any) -> Reals:
    nu = in_unit(frequency, "Hz", "frequency")
    if not np.all(nu > 0.0):
        raise InputError(f"frequencies must be positive and in Hz, got {shown(frequency)}")
    return nu


def _power_laws(nu: Reals, own: Reals, kappa: Reals) -> Reals:
    """Return κ: log κ is linear in log ν, beyond the ends too; κ is where one of two is zero."""
    return _between(np.log(nu), np.log(own), kappa, logarithmic=True)


def _between(x: Reals, xs: Reals, ys: Reals, *, logarithmic: bool) -> Reals:
    i = np.clip(np.searchsorted(xs, x, side="right") - 1, 0, len(xs) - 2)
    w = (x - xs[i]) / (xs[i + 1] - xs[i])
    first, last = ys[i], ys[i + 1]
    # Of zero and a positive value there is no power law: beyond the end there is nothing.
    linear = np.maximum((1.0 - w) * first + w * last, 0.0) * ~((w < 0.0) & (first <= 0.0))
    if not logarithmic:
        return np.asarray(linear)
    with np.errstate(divide="ignore", invalid="ignore"):
        steady = np.exp((1.0 - w) * np.log(first) + w * np.log(last))
    return np.where((first > 0.0) & (last > 0.0), steady, linear)


def _as_radmc3d(nu: Reals, own: Reals, kappa: Reals, grid: Reals) -> Reals:
    """Return κ by RADMC-3D's rules; `own` are the table's frequencies, which rise.

    Inside the table it is linear in ν. Outside, the table's copy on the global frequencies is: its
    log is linear in ν within the table, and beyond the ends it is as above.
    """
    below = np.zeros(len(grid))
    if kappa[0] > 0.0 and kappa[1] > 0.0:
        below = _power_laws(grid, own, kappa)
    inner = _between(np.clip(grid, own[0], own[-1]), own, kappa, logarithmic=True)
    copy = np.maximum(np.where(grid < own[0], below, inner), _LEAST)
    ends = (grid[0] * (1.0 - _RAMP), grid[-1] * (1.0 + _RAMP))
    outside = np.interp(nu, [ends[0], *grid, ends[1]], [0.0, *copy, 0.0])
    inside = (nu > own[0]) & (nu < own[-1])
    return np.where(inside, np.interp(nu, own, kappa), outside)
