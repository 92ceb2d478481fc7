"""Numbers of any medium: j per channel, and one α or one per channel."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...backend import dr
from ...backend.functions import any_attenuation
from ...expressions.interval import Interval
from ...media.context import Context
from ...media.contract import Medium
from ...media.ranges import RangeContext
from ...media.stretch import Panel, Stretch
from ...schemes.path import Path, most
from .emission_unit import channels_last, in_units_of, unit_near


@dataclass
class Direct:
    """Emissivity per channel and extinction, as the medium gives them.

    Attributes
    ----------
    unit : float
        The emission that counts as one in kernels, a power of two: emissivities in some systems of
        units are below what single precision can hold.
    """

    medium: Medium
    unit: float = 1.0

    @property
    def emissions(self) -> int:
        """Number of emissions that the loop integrates."""
        return self.medium.channels

    @property
    def extinctions(self) -> int:
        """Number of extinctions."""
        return 1 if self.medium.grey else self.medium.channels

    @property
    def count(self) -> int:
        """Number of values per place."""
        return self.emissions + self.extinctions

    def key(self) -> Any:
        """Return what the values depend on, besides the fields."""
        return self.medium.key()

    def values(self, fields: dict[str, Any], context: Context) -> list[Any]:
        """Return the values per unit length."""
        found = self.medium.coefficients(fields, context)
        own = context.number(1.0 / self.unit)
        return [*(own * j for j in found.emissivity), *found.extinction]

    def means(self, panel: Panel, context: Context) -> list[Any]:
        """Return the means of the values over a panel of a ray."""
        return self.medium.means(panel, context).listed()

    def sampled(self, stretch: Stretch, context: Context, *, fine: bool) -> list[list[Any]]:
        """Return mean, first and last values of a stretch, and how far the means may be off."""
        return [own.listed() for own in self.medium.sampled(stretch, context, fine=fine)]

    def brightness(self, emission: list[Any]) -> Any:
        """Return the magnitude of the brightest channel."""
        return most([dr.abs(b) for b in emission])

    def ranges(self, fields: dict[str, Interval], context: RangeContext) -> list[Interval]:
        """Return what encloses the values while the fields stay in ranges."""
        found = self.medium.ranges(fields, context)
        own = 1.0 / self.unit
        return [*(own * j for j in found.emissivity), *found.extinction]

    def normalise(self, largest: list[float]) -> None:
        """Choose the unit by bounds of the numbers; where they have none, by the colours."""
        most = self.brightest(largest)
        self.unit = unit_near(most if most < np.inf else self._brightest_color())

    def in_units(self, largest: list[float]) -> list[float]:
        """Return bounds of the numbers as they are in kernels."""
        k = self.emissions
        return [*(value / self.unit for value in largest[:k]), *largest[k:]]

    def reuse(self, earlier: Direct) -> Direct:
        """Return what an earlier table of the same medium was made with."""
        return earlier

    def inputs(self) -> Any:
        return ()

    def split(self, values: list[Any]) -> tuple[list[Any], list[Any]]:
        """Return j and α from the values (traced in the loop)."""
        return values[: self.emissions], values[self.emissions :]

    def mix(self, emission: list[np.ndarray]) -> np.ndarray:
        """Return the intensity (…, channel) from what the loop integrated."""
        return in_units_of(self.unit, channels_last(emission))

    def brightest_channel(self, emission: list[np.ndarray]) -> np.ndarray:
        """Return the magnitude in the brightest channel, in the kernel's unit."""
        return functools.reduce(np.maximum, map(np.abs, emission))

    def densest(self, largest: list[Any]) -> Any:
        """Return a bound of the extinction, from the largest values; 0 if there is none."""
        most_of_all = functools.reduce(np.maximum, largest[self.emissions :])
        return np.where(np.isfinite(most_of_all), most_of_all, 0.0)

    def one_path(self) -> float:
        """Return how bright one path length of the brightest part is; zero where that has none."""
        return self._brightest_color() / self.unit

    def _brightest_color(self) -> float:
        return max(part.strongest()[0] for part in self.medium.components())

    def one_depth(self) -> float:
        """Return the optical depth of one path length of the densest part."""
        return max(part.strongest()[1] for part in self.medium.components())

    def paths(self, largest: list[float]) -> float:
        """Return how many path lengths go into a length of one; zero if that cannot be told."""
        one, most = self._brightest_color(), self.brightest(largest)
        return most / one if one > 0.0 and most < np.inf else 0.0

    def shares(self, path: Path, panel: Panel, context: Context) -> list[tuple[Any, Any]]:
        """Return the brightness and the optical depth of each part on a panel that was solved."""
        parts = self.medium.components()
        if len(parts) == 1:
            return [(path.error[2], most(path.depth))]
        found = []
        for part in parts:
            means = part.means(panel, context)
            bright = self.brightness(means.emissivity) * panel.length
            depth = most(means.extinction) * panel.length
            found.append((bright * any_attenuation(depth)[1], depth))
        return found

    def weights(self) -> np.ndarray:
        """Return weights of emissions whose sum is at most the brightest channel's intensity."""
        return np.full(self.emissions, 1.0 / self.emissions)

    def brightest(self, largest: list[float]) -> float:
        """Return a bound of the emissivity of any channel, from the largest values."""
        return max(largest[: self.emissions])
