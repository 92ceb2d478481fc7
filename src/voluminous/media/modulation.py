"""Modulation of a medium by other expressions: gates, and colours of another field.

The mean of shape times modulation over a panel uses three values of the modulation: at both ends,
and at the centre of mass of the shape. With the weights that follow from the
shape's width this is exact for modulations that are quadratic along the panel, for shells much
thinner than the panel, and Simpson's rule where the shape is constant.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..backend import dr
from ..backend.types import Float, Mask
from ..errors import InputError
from ..expressions import Expression
from ..expressions.interval import Interval
from ..expressions.traced_interval import TracedInterval
from .arguments import color_values, level_colors
from .color_by import BoundColors, ColorBy
from .context import Context, Feature, Halves, MediumSample
from .jumps import SENSITIVITY, Jump
from .panel import NODES, PLACES, Middle, Panel, extremes, kept, third_differences
from .quadrature import parabola
from .shading import Shade

if TYPE_CHECKING:
    from ..bounds.enclosure import EnclosedPanel, EnclosureContext, PanelBounds
    from .bound import Binding, BoundMedium

# Where a gate may change by more than this within a panel, panels are made smaller.
_DOUBT = 0.25


@dataclass
class Factors:
    """Factors of the emissivity per channel, and of the extinction."""

    emission: list[Float]
    gate: Float

    def times(self, sample: MediumSample) -> MediumSample:
        """Return modulated coefficients; zero where the factor is zero, even if they are NaN."""
        return MediumSample(
            [_product(f, j) for f, j in zip(self.emission, sample.emissivity, strict=True)],
            [_product(self.gate, a) for a in sample.extinction],
        )


def modulated(
    color: Any, where: Any, shade: Shade | None = None
) -> tuple[tuple[float, ...], Modulation]:
    """Return the constant factors per channel, and the modulation, from a user's arguments."""
    if isinstance(color, ColorBy):
        return (color.brightness,) * 3, Modulation(where, color, 3, shade)
    values = color_values(color)
    return values, Modulation(where, None, len(values), shade)


def modulated_colors(
    color: Any, where: Any, count: int
) -> tuple[tuple[tuple[float, ...], ...], Modulation]:
    """Return one colour per level, and the modulation."""
    if isinstance(color, ColorBy):
        row, modulation = modulated(color, where)
        return (row,) * count, modulation
    rows = level_colors(color, count)
    return rows, Modulation(where, None, len(rows[0]))


class Modulation:
    """A gate, a colour by another expression and a shading, each of which may be missing.

    The gate `where` multiplies emission and extinction: a comparison, or a number, limited to
    0 … 1; where it has no value (NaN) it is 0. Colours multiply the emission of three channels, the
    shading that of all. If `fixed`, all factors are one.
    """

    def __init__(
        self, where: Any, color: ColorBy | None, channels: int, shade: Shade | None = None
    ) -> None:
        self.where = None if where is None else Expression(where)
        self.color, self.channels, self.shade = color, channels, shade
        self.paint: BoundColors | None = None  # once it is bound
        parts = [part for part in (self.where, color, shade) if part is not None]
        self.fixed = not parts
        self.names = tuple(dict.fromkeys(name for part in parts for name in part.names))

    @property
    def painted(self) -> bool:
        """Whether emission and extinction have different factors."""
        return self.color is not None or self.shade is not None

    @property
    def stepped(self) -> bool:
        """Whether the gate is a step, either open or closed."""
        return self.where is not None and self.where.stepped

    @property
    def sensitivity(self) -> float:
        """Factor on the error of fields; see `Medium.sensitivity`."""
        return SENSITIVITY if self.stepped else 1.0

    @property
    def even(self) -> bool:
        """Whether there is no modulation except possibly a step gate."""
        return not self.painted and (self.where is None or self.stepped)

    @property
    def soft(self) -> bool:
        """Whether the gate has kinks only where it becomes open or closed."""
        return self.where is not None and self.where.smooth and not self.where.partial

    def on_rays(self) -> Modulation:
        """Return it with a shading for rays alone."""
        shade = self.shade.on_rays() if self.shade else None
        return Modulation(self.where, self.color, self.channels, shade)

    def bind(self, binding: Binding) -> Modulation:
        """Return it for some channels, with the numbers of its colours."""
        bound = copy.copy(self)
        bound.channels = len(range(self.channels)[binding.channels])
        bound.paint = self.color.bind(binding) if self.color else None
        return bound

    def jumps(self) -> list[Jump]:
        """Return the levels where the gate opens and closes, or a soft gate begins or ends to."""
        if self.where is None:
            return []
        if self.stepped:
            return [Jump(margin, 0.0) for margin in self.where.margins()]
        return [Jump(self.where, level) for level in (0.0, 1.0)] if self.soft else []

    def features(self) -> tuple[Feature, ...]:
        """Return the expressions of gate, colour and shading."""
        gate = [Feature(self.where)] if self.where else []
        paint = [self.color.feature] if self.color else []
        return (*gate, *paint, *map(Feature, self.shade.expressions() if self.shade else ()))

    def coefficients(
        self, sample: MediumSample, fields: dict[str, Any], context: Context
    ) -> MediumSample:
        """Return coefficients at places, or intervals of them, modulated."""
        if self.fixed:
            return sample
        gate = self.gate(fields, context) if self.where else context.real(1.0)
        paint = self.paint.colors(fields, context) if self.paint else None
        emission = [gate * c for c in paint] if paint else [gate] * self.channels
        if self.shade:
            light = self.shade.factor(fields, context)
            emission = [e * light for e in emission]
        where, zero = context.ops.where, context.real(0.0)
        return MediumSample(
            [
                where(gate > 0.0, f * j, zero)
                for f, j in zip(emission, sample.emissivity, strict=True)
            ],
            [where(gate > 0.0, gate * a, zero) for a in sample.extinction],
        )

    def mean(self, sample: MediumSample, panel: Panel, middle: Middle) -> MediumSample:
        """Return mean coefficients over a panel, modulated at their centre of mass."""
        if self._is_decided(panel) and not self.painted:
            gate = self._in_middle(panel)
            return Factors([gate] * self.channels, gate).times(sample)
        return sample if self.fixed else self.factors(panel, middle).times(sample)

    def halves(self, halves: Halves, panel: Panel, middles: Sequence[Middle]) -> Halves:
        """Return means over both halves of a panel, modulated where the shape is in each."""
        if self._is_decided(panel) and not self.painted:
            gate = self._in_middle(panel)
            return halves.map(Factors([gate] * self.channels, gate).times)
        rows = [self.at_node(panel, s) for s in PLACES]
        means, errors = [], []
        for k, middle in enumerate(middles):
            found = []
            for values in zip(*rows, strict=True):
                half, cubic = values[2 * k : 2 * k + 3], third_differences(values)[k]
                found.append(parabola(half, cubic, middle.place, middle.spread))
            gate, *paint = found
            every = paint if self.painted else [gate] * self.channels
            means.append(Factors([f for f, _ in every], gate[0]))
            errors.append(Factors([e for _, e in every], gate[1]))
        first, last = means[0].times(halves.first), means[1].times(halves.last)
        total = [extremes([m.gate for m in means])[1]]
        most = Factors(
            [extremes([m.emission[c] for m in means])[1] for c in range(self.channels)], total[0]
        )
        error = MediumSample.of(
            lambda a, b, c: a + 0.5 * (b + c),
            most.times(halves.error),
            errors[0].times(halves.first),
            errors[1].times(halves.last),
        )
        if self.shade:
            turned = self.shade.turned(panel)
            bright = zip(error.emissivity, first.emissivity, last.emissivity, strict=True)
            error.emissivity = [e + turned * (dr.abs(a) + dr.abs(b)) for e, a, b in bright]
        return Halves(first, last, error)

    def factors(self, panel: Panel, middle: Middle) -> Factors:
        """Return the mean factors over a panel for a shape with this centre of mass."""
        first, last = (self.at_node(panel, s) for s in (0.0, 1.0))
        here = self._at(panel, panel.fields(middle.place))
        spread, place = middle.spread, middle.place
        weights = ((1.0 - place) * spread, 1.0 - spread, place * spread)
        mean = [
            weights[0] * a + weights[1] * b + weights[2] * c
            for a, b, c in zip(first, here, last, strict=True)
        ]
        painted = mean[1:] if self.painted else mean * self.channels
        return Factors(painted, mean[0])

    def panel_bounds(
        self,
        medium: BoundMedium,
        emission: list[TracedInterval],
        means: MediumSample,
        sources: Sequence[TracedInterval | None],
        panel: EnclosedPanel,
        context: EnclosureContext,
    ) -> list[PanelBounds]:
        """Return the bounds of a modulated medium on a panel.

        Given are its emission anywhere, its mean coefficients and j/α, without modulation.
        """
        if self.shade is not None:
            raise InputError(
                "bounds=True is for media without shading, which is an illustration; use shading=0"
            )
        if self.paint is not None:
            colors, mean_colors = self.paint.panel_colors(panel, context)
            columns = zip(emission, means.emissivity, colors, mean_colors, strict=True)
            means = MediumSample([panel.mean_product(*c) for c in columns], means.extinction)
            sources = [None if s is None else s * c for s, c in zip(sources, colors, strict=True)]
        if self.where is not None:
            gate = self.gate(panel.fields, context)
            rows = zip(emission, means.emissivity, strict=True)
            means = MediumSample(
                [panel.gated_mean(gate, *row) for row in rows], [gate * m for m in means.extinction]
            )
        ranges = medium.coefficients(panel.fields, context)
        return [panel.bounds(ranges, means, sources)]

    def visible(self, panel: Panel, seen: Mask, unresolved: Mask) -> tuple[Mask, Mask]:
        """Return the masks of `BoundMedium.visible`, given those without modulation."""
        if self.fixed or panel.culling_only:
            return seen, unresolved
        if self.paint:
            unresolved = unresolved | (seen & self.paint.turns(panel, _DOUBT))
        if self.where is None:
            return seen, unresolved
        if panel.without_jumps and (self.stepped or self.soft):
            seen = seen & (self._in_middle(panel) > 0.0)
            return seen, seen & unresolved
        gates = [self._gate_at(panel, s) for s in NODES]
        least, largest = extremes(gates)
        # Between the nodes a gate that is none of them shows is at most as far from them again.
        seen = seen & ((largest > 0.0) | (panel.beyond(self.where) > 0.0))
        return seen, seen & (unresolved | (largest - least > _DOUBT))

    def open(self, panel: Panel, seen: Mask) -> Mask:
        """Return where the medium is seen and the gate may be open."""
        if self.where is None:
            return seen
        return seen & (extremes([self._gate_at(panel, s) for s in NODES])[1] > 0.0)

    def may_show(self, ranges: dict[str, Interval], context: Context) -> Mask:
        """Return where the gate may be open while the fields stay in ranges."""
        return True if self.where is None else self.gate(ranges, context).hi > 0.0

    def key(self) -> tuple[Any, ...]:
        """Return a hashable value that identifies it."""
        color = self.color.key() if self.color else None
        return (self.gate_key(), color, self.shade.key() if self.shade else None)

    def gate_key(self) -> str | None:
        """Return a key of all that `may_show` depends on."""
        return self.where.text if self.where else None

    def gate(self, fields: dict[str, Any], context: Context) -> Float:
        """Return the gate alone, from 0 to 1, at places; or intervals that hold it."""
        assert self.where is not None
        return _unit(context.evaluate(self.where, fields))

    def at_place(self, fields: dict[str, Any], context: Context) -> list[Float]:
        """Return the gate, then the factor of each channel, at a place with these fields."""
        if self.fixed:
            return [context.narrow(context.real(1.0))] * (self.channels + 1)
        gate, *paint = self._painted(self._narrow_gate(fields, context), fields, context)
        return [gate, *(paint or [gate] * self.channels)]

    def at_node(self, panel: Panel, s: float) -> list[Float]:
        """Return the factors, the gate first, at a place of a panel; computed once.

        Nothing if they are one.
        """
        if self.fixed:
            return []
        return kept(panel, (id(self), s), lambda: self._at(panel, panel.fields(s)))

    def _gate_at(self, panel: Panel, s: float) -> Float:
        key = (id(self), "gate", s)
        return kept(panel, key, lambda: self._narrow_gate(panel.fields(s), panel.context))

    def _is_decided(self, panel: Panel) -> bool:
        return self.stepped and panel.without_jumps

    def _at(self, panel: Panel, fields: dict[str, Any]) -> list[Float]:
        light = self.shade.seen(fields, panel) if self.shade else None
        if self._is_decided(panel):
            gate = self._in_middle(panel)
        else:
            gate = self._narrow_gate(fields, panel.context)
        return self._painted(gate, fields, panel.context, light)

    def _narrow_gate(self, fields: dict[str, Any], context: Context) -> Float | None:
        return context.narrow(self.gate(fields, context)) if self.where else None

    def _in_middle(self, panel: Panel) -> Float:
        return self._gate_at(panel, 0.5)

    def _painted(
        self,
        gate: Float | None,
        fields: dict[str, Any],
        context: Context,
        light: Float | None = None,
    ) -> list[Float]:
        paint = self.paint.seen(fields, context) if self.paint else []
        if light is not None:
            paint = [c * light for c in paint] if paint else [light] * self.channels
        if gate is None:
            return [type(paint[0])(1.0), *paint]
        return [gate, *(gate * c for c in paint)]


def _product(factor: Float, value: Float) -> Float:
    return dr.select(factor == 0.0, 0.0, factor * value)


def _unit(value: Float) -> Float:
    """Return a number, or an interval, limited to 0 … 1; 0 where it is NaN."""
    if not isinstance(value, Interval):
        return dr.select(value > 0.0, dr.select(value < 1.0, value, 1.0), 0.0)
    where: Any = dr.select if isinstance(value, TracedInterval) else np.where
    low = where(value.nan | (value.lo <= 0.0), 0.0, where(value.lo < 1.0, value.lo, 1.0))
    high = where(value.hi >= 1.0, 1.0, where(value.hi > 0.0, value.hi, 0.0))
    return type(value)(low, high)
