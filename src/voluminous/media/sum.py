"""A sum of media: emissivities and extinctions add."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ..backend.types import Float, Mask
from ..errors import InputError
from ..expressions import Expression
from ..expressions.interval import Interval
from ..notebook import page, table
from .context import Context, Feature, Halves, MediumSample
from .contract import Medium, integrated

if TYPE_CHECKING:
    from ..bounds.enclosure import EnclosedPanel, EnclosureContext, PanelBounds
    from .jumps import Jump
    from .panel import Panel


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
        self.discrete = all(part.discrete for part in parts)
        self.names = tuple(dict.fromkeys(name for part in parts for name in part.names))
        self.sight = tuple(dict.fromkeys(axis for part in parts for axis in part.sight))
        self.sensitivity = max(part.sensitivity for part in parts)

    def components(self) -> tuple[Medium, ...]:
        return self.parts

    def group(self, first: int, last: int) -> Medium:
        return Sum(tuple(part.group(first, last) for part in self.parts))

    def coefficients(self, fields: dict[str, Any], context: Context) -> MediumSample:
        return self._total([part.coefficients(fields, context) for part in self.parts])

    def features(self) -> tuple[Feature, ...]:
        rows = [part.features() for part in self.parts]
        return tuple(f for row in rows for f in row) if all(rows) else ()

    def scalars(self) -> tuple[Expression, ...]:
        found = (e for part in self.parts for e in part.scalars())
        return tuple({e.text: e for e in found}.values())

    def means(self, panel: Panel, context: Context) -> MediumSample:
        return self._total([part.means(panel, context) for part in self.parts])

    def integrate(self, panel: Panel, context: Context) -> Halves:
        found = [integrated(part, panel, context) for part in self.parts]
        rows = ([getattr(h, name) for h in found] for name in ("first", "last", "error"))
        return Halves(*map(self._total, rows))

    def jumps(self, context: Context) -> list[Jump]:
        every = (jump for part in self.parts for jump in part.jumps(context))
        return list({(jump.expr.text, id(jump.level)): jump for jump in every}.values())

    def layer(self, panel: Panel, context: Context, place: Float) -> MediumSample | None:
        found = [part.layer(panel, context, place) for part in self.parts]
        some = [one for one in found if one is not None]
        return self._total(some) if some else None

    def warmth(self, panel: Panel, context: Context) -> list[Float] | None:
        found = [part.warmth(panel, context) for part in self.parts]
        known = [own for own in found if own is not None]
        return [t for own in known for t in own] if len(known) == len(found) else None

    @property
    def surface_only(self) -> bool:
        return all(part.surface_only for part in self.parts)

    def visible(self, panel: Panel, context: Context) -> tuple[Mask, Mask]:
        masks = [part.visible(panel, context) for part in self.parts]
        seen, unresolved = masks[0]
        for a, b in masks[1:]:
            seen, unresolved = seen | a, unresolved | b
        return seen, unresolved

    def visible_in(self, fields: dict[str, Interval], context: Context) -> Mask:
        seen = self.parts[0].visible_in(fields, context)
        for part in self.parts[1:]:
            seen = seen | part.visible_in(fields, context)
        return seen

    def visible_key(self) -> Any:
        keys = tuple(part.visible_key() for part in self.parts)
        return None if None in keys else keys

    def ranges(self, fields: dict[str, Interval], context: Context) -> MediumSample:
        return self._total([part.ranges(fields, context) for part in self.parts])

    def largest(self, fields: dict[str, Interval], context: Context) -> MediumSample:
        return self._total([part.largest(fields, context) for part in self.parts])

    def panel_bounds(self, panel: EnclosedPanel, context: EnclosureContext) -> list[PanelBounds]:
        return [found for part in self.parts for found in part.panel_bounds(panel, context)]

    def _total(self, solved: list[MediumSample]) -> MediumSample:
        n = self.extinction_count  # a grey medium counts in all channels
        rows = [
            [*c.emissivity, *(c.extinction if len(c.extinction) == n else c.extinction * n)]
            for c in solved
        ]
        return self.split([sum(own[1:], own[0]) for own in zip(*rows, strict=True)])

    def intensity_unit(self, context: Context) -> Any:
        units = (part.intensity_unit(context) for part in self.parts)
        return next((unit for unit in units if unit is not None), None)

    def key(self) -> Any:
        keys = tuple(part.key() for part in self.parts)
        return None if None in keys else keys

    def _repr_html_(self) -> str:
        rows = ((repr(part),) for part in self.parts)
        return page("Sum", self._swatch(), table(rows))

    def __repr__(self) -> str:
        return " + ".join(repr(part) for part in self.parts)


def with_each(medium: Medium, change: Callable[[Medium], Medium]) -> Medium:
    """Return a medium with a change made to each of its components."""
    parts = medium.components()
    changed = tuple(map(change, parts))
    if all(new is old for new, old in zip(changed, parts, strict=True)):
        return medium
    return changed[0] if len(changed) == 1 else Sum(changed)
