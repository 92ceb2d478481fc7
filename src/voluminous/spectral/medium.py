"""Media of physics: emission and absorption at frequencies, with a channel for each of them."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.functions import any_attenuation, precision_of
from ..backend.types import Float
from ..digest import digest
from ..errors import InputError
from ..expressions import Expression
from ..expressions.interval import Interval
from ..media.arguments import named
from ..media.bound import Binding, BoundMedium, SourceRange, Wrapped
from ..media.context import Context, Feature, MediumSample
from ..media.contract import Medium
from ..media.function import Function
from ..media.panel import extremes
from ..media.sum import with_each
from ..units import as_given, is_quantity, parse_unit, plain

if TYPE_CHECKING:
    from ..media.panel import Panel
    from ..physics.constants import Constants
    from ..volume import Volume

# How far temperatures may be beyond those at five places, as a part of their range.
_OVERSHOOT = 0.1
# Beyond this hν/kT the Planck function is Wien's, in double precision, too.
_WIEN = 40.0
# The logarithm of what is nothing, in units of the hottest matter's intensity.
_DARK = -600.0
# The largest hν/kT of which the exponential can be represented.
_COLDEST = {"single": 80.0, "double": 700.0}


@dataclass(frozen=True)
class Bands:
    """The frequencies at which a volume is observed.

    Attributes
    ----------
    frequencies : float array, shape (channel,)
        In Hz.
    unit : float array, shape (channel,)
        The intensity (erg/s/cm²/Hz/sr) that counts as one in each channel: that of the hottest
        matter. Single precision holds it where it is 1e-43.
    hottest : float
        The highest temperature in K; one if there is none.
    constants : Constants
    volume : Volume
    extremes : callable
        Returns the least and largest value of an expression in the volume, or bounds of them; of
        cells with ``in_cells=True``.
    once : bool
        They are drawn once: kernels and tables are not kept.
    """

    frequencies: np.ndarray
    unit: np.ndarray
    hottest: float
    constants: Constants
    volume: Volume
    extremes: Callable[..., tuple[float, float]]
    once: bool = False

    @property
    def length(self) -> float:
        """Centimetres in the volume's unit of length; plain numbers are centimetres."""
        unit = self.volume.unit
        return 1.0 if unit is None else float(unit.to("cm"))

    def some(self, first: int, last: int) -> Bands:
        """Return the bands of some of the channels."""
        part = slice(first, last)
        return replace(self, frequencies=self.frequencies[part], unit=self.unit[part])


@dataclass(frozen=True)
class InCgs:
    """An expression of the fields, and the factor to CGS units and kelvin."""

    expr: Expression
    factor: float = 1.0

    @classmethod
    def of(cls, value: Any, unit: str, what: str, volume: Volume) -> InCgs:
        """Return what a user gives for a quantity: a number, a quantity, a field, an expression.

        What has no unit is in CGS units.
        """
        if is_quantity(value) or isinstance(value, Real):
            return cls(Expression(float(plain(value, parse_unit(unit), what))))
        expr = Expression(value)
        expr = volume.without_units(expr)
        own = volume.expression_unit(expr)
        if own is None or not unit:
            return cls(expr)
        return cls(expr, float(plain(1.0 * own, parse_unit(unit), f"{what} {expr.text!r}")))

    def value(self, fields: Mapping[str, Any], context: Context) -> Any:
        """Return its value at values of the fields."""
        found = context.evaluate(self.expr, dict(fields))
        return found if self.factor == 1.0 else found * context.kept_number(self.factor)

    def where(self, matter: Any, fields: Mapping[str, Any], context: Context) -> Any:
        """Return the same where there is matter, elsewhere one: p/ρ is 0/0 in a vacuum."""
        return dr.select(matter == 0.0, 1.0, self.value(fields, context))

    def extremes(self, bands: Bands) -> tuple[float, float]:
        """Return its least and largest value in the volume."""
        low, high = bands.extremes(self.expr)
        return low * self.factor, high * self.factor


class SpectralMedium(Medium):
    """Emission and absorption of physical processes; media add with ``+``.

    It has no channels before `at_frequencies` gives it some: `voluminous.observe` does.

    Attributes
    ----------
    bands : Bands or None
        Its frequencies.
    """

    grey = False
    thermal = True
    channels = 0
    names: tuple[str, ...] = ()
    bands: Bands | None = None
    _digest: Any = None

    def temperatures(self, volume: Volume) -> list[InCgs]:
        """Return the temperatures of what emits."""
        return []

    def quantities(self) -> Sequence[InCgs]:
        """Return all that it evaluates, once it has frequencies."""
        raise NotImplementedError

    def at_frequencies(self, bands: Bands) -> SpectralMedium:
        """Return the medium with a channel for each frequency.

        Its emissivity is in ``bands.unit`` per unit length of the volume.
        """
        medium = self.tuned(bands)
        found = (q.expr.names for q in medium.quantities())
        names = tuple(dict.fromkeys(name for own in found for name in own))
        return medium.changed(names=names)

    def tuned(self, bands: Bands) -> SpectralMedium:
        """Return a copy with bands, and all numbers that depend on them."""
        return self.changed(bands=bands, channels=len(bands.frequencies))

    def bind(self, binding: Binding) -> BoundMedium:
        assert self.bands is not None
        first, last, _ = binding.channels.indices(self.channels)
        medium = self
        if last - first < self.channels:
            medium = self.at_frequencies(self.bands.some(first, last))
        return medium.bound(replace(binding, channels=slice(None)))

    def bound(self, binding: Binding) -> BoundSpectral:
        """Return its numbers, of all channels."""
        return BoundSpectral(self, binding)

    def features(self) -> tuple[Feature, ...]:
        return tuple(Feature(q.expr) for q in self.quantities() if q.expr.names)

    def heat(self) -> Sequence[InCgs]:
        """Return the temperatures of what emits, once it has frequencies."""
        return ()

    def __call__(self, values: Any) -> tuple[Any, Any]:
        raise InputError(self._without_channels())

    def plot(self, volume: Volume | None = None, ax: Any = None) -> Any:
        raise InputError(self._without_channels())

    def _without_channels(self) -> str:
        return (
            f"{type(self).__name__} has no transfer function: it emits at any frequency. Draw "
            "vm.observe(volume, medium, camera, wavelengths=[0.87] * u.mm), or a spectrum"
        )

    def describe(self) -> dict[str, Any]:
        """Return its arguments as plain values; of opacities and molecules the names."""
        parameters = inspect.signature(type(self)).parameters
        given = {name: getattr(self, name, None) for name in parameters}
        return {"type": self.kind, **{k: _told(v) for k, v in given.items() if v is not None}}

    def row(self, context: Context, name: str, values: Any) -> list[Float]:
        """Return a number for each channel as run-time data, which enters a kernel once."""
        return context.keep(
            (id(self), name), lambda: [context.number(float(v)) for v in np.atleast_1d(values)]
        )

    def key(self) -> Any:
        bands = self.bands
        if bands is None or bands.once:
            return None
        numbers = (bands.frequencies, bands.unit, np.array([bands.hottest, bands.length]))
        texts = ((q.expr.text, q.factor) for q in self.quantities())
        own = tuple(digest(n) for n in (*numbers, *self.constant_arrays()))
        return (type(self).__name__, bands.constants.name, *texts, *own)

    def constant_arrays(self) -> Sequence[np.ndarray]:
        """Return the other arrays that it depends on."""
        return ()

    @staticmethod
    def from_function(  # type: ignore[override]
        function: Callable[..., Any],
        fields: Any,
        *,
        parameters: dict[str, float] | None = None,
    ) -> SpectralMedium:
        """Return a medium from a Python function of the fields and the frequency.

        Parameters
        ----------
        function : callable
            Called as ``function(*fields, frequency, **parameters)`` with arrays in the fields' own
            units and a frequency in Hz; returns (j, α): erg/s/cm³/Hz/sr, and per cm.
        fields : sequence of str
            Field names, or expressions of them.
        parameters : dict of float, optional
            As for `Medium.from_function`.

        Examples
        --------
        >>> import voluminous as vm
        >>> grey_body = vm.SpectralMedium.from_function(
        ...     lambda rho, nu: (1e-40 * rho * nu**2, 1e-30 * rho * nu**2), ["rho"]
        ... )
        """
        return SpectralFunction(function, fields, parameters=parameters)


class BoundSpectral(Wrapped):
    """The numbers of a spectral medium in a kernel's units."""

    medium: SpectralMedium

    def source_range(self, panel: Panel) -> SourceRange | None:
        heat, bands, context = self.medium.heat(), self.medium.bands, panel.context
        if not heat or bands is None:
            return None
        rows = ([q.value(panel.fields(s), context) for s in panel.where] for q in heat)
        low, high = extremes([context.narrow(t + panel.length * 0.0) for row in rows for t in row])
        over = _OVERSHOOT * (high - low)
        exponents = bands.constants.planck_exponent * bands.frequencies
        numbers = context.keep(
            (self._part, "hν/k"), lambda: [context.narrow_number(float(x)) for x in exponents]
        )
        return SourceRange(low - over, high + over, numbers)


class SpectralFunction(SpectralMedium):
    """Emissivity and extinction by a function of fields and frequency."""

    thermal = False

    def __init__(
        self,
        function: Callable[..., Any],
        fields: Any,
        *,
        parameters: dict[str, float] | None = None,
    ) -> None:
        self.function = Function(function, fields, 1, grey=False, parameters=parameters)

    def describe(self) -> dict[str, Any]:
        own = self.function.describe()
        return {"type": self.kind, **{k: own[k] for k in ("function", "fields") if k in own}}

    def quantities(self) -> Sequence[InCgs]:
        return tuple(map(InCgs, self.function.inputs))

    def features(self) -> tuple[Feature, ...]:
        return ()  # what it computes is not known

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        bands, function = self.bands, self.function
        assert bands is not None
        arguments = [context.evaluate(e, fields) for e in function.inputs]
        keywords = {k: context.number(v) for k, v in function.parameters.items()}
        bright = self.row(context, "j", bands.length / bands.unit)
        length = context.kept_number(bands.length)
        found = MediumSample([], [])
        for nu, unit in zip(self.row(context, "ν", bands.frequencies), bright, strict=True):
            try:
                pair = function.function(*arguments, nu, **keywords)
                if not isinstance(pair, tuple) or len(pair) != 2:
                    raise TypeError(f"it returns {type(pair).__name__}")
                j, alpha = pair
            except (TypeError, ValueError) as error:
                raise InputError(
                    f"a spectral function is called with {len(arguments)} fields and the frequency "
                    f"in Hz, and returns j and alpha: {error}"
                ) from error
            found.emissivity.append(context.real(j) * unit)
            found.extinction.append(context.real(alpha) * length)
        return found

    def key(self) -> Any:
        return None  # a function may change


# --- thermal emission -----------------------------------------------------------------------------


class Planck:
    """The Planck function of each channel, in its unit.

    B_ν(T) = 2hν³/c² / (exp(hν/kT) - 1) (Rybicki & Lightman 1979, equation 1.51). The exponent is
    that of the hottest matter plus what colder matter has more, so that no digits are lost where
    it is large; far in Wien's tail both parts of the quotient lose a common factor.
    """

    def __init__(self, bands: Bands) -> None:
        constants, nu = bands.constants, bands.frequencies
        self.hottest = bands.hottest
        self.slope = constants.planck_exponent * nu / bands.hottest
        self.least = np.minimum(self.slope, _WIEN)
        with np.errstate(under="ignore", over="ignore"):
            lost = np.log(constants.planck_factor) + 3.0 * np.log(nu) - np.log(bands.unit)
            size = lost - (self.slope - self.least)
        # Where all is dark even in the smallest unit there is, products would be subnormal.
        self.factor = np.where(size - self.least < _DARK, 0.0, np.exp(np.maximum(size, _DARK)))

    def coolness(self, temperature: Float, context: Context) -> Float:
        """Return (T_hottest - T)/T: large where it is cold."""
        hottest = context.kept_number(self.hottest)
        warm = temperature > 0.0
        cool = (hottest - temperature) / dr.select(warm, temperature, 1.0)
        return dr.select(warm, cool, dr.select(dr.isnan(temperature), temperature, 1e30))

    def values(self, medium: SpectralMedium, temperature: Float, context: Context) -> list[Float]:
        """Return B_ν(T) per channel."""
        cool = self.coolness(temperature, context)
        numbers = {"slope": self.slope, "least": self.least, "factor": self.factor}
        rows = (medium.row(context, f"B {name}", own) for name, own in numbers.items())
        return [
            factor * occupation(dr.fma(slope, cool, least))
            for slope, least, factor in zip(*rows, strict=True)
        ]

    def between(self, low: np.ndarray, high: np.ndarray) -> list[Interval]:
        """Return intervals of B_ν between two temperatures."""
        ends = []
        for t in (low, high):
            with np.errstate(all="ignore"):
                cool = np.where(t > 0.0, (self.hottest - t) / np.where(t > 0.0, t, 1.0), np.inf)
                ends.append(
                    [
                        f / np.expm1(np.maximum(s * cool + x, 1e-300))
                        for s, x, f in zip(self.slope, self.least, self.factor, strict=True)
                    ]
                )
        return [Interval(np.minimum(a, b), np.maximum(a, b)) for a, b in zip(*ends, strict=True)]


def occupation(x: Float) -> Float:
    """Return 1/(exp(x) - 1) for x > 0, with all digits at both ends."""
    coldest = _COLDEST[precision_of(type(x))]
    x = dr.select(x < coldest, x, dr.select(dr.isnan(x), x, coldest))
    theta, mean = any_attenuation(x)
    return theta / (x * mean)


def some_channels(medium: Medium, channels: slice) -> Medium:
    """Return the medium at some of its frequencies."""

    def at_some(part: Any) -> Medium:
        tuned: Medium = part.at_frequencies(part.bands.some(channels.start, channels.stop))
        return tuned

    return with_each(medium, at_some)


def hottest(medium: Medium, bands: Bands) -> float | None:
    """Return the highest temperature in a volume of what emits; None if it is not known.

    Raises
    ------
    InputError
        If one is below 0 K.
    """
    found = []
    for part in medium.components():
        if not isinstance(part, SpectralMedium):
            continue
        for q in part.temperatures(bands.volume):
            low, high = q.extremes(bands)
            if low < 0.0:  # a bound, unless it is in a cell
                low = q.factor * bands.extremes(q.expr, in_cells=True)[0]
            if low < 0.0:
                raise InputError(
                    f"temperatures are 0 K or more, but {q.expr.text!r} of {part.kind} is down to "
                    f"{low:.6g} K: correct the field, or write max({q.expr.text}, 0)"
                )
            found.append(high)
    return max((t for t in found if math.isfinite(t) and t > 0.0), default=None)


# --- the arguments of media -----------------------------------------------------------------------


def given_field(value: Any, what: str) -> Any:
    """Return an argument that is a field, an expression, a number or a quantity."""
    if isinstance(value, Expression):
        return value
    if isinstance(value, str):
        return Expression(value)
    value = as_given(value, what)
    number = isinstance(value, Real) and not isinstance(value, (bool, np.bool_))
    if number or (is_quantity(value) and np.ndim(value.value) == 0):
        if np.asarray(getattr(value, "value", value)) < 0.0:
            raise InputError(f"{what} must not be negative, got {value}")
        return value
    raise InputError(
        f"{what} must be the name of a field, an expression, a number or a quantity (of several "
        f"species a list of these; arrays become fields by volume['name'] = array), got {value!r}"
    )


def _told(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return [_told(one) for one in value]
    if isinstance(value, Expression):
        return value.text
    return named(value) if isinstance(value, (str, Real)) or is_quantity(value) else _name(value)


def _name(value: Any) -> str:
    return str(getattr(value, "name", None) or getattr(value, "__name__", type(value).__name__))


def model_of(volume: Any, what: str) -> Any:
    """Return what the folder of a model of RADMC-3D says besides its fields."""
    folder = getattr(volume, "meta", {}).get("radmc3d")
    if folder is None:
        raise InputError(
            f"{what} needs a volume that was opened from a folder of RADMC-3D, or fields by their "
            "names; see the docstring"
        )
    from ..radmc3d.model import read_model

    return read_model(folder)


def field_in(volume: Volume, stem: str, number: int, count: int) -> str:
    """Return the name of a field of one of several species."""
    return stem if count == 1 and stem in volume.fields else f"{stem}_{number + 1}"
