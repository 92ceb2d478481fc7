"""The channels of a picture: their units in kernels, their tables, and how their errors count."""

from __future__ import annotations

import copy
import functools
import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.types import Float
from .path import most

if TYPE_CHECKING:
    from ..media.bound import Binding
    from ..media.context import Context, MediumSample
    from ..media.contract import Medium
    from ..media.panel import Panel
    from .base import JAlpha, Scheme

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


# Maximum number of channels in a kernel. Drawing all 100 of a spectrum at once took as long, with
# ten times the memory, and up to 15 times as long to compile.
MOST_TOGETHER = 16
# The same with error control, because compiling takes longer, and where there is a table in memory.
_FEW_TOGETHER = 5


def channel_groups(
    medium: Medium, scheme: Scheme | None = None, count: int | None = None
) -> list[slice]:
    """Return the groups in which channels are drawn, all of one size, so that they share a kernel.

    The last ones may overlap. Of `count` channels, or all of the medium.
    """
    from .base import is_controlled

    few = scheme is not None and (is_controlled(scheme) or scheme.coefficients_at == "vertex")
    few = few and not ColouredShapes.serve(medium)  # more colours of a shape take no longer
    channels = count or medium.channels
    count = math.ceil(channels / (_FEW_TOGETHER if few else MOST_TOGETHER))
    size = math.ceil(channels / count)
    firsts = (min(k * size, channels - size) for k in range(count))
    return [slice(first, first + size) for first in firsts]


class Channels:
    """Emission per channel and extinction, in the units of kernels.

    Attributes
    ----------
    emissions, extinctions : int
        Number of channels, and of extinctions: one if the medium is grey.
    spectral : bool
        Each channel is a picture of its own, with its own unit and tolerance.
    unit : float array, shape (channel,)
        The emission that counts as one in kernels, a power of two: emissivities in some systems of
        units are below the range of single precision. Equal for the colours of one picture.
    bound : BoundMedium
        The medium in these units.
    scalars : tuple of Expression
        Those that panels interpolate.
    constant : list of bool
        Which components of the medium have one source function everywhere.
    surfaces : list of bool
        Which consist of surfaces without width.
    looks_inside : bool
        Means evaluate fields between a panel's ends.
    jumps : list of Jump
        Where panels end.
    peaks : float array, shape (channel,)
        The brightness to which errors of each channel are relative, in its unit.
    count : int
        Number of values per place in tables.
    signed : int
        Number of these that may be negative: the first ones.
    """

    def __init__(self, medium: Medium, binding: Binding) -> None:
        self.medium, self.emissions = medium, len(range(medium.channels)[binding.channels])
        self.extinctions = 1 if medium.grey else self.emissions
        self.count = self.emissions + self.extinctions
        self.signed = self.emissions
        self.spectral = medium.channels > 1 and medium.spectral
        self.unit = self.peaks = np.ones(self.emissions)
        # Asked for while kernels are traced.
        self.scalars = medium.scalars()
        self.constant = [part.constant_source_function for part in medium.components()]
        self.surfaces = [part.surface_only for part in medium.components()]
        self.looks_inside = medium.looks_inside
        self.binding, self.bound = binding, medium.bind(binding)
        self.jumps = self.bound.jumps()

    def in_unit(self, unit: Any) -> Channels:
        """Return the channels in other units of emission."""
        part = copy.copy(self)
        part.unit = np.broadcast_to(unit, self.emissions)
        part.binding = replace(self.binding, radiance=self._radiance(part.unit))
        part.bound = self.medium.bind(part.binding)
        return part

    def _radiance(self, unit: np.ndarray) -> Any:
        return unit if self.spectral else float(unit[0])

    def group(self, channels: slice) -> Channels:
        """Return some of the channels, which are drawn together."""
        unit = self.unit[channels]
        binding = replace(self.binding, channels=channels, radiance=self._radiance(unit))
        part = Channels(self.medium, binding)
        part.unit, part.peaks = unit, self.peaks[channels]
        return part

    def groups(self, scheme: Scheme) -> list[slice]:
        """Return the groups of channels that are drawn together."""
        return channel_groups(self.medium, scheme, self.emissions)

    # --- how errors count -----------------------------------------------------------------------

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
        """The largest weight of a channel in errors."""
        return float(np.max(1.0 / self.peaks))

    def weigh(self, peaks: np.ndarray) -> float:
        """Set the peaks of a spectrum's channels; return by how much weights grow at most.

        A channel without a maximum has the least one of the others.
        """
        some = peaks[peaks > 0.0]
        least: Any = _LEAST_PEAK
        if self.medium.thermal:  # intensities are at most one, emission per cell at most the unit
            least = _FAINT_CHANNEL * np.minimum(1.0, 1.0 / self.unit)
        peaks = np.where(peaks > 0.0, np.maximum(peaks, least), some.min(initial=1.0))
        growth = float(np.max(self.peaks[peaks > 0.0] / peaks[peaks > 0.0]))
        self.peaks = peaks
        return growth

    def maxima(
        self, emission: list[np.ndarray], through: list[np.ndarray], background: float
    ) -> np.ndarray:
        """Return the largest magnitude of each channel before a background, in its unit."""
        every = through if len(through) > 1 else through * self.emissions
        rows = zip(emission, every, background / self.unit, strict=True)
        return np.array([float(np.max(np.abs(b) + t * own, initial=0.0)) for b, t, own in rows])

    # --- places: values in tables, and coefficients of them -------------------------------------

    def key(self) -> Hashable:
        """Return the key of everything that the values depend on, besides the fields."""
        key: Hashable = self.medium.key()
        return key

    def table_values(self, fields: dict[str, Float], context: Context) -> list[Float]:
        """Return the values of a table at places: here coefficients."""
        with context.requests_of("coefficients"):
            return self.bound.coefficients(fields, context).listed()

    def split(self, values: list[Float]) -> JAlpha:
        """Return j and α from the values of a table (traced in the loop)."""
        return values[: self.emissions], values[self.emissions :]

    def largest(self, values: list[float]) -> list[float]:
        """Return bounds of j and α, given the largest values of a table."""
        return values

    def reuse(self, earlier: Channels) -> Channels:
        """Return the channels of a table that was made with earlier ones of an equal key."""
        return earlier

    # --- panels ---------------------------------------------------------------------------------

    def means(self, panel: Panel) -> JAlpha:
        """Return mean j and α over a panel, per length of the grid's scale."""
        return _usable(self.bound.mean(panel))

    def integrate(self, panel: Panel) -> list[JAlpha]:
        """Return mean j and α over both halves of a panel, and the errors of those over it."""
        found = self.bound.halves(panel)
        error = found.error.emissivity, found.error.extinction
        return [_usable(found.first), _usable(found.last), error]

    # --- bounds ---------------------------------------------------------------------------------

    def normalised(self, largest: list[float]) -> Channels:
        """Return the channels with units chosen by bounds of j and α."""
        sizes = largest[: self.emissions] if self.spectral else [self.brightest(largest)]
        units = [unit_near(size if size < np.inf else self._color()) for size in sizes]
        return self.in_unit(units)

    def in_units(self, largest: list[float]) -> list[float]:
        """Return bounds of j and α in the kernel's unit."""
        k = self.emissions
        bright = [float(v / u) for v, u in zip(largest[:k], self.unit, strict=True)]
        return [*bright, *largest[k:]]

    def some_of(self, values: list[float], channels: slice) -> list[float]:
        """Return the bounds of j and α that belong to some channels."""
        extinctions = values[self.emissions :]
        return values[channels] + (extinctions[channels] if self.extinctions > 1 else extinctions)

    def brightest(self, largest: list[float]) -> float:
        """Return a bound of the emissivity of any channel."""
        return max(largest[: self.emissions])

    def densest(self, largest: list[Any]) -> Any:
        """Return a bound of the extinction; 0 if none is finite."""
        densest = functools.reduce(np.maximum, largest[self.emissions :])
        return np.where(np.isfinite(densest), densest, 0.0)

    def behind(self, emission: list[float], background: float) -> list[float]:
        """Return bounds of the intensity from behind: of each channel, or of all colours."""
        total = np.array(emission[: self.emissions]) + background / self.unit
        return total.tolist() if self.spectral else [float(np.max(total))]

    def one_path(self) -> tuple[float, float]:
        """Return brightness and optical depth of one path length of the extreme parts, or zero."""
        depth = max(depth for _, _, depth in self._peaks())
        return self._color() / float(np.min(self.unit)), depth

    def _color(self) -> float:
        return max(max(-least, most) for least, most, _ in self._peaks())

    def _peaks(self) -> list[tuple[float, float, float]]:
        return [part.peak() or (0.0, 0.0, 0.0) for part in self.medium.components()]

    def paths(self, largest: list[float]) -> float:
        """Return the number of path lengths per unit length; zero if it cannot be determined."""
        color, bright = self._color(), self.brightest(largest)
        return bright / color if color > 0.0 and bright < np.inf else 0.0

    # --- pictures -------------------------------------------------------------------------------

    def intensity(self, emission: list[np.ndarray]) -> np.ndarray:
        return in_units_of(self.unit, channels_last(emission))


def _usable(sample: MediumSample) -> JAlpha:
    # Unphysical values become NaN and reach the picture, which is checked afterwards.
    return sample.emissivity, [dr.select(a >= 0.0, a, math.nan) for a in sample.extinction]


class ColouredShapes(Channels):
    """Channels of a grey sum of fewer shapes than channels: tables hold the shapes alone.

    One Gaussian in three colours takes a fourth of the memory, and 0.75 of the time; a table serves
    all colours.
    """

    def __init__(self, medium: Medium, binding: Binding, context: Context) -> None:
        super().__init__(medium, binding)
        shapes: Any = self.bound.parts
        self.shapes, self.count = shapes, len(shapes)
        self.signed = self.count
        color = np.array([shape.color for shape in shapes], dtype=np.float64)
        self.unit = np.broadcast_to(unit_near(float(np.max(np.abs(color)))), self.emissions)
        self.color = color / self.unit
        with context.requests_of("colors"):
            self.rows = [[context.number(c) for c in row] for row in self.color.T.tolist()]
            self.dense = [context.number(shape.opacity[0]) for shape in shapes]

    @staticmethod
    def serve(medium: Medium) -> bool:
        """Return whether a medium is such a sum."""
        parts = medium.components()
        mixed = all(getattr(part, "mixes", False) for part in parts)
        return mixed and len(parts) <= medium.channels

    def key(self) -> Hashable:
        return tuple(shape.form.shape_key() for shape in self.shapes)

    def table_values(self, fields: dict[str, Float], context: Context) -> list[Float]:
        with context.requests_of("coefficients"):
            return [shape.shape(fields, context) for shape in self.shapes]

    def split(self, values: list[Float]) -> JAlpha:
        return [_dot(row, values) for row in self.rows], [_dot(self.dense, values)]

    def largest(self, values: list[float]) -> list[float]:
        dense = sum(abs(s.opacity[0]) * v for s, v in zip(self.shapes, values, strict=True))
        return [*(np.abs(self.color.T) @ np.asarray(values)).tolist(), dense]

    def normalised(self, largest: list[float]) -> Channels:
        return self  # shapes are near one, and colours already have a unit

    def reuse(self, earlier: Channels) -> Channels:
        return self


def _dot(factors: list[Float], values: list[Float]) -> Float:
    total = factors[0] * values[0]
    for factor, value in zip(factors[1:], values[1:], strict=True):
        total = dr.fma(factor, value, total)
    return total


@dataclass
class Tolerance:
    """The errors allowed in a segment, as it is seen from the observer, as run-time numbers.

    Attributes
    ----------
    emission, transparency : array
    weights : list of arrays
        Factors on the brightness of a spectrum's channels, for errors relative to each one's peak.
        Empty for the colours of one picture.
    """

    emission: Float
    transparency: Float
    weights: list[Float]

    def seen(self, factors: list[Float]) -> Tolerance:
        pairs = zip(self.weights, factors, strict=True) if self.weights else ()
        return replace(self, weights=[w * f for w, f in pairs] or factors)

    def bright(self, emission: list[Float]) -> list[Float]:
        """Return the magnitude of each channel, relative to its peak if it has one."""
        size = [dr.abs(b) for b in emission]
        return [w * b for w, b in zip(self.weights, size, strict=True)] if self.weights else size

    def brightness(self, emission: list[Float]) -> Float:
        """Return the magnitude of the brightest channel, relative to its peak if it has one."""
        return most(self.bright(emission))
