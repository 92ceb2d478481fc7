"""A sum of media: emissivities and extinctions add."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..backend.types import Float, Mask
from ..errors import InputError
from ..expressions import Expression
from ..expressions.interval import Interval
from ..notebook import page, table
from ..units import Unit
from .bound import Binding, BoundMedium, SourceRange, integrated
from .context import Context, Feature, Halves, MediumSample
from .contract import Medium
from .panel import Panel, extremes

if TYPE_CHECKING:
    from ..bounds.enclosure import EnclosedPanel, EnclosureContext, PanelBounds
    from .jumps import Jump


class Sum(Medium):
    """Several media in the same place.

    Raises
    ------
    InputError
        If they have different numbers of channels.
    """

    def __init__(self, parts: tuple[Medium, ...]) -> None:
        counts = {part.channels for part in parts}
        if len(counts) > 1 and 0 in counts:
            raise InputError(
                "media that emit at any frequency (vm.Dust, vm.Lines, …) and media of colours "
                "cannot be added; draw them apart"
            )
        if len(counts) > 1:
            raise InputError(
                f"media with {' and '.join(map(str, sorted(counts)))} channels cannot be added; "
                "give all of them the same number of colours"
            )
        self.parts = parts
        self.channels = parts[0].channels
        self.grey = all(part.grey for part in parts)
        self.thermal = all(part.thermal for part in parts)
        self.discrete = any(part.discrete for part in parts)
        self.names = tuple(dict.fromkeys(name for part in parts for name in part.names))
        self.sight = tuple(dict.fromkeys(axis for part in parts for axis in part.sight))
        self.sensitivity = max(part.sensitivity for part in parts)

    def components(self) -> tuple[Medium, ...]:
        return self.parts

    def bind(self, binding: Binding) -> BoundSum:
        numbers = ((*binding.part, k) for k in range(len(self.parts)))
        parts = zip(self.parts, numbers, strict=True)
        return BoundSum([part.bind(replace(binding, part=number)) for part, number in parts])

    def features(self) -> tuple[Feature, ...]:
        rows = [part.features() for part in self.parts]
        return tuple(f for row in rows for f in row) if all(rows) else ()

    def scalars(self) -> tuple[Expression, ...]:
        found = (e for part in self.parts for e in part.scalars())
        return tuple({e.text: e for e in found}.values())

    @property
    def surface_only(self) -> bool:
        return all(part.surface_only for part in self.parts)

    def emission_unit(self, unit_of: Callable[[Expression], Unit]) -> Unit:
        units = (part.emission_unit(unit_of) for part in self.parts)
        return next((unit for unit in units if unit is not None), None)

    def visible_key(self) -> Any:
        keys = tuple(part.visible_key() for part in self.parts)
        return None if None in keys else keys

    def key(self) -> Any:
        keys = tuple(part.key() for part in self.parts)
        return None if None in keys else keys

    def _repr_html_(self) -> str:
        rows = ((repr(part),) for part in self.parts)
        return page("Sum", self._swatch(), table(rows))

    def __repr__(self) -> str:
        return " + ".join(repr(part) for part in self.parts)


class BoundSum(BoundMedium):
    """The numbers of several media; a grey one counts in all channels."""

    parts: Sequence[BoundMedium] = ()

    def __init__(self, parts: Sequence[BoundMedium]) -> None:
        self.parts = parts

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        return _total([part.coefficients(fields, context) for part in self.parts])

    def may_show(self, ranges: dict[str, Interval], context: Context) -> Mask:
        return functools.reduce(
            operator.or_, (part.may_show(ranges, context) for part in self.parts)
        )

    def mean(self, panel: Panel) -> MediumSample:
        return _total([part.mean(panel) for part in self.parts])

    def halves(self, panel: Panel) -> Halves:
        found = [integrated(part, panel) for part in self.parts]
        return Halves(
            _total([half.first for half in found]),
            _total([half.last for half in found]),
            _total([half.error for half in found]),
        )

    def visible(self, panel: Panel) -> tuple[Mask, Mask]:
        seen, unresolved = zip(*(part.visible(panel) for part in self.parts), strict=True)
        return functools.reduce(operator.or_, seen), functools.reduce(operator.or_, unresolved)

    def jumps(self) -> list[Jump]:
        every = (jump for part in self.parts for jump in part.jumps())
        return list({(jump.expr.text, jump.level): jump for jump in every}.values())

    def sheet(self, panel: Panel, place: Float) -> MediumSample | None:
        found = [part.sheet(panel, place) for part in self.parts]
        some = [one for one in found if one is not None]
        return _total(some) if some else None

    def panel_bounds(self, panel: EnclosedPanel, context: EnclosureContext) -> list[PanelBounds]:
        return [found for part in self.parts for found in part.panel_bounds(panel, context)]

    def source_range(self, panel: Panel) -> SourceRange | None:
        found = [part.source_range(panel) for part in self.parts]
        known = [one for one in found if one is not None]
        if len(known) < len(found):
            return None
        low, high = extremes([t for one in known for t in (one.low, one.high)])
        return SourceRange(low, high, known[0].exponents)


def _total(samples: list[MediumSample]) -> MediumSample:
    count = max(len(sample.extinction) for sample in samples)
    rows = [s.extinction * (count if len(s.extinction) == 1 else 1) for s in samples]
    every = (MediumSample(s.emissivity, row) for s, row in zip(samples, rows, strict=True))
    return MediumSample.of(lambda *values: sum(values[1:], values[0]), *every)


def with_each(medium: Medium, change: Callable[[Medium], Medium]) -> Medium:
    """Return a medium with a change made to each of its components."""
    parts = medium.components()
    changed = tuple(map(change, parts))
    if all(new is old for new, old in zip(changed, parts, strict=True)):
        return medium
    return changed[0] if len(changed) == 1 else Sum(changed)
