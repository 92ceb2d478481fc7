"""Bounds of the solution of the transfer equation on one panel, from bounds of its coefficients.

With lengths scaled so that the panel's is one, τ the depth, w = e^{-τ(u)} the transparency in front
of u, and m(τ) = (1 - e^{-τ})/τ, four bounds of b = ∫ j w du are intersected:

* j and α are in their ranges: b is from j₋ m(α₊) to j₊ m(α₋).
* Their means have narrower bounds. The mean of w differs from m by a factor of at most e^{±Δα/4},
  since the depth differs from a straight line by at most Δα/4; the mean of a product differs from
  the product of the means by at most Δj Δw/4 (Grüss 1935). Both are of second order.
* j/α is in its range: b is that times 1 - e^{-τ}. For one shell it is exact.
* The components of a sum are bounded separately, each dimmed by at most all others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from ..backend import dr
from ..backend.functions import any_attenuation, loop
from ..backend.types import Float, Mask
from ..expressions.traced_interval import TracedInterval, larger, positive, smaller
from ..grids.contract import Segment
from ..schemes.base import Position, Scheme, Solution
from ..schemes.path import Path, empty_path, most, over
from ..schemes.post_classified import next_panel
from .enclosure import Ends, PanelBounds
from .fields import Bracketed


def solve_components(components: list[PanelBounds]) -> tuple[list[Ends], list[Ends]]:
    """Return bounds of the emission per channel, and of the transparency per extinction."""
    count = max(len(one.extinction) for one in components)
    components = [_with_extinctions(one, count) for one in components]
    whole = _total(components)
    seen = [
        (any_attenuation(positive(depth.hi))[0], any_attenuation(positive(depth.lo))[0])
        for depth in whole.depth
    ]
    emission = []
    for c in range(len(whole.emissivity)):
        bounds = _emission(whole, c)
        if len(components) > 1:
            bounds = _met(bounds, _one_by_one(components, c))
        emission.append(bounds)
    return emission, seen


def _with_extinctions(one: PanelBounds, count: int) -> PanelBounds:
    if len(one.extinction) == count:
        return one
    return replace(one, extinction=one.extinction * count, depth=one.depth * count)


def _total(components: list[PanelBounds]) -> PanelBounds:
    """Return the bounds of a sum; its j/α lies in the hull of j/α of the components present."""
    if len(components) == 1:
        return components[0]
    rows = zip(*((c.emissivity, c.extinction, c.emitted, c.depth) for c in components), strict=True)
    sums = [[sum(values[1:], values[0]) for values in zip(*row, strict=True)] for row in rows]
    total = PanelBounds(sums[0], sums[1], sums[2], sums[3], [None] * len(sums[0]))
    sources = [_source(components, total, channel) for channel in range(len(sums[0]))]
    return replace(total, source=sources)


def _source(components: list[PanelBounds], total: PanelBounds, channel: int) -> Ends:
    """Return the hull of j/α of all that may absorb or emit, intersected with the sum's."""
    whole = total.source_of(channel)
    low, high = dr.inf, -dr.inf
    for one in components:
        alpha = one.extinction[channel if len(one.extinction) > 1 else 0]
        there = (alpha.hi > 0.0) | (one.emissivity[channel].size > 0.0)
        below, above = one.source_of(channel)
        low = dr.select(there & ~(below >= low), below, low)
        high = dr.select(there & ~(above <= high), above, high)
    return larger(whole[0], low), smaller(whole[1], high)


def _emission(one: PanelBounds, channel: int) -> Ends:
    e = channel if len(one.extinction) > 1 else 0
    j, total = one.emissivity[channel], one.emitted[channel]
    least, most = (positive(v) for v in (one.extinction[e].lo, one.extinction[e].hi))
    thin, thick = (positive(v) for v in (one.depth[e].lo, one.depth[e].hi))
    ranged = any_attenuation(most)[1], any_attenuation(least)[1]
    dimmed = _dimmed(j, (total.lo, total.hi), any_attenuation(thick)[0])
    bounds = _met(_scaled((j.lo, j.hi), ranged), dimmed)
    bounds = _met(bounds, _by_means(j, total, (thin, thick), most - least))
    return _met(bounds, _scaled(one.source_of(channel), (_absorbed(thin), _absorbed(thick))))


def _by_means(j: TracedInterval, total: TracedInterval, depth: Ends, change: Any) -> Ends:
    brightest = any_attenuation(depth[0])[1]
    last, dimmest = any_attenuation(depth[1])
    off = dr.exp(0.25 * dr.select(change < 2000.0, change, 2000.0))
    above = brightest * off
    low, high = _scaled((total.lo, total.hi), (dimmest / off, dr.select(above < 1.0, above, 1.0)))
    apart = 0.25 * (j.hi - j.lo) * (1.0 - last)
    return low - apart, high + apart


def _one_by_one(components: list[PanelBounds], channel: int) -> Ends:
    e = channel if len(components[0].extinction) > 1 else 0
    low, high = 0.0, 0.0
    for one in components:
        others = sum(positive(other.depth[e].hi) for other in components if other is not one)
        dimmest = any_attenuation(others)[0]
        ends = _dimmed(one.emissivity[channel], _emission(one, channel), dimmest)
        low, high = low + ends[0], high + ends[1]
    return low, high


def _dimmed(j: TracedInterval, emitted: Ends, dimmest: Any) -> Ends:
    """Return bounds of an emission behind an absorber that may cover some of it.

    There is no bound where j has both signs: all that remains may have one sign.
    """
    one_sign = (j.lo >= 0.0) | (j.hi <= 0.0)
    low, high = _scaled(emitted, (dimmest, 1.0))
    return dr.select(one_sign, low, -dr.inf), dr.select(one_sign, high, dr.inf)


def _absorbed(depth: Float) -> Float:
    theta, mean = any_attenuation(depth)
    return dr.select(depth < 1.0, depth * mean, 1.0 - theta)


def _scaled(ends: Ends, factors: Ends) -> Ends:
    (low, high), (least, most) = ends, factors
    return (
        low * dr.select(low < 0.0, most, least),
        high * dr.select(high < 0.0, least, most),
    )


def _met(a: Ends, b: Ends) -> Ends:
    low = dr.select(dr.isnan(a[0]), -dr.inf, a[0])
    high = dr.select(dr.isnan(a[1]), dr.inf, a[1])
    return dr.select(b[0] > low, b[0], low), dr.select(b[1] < high, b[1], high)


# The smallest panel, as a fraction of a segment; at a jump nothing else would stop the halving.
_NARROWEST = 2.0**-24
# The fraction of the budget that may be used anywhere on a segment.
_SHARE = 0.25


@dataclass
class BracketState:
    """Progress on a segment: place, width of the next panel, panels tried, accumulated bounds."""

    begin: Float
    width: Float
    tried: Float
    path: Path


class Bracket(Scheme[Bracketed]):
    """Bounds of the limit of post-classified.

    At most about `budget` panels are tried per segment. If `signed`, emissivities may be negative,
    and their negative values are a separate emission.
    """

    name = "bracket"
    order = 2
    coefficients_at = "field"

    def __init__(self, budget: int, signed: bool) -> None:
        self.budget, self.signed = budget, signed

    def start(self, position: Position, source: Bracketed) -> list[Float]:
        """Carry the visible part of the emission, and the fields at the end (still unknown)."""
        return [source.backend.Float(1), *source.unknown()]

    def after_skip(
        self, position: Position, source: Bracketed, carried: list[Float], moved: Mask
    ) -> list[Float]:
        """Discard the field values from before empty space."""
        seen, *before = carried
        return [seen, *(dr.select(moved, math.nan, value) for value in before)]

    def solve(
        self, segment: Segment, source: Bracketed, carried: list[Float]
    ) -> tuple[Solution, list[Float]]:
        """Return the bounds of one segment."""
        seen, *before = carried
        real = source.backend.Float
        cubics = source.along(segment)
        budget = dr.opaque(real, self.budget)

        def going_on(state: BracketState) -> Float:
            return state.begin < 1.0

        def step(state: BracketState) -> tuple[BracketState]:
            panel = source.panel(cubics, segment.length, state.begin, state.width)
            found, gaps = self._bounded(source.components(panel))
            wrong, dim = (gap * seen for gap in gaps)
            good = ~(wrong > source.tolerance.emission) & ~(dim > source.tolerance.transparency)
            tried = state.tried + 1.0
            end = state.begin + state.width
            # The budget is spread evenly along the segment, except a share for where it is needed.
            good |= tried >= budget * (_SHARE + (1.0 - _SHARE) * end)
            good |= (state.width <= _NARROWEST) | (state.begin < 0.0)
            path = dr.select(good, over(state.path, found), state.path)
            return (
                BracketState(*next_panel(good, state.begin, state.width, state.width), tried, path),
            )

        count = source.channels.emissions
        nothing = empty_path(real, count, count)
        # A jump to where the segment begins is a separate panel before it.
        begin = dr.select(source.jumps(cubics, before), real(-1), 0)
        begin = dr.select(segment.active, begin, 1)
        state = BracketState(begin, real(1), real(0), nothing)
        (state,) = loop((state,), going_on, step, label="bracket")
        after = [
            dr.select(segment.active, there, here)
            for there, here in zip(source.ends(cubics), before, strict=True)
        ]
        return state.path, [seen * most(state.path.transparency), *after]

    def _bounded(self, components: list[PanelBounds]) -> tuple[Path, tuple[Float, Float]]:
        emission, transparency = solve_components(components)
        grey = len(transparency) == 1
        through = [transparency[0 if grey else c] for c in range(len(emission))]
        lows, highs = ([ends[k] for ends in emission] for k in (0, 1))
        dims, clears = ([ends[k] for ends in through] for k in (0, 1))
        gaps = (
            most([b - positive(a) if not self.signed else b - a for a, b in emission]),
            most([b - a for a, b in transparency]),
        )
        found = [positive(v) for v in (*lows, *highs)]
        theta = [*dims, *clears]
        if self.signed:
            found += [positive(-v) for v in (*lows, *highs)]
            theta += [*clears, *dims]
        # Instead of depths: the number of panels, each of which adds a rounding error.
        one = type(found[0])(1)
        return Path(found, theta, [one for _ in found]), gaps
