"""Post-classified: fields are interpolated along the ray, and the medium is evaluated there.

A segment of the walk is one cell, or a cube of cells in which fields are nearly linear. The medium
integrates both halves of a panel of it, and estimates the error; `step_doubling` adds what the
order of light and absorption is worth. Panels whose error exceeds its limit are halved; they end at
the jumps of the medium. The limit follows from the tolerance of the picture.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..backend.functions import branch, loop, precision_of, records
from ..backend.types import Float, Mask
from ..grids.contract import Segment
from ..media.jumps import first_jump, jumps_ahead
from ..media.panel import NODES, PLACES
from .base import Position, Scheme, Solution
from .path import Path, empty_path, last_argument, most, over
from .pre_integrated import begin_values
from .step_doubling import Limits, solve_with_error

if TYPE_CHECKING:
    from ..media.panel import Panel

# Panels are not narrower than this fraction of a segment. With 2^-8 in single precision, three
# surfaces of noise in a 500th of a cell had errors of 0.1 of the maximum, in more time.
_NARROWEST = 2.0**-14
# A panel this narrow that evaluates to NaN will not improve by halving: with a negative extinction
# pictures of 20 x 20 pixels took minutes until they were refused.
_NOT_FINITE = 2.0**-4
# A panel ends this far behind a jump, as a fraction of the segment: more than its rounding error.
# With 2^-16 in single precision shells behind gates had errors of up to 1e-4 of the maximum.
_BEHIND = {"single": 2.0**-20, "double": 2.0**-32}
# A panel may have at least this part of a segment's error.
_LEAST_PART = 0.25
# Scalars may bend within a wide step by the root of the tolerance, times this, in widths of
# structures.
_BEND, _MOST_BEND = 1.0, 0.3

# The fields at a place, and the scalars.
Place = tuple[dict[str, Float], list[Float]]


class PostClassified(Scheme):
    """Classify interpolated fields, to a tolerance."""

    name = "post-classified"
    order = 2
    coefficients_at = "field"
    controlled = True

    def coarseness_for(self, tolerance: float) -> float:
        return min(_BEND * math.sqrt(tolerance), _MOST_BEND)

    def start(self, position: Position, source: Any) -> list[Float]:
        """Carry the scalars at the ray's position (NaN: not computed yet), and what lies in front.

        That is the transparency per extinction; one where the walk goes towards the observer.
        """
        unknown: Any = source.context.real(math.nan)
        clear: Any = [source.backend.Float(1) for _ in range(source.numbers.extinctions)]
        return [*(unknown for _ in source.scalars), clear]

    def after_skip(
        self, position: Position, source: Any, carried: list[Float], moved: Mask
    ) -> list[Float]:
        *scalars, through = carried
        return [*(dr.select(moved, math.nan, x) for x in scalars), through]

    def after_discarded(self, carried: list[Float], onward: list[Float]) -> list[Float]:
        """Continue with the scalars after the hidden segment, and what was in front of it."""
        return [*onward[:-1], carried[-1]]

    def solve(
        self, segment: Segment, source: Any, carried: list[Float]
    ) -> tuple[Solution, list[Float]]:
        *scalars, through = carried
        ray = _Ray.along(segment, source)
        values = [begin_values(source, ray.fields, scalars), *map(ray.scalars, PLACES[1:])]
        inside = source.looks_inside
        places = [(ray.fields.own(s) if inside else {}) for s in PLACES]
        scalars_only = source.panel(places, values, segment.length, where=PLACES, culling_only=True)
        visible, _ = source.bound.visible(scalars_only)
        numbers, (allowed, dim) = source.numbers, source.tolerance
        nothing = empty_path(source.backend.Float, numbers.emissions, numbers.extinctions, 3)
        through = dr.detach(through)  # what is accepted has no derivative
        clearest = most(through)
        behind = 1.0 / dr.select(clearest > 1e-6, clearest, 1e-6)
        path = branch(
            args=(values, Limits(allowed * behind, dim * behind, through), nothing),
            cond=visible & segment.active,
            true_fn=functools.partial(_segment, ray),
            false_fn=last_argument,
        )
        through = [a * b for a, b in zip(through, path.transparency, strict=True)]
        after = [
            dr.select(segment.active, value, before)
            for value, before in zip(values[-1], scalars, strict=True)
        ]
        return path, [*after, through]


@dataclass
class _Ray:
    """A segment of a ray: what its fields and scalars are at any place from 0 to 1."""

    source: Any
    segment: Segment
    fields: Any
    length: Float

    @classmethod
    def along(cls, segment: Segment, source: Any) -> _Ray:
        return cls(source, segment, source.along(segment), segment.length)

    def scalars(self, s: Float) -> list[Float]:
        found: list[Float] = self.source.evaluated(self.fields.own(s))
        return found

    def place(self, s: Float) -> Place:
        """Return the fields that the medium looks at within panels, and the scalars."""
        own = self.fields.own(s)
        return own if self.source.looks_inside else {}, self.source.evaluated(own)

    def panel(self, begin: Float, width: Float, places: list[Place]) -> Panel:
        """Return the panel with these three, or five, places."""
        fields, values = zip(*places, strict=True)
        where = PLACES if len(places) == len(PLACES) else NODES
        options: dict[str, Any] = {"where": where, "many": self.fields.many}
        if self.source.looks_inside:
            options["ahead"] = self.fields.ahead
            options["between"] = lambda s: self.fields.own(dr.fma(width, s, begin))
        panel: Panel = self.source.panel(fields, values, self.length * width, **options)
        return panel

    def solved(
        self, begin: Float, width: Float, places: list[Place], limits: Limits, front: Path
    ) -> tuple[Path, Mask]:
        """Return the solution of a panel without a jump inside, and where it may miss something.

        From the fields and scalars at five `PLACES`; `front` is the part of the segment before it.
        """
        panel = self.panel(begin, width, places)
        panel.without_jumps = bool(self.source.jumps)
        _, unresolved = self.source.bound.visible(panel)
        return solve_with_error(self.source, panel, limits.seen(front)), unresolved


def _segment(ray: _Ray, values: list[list[Float]], limits: Limits, nothing: Path) -> Path:
    with ray.source.recording():
        found, good = _as_one(ray, values, limits, nothing)
    ray.source.accept(nothing, found, good)
    several = functools.partial(_in_panels, ray, nothing)
    path: Path = branch((values, limits, found), good, last_argument, several)
    return path


def _as_one(
    ray: _Ray, values: list[list[Float]], limits: Limits, nothing: Path
) -> tuple[Path, Mask]:
    source, real = ray.source, type(ray.length)
    if records(ray.length):  # scalars that were computed outside have no derivatives
        values = [ray.scalars(s) for s in PLACES]
    inside = source.looks_inside
    places: list[Place] = [
        (ray.fields.own(s) if inside else {}, own) for s, own in zip(PLACES, values, strict=True)
    ]
    whole = ray.panel(real(0), real(1), places[::2])
    count, uncounted = jumps_ahead(whole, source.jumps)
    if source.surface_only:
        good = ~uncounted & (count < 2)
        return _with_layer(ray, whole, good & (count > 0), nothing), good
    found, unresolved = ray.solved(real(0), real(1), places, limits, nothing)
    return found, ~unresolved & limits.accept(found) & (count == 0) & ~uncounted


@dataclass
class _State:
    """The loop over panels of one segment: where the next one begins, how wide it may be."""

    begin: Float
    width: Float
    place: Place
    path: Path


def _in_panels(
    ray: _Ray, nothing: Path, values: list[list[Float]], limits: Limits, found: Path
) -> Path:
    source, real = ray.source, type(ray.length)
    # Dr.Jit 1.5 loses the derivatives of what a loop in a loop uses besides its arguments.
    arguments = (ray.segment,) if records(ray.length) else ()

    def going_on(state: _State, *_: Segment) -> Mask:
        return state.begin < 1.0

    def step(state: _State, *own: Segment) -> tuple[Any, ...]:
        with source.recording():
            here = _Ray.along(own[0], source) if own else ray
            solved, good, last, width = _tried(here, state, values[-1], limits, nothing)
        source.accept(state.path, solved, good)
        path = dr.select(good, over(state.path, solved), state.path)
        begin, width = next_panel(good, state.begin, width, state.width)
        return _State(begin, width, dr.select(good, last, state.place), path), *own

    first = (ray.fields.own(0.0) if source.looks_inside else {}, values[0])
    state = _State(real(0), real(1.0 if source.jumps else 0.5), first, nothing)
    end: _State
    end, *_ = loop((state, *arguments), going_on, step, label="panels")
    return end.path


def _tried(
    ray: _Ray, state: _State, after: list[Float], limits: Limits, nothing: Path
) -> tuple[Path, Mask, Place, Float]:
    """Return the next panel solved, where that is accurate enough, its end and its width.

    `after` are the scalars at the end of the segment.
    """
    source, begin, width = ray.source, state.begin, state.width
    recorded = records(ray.length)
    first = ray.place(begin) if recorded else state.place  # loops carry no derivatives

    def up_to(width: Float) -> tuple[Place, Place]:
        """Return middle and end of a panel.

        At the end of the segment scalars equal the next segment's to the last bit; otherwise a
        crossing could be counted twice.
        """
        end = begin + width
        fields, own = ray.place(end)
        if not recorded:
            own = [dr.select(end >= 1.0, b, a) for a, b in zip(own, after, strict=True)]
        return ray.place(dr.fma(width, 0.5, begin)), (fields, own)

    middle, last = up_to(width)
    passed = uncounted = begin < 0.0
    if source.jumps:
        trial = ray.panel(begin, width, [first, middle, last])
        count, uncounted = jumps_ahead(trial, source.jumps)
        passed = count > 0
        # A surface without width that is alone in a panel need not be at its end.
        several = count > (1 if source.surface_only else 0)
        behind = _BEHIND[precision_of(type(width))]
        cut = dr.fma(first_jump(trial, source.jumps), width, behind)
        width = dr.select(several & (cut < width), cut, width)
        middle, last = up_to(width)
    least = width <= _NARROWEST
    if source.surface_only:
        solved, good = nothing, ~uncounted | least
    else:
        quarters = [ray.place(dr.fma(width, part, begin)) for part in (0.25, 0.75)]
        places = [first, quarters[0], middle, quarters[1], last]
        solved, unresolved = ray.solved(begin, width, places, limits, state.path)
        part = dr.select(width > _LEAST_PART, width, _LEAST_PART)
        good = (limits.times(part).accept(solved) & ~unresolved & ~uncounted) | least
        good |= dr.isnan(solved.error[0] + solved.error[1]) & (width <= _NOT_FINITE)
    panel = ray.panel(begin, width, [first, middle, last])
    panel.without_jumps = bool(source.jumps)
    return _with_layer(ray, panel, good & passed, solved), good, last, width


def next_panel(good: Mask, begin: Float, width: Float, tried: Float) -> tuple[Float, Float]:
    """Return beginning and width of the next panel, as fractions of the segment.

    After an accepted panel the width is doubled, if there is room; a rejected panel is halved. If
    a jump made the panel narrower than `tried`, the next panel has at least that width.
    """
    begin = dr.select(good, begin + width, begin)
    wider = dr.select(2.0 * width > tried, 2.0 * width, tried)
    width = dr.select(good, wider, 0.5 * width)
    return begin, dr.select(width < 1.0 - begin, width, 1.0 - begin)


def _with_layer(ray: _Ray, panel: Panel, passed: Mask, solved: Path) -> Path:
    source = ray.source
    if not source.layered:
        return solved

    def layered(solved: Path) -> Path:
        place: Float = 1.0
        if source.surface_only and source.looks_inside:
            place = first_jump(panel, source.jumps)
        layer: Path = source.layer(panel, place)
        zero = 0.0 * panel.length
        layer.error = [zero, zero, source.numbers.brightness(layer.emission)]
        return over(solved, layer)

    result: Path = branch((solved,), passed, layered, last_argument)
    return result
