"""The numbers of a medium that a scheme integrates, and their conversion to intensities."""

from __future__ import annotations

import copy
import functools
import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, TypeAlias

import numpy as np

from ...backend import Backend, dr
from ...backend.functions import any_attenuation
from ...backend.types import Float
from ...media import Shaped
from ...media.bound import Binding, BoundMedium, integrated
from ...media.context import Context, MediumSample
from ...media.contract import Medium
from ...media.panel import Panel
from ...schemes.base import Coefficients, Scheme
from ...schemes.path import Path, most
from ..options import MOST_TOGETHER

# A maximum below this fraction of a channel's unit may be due to rounding.
_LEAST_PEAK = 2.0**-60
# Channels far in the wings of lines need not be as exact as others: their light is that of few
# places, in steep tails. With the tolerance relative to it a real disc took 500 times as long.
_FAINT_CHANNEL = 1e-7


def unit_near(size: float) -> float:
    """Return a power of two near a size, so that scaling is exact; one if there is no size."""
    if not 0.0 < size < np.inf:
        return 1.0
    return float(2.0 ** np.clip(np.round(np.log2(size)), -1000, 1000))


def fits_single(size: float) -> bool:
    """Return True if single precision holds a size with room for smaller and larger numbers."""
    return size == 0.0 or 2.0**-90 < size < 2.0**90


def in_units_of(unit: Any, values: np.ndarray) -> np.ndarray:
    """Return values times a unit, in double precision where single may not hold them.

    An array has the units of channels, which are the last axis.
    """
    if np.all(unit == 1.0):
        return values
    fits = all(map(fits_single, np.atleast_1d(unit)))
    return np.asarray(values * np.asarray(unit, values.dtype if fits else np.float64)[()])


def before(background: np.ndarray, emission: np.ndarray, through: np.ndarray) -> np.ndarray:
    """Return the intensity before a background, in double precision if single may not hold it."""
    total: np.ndarray = emission + through * background
    fits = fits_single(float(np.max(np.abs(background))))
    return total.astype(emission.dtype) if fits else total


def channels_last(planes: Sequence[np.ndarray]) -> np.ndarray:
    """Stack planes along a last axis.

    One assignment each: 1 ms for three of 800 × 800, where `numpy.stack` takes 4.
    """
    if len(planes) == 1:
        return planes[0][..., None]
    result = np.empty((*planes[0].shape, len(planes)), planes[0].dtype)
    for c, plane in enumerate(planes):
        result[..., c] = plane
    return result


# Maximum number of channels in a kernel with error control, because compiling takes longer, and
# where there is a table in memory.
_FEW_TOGETHER = 5


def channel_groups(channels: int, scheme: Scheme | None = None) -> list[slice]:
    """Return the groups in which channels are drawn, all of one size, so that they share a kernel.

    The last ones may overlap.
    """
    few = scheme is not None and (scheme.controlled or scheme.coefficients_at == "vertex")
    count = math.ceil(channels / (_FEW_TOGETHER if few else MOST_TOGETHER))
    size = math.ceil(channels / count)
    firsts = (min(k * size, channels - size) for k in range(count))
    return [slice(first, first + size) for first in firsts]


@dataclass
class PerChannel:
    """Emissivity per channel and extinction, as the medium gives them.

    Attributes
    ----------
    emissions, extinctions, count : int
        Number of integrated emissions and extinctions, and of values per place.
    unit : float array, shape (channel,)
        The emission that counts as one in kernels, a power of two: emissivities in some systems of
        units are below the range of single precision. Equal for the colours of one picture.
    weights : list of arrays
        Factors on the brightness of channels, as run-time numbers: the inverse of each one's
        maximum, for the error relative to it. Empty for the colours of one picture.
    peaks : float array, shape (channel,)
        These maxima, in units of channels.
    """

    medium: Medium
    binding: Binding
    weights: list[Float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.emissions = len(range(self.medium.channels)[self.binding.channels])
        self.extinctions = 1 if self.medium.grey else self.emissions
        self.count = self.emissions + self.extinctions
        self.spectral = self.medium.channels > 1 and self.medium.spectral
        self.peaks = np.ones(self.emissions)
        self.bind(np.ones(1))

    def bind(self, unit: np.ndarray) -> None:
        """Take the units of channels."""
        self.unit = np.broadcast_to(unit, self.emissions)
        radiance: Any = self.unit if self.spectral else float(self.unit[0])
        self.binding = replace(self.binding, radiance=radiance)
        self.bound: BoundMedium = self.medium.bind(self.binding)

    def group(self, channels: slice) -> PerChannel:
        """Return the layout of some channels."""
        part = PerChannel(self.medium, replace(self.binding, channels=channels))
        part.bind(self.unit[channels])
        part.weights = self.weights[channels]
        return part

    @property
    def error_unit(self) -> float:
        """The intensity, in the brightest channel, that counts as one in errors."""
        return float(np.max(self.unit * self.peaks))

    @property
    def faintest_unit(self) -> float:
        """The intensity, in the faintest channel, that counts as one in errors."""
        return float(np.min(self.unit * self.peaks))

    @property
    def heaviest(self) -> float:
        """The largest weight."""
        return float(np.max(1.0 / self.peaks))

    def weigh(self, peaks: np.ndarray, opaque: Callable[[float], Float]) -> float:
        """Set the weights of a spectrum's channels; return by how much they grow at most.

        A channel without a maximum has the least one of the others.
        """
        some = peaks[peaks > 0.0]
        least: Any = _LEAST_PEAK
        if self.medium.thermal:  # intensities are at most one, emission per cell at most the unit
            least = _FAINT_CHANNEL * np.minimum(1.0, 1.0 / self.unit)
        peaks = np.where(peaks > 0.0, np.maximum(peaks, least), some.min(initial=1.0))
        growth = float(np.max(self.peaks[peaks > 0.0] / peaks[peaks > 0.0]))
        self.peaks, self.weights = peaks, [opaque(1.0 / peak) for peak in peaks]
        return growth

    @property
    def signed(self) -> int:
        """Number of values that may be negative: the first ones."""
        return self.emissions

    def table_values(self, fields: dict[str, Float], context: Context) -> list[Float]:
        """Return the values of tables."""
        return self.values(fields, context)

    def key(self) -> Hashable:
        """Return the key of everything that the values depend on, besides the fields."""
        key: Hashable = self.medium.key()
        return key

    def values(self, fields: dict[str, Any], context: Context) -> list[Any]:
        """Return the values; or intervals that hold them, while the fields stay in theirs."""
        with context.requests_of("coefficients"):
            return self.bound.coefficients(fields, context).listed()

    def means(self, panel: Panel) -> list[Float]:
        """Return the means of the values over a panel of a ray."""
        return self.bound.mean(panel).listed()

    def integrate(self, panel: Panel) -> tuple[list[Float], ...]:
        """Return the means over both halves of a panel, and their errors."""
        found = self.bound.halves(panel)
        return found.first.listed(), found.last.listed(), found.error.listed()

    def split(self, values: list[Float]) -> Coefficients:
        """Return j and α from the values (traced in the loop)."""
        return values[: self.emissions], values[self.emissions :]

    def brightness(self, emission: list[Float]) -> Float:
        """Return the magnitude of the brightest channel, relative to its maximum if it has one."""
        return most(self.bright(emission))

    def seen(self, factors: list[Float]) -> PerChannel:
        """Return the layout for errors, with a factor on the brightness of each channel."""
        part = copy.copy(self)
        pairs = zip(self.weights, factors, strict=True) if self.weights else ()
        part.weights = [w * f for w, f in pairs] or factors
        return part

    def shares(self, solved: Sequence[Path], panel: Panel) -> list[list[list[tuple[Float, Float]]]]:
        """Return brightness and optical depth of each part on both halves, per extinction."""
        parts = self.bound.parts
        if len(parts) == 1:
            if self.extinctions == 1:
                return [[[(path.error[2], path.depth[0])]] for path in solved]
            return [
                [list(zip(self.bright(path.emission), path.depth, strict=True))] for path in solved
            ]
        found, length = [integrated(part, panel) for part in parts], 0.5 * panel.length
        return [
            [self._share(getattr(one, name), length) for one in found] for name in ("first", "last")
        ]

    def _share(self, means: MediumSample, length: Float) -> list[tuple[Float, Float]]:
        depths = [a * length for a in means.extinction]
        if self.extinctions == 1:
            bright = [self.brightness(means.emissivity)]
        else:
            bright = self.bright(means.emissivity)
            depths = depths if len(depths) > 1 else depths * len(bright)
        rows = zip(bright, depths, strict=True)
        return [(b * length * any_attenuation(depth)[1], depth) for b, depth in rows]

    def bright(self, emission: list[Float]) -> list[Float]:
        """Return the magnitude of each channel, relative to its maximum if it has one."""
        size = [dr.abs(b) for b in emission]
        return [w * b for w, b in zip(self.weights, size, strict=True)] if self.weights else size

    def mix(self, emission: list[np.ndarray]) -> np.ndarray:
        """Return the intensity (…, channel) from the integrated emissions."""
        return in_units_of(self.unit, channels_last(emission))

    def brightest_channel(self, emission: list[np.ndarray]) -> np.ndarray:
        """Return the magnitude in the brightest channel, in the kernel's unit."""
        return functools.reduce(np.maximum, map(np.abs, emission))

    def maxima(
        self, emission: list[np.ndarray], through: list[np.ndarray], background: float
    ) -> np.ndarray:
        """Return the largest magnitude of each channel before a background, in its unit."""
        every = through if len(through) > 1 else through * self.emissions
        rows = zip(emission, every, background / self.unit, strict=True)
        return np.array([float(np.max(np.abs(b) + t * own, initial=0.0)) for b, t, own in rows])

    def normalise(self, largest: list[float]) -> None:
        """Choose the units, given bounds of the numbers."""
        sizes = largest[: self.emissions] if self.spectral else [self.brightest(largest)]
        units = [unit_near(size if size < np.inf else self._color()) for size in sizes]
        self.bind(np.array(units))

    def in_units(self, largest: list[float]) -> list[float]:
        """Return bounds of the numbers in the kernel's unit."""
        k = self.emissions
        bright = [float(v / u) for v, u in zip(largest[:k], self.unit, strict=True)]
        return [*bright, *largest[k:]]

    def reuse(self, earlier: ChannelLayout) -> ChannelLayout:
        """Return the layout for a table that was made with an earlier layout of an equal key."""
        return earlier

    def brightest(self, largest: list[float]) -> float:
        """Return a bound of the emissivity of any channel, from the largest values."""
        return max(largest[: self.emissions])

    def densest(self, largest: list[Any]) -> Any:
        """Return a bound of the extinction, from the largest values; 0 if none is finite."""
        densest = functools.reduce(np.maximum, largest[self.emissions :])
        return np.where(np.isfinite(densest), densest, 0.0)

    def one_path(self) -> tuple[float, float]:
        """Return brightness and optical depth of one path length of the extreme parts, or zero."""
        depth = max(part.strongest()[1] for part in self.medium.components())
        return self._color() / float(np.min(self.unit)), depth

    def _color(self) -> float:
        return max(part.strongest()[0] for part in self.medium.components())

    def paths(self, largest: list[float]) -> float:
        """Return the number of path lengths per unit length; zero if it cannot be determined."""
        color, bright = self._color(), self.brightest(largest)
        return bright / color if color > 0.0 and bright < np.inf else 0.0

    def behind(self, emission: list[float], background: float) -> list[float]:
        """Return bounds of the intensity from behind: of each channel, or of all colours."""
        total = np.array(emission[: self.emissions]) + background / self.unit
        return total.tolist() if self.spectral else [float(np.max(total))]

    def shares_of_brightest(self) -> np.ndarray:
        """Return weights of emissions whose sum is at most the brightest channel's intensity."""
        return np.full(self.emissions, 1.0 / self.emissions)


def some_channels(numbers: ChannelLayout, values: list[float], channels: slice) -> list[float]:
    """Return those of a layout's numbers that belong to some channels."""
    k = numbers.emissions
    extinctions = values[k:] if numbers.extinctions == 1 else values[k:][channels]
    return [*values[channels], *extinctions]


@dataclass
class SharedProfiles:
    """Shapes of a grey medium that is their sum; the methods are those of `PerChannel`.

    Attributes
    ----------
    bound : BoundMedium
        The media added.
    color : float array, shape (channel, part)
        Emission of each part in each channel, in the unit.
    opacity, peak : list
        Extinction of each part, and its emission in its brightest channel, as run-time numbers.
    """

    bound: BoundMedium
    color: np.ndarray
    opacity: list[Float]
    peak: list[Float]
    unit: float = 1.0
    extinctions: ClassVar[int] = 1
    spectral: ClassVar[bool] = False
    weights: ClassVar[list[Float]] = []
    heaviest: ClassVar[float] = 1.0
    peaks: ClassVar[np.ndarray] = np.ones(1)

    def __post_init__(self) -> None:
        self.parts: Any = self.bound.parts
        self.emissions = self.count = len(self.parts)
        self.error_unit = self.faintest_unit = self.unit

    @property
    def signed(self) -> int:
        return self.emissions

    def table_values(self, fields: dict[str, Float], context: Context) -> list[Float]:
        return self.values(fields, context)

    def key(self) -> Hashable:
        # Tables do not contain colours and opacities, which may differ.
        return tuple(part.form.shape_key() for part in self.parts)

    def values(self, fields: dict[str, Any], context: Context) -> list[Any]:
        return [part.shape(fields, context) for part in self.parts]

    def means(self, panel: Panel) -> list[Float]:
        return [part.mean_shape(panel) for part in self.parts]

    def integrate(self, panel: Panel) -> tuple[list[Float], ...]:
        found = (part.half_shapes(panel) for part in self.parts)
        first, last, error = (list(values) for values in zip(*found, strict=True))
        return first, last, error

    def split(self, values: list[Float]) -> Coefficients:
        alpha = self.opacity[0] * values[0]
        for h, value in zip(self.opacity[1:], values[1:], strict=True):
            alpha = dr.fma(h, value, alpha)
        return list(values), [alpha]

    def brightness(self, emission: list[Float]) -> Float:
        total = dr.abs(emission[0]) * self.peak[0]
        for b, weight in zip(emission[1:], self.peak[1:], strict=True):
            total = dr.fma(dr.abs(b), weight, total)
        return total

    def shares(self, solved: Sequence[Path], panel: Panel) -> list[list[list[tuple[Float, Float]]]]:
        return [self._shares(path) for path in solved]

    def _shares(self, path: Path) -> list[list[tuple[Float, Float]]]:
        (depth,), (theta,) = path.depth, path.transparency
        dimmed = dr.select(depth > 0.0, (1.0 - theta) / dr.select(depth > 0.0, depth, 1.0), 1.0)
        thin = 1.0 / dr.select(dimmed > 0.0, dimmed, 1.0)
        return [
            [(dr.abs(b) * peak, dr.abs(b) * thin * opacity)]
            for b, peak, opacity in zip(path.emission, self.peak, self.opacity, strict=True)
        ]

    def mix(self, emission: list[np.ndarray]) -> np.ndarray:
        # The unit is a power of two, so multiplying the colours by it is exact.
        fits = fits_single(self.unit)
        mixed = self._mixed(emission, self.color * self.unit if fits else self.color)
        mixed = np.moveaxis(mixed, 0, -1)
        return mixed if fits else in_units_of(self.unit, mixed)

    def _mixed(self, emission: list[np.ndarray], color: np.ndarray) -> np.ndarray:
        """Return channels, (channel, …): 0.2 ms for 400 × 400 pixels; pixel by pixel 0.4."""
        heights = color.T.astype(emission[0].dtype).reshape(
            len(self.parts), -1, *(1,) * emission[0].ndim
        )
        mixed = heights[0] * emission[0]
        for height, values in zip(heights[1:], emission[1:], strict=True):
            mixed += height * values
        return np.asarray(mixed)

    def brightest_channel(self, emission: list[np.ndarray]) -> np.ndarray:
        return np.asarray(np.abs(self._mixed(emission, self.color)).max(axis=0))

    def normalise(self, largest: list[float]) -> None:
        """Do nothing: shapes are near one, and colours already have a unit."""

    def in_units(self, largest: list[float]) -> list[float]:
        return largest

    def reuse(self, earlier: ChannelLayout) -> ChannelLayout:
        return self

    def brightest(self, largest: list[float]) -> float:
        return float(np.max(np.abs(self.color) @ np.asarray(largest)))

    def densest(self, largest: list[Any]) -> Any:
        return sum(p.opacity[0] * v for p, v in zip(self.parts, largest, strict=True))

    def one_path(self) -> tuple[float, float]:
        depth = float(max(abs(part.opacity[0]) for part in self.parts))
        return float(np.max(np.abs(self.color))), depth

    def paths(self, largest: list[float]) -> float:
        return float(np.max(largest))

    def behind(self, emission: list[float], background: float) -> list[float]:
        return [self.brightest(emission) + background / self.unit]

    def shares_of_brightest(self) -> np.ndarray:
        return np.asarray(self.color.mean(axis=0))


ChannelLayout: TypeAlias = PerChannel | SharedProfiles


def choose_layout(
    medium: Medium, scheme: Scheme, backend: Backend, binding: Binding
) -> ChannelLayout:
    """Return the layout of a medium's numbers: shapes where that is possible and fewer."""
    if scheme.layout is not None:
        return scheme.layout(medium, backend, binding)  # type: ignore[no-any-return]
    parts = tuple(part for part in medium.components() if isinstance(part, Shaped) and part.mixes)
    mixed = len(parts) < len(medium.components())
    # Of shared profiles colours and opacities are no numbers of kernels.
    if backend.derivatives or mixed or not scheme.linear or len(parts) > medium.channels:
        return PerChannel(medium, binding)
    color = np.array([part.color for part in parts], dtype=np.float64).T
    unit = unit_near(float(np.max(np.abs(color))))
    color /= unit
    peak = [backend.opaque(most) for most in np.max(np.abs(color), axis=0)]
    opacity = [backend.opaque(part.opacity[0]) for part in parts]
    return SharedProfiles(medium.bind(binding), color, opacity, peak, unit)
