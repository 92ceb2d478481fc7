"""Numbers of a grey medium made of shapes: the shapes alone, of which all channels are mixed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...backend import dr
from ...expressions.interval import Interval
from ...media.context import Context
from ...media.ranges import RangeContext
from ...media.stretch import Panel, Stretch
from ...schemes.path import Path
from .emission_unit import fits_single, in_units_of


@dataclass
class Shapes:
    """The shapes of a grey medium that is a sum of them.

    Attributes
    ----------
    parts : tuple of Shaped
        The media added.
    color : float array, shape (channel, part)
        Emission of each part in each channel, in the unit.
    opacity, peak : list
        Extinction of each part, and its emission in its brightest channel, as run-time numbers.
    unit : float
        The emission that counts as one in kernels, where brightnesses are compared.
    """

    parts: tuple[Any, ...]
    color: np.ndarray
    opacity: list[Any]
    peak: list[Any]
    unit: float = 1.0

    @property
    def emissions(self) -> int:
        """Number of emissions that the loop integrates."""
        return len(self.parts)

    extinctions = 1

    @property
    def count(self) -> int:
        """Number of values per place."""
        return len(self.parts)

    def key(self) -> Any:
        """Return what the values depend on, besides the fields: neither colours nor opacities."""
        return tuple(part.shape_key() for part in self.parts)

    def values(self, fields: dict[str, Any], context: Context) -> list[Any]:
        """Return the shapes per path length."""
        return [part.per_length(fields, context) for part in self.parts]

    def means(self, panel: Panel, context: Context) -> list[Any]:
        """Return the means of the shapes over a panel of a ray."""
        return [part.mean_per_length(panel, context) for part in self.parts]

    def sampled(self, stretch: Stretch, context: Context, *, fine: bool) -> list[list[Any]]:
        """Return mean, first and last shapes of a stretch, and how far the means may be off."""
        found = [part.sampled_per_length(stretch, context, fine=fine) for part in self.parts]
        return [list(own) for own in zip(*found, strict=True)]

    def brightness(self, emission: list[Any]) -> Any:
        """Return a bound of the magnitude of the brightest channel."""
        total = dr.abs(emission[0]) * self.peak[0]
        for b, weight in zip(emission[1:], self.peak[1:], strict=True):
            total = dr.fma(dr.abs(b), weight, total)
        return total

    def ranges(self, fields: dict[str, Interval], context: RangeContext) -> list[Interval]:
        """Return what encloses the values while the fields stay in ranges."""
        return [part.per_length(fields, context) for part in self.parts]

    def normalise(self, largest: list[float]) -> None:
        """Do nothing: shapes are near one, and colours have a unit already."""

    def in_units(self, largest: list[float]) -> list[float]:
        """Return bounds of the numbers as they are in kernels: the same."""
        return largest

    def reuse(self, earlier: Shapes) -> Shapes:
        """Return these: colours and opacities are not in the table, they may have been turned."""
        return self

    def inputs(self) -> Any:
        return self.opacity, self.peak

    def split(self, values: list[Any]) -> tuple[list[Any], list[Any]]:
        """Return j and α from the values (traced in the loop)."""
        alpha = self.opacity[0] * values[0]
        for h, value in zip(self.opacity[1:], values[1:], strict=True):
            alpha = dr.fma(h, value, alpha)
        return list(values), [alpha]

    def mix(self, emission: list[np.ndarray]) -> np.ndarray:
        """Return the intensity (…, channel) from what the loop integrated."""
        # The unit is a power of two: no bits change if it is in the colours already.
        fits = fits_single(self.unit)
        color = self.color * self.unit if fits else self.color
        # Channel by channel in memory: 0.2 ms for 400 × 400 pixels, pixel by pixel 0.4.
        mixed = np.empty((len(color), *emission[0].shape), emission[0].dtype)
        for c, row in enumerate(color):
            _mix(emission, row, mixed[c, ...])  # an array, also of one number
        mixed = np.moveaxis(mixed, 0, -1)
        return mixed if fits else in_units_of(self.unit, mixed)

    def brightest_channel(self, emission: list[np.ndarray]) -> np.ndarray:
        """Return the magnitude in the brightest channel, in the kernel's unit."""
        most, plane = np.zeros_like(emission[0]), np.empty_like(emission[0])
        for row in self.color:
            _mix(emission, row, plane)
            np.maximum(most, np.abs(plane, out=plane), out=most)
        return most

    def densest(self, largest: list[Any]) -> Any:
        """Return a bound of the extinction, from the largest values."""
        return sum(p.opacity[0] * v for p, v in zip(self.parts, largest, strict=True))

    def one_path(self) -> float:
        """Return how bright one path length of the brightest part is."""
        return float(np.max(np.abs(self.color)))

    def one_depth(self) -> float:
        """Return the optical depth of one path length of the densest part."""
        return float(max(abs(part.opacity[0]) for part in self.parts))

    def paths(self, largest: list[float]) -> float:
        """Return how many path lengths go into a length of one."""
        return float(np.max(largest))

    def shares(self, path: Path, panel: Panel, context: Context) -> list[tuple[Any, Any]]:
        """Return the brightness and the optical depth of each shape on a panel that was solved."""
        (depth,), (theta,) = path.depth, path.transparency
        dimmed = dr.select(depth > 0.0, (1.0 - theta) / dr.select(depth > 0.0, depth, 1.0), 1.0)
        thin = 1.0 / dr.select(dimmed > 0.0, dimmed, 1.0)
        return [
            (dr.abs(b) * peak, dr.abs(b) * thin * opacity)
            for b, peak, opacity in zip(path.emission, self.peak, self.opacity, strict=True)
        ]

    def weights(self) -> np.ndarray:
        """Return weights of emissions whose sum is at most the brightest channel's intensity."""
        return self.color.mean(axis=0)

    def brightest(self, largest: list[float]) -> float:
        """Return a bound of the emissivity of any channel, from the largest values."""
        return float(np.max(np.abs(self.color) @ np.asarray(largest)))


def _mix(emission: list[np.ndarray], heights: np.ndarray, out: np.ndarray) -> None:
    heights, part = heights.astype(out.dtype), np.empty_like(out)
    np.multiply(emission[0], heights[0], out=out)
    for values, height in zip(emission[1:], heights[1:], strict=True):
        out += np.multiply(values, height, out=part)
