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


# Wavelength (micron), then in cm²/g of dust absorption, scattering, and its mean cosine.
TABLES = {
    # B. T. Draine's table of 2003-12-17 for R_V = 3.1, case A: 59 of its 548 points from 0.1
    # micron to 1 cm. Between them absorption is within 2 %, scattering within 4 % of the others.
    "draine-2003": """
0.1 8.225e4 3.09e4 0.649; 0.1318 5.046e4 2.71e4 0.681; 0.1549 4.09e4 2.61e4 0.659;
0.1738 3.61e4 2.86e4 0.628; 0.182 3.556e4 3.04e4 0.61; 0.1905 3.677e4 3.2e4 0.593;
0.2125 4.743e4 3.5e4 0.559; 0.2188 4.768e4 3.54e4 0.552; 0.2291 4.189e4 3.51e4 0.546;
0.2455 3.12e4 3.35e4 0.543; 0.2512 2.902e4 3.31e4 0.542; 0.2754 2.343e4 3.09e4 0.548;
0.4074 1.343e4 2.4e4 0.569; 0.547 8551 1.76e4 0.538; 0.6761 6371 1.31e4 0.488;
0.871 4699 8.6e3 0.412; 1.66 2305 2.45e3 0.204; 2.455 1449 978 0.098;
3.45 916.2 359 0.0056; 4.266 673.3 171 -0.0302; 5.37 488.6 69 -0.0491;
5.888 449.8 47.1 -0.0522; 6.026 455.4 42.7 -0.0526; 6.166 480.6 38.8 -0.0528;
6.25 472.2 36.6 -0.053; 6.457 419.4 31.9 -0.053; 6.607 402.7 28.9 -0.053;
7.079 385.2 21.4 -0.0525; 7.244 395.5 19.4 -0.0522; 7.413 428.5 17.5 -0.0519;
7.943 686.3 12.9 -0.0505; 8.318 1062 10.7 -0.0486; 8.511 1248 9.94 -0.0474;
9.12 1940 7.99 -0.0418; 9.333 2137 7.51 -0.0393; 9.5 2171 7.19 -0.0377;
10.36 1798 5.23 -0.0328; 13.49 550.9 1.66 -0.0289; 13.8 506.9 1.47 -0.029;
14.13 488.1 1.32 -0.0291; 14.79 516.7 1.09 -0.0291; 16.98 718.7 0.647 0;
18.2 785.2 0.471 0; 19.5 732.2 0.366 0; 22.39 564.6 0.226 0;
24.55 490.5 0.147 0; 32.36 364.5 0.0729 0; 37.15 281.5 0.0563 0;
57.54 96 0.0096 0; 97.72 28.55 0 0.0072; 117.5 19.31 0 0.0029;
138 14.33 0 0; 162.2 9.895 0 0; 245.5 4.187 0 0;
338.8 2.05 0 0; 457.1 1.123 0 0; 691.8 0.5358 0 0;
2630 0.06049 0 0; 1e4 0.006553 0 0
""",
    # Table 1, column "thin ice mantles, 1e6 cm-3"; absorption only.
    "ossenkopf-henning-1994": """
1 1.309e4; 1.166 1.144e4; 1.359 9799; 1.585 8010; 1.848 6438; 2.154 5080;
2.512 3897; 2.712 3393; 2.818 3607; 2.929 6563; 3.043 6240; 3.162 4338;
3.286 2941; 3.414 2538; 3.548 2323; 3.687 2134; 3.831 2033; 3.981 1932;
4.299 1762; 4.642 1625; 5.012 1421; 5.412 1289; 5.843 1367; 6.31 1304;
6.813 1246; 7.356 1122; 7.943 1057; 8.577 1103; 8.912 1432; 9.261 1723;
9.623 2202; 9.81 2678; 10 2579; 10.39 2522; 10.8 2478; 11.22 2555;
11.66 2506; 12.59 1964; 13.59 1602; 14.68 1347; 15.85 1327; 17.11 1513;
18.48 1584; 19.95 1343; 21.55 1098; 25.12 767.9; 29.29 545.3; 34.15 451.3;
36.87 433.9; 39.81 426.9; 42.99 421.5; 46.42 386.9; 54.12 279.6; 63.1 211.2;
73.57 158; 85.77 118.2; 100 86.47; 116.6 67.53; 135.9 52.51; 158.5 40.86;
184.8 30.66; 226 21.69; 350 10.08; 500 5.043; 700 2.573; 1000 1.367;
1300 0.8992
""",
}
# κ in cm²/g of dust, at this wavelength in micron, and β. The papers have 0.1 cm²/g of gas and
# dust, of which a hundredth is dust.
POWER_LAWS = {
    "beckwith-1990": (10.0, 299.792458, 1.0),
    "hildebrand-1983": (10.0, 250.0, 2.0),
}
