"""What is certain of a medium, or of a part of it, on a panel of a ray."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from ..backend import dr
from ..expressions.traced_interval import TracedInterval
from ..expressions.traced_rounding import larger, smaller
from .contract import Coefficients


@dataclass
class PartBounds:
    """Intervals of a part's coefficients on a panel, times the panel's length.

    Attributes
    ----------
    emissivity : list of TracedInterval
        Values of j anywhere, per channel.
    extinction : list of TracedInterval
        Values of α anywhere, one (grey) or per channel.
    emitted, depth : list of TracedInterval
        Their integrals over the panel.
    source : list of (low, high) or None, per channel
        Values of j/α, where they are known by themselves.
    """

    emissivity: list[TracedInterval]
    extinction: list[TracedInterval]
    emitted: list[TracedInterval]
    depth: list[TracedInterval]
    source: list[Any] = field(default_factory=list)

    def spread(self, count: int) -> PartBounds:
        """Return the same with a number of extinctions."""
        if len(self.extinction) == count:
            return self
        alike = self.extinction * count, self.depth * count
        return PartBounds(self.emissivity, alike[0], self.emitted, alike[1], self.source)

    def source_of(self, channel: int) -> tuple[Any, Any]:
        """Return between which values j/α is; infinite where nothing is known."""
        if self.source and self.source[channel] is not None:
            return self.source[channel]
        alpha = self.extinction[channel if len(self.extinction) > 1 else 0]
        quotient = self.emissivity[channel] / alpha
        return quotient.lo, quotient.hi


def part_bounds(
    found: Coefficients, means: Coefficients, length: TracedInterval, source: Sequence[Any] = ()
) -> PartBounds:
    """Return bounds from ranges and from means of the coefficients over a panel of a length."""

    def whole(values: list[Any]) -> list[TracedInterval]:
        return [length * v for v in values]

    j, alpha, emitted, depth = (
        whole(values)
        for values in (found.emissivity, found.extinction, means.emissivity, means.extinction)
    )
    emitted = [meet(a, b) for a, b in zip(emitted, j, strict=True)]
    depth = [meet(a, b) for a, b in zip(depth, alpha, strict=True)]
    return PartBounds(j, alpha, emitted, depth, list(source))


Sums = tuple[list[TracedInterval], list[TracedInterval], list[TracedInterval], list[TracedInterval]]


def total_bounds(parts: list[PartBounds]) -> PartBounds:
    """Return the bounds of a sum; its j/α is among those of the parts that are there."""
    if len(parts) == 1:
        return parts[0]
    sums = (
        _added([p.emissivity for p in parts]),
        _added([p.extinction for p in parts]),
        _added([p.emitted for p in parts]),
        _added([p.depth for p in parts]),
    )
    channels = range(len(parts[0].emissivity))
    return PartBounds(*sums, [_source(parts, c, sums) for c in channels])


def _added(rows: list[list[TracedInterval]]) -> list[TracedInterval]:
    return [functools.reduce(lambda a, b: a + b, column) for column in zip(*rows, strict=True)]


def _source(parts: list[PartBounds], channel: int, sums: Sums) -> tuple[Any, Any]:
    """Return the hull of j/α over the parts that may absorb or emit, met with that of the sums."""
    own = PartBounds(*sums).source_of(channel)
    low, high = dr.inf, -dr.inf
    for part in parts:
        alpha = part.extinction[channel if len(part.extinction) > 1 else 0]
        there = (alpha.hi > 0.0) | (part.emissivity[channel].size > 0.0)
        below, above = part.source_of(channel)
        low = dr.select(there & ~(below >= low), below, low)
        high = dr.select(there & ~(above <= high), above, high)
    return larger(own[0], low), smaller(own[1], high)


def meet(a: TracedInterval, b: TracedInterval) -> TracedInterval:
    """Return what is in both of two intervals that hold the same number."""
    return TracedInterval(larger(a.lo, b.lo), smaller(a.hi, b.hi), a.nan & b.nan)
