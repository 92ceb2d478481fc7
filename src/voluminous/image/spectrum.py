"""`Spectrum`: fluxes or intensities at wavelengths, frequencies or velocities."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import FileFormatError, InputError, UnitsError, check_name
from ..figures import new_figure
from ..files import as_path, check_start, expecting, replacing
from ..units import as_quantity, is_quantity, parse_unit, plain, pretty_unit, unit_of
from ..value import Value
from .arguments import distance as distance_of
from .arguments import json_value
from .formats import radmc3d
from .lengths import labelled
from .metadata import KEY, fits_text
from .spectral_axis import SpectralAxis, as_spectral

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..units import UnitLike
    from .arguments import Axis

# Suffix of a file: astropy's name of its format, and its first bytes.
_FORMATS: dict[str, tuple[str, tuple[bytes, ...]]] = {
    ".fits": ("fits", (b"SIMPLE  =",)),
    ".ecsv": ("ascii.ecsv", (b"# %ECSV",)),
    ".out": ("RADMC-3D's", (b" ", b"\n", b"1")),
}
# Entry of a table's head with all that is not in its columns, as JSON.
_TEXT = "VOLMETA"
# Wavelengths or frequencies that reach over this factor are drawn on logarithmic axes, and fluxes
# over so many decades.
_WIDE, _DECADES = 3.0, 8.0
_SHOWN = {"velocity": "km / s", "frequency": "GHz", "wavelength": "micron"}


class Spectrum(Value):
    """A spectrum: the flux of a picture or an aperture, or the intensity in a pixel.

    Parameters
    ----------
    spectral : SpectralAxis, Quantity or array_like, shape (channel,)
        Wavelengths, frequencies or velocities; plain numbers are wavelengths in micron.
    flux : array_like or Quantity, shape (channel,)
        Flux densities, or whatever `unit` says.
    unit : str or unit, optional
        Unit of the flux. Default: that of `flux`.
    distance : Quantity, str or float, optional
        Distance at which the flux is received; plain numbers are cm. Gives luminosities.
    provenance : dict, optional
        Origin of the spectrum: dicts, lists, strings, numbers, booleans and None.
    error : array_like or Quantity, shape (channel,), optional
        Estimated absolute error of the flux.

    Raises
    ------
    InputError
        If shapes do not fit.
    UnitsError
        If a quantity cannot be converted.

    Examples
    --------
    >>> Spectrum([1300.0, 870.0], [1.0, 3.0], "Jy")
    <Spectrum of 2 channels, 1300 … 870 micron, 1 … 3 Jy>
    """

    spectral: SpectralAxis
    flux: Axis
    unit: str
    distance: float | None
    provenance: dict[str, Any] | None
    error: Axis | None

    def __init__(
        self,
        spectral: Any,
        flux: ArrayLike,
        unit: UnitLike = None,
        distance: Any = None,
        provenance: dict[str, Any] | None = None,
        error: ArrayLike | None = None,
    ) -> None:
        given = as_quantity(flux)
        nothing = unit is None or (isinstance(unit, str) and not unit)
        present = parse_unit(unit_of(given) if nothing else unit)
        self.spectral = as_spectral(spectral)
        self.unit = "" if present is None else str(present)
        self.flux = self._numbers(given, present, "flux")
        self.error = None if error is None else self._numbers(error, present, "error")
        self.distance = distance_of(distance)
        self.provenance = json_value(provenance, "provenance")

    def _numbers(self, values: Any, unit: Any, what: str) -> Axis:
        exact = is_quantity(values) and values.unit == unit  # no factor, no rounding
        numbers = np.array(values.value if exact else plain(values, unit, what), np.float64)
        if numbers.shape != (len(self.spectral),):
            raise InputError(
                f"{what} has shape {numbers.shape}, expected one number for each of "
                f"{len(self.spectral)} channels"
            )
        return numbers

    def __len__(self) -> int:
        return len(self.flux)

    def to(self, unit: UnitLike) -> Spectrum:
        """Return the spectrum in another unit.

        Parameters
        ----------
        unit : str or unit
            A flux density such as ``"Jy"`` or ``"W / (m2 micron)"``; a flux such as ``"W / m2"``
            or ``"erg / (s cm2)"``, which is ν F_ν = λ F_λ; with a `distance` a luminosity such as
            ``"L_sun"`` or ``"erg / (s Hz)"``, 4π d² times these. Intensities become brightness
            temperatures, T = c² I / (2 k ν²).

        Raises
        ------
        UnitsError
            If it cannot be converted.
        """
        from astropy import units as u

        present, target = parse_unit(self.unit), parse_unit(unit)
        if present is None or target is None:
            raise UnitsError(f"a spectrum in {present or 'no unit'} cannot be converted to {unit}")
        nu = None if present.is_equivalent(target) else self.spectral.frequencies * u.Hz
        laws = [] if nu is None else u.spectral_density(nu) + u.brightness_temperature(nu)
        if self.distance is not None and not present.is_equivalent(target, laws):
            sphere = u.Unit(4.0 * math.pi * self.distance**2 * u.cm**2)
            units = (present * sphere, present * sphere**-1)
            present = next(
                (choice for choice in units if choice.is_equivalent(target, laws)), present
            )
        try:
            parts = {
                name: np.asarray(present.to(target, values, equivalencies=laws), np.float64)
                for name, values in (("flux", self.flux), ("error", self.error))
                if values is not None
            }
        except u.UnitConversionError as error:
            message = f"a spectrum in {self.unit} cannot be converted to {unit}"
            hint = "" if self.distance else "; a luminosity needs spectrum.replace(distance=…)"
            raise UnitsError(message + hint) from error
        return self.replace(**parts, unit=target)

    def plot(
        self,
        ax: Axes | None = None,
        *,
        unit: UnitLike = None,
        x: str | None = None,
        **options: Any,
    ) -> Axes:
        """Draw the spectrum: as steps over velocities, else as a line.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Default: axes in a new figure, as for `Image.plot`.
        unit : str or unit, optional
            Convert first, as with `to`: ``"W / m2"`` draws ν F_ν.
        x : {"velocity", "frequency", "wavelength"}, optional
            What runs to the right. Default: what the channels were given as.
        **options
            Those of matplotlib's ``plot``: ``label``, ``color``, ``marker`` …

        Returns
        -------
        matplotlib Axes
            Logarithmic where wavelengths or frequencies reach over more than a factor of 3.
        """
        shown = self if unit is None else self.to(unit)
        kind = shown.spectral.kind if x is None else x
        check_name("x axis", kind, _SHOWN)
        places, flux = shown.spectral.places(kind), shown.flux
        if kind == "frequency":
            places = 1e-9 * places
        axes: Axes = new_figure().add_subplot() if ax is None else ax
        order = np.argsort(places)
        look: dict[str, Any] = {"drawstyle": "steps-mid"} if kind == "velocity" else {}
        few = len(flux) < 100 and kind != "velocity"
        look |= {"marker": "o", "markersize": 3} if few else {}
        axes.plot(places[order], flux[order], **{**look, **options})
        if shown.error is not None:
            low, high = (flux - shown.error)[order], (flux + shown.error)[order]
            look = {"color": axes.lines[-1].get_color(), "alpha": 0.25, "linewidth": 0}
            look |= {"step": "mid"} if kind == "velocity" else {}
            axes.fill_between(places[order], low, high, **look)
        if kind != "velocity" and places.max() > _WIDE * places.min():
            axes.set_xscale("log")
            bright = flux[np.isfinite(flux) & (flux > 0)]
            if bright.size:
                axes.set_yscale("log")
                least, most = axes.get_ylim()
                axes.set_ylim(max(least, most / 10**_DECADES), most)
        axes.set_xlabel(labelled(kind, pretty_unit(_SHOWN[kind])))
        axes.set_ylabel(labelled(_name(shown), pretty_unit(shown.unit)))
        if shown.spectral.line and not axes.get_title():
            axes.set_title(shown.spectral.line)
        return axes

    def save(self, path: str | Path) -> None:
        """Write a table: ``.fits``, or ``.ecsv`` (text); `load` reads both unchanged.

        The columns are the channels as they were given, their frequencies if these are known, the
        flux, and the error if there is one. ``.out`` is RADMC-3D's ``spectrum.out``: fluxes at
        1 pc, and nothing else.

        Raises
        ------
        UnknownNameError
            If the suffix is another.
        UnitsError
            If RADMC-3D's file is asked for, and the spectrum is no flux at a `distance`.
        """
        place = as_path(path)
        suffix = place.suffix.lower()
        check_name("format of a spectrum", suffix, _FORMATS)
        if suffix == ".out":
            if self.distance is None:
                raise UnitsError(
                    "RADMC-3D's spectra are fluxes at 1 pc: say at what distance these are, "
                    "spectrum.replace(distance='140 pc')"
                )
            flux = self.to(radmc3d.FLUX).flux * (self.distance / radmc3d.PARSEC) ** 2
            with replacing(place) as temporary:
                radmc3d.write_spectrum(temporary, self.spectral.wavelengths, flux)
            return
        with replacing(place) as temporary:
            self.table().write(temporary, format=_FORMATS[suffix][0])

    @classmethod
    def load(cls, path: str | Path) -> Spectrum:
        """Read a table that `save` wrote, or one of another program with the same columns.

        RADMC-3D's ``spectrum.out`` has fluxes at a distance of 1 pc.

        Raises
        ------
        MissingPathError
            If there is no such file.
        FileFormatError
            If there is no column ``flux``, or none of wavelength, frequency and velocity.
        """
        from astropy.table import Table

        place = as_path(path)
        check_name("format of a spectrum", place.suffix.lower(), _FORMATS)
        form, start = _FORMATS[place.suffix.lower()]
        check_start(place, start, "a table of a spectrum")
        with expecting(place, "a table of a spectrum"):
            if place.suffix.lower() == ".out":
                waves, flux = radmc3d.read_spectrum(place)
                return cls(waves, flux, radmc3d.FLUX, radmc3d.PARSEC)
            table = Table.read(place, format=form)
            known = json.loads(table.meta.get(_TEXT, "{}"))
            axis = known.pop("spectral", {})
            kind = next((k for k in [axis.pop("kind", None), *_SHOWN] if k in table.colnames), None)
            if kind is None or "flux" not in table.colnames:
                raise FileFormatError(
                    f"expected columns flux and one of {', '.join(_SHOWN)}, found "
                    f"{', '.join(table.colnames)}"
                )
            columns: dict[str, Any] = {
                name: np.asarray(table[name], np.float64)
                for name in ("flux", "error")
                if name in table.colnames
            }
            axis = {**axis, "values": np.asarray(table[kind], np.float64)}
            axis.setdefault("unit", table[kind].unit or _SHOWN[kind])
            known.setdefault("unit", table["flux"].unit)
            return cls(**columns, spectral=SpectralAxis(**axis), **known)

    def table(self) -> Any:
        """Return the spectrum as an astropy Table, as `save` writes it."""
        from astropy.table import Column, Table

        axis = self.spectral.describe()
        del axis["values"]
        columns = [Column(self.spectral.values, self.spectral.kind, unit=self.spectral.unit)]
        known = self.spectral.kind != "velocity" or self.spectral.rest is not None
        if known and self.spectral.kind != "frequency":
            columns.append(Column(self.spectral.frequencies, "frequency", unit="Hz"))
        columns.append(Column(self.flux, "flux", unit=self.unit or None))
        if self.error is not None:
            columns.append(Column(self.error, "error", unit=self.unit or None))
        text = {
            "spectral": {"kind": self.spectral.kind, **axis},
            "unit": self.unit,
            "distance": self.distance,
            "provenance": self.provenance,
        }
        meta: dict[str, Any] = {"CREATOR": KEY}
        if self.spectral.rest is not None:
            meta |= {"RESTFRQ": self.spectral.rest}
        return Table(columns, meta={**meta, _TEXT: fits_text(json.dumps(text))})

    def describe(self) -> dict[str, Any]:
        """Return its arguments as plain values, which make the same spectrum."""
        return {
            "spectral": self.spectral.describe(),
            "flux": self.flux.tolist(),
            "unit": self.unit,
            "distance": self.distance,
            "provenance": self.provenance,
            "error": None if self.error is None else self.error.tolist(),
        }

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Spectrum) and self.describe() == other.describe()

    def __hash__(self) -> int:
        return hash((self.spectral, self.unit, *self.flux))

    def __repr__(self) -> str:
        finite = self.flux[np.isfinite(self.flux)]
        span = f"{finite.min():.4g} … {finite.max():.4g}" if finite.size else "not finite"
        channels = repr(self.spectral).strip("<>")
        return f"<Spectrum of {channels}, {span} {self.unit}".rstrip() + ">"


def _name(spectrum: Spectrum) -> str:
    unit = parse_unit(spectrum.unit)
    for name, kinds in (
        (r"$F_\nu$", ("Jy", "ph / (s cm2 Hz)")),
        (r"$F_\lambda$", ("W / m3",)),
        (r"$\nu F_\nu$", ("W / m2",)),
        (r"$\nu L_\nu$", ("W",)),
        (r"$L_\nu$", ("W / Hz",)),
        ("brightness temperature", ("K",)),
        ("intensity", ("Jy / sr", "Jy / beam", "Jy / pix")),
    ):
        if unit is not None and any(unit.is_equivalent(kind) for kind in kinds):
            return name
    return "flux"
