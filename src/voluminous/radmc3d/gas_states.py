"""The state of the gas in place of j and α, for RADMC-3D's Doppler catching."""

from __future__ import annotations

import functools
from collections.abc import Hashable, Iterator

from ..backend import Backend, dr
from ..backend.types import Float
from ..media.context import Context, no_unit
from ..media.contract import Medium
from ..rendering.sources.channel_layout import PerChannel
from ..schemes.base import Coefficients
from ..spectral.lines import Lines


class GasStates(PerChannel):
    """The state of the gas for lines, and j and α of all else, in place of coefficients.

    A table of it has `count` numbers per place, of which coefficients are made along the ray.

    Attributes
    ----------
    context : Context
        With which these are evaluated.
    scale : float
        The grid's.
    """

    context: Context
    scale: float

    def __post_init__(self) -> None:
        super().__post_init__()
        parts = self.medium.components()
        self.lines = [part for part in parts if isinstance(part, Lines)]
        self.others = [part for part in parts if not isinstance(part, Lines)]
        self.count = sum(part.state_count for part in self.lines)
        self.count += 2 * self.emissions * bool(self.others)

    @property
    def signed(self) -> int:
        return self.count

    @classmethod
    def on(cls, medium: Medium, backend: Backend, scale: float) -> GasStates:
        """Return it for a device, a precision, and the scale of a grid."""
        states, real = cls(medium), backend.Float
        number = functools.partial(dr.opaque, real)
        states.context, states.scale = Context(real, number, None, no_unit), scale
        return states

    def group(self, channels: slice) -> PerChannel:
        part = GasStates(self.medium.group(channels.start, channels.stop), self.unit[channels])
        part.spectral, part.context, part.scale = self.spectral, self.context, self.scale
        return part

    def key(self) -> Hashable:
        key = self.medium.key()
        return None if key is None else ("states", key)

    def table_values(self, fields: dict[str, Float], context: Context, scale: Float) -> list[Float]:
        found = [v for part in self.lines for v in part.states(fields, context)]
        if self.others:
            samples = [part.coefficients(fields, context) for part in self.others]
            for rows in ([s.emissivity for s in samples], [s.extinction for s in samples]):
                sums = (sum(own[1:], own[0]) for own in zip(*rows, strict=True))
                found += [v * scale for v in sums]
        return found

    def split(self, values: list[Float], channel: int | None = None) -> Coefficients:
        """Return j and α per unit of the scale from the state of the gas, of one channel or all."""
        chosen = list(range(self.emissions)) if channel is None else [channel]
        zero, scale = values[0] * 0.0, self.context.kept_number(self.scale)
        j, alpha = [zero for _ in chosen], [zero for _ in chosen]
        for part, own in self._of_lines():
            sample = part.from_states(values[own], chosen, self.context)
            j = [dr.fma(scale, a, b) for a, b in zip(sample.emissivity, j, strict=True)]
            alpha = [dr.fma(scale, a, b) for a, b in zip(sample.extinction, alpha, strict=True)]
        if self.others:
            k = self.emissions
            first = len(values) - 2 * k
            j = [values[first + c] + v for c, v in zip(chosen, j, strict=True)]
            alpha = [values[first + k + c] + v for c, v in zip(chosen, alpha, strict=True)]
        # In units of channels, as tables of coefficients.
        units = [self.context.kept_number(1.0 / float(self.unit[c])) for c in chosen]
        return [u * v for u, v in zip(units, j, strict=True)], alpha

    def _of_lines(self) -> Iterator[tuple[Lines, slice]]:
        first = 0
        for part in self.lines:
            yield part, slice(first, first + part.state_count)
            first += part.state_count

    def steps(self, first: list[Float], last: list[Float], resolution: float) -> list[Float]:
        """Return, per channel, the number of steps that resolve lines between two states."""
        found = [first[0] * 0.0] * self.emissions
        for part, own in self._of_lines():
            counts = part.steps(first[own], last[own], resolution, self.context)
            found = [dr.select(a > b, a, b) for a, b in zip(counts, found, strict=True)]
        return found
