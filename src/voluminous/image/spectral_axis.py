"""`SpectralAxis`: the wavelengths, frequencies or velocities of a cube's channels."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import FileFormatError, InputError, UnitsError
from ..units import as_given, is_count, is_quantity, parse_unit, plain, shown, unit_of
from ..value import Value

if TYPE_CHECKING:
    from astropy.io.fits import HDUList, Header
    from astropy.wcs import WCS

    from ..units import UnitLike
    from .arguments import Axis

# Speed of light (exact): km/s, and micron Hz.
_LIGHT, LIGHT_MICRON = 299792.458, 2.99792458e14
# Kind of axis, and the unit of its `places`.
UNITS = {"velocity": "km / s", "frequency": "Hz", "wavelength": "micron"}
# Channels this near to even spacing (in channels) count as even; rounding is far below.
_EVEN_TO = 1e-6


class SpectralAxis(Value):
    """The middle of each channel of a cube: wavelengths in vacuum, frequencies or velocities.

    Velocities are those of radio astronomy, ν = ν₀ (1 - v / c), positive for what recedes: Greisen
    et al. (2006), "Representations of spectral coordinates in FITS", A&A 446, 747, table 3.

    Parameters
    ----------
    values : array_like or Quantity, shape (channel,)
        In any order; moments and files for other programs need a rising or falling one.
    unit : str or unit, optional
        A length, a frequency or a velocity. Default: that of `values`, else micron.
    rest : float, str or Quantity, optional
        Frequency at rest, or wavelength; plain numbers are Hz. Velocities become frequencies, and
        frequencies velocities, by it.
    line : str, optional
        The line, such as ``"CO 2-1"``. `vm.observe` takes its frequency from the medium's molecules
        if there is no `rest`.
    frame : str
        Where velocities are at rest, by the names of FITS (SPECSYS): ``"SOURCE"`` for a model.

    Raises
    ------
    InputError
        If a value is not finite, or a wavelength or frequency is not positive.
    UnitsError
        If the unit is none of the three.
    """

    values: Axis
    unit: str
    kind: str
    rest: float | None
    line: str | None
    frame: str

    def __init__(
        self,
        values: ArrayLike,
        unit: UnitLike = None,
        rest: Any = None,
        line: str | None = None,
        frame: str = "SOURCE",
    ) -> None:
        given = as_given(values, "a channel's place", "1.3 mm")
        parsed = parse_unit(unit) or unit_of(given) or parse_unit(UNITS["wavelength"])
        kinds = [kind for kind, known in UNITS.items() if parsed.is_equivalent(known)]
        if not kinds:
            raise UnitsError(
                f"channels are wavelengths, frequencies or velocities, got the unit {parsed}"
            )
        exact = is_quantity(given) and given.unit == parsed  # no factor, no rounding
        numbers = given.value if exact else plain(given, parsed, "a channel's place")
        self.values = np.atleast_1d(np.array(numbers, dtype=np.float64))
        self.unit, self.kind = str(parsed), kinds[0]
        self.rest = None if rest is None else _hertz(rest)
        self.line, self.frame = line, frame
        if self.values.ndim != 1 or not self.values.size or not np.isfinite(self.values).all():
            raise InputError(
                f"channels need one finite number each, in a list, got {shown(values)}"
            )
        if self.kind == "velocity":
            fits = self._in("velocity") < _LIGHT
        else:
            fits = self.values > 0.0
        if not fits.all():
            raise InputError(
                "wavelengths and frequencies are positive, and velocities below that of light, "
                f"got {shown(values)}"
            )

    def __len__(self) -> int:
        return len(self.values)

    @property
    def frequencies(self) -> Axis:
        """Frequencies in Hz."""
        match self.kind:
            case "frequency":
                return self._in("frequency")
            case "wavelength":
                return LIGHT_MICRON / self._in("wavelength")
        return self._rest("frequencies of velocities") * (1.0 - self._in("velocity") / _LIGHT)

    @property
    def wavelengths(self) -> Axis:
        """Wavelengths in vacuum in micron."""
        if self.kind == "wavelength":
            return self._in("wavelength")
        return LIGHT_MICRON / self.frequencies

    @property
    def velocities(self) -> Axis:
        """Velocities in km/s, positive for what recedes."""
        if self.kind == "velocity":
            return self._in("velocity")
        return _LIGHT * (1.0 - self.frequencies / self._rest("velocities"))

    def places(self, kind: str) -> Axis:
        """Return velocities (km/s), frequencies (Hz) or wavelengths (micron): `kind` names one."""
        match kind:
            case "velocity":
                return self.velocities
            case "frequency":
                return self.frequencies
        return self.wavelengths

    @property
    def is_even(self) -> bool:
        """True if the values have equal distances, so that a number for the step says all."""
        steps = np.diff(self.values)
        if not len(steps):
            return True
        even = np.linspace(self.values[0], self.values[-1], len(self))
        step = abs(even[1] - even[0])
        return bool(step > 0 and np.abs(even - self.values).max() <= _EVEN_TO * step)

    def at_rest(self, rest: Any) -> SpectralAxis:
        """Return the axis with another frequency (or wavelength) at rest; plain numbers are Hz."""
        return self.replace(rest=rest)

    def describe(self) -> dict[str, Any]:
        """Return its arguments as plain values, which make the same axis."""
        return {
            "values": self.values.tolist(),
            "unit": self.unit,
            "rest": self.rest,
            "line": self.line,
            "frame": self.frame,
        }

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SpectralAxis) and self.describe() == other.describe()

    def __hash__(self) -> int:
        return hash((self.unit, self.rest, self.line, *self.values))

    def __repr__(self) -> str:
        first, last = self.values[0], self.values[-1]
        name = f" of {self.line}" if self.line else ""
        plural = "" if len(self) == 1 else "s"
        ends = f"{first:.6g}" if len(self) == 1 else f"{first:.6g} … {last:.6g}"
        return f"<{len(self)} channel{plural}{name}, {ends} {self.unit}>"

    def _in(self, kind: str) -> Axis:
        present, unit = parse_unit(self.unit), parse_unit(UNITS[kind])
        # To astropy a millimetre is 1000.0000000000001 micron: 15 digits make it 1000.
        return self.values if present == unit else self.values * float(f"{present.to(unit):.15g}")

    def _rest(self, what: str) -> float:
        if self.rest is None:
            line = f", or a medium that has the line {self.line}" if self.line else ""
            raise InputError(
                f"{what} need a frequency at rest: give rest=230.538 * u.GHz to the channels, "
                f"cube.at_rest(230.538 * u.GHz){line}"
            )
        return self.rest


def channels(
    first: Any, last: Any, count: int, line: str | None = None, rest: Any = None
) -> SpectralAxis:
    """Return evenly spaced velocities, both ends included: the channels of a line.

    Parameters
    ----------
    first, last : float, str or Quantity
        Velocities of the first and the last channel; plain numbers are km/s. What approaches has
        negative ones.
    count : int
        Number of channels; a single one is midway.
    line : str, optional
        The line, such as ``"CO 2-1"``: `vm.observe` looks for it in the medium's molecules.
    rest : float, str or Quantity, optional
        Its frequency (plain numbers: Hz) or wavelength at rest. Default: that of `line`.

    Raises
    ------
    InputError
        If a number is not finite, or the count is no positive whole number.
    UnitsError
        If a quantity is no velocity.

    Examples
    --------
    >>> channels(-5, 5, 5, line="CO 2-1")
    <5 channels of CO 2-1, -5 … 5 km / s>
    """
    if not is_count(count, 2**31):
        raise InputError(f"the number of channels must be a positive whole number, got {count!r}")
    low, high = (plain(v, UNITS["velocity"], "a channel's velocity") for v in (first, last))
    if np.ndim(low) or np.ndim(high):
        raise InputError(f"the first and last velocity are one number each, got {first}, {last}")
    values = np.linspace(low, high, int(count)) if count > 1 else [0.5 * (low + high)]
    return SpectralAxis(values, UNITS["velocity"], rest=rest, line=line)


def as_spectral(value: Any) -> SpectralAxis:
    """Return an axis of what a user gave: an axis, its description, or quantities."""
    if isinstance(value, SpectralAxis):
        return value
    return SpectralAxis(**value) if isinstance(value, dict) and value else SpectralAxis(value)


def _hertz(rest: Any) -> float:
    given = as_given(rest, "rest", "230.538 GHz")
    if is_quantity(given) and given.unit.is_equivalent("micron"):
        given = LIGHT_MICRON / np.asarray(plain(given, "micron", "rest"))
    frequency = np.asarray(plain(given, "Hz", "rest"))
    if frequency.ndim or not 0.0 < frequency < np.inf:
        raise InputError(f"rest must be one positive frequency or wavelength, got {rest!r}")
    return float(frequency)


Card = tuple[str, Any, str]
Linear = tuple[str, str, float, float]  # type, unit, first value and step

# Kind → type of the axis, its unit, and that of `SpectralAxis.places` in it.
_TYPES = {
    "velocity": ("VRAD", "m/s", 1e3),
    "frequency": ("FREQ", "Hz", 1.0),
    "wavelength": ("WAVE", "m", 1e-6),
}
# What other types than these become, if not velocities.
_BECOMES = {"AWAV": "WAVE", "ENER": "FREQ", "WAVN": "FREQ", "AFRQ": "FREQ"}
# Types whose convention does not show without a frequency at rest.
_VELOCITIES = ("VOPT", "VELO")
# Extension with the places of uneven channels, in SKIRT's files and ours.
_TABLE, _COLUMN = "Z-axis coordinate values", "GRID_POINTS"
# Extension with the exact numbers: cards have 16 digits, and even steps only.
_EXACT = "SPECTRAL"
# Steps between header and exact numbers, at most, unless the header was edited.
_SAME = 1e-6
# Width that a file says of a single channel, as a part of its place, and of velocities in m/s.
_SINGLE, _SINGLE_VELOCITY = 1e-5, 1e3


def linear(axis: SpectralAxis) -> Linear:
    """Return an axis of even channels as a header has it."""
    kind, unit, factor = _TYPES[axis.kind]
    values = factor * axis.places(axis.kind)
    step = _SINGLE_VELOCITY if axis.kind == "velocity" else _SINGLE * values[0]
    if len(values) > 1:
        step = (values[-1] - values[0]) / (len(values) - 1)
    return kind, unit, float(values[0]), float(step)


def cards(axis: SpectralAxis) -> Iterator[Card]:
    """Yield the cards of the third axis."""
    kind, unit, first, step = linear(axis) if axis.is_even else ("CHANNEL", "", 0.0, 1.0)
    yield "CTYPE3", kind, "linear" if unit else "their places are in a table"
    yield "CRPIX3", 1.0, "reference pixel; centre of the first is 1"
    yield "CRVAL3", first, "coordinate there"
    yield "CDELT3", step, "from one channel to the next"
    if unit:
        yield "CUNIT3", unit, "unit"
    if axis.rest is not None:
        yield "RESTFRQ", axis.rest, "[Hz] frequency at rest"
    if axis.frame:
        yield "SPECSYS", axis.frame, "frame of velocities"
    if axis.line:
        yield "LINE", axis.line, "name of the line"


def hdus(axis: SpectralAxis) -> Iterator[Any]:
    """Yield the extensions: exact numbers, and the table of uneven channels."""
    from astropy.io import fits

    yield fits.ImageHDU(axis.values, name=_EXACT)
    if not axis.is_even:
        unit, values = UNITS[axis.kind].replace(" ", ""), axis.places(axis.kind)
        column = fits.Column(_COLUMN, "D", unit=unit.replace("micron", "um"), array=values)
        yield fits.BinTableHDU.from_columns([column], name=_TABLE)


def read(
    header: Header, hdus: HDUList, count: int, known: dict[str, Any] | None, wcs: WCS | None
) -> SpectralAxis | None:
    """Return the axis of so many channels; None if there is none.

    `known` are arguments that our own description has, `wcs` is that of the channels' axis. The
    exact numbers are valid unless the header was edited afterwards.
    """
    exact = next((np.array(h.data, np.float64) for h in hdus if h.name == _EXACT), None)
    axis = None if wcs is None or wcs.wcs.spec < 0 else _of_wcs(wcs, count)
    rest = header.get("RESTFRQ", header.get("RESTFREQ"))
    if not rest and header.get("RESTWAV"):
        rest = LIGHT_MICRON / (1e6 * header["RESTWAV"])
    if known and exact is not None and len(exact) == count:
        spectral = SpectralAxis(exact, **known)
        edited = spectral.rest is None or not np.isclose(
            rest or 0.0, spectral.rest, rtol=1e-12, atol=0.0
        )
        spectral = spectral.at_rest(rest) if rest and edited else spectral
        if not spectral.is_even or axis is None or _agree(spectral, axis):
            return spectral
    if axis is None or wcs is None:
        return None
    line, frame = str(header.get("LINE", "")), str(header.get("SPECSYS", "")) or wcs.wcs.specsys
    return axis.replace(rest=rest or None, line=line or None, frame=frame)


def _of_wcs(wcs: WCS, count: int) -> SpectralAxis:
    """Return what the WCS of a single axis describes, without what is at rest.

    Other kinds of axes become ours, by the formulas of wcslib.
    """
    from astropy.wcs import WCS

    places = np.arange(count, dtype=float)
    values = wcs.wcs_pix2world(places[:, None], 0)[:, 0]
    kinds = {kind: name for name, (kind, *_) in _TYPES.items()}
    if not (wcs.wcs.restfrq or wcs.wcs.restwav):
        kinds |= dict.fromkeys(_VELOCITIES, "velocity")  # of no known frequency
    name = wcs.wcs.ctype[0][:4]
    if name not in kinds:
        step = values[0] or 1.0  # an even axis: wcslib knows no logarithms or tables of others
        even = WCS(naxis=1)
        even.wcs.ctype, even.wcs.cunit = [name], wcs.wcs.cunit
        even.wcs.crpix, even.wcs.crval, even.wcs.cdelt = [1.0], values[:1], [step]
        even.wcs.restfrq, even.wcs.restwav = wcs.wcs.restfrq, wcs.wcs.restwav
        try:
            even.wcs.sptr(f"{_BECOMES.get(name, 'VRAD')}-???")
        except ValueError as error:
            raise FileFormatError(
                f"the axis {name} is no velocity without a frequency at rest; give its header "
                "RESTFRQ, in Hz"
            ) from error
        values = even.wcs_pix2world((values - values[0])[:, None] / step, 0)[:, 0]
        wcs, name = even, even.wcs.ctype[0][:4]
    unit = UNITS[kinds[name]]
    # 15 digits make a factor of 1000.0000000000001 one of 1000.
    return SpectralAxis(values * float(f"{wcs.wcs.cunit[0].to(unit):.15g}"), unit)


def _agree(one: SpectralAxis, other: SpectralAxis) -> bool:
    if one.kind != other.kind:
        return False
    values, seen = one.places(one.kind), other.places(one.kind)
    step = abs(linear(one)[3]) / _TYPES[one.kind][2]
    return bool(np.abs(values - seen).max() <= _SAME * step + 1e-14 * np.abs(values).max())
