"""Some of the channels of any medium, which are drawn together."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend.types import Float, Mask
from ..expressions import Expression
from ..expressions.interval import Interval
from .context import Context, Feature, Halves, MediumSample
from .contract import Medium

if TYPE_CHECKING:
    from .jumps import Jump
    from .panel import Panel


class SomeChannels(Medium):
    """The channels of a medium from one up to another; kernels drop what the others need.

    Media whose channels are independent have a faster `Medium.group`.
    """

    def __init__(self, medium: Medium, first: int, last: int) -> None:
        self.medium, self.first, self.last = medium, first, last
        self.channels, self.grey = last - first, medium.grey
        self.names, self.discrete, self.sight = medium.names, medium.discrete, medium.sight
        self.thermal = medium.thermal
        self.path_length, self.sensitivity = medium.path_length, medium.sensitivity

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        return self._some(self.medium.coefficients(fields, context))

    def ranges(self, fields: dict[str, Interval], context: Context) -> MediumSample:
        return self._some(self.medium.ranges(fields, context))

    def means(self, panel: Panel, context: Context) -> MediumSample:
        return self._some(self.medium.means(panel, self._whole(context)))

    def integrate(self, panel: Panel, context: Context) -> Halves:
        found = self.medium.integrate(panel, self._whole(context))
        return Halves(*map(self._some, (found.first, found.last, found.error)))

    def layer(self, panel: Panel, context: Context, place: Float) -> MediumSample | None:
        sheet = self.medium.layer(panel, self._whole(context), place)
        return None if sheet is None else self._some(sheet)

    def _whole(self, context: Context) -> Context:
        if np.ndim(context.radiance) == 0:
            return context

        def make() -> Context:
            units = np.ones(self.medium.channels)
            units[self.first : self.last] = context.radiance
            return replace(context, radiance=units, _kept={})

        return context.keep((id(self), "whole"), make)

    def _some(self, sample: MediumSample) -> MediumSample:
        part, every = slice(self.first, self.last), slice(None)
        extinction = sample.extinction[every if self.grey else part]
        return MediumSample(sample.emissivity[part], extinction)

    def features(self) -> tuple[Feature, ...]:
        return self.medium.features()

    def scalars(self) -> tuple[Expression, ...]:
        return self.medium.scalars()

    def visible_in(self, fields: dict[str, Interval], context: Context) -> Mask:
        return self.medium.visible_in(fields, context)

    def visible(self, panel: Panel, context: Context) -> tuple[Mask, Mask]:
        return self.medium.visible(panel, self._whole(context))

    def jumps(self, context: Context) -> list[Jump]:
        return self.medium.jumps(self._whole(context))

    def emission_range(self) -> tuple[float, float] | None:
        return self.medium.emission_range()

    def strongest(self) -> tuple[float, float]:
        return self.medium.strongest()

    @property
    def looks_inside(self) -> bool:
        return self.medium.looks_inside

    @property
    def surface_only(self) -> bool:
        return self.medium.surface_only

    @property
    def constant_source_function(self) -> bool:
        return self.medium.constant_source_function

    def key(self) -> Any:
        key = self.medium.key()
        return None if key is None else ("SomeChannels", key, self.first, self.last)
