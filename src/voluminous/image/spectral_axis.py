"""`SpectralAxis`: the wavelengths, frequencies or velocities of a cube's channels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError, UnitsError
from ..units import as_given, is_count, is_quantity, parse_unit, plain, shown, unit_of
from ..value import Value

if TYPE_CHECKING:
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
