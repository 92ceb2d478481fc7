"""Post-classified: fields are interpolated along the ray, and the medium is evaluated there.

A segment of the walk is one cell, or a cube of cells in which fields are nearly linear. The medium
integrates both halves of a panel of it, and estimates the error; `step_doubling` adds what the
order of light and absorption is worth. Panels whose error exceeds its limit are halved; they end at
the jumps of the medium. The limit follows from the tolerance of the picture.
"""

from __future__ import annotations

import functools
import math
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..backend import dr
from ..backend.functions import branch, loop, precision_of, records
from ..backend.types import Float, Mask
from ..grids.contract import Segment
from ..media.jumps import first_jump, jumps_ahead
from ..media.panel import PLACES
from .base import FieldScheme, FieldSource, Node, Position, Solution
from .path import Path, PathError, empty_path, last_argument, layer, most, over
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


class PostClassified(FieldScheme):
    """Classify interpolated fields, to a tolerance."""

    name = "post-classified"
    order = 2
    controlled = True

    def coarseness(self, tolerance: float) -> float:
        return min(_BEND * math.sqrt(tolerance), _MOST_BEND)

    def recording(self) -> AbstractContextManager[None]:
        """Return a context in which panels are solved; `replay` differentiates in it."""
        return nullcontext()

    def accepted(self, front: Path, panel: Path, where: Mask) -> None:
        """Take note of an accepted panel, and of the part of its segment in front of it."""

    def start(self, position: Position, source: FieldSource) -> list[Any]:
        """Carry the scalars at the ray's position (NaN: not computed yet), and what lies in front.

        That is the transparency per extinction; one where the walk goes towards the observer.
        """
        unknown: Any = source.context.real(math.nan)
        clear: Any = [source.backend.Float(1) for _ in range(source.channels.extinctions)]
        return [*(unknown for _ in source.channels.scalars), clear]

    def after_skip(
        self, position: Position, source: FieldSource, carried: list[Any], moved: Mask
    ) -> list[Any]:
        *scalars, through = carried
        return [*(dr.select(moved, math.nan, x) for x in scalars), through]

    def solve(
        self, segment: Segment, source: FieldSource, carried: list[Any]
    ) -> tuple[Solution, list[Any]]:
        *scalars, through = carried
        ray = _Ray(self, source, segment)
        first = ray.inside(0.0), begin_values(segment, ray.fields, scalars)
        nodes = [first, *map(ray.fields.node, PLACES[1:])]
        culled = ray.fields.panel(nodes, culling_only=True)
        visible, _ = ray.bound.visible(culled)
        channels, tolerance = source.channels, source.tolerance
        nothing = empty_path(source.backend.Float, channels.emissions, channels.extinctions, 3)
        through = dr.detach(through)  # what is accepted has no derivative
        clearest = most(through)
        behind = 1.0 / dr.select(clearest > 1e-6, clearest, 1e-6)
        limits = Limits(tolerance.emission * behind, tolerance.transparency * behind, through)
        values = [scalars for _, scalars in nodes]
        path = branch(
            args=(values, limits, nothing),
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


class _Ray:
    """A segment of a ray while it is solved."""

    def __init__(self, scheme: PostClassified, source: FieldSource, segment: Segment) -> None:
        self.scheme, self.source, self.segment = scheme, source, segment
        self.fields, self.surfaces = source.along(segment), source.channels.surfaces
        self.bound = source.channels.bound
        self.jumps = source.channels.jumps
        self.real = type(segment.length)

    def inside(self, s: Float) -> dict[str, Float]:
        """Return the fields at a place, if panels need them."""
        return self.fields.at(s) if self.fields.looks_inside else {}

    def again(self, arguments: tuple[Segment, ...]) -> _Ray:
        """Return it with the segment that a loop has as an argument."""
        return _Ray(self.scheme, self.source, *arguments) if arguments else self

    def solved(
        self, begin: Float, width: Float, nodes: list[Node], limits: Limits, front: Path
    ) -> tuple[Path, Mask]:
        """Return the solution of a panel without a jump inside, and where it may miss something.

        From five nodes; `front` is the part of the segment before it.
        """
        panel = self.fields.panel(nodes, begin, width)
        panel.without_jumps = bool(self.jumps)
        _, unresolved = self.bound.visible(panel)
        return solve_with_error(self.source, panel, limits.seen(front)), unresolved


def _segment(ray: _Ray, values: list[list[Float]], limits: Limits, nothing: Path) -> Path:
    with ray.scheme.recording():
        found, good = _as_one(ray, values, limits, nothing)
    ray.scheme.accepted(nothing, found, good)
    several = functools.partial(_in_panels, ray, nothing)
    path: Path = branch((values, limits, found), good, last_argument, several)
    return path


def _as_one(
    ray: _Ray, values: list[list[Float]], limits: Limits, nothing: Path
) -> tuple[Path, Mask]:
    real, fields = ray.real, ray.fields
    if records(ray.segment.length):  # scalars that were computed outside have no derivatives
        values = [fields.scalars(s) for s in PLACES]
    nodes = [(ray.inside(s), own) for s, own in zip(PLACES, values, strict=True)]
    whole = fields.panel(nodes[::2])
    count, uncounted = jumps_ahead(whole, ray.jumps)
    if all(ray.surfaces):
        good = ~uncounted & (count < 2)
        return _with_layer(ray, whole, good & (count > 0), nothing), good
    found, unresolved = ray.solved(real(0), real(1), nodes, limits, nothing)
    return found, ~unresolved & limits.accept(found) & (count == 0) & ~uncounted


@dataclass
class _State:
    """The loop over panels of one segment: where the next one begins, how wide it may be."""

    begin: Float
    width: Float
    node: Node
    path: Path


def _in_panels(
    ray: _Ray, nothing: Path, values: list[list[Float]], limits: Limits, found: Path
) -> Path:
    real = ray.real
    # Dr.Jit 1.5 loses the derivatives of what a loop in a loop uses besides its arguments.
    arguments = (ray.segment,) if records(ray.segment.length) else ()

    def going_on(state: _State, *_: Segment) -> Mask:
        return state.begin < 1.0

    def step(state: _State, *own: Segment) -> tuple[Any, ...]:
        with ray.scheme.recording():
            solved, good, last, width = _tried(ray.again(own), state, values[-1], limits, nothing)
        ray.scheme.accepted(state.path, solved, good)
        path = dr.select(good, over(state.path, solved), state.path)
        begin, width = next_panel(good, state.begin, width, state.width)
        return _State(begin, width, dr.select(good, last, state.node), path), *own

    first = ray.inside(0.0), values[0]
    state = _State(real(0), real(1.0 if ray.jumps else 0.5), first, nothing)
    end: _State
    end, *_ = loop((state, *arguments), going_on, step, label="panels")
    return end.path


def _tried(
    ray: _Ray, state: _State, after: list[Float], limits: Limits, nothing: Path
) -> tuple[Path, Mask, Node, Float]:
    """Return the next panel solved, where that is accurate enough, its end and its width.

    `after` are the scalars at the end of the segment.
    """
    fields, surface_only, begin, width = (
        ray.fields,
        all(ray.surfaces),
        state.begin,
        state.width,
    )
    recorded = records(ray.segment.length)
    first = fields.node(begin) if recorded else state.node  # loops carry no derivatives

    def up_to(width: Float) -> tuple[Node, Node]:
        """Return middle and end of a panel.

        At the end of the segment scalars equal the next segment's to the last bit; otherwise a
        crossing could be counted twice.
        """
        end = begin + width
        inside, values = fields.node(end)
        if not recorded:
            values = [dr.select(end >= 1.0, b, a) for a, b in zip(values, after, strict=True)]
        return fields.node(dr.fma(width, 0.5, begin)), (inside, values)

    middle, last = up_to(width)
    passed = uncounted = begin < 0.0
    if ray.jumps:
        trial = fields.panel([first, middle, last], begin, width)
        count, uncounted = jumps_ahead(trial, ray.jumps)
        passed = count > 0
        # A surface without width that is alone in a panel need not be at its end.
        several = count > (1 if surface_only else 0)
        behind = _BEHIND[precision_of(type(width))]
        cut = dr.fma(first_jump(trial, ray.jumps), width, behind)
        width = dr.select(several & (cut < width), cut, width)
        middle, last = up_to(width)
    least = width <= _NARROWEST
    if surface_only:
        solved, good = nothing, ~uncounted | least
    else:
        quarters = [fields.node(dr.fma(width, part, begin)) for part in (0.25, 0.75)]
        nodes = [first, quarters[0], middle, quarters[1], last]
        solved, unresolved = ray.solved(begin, width, nodes, limits, state.path)
        part = dr.select(width > _LEAST_PART, width, _LEAST_PART)
        good = (limits.times(part).accept(solved) & ~unresolved & ~uncounted) | least
        error = PathError(*solved.error)
        good |= dr.isnan(error.emission + error.transparency) & (width <= _NOT_FINITE)
    panel = fields.panel([first, middle, last], begin, width)
    panel.without_jumps = bool(ray.jumps)
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
    if not any(ray.surfaces):
        return solved

    def layered(solved: Path) -> Path:
        place: Float = 1.0
        if all(ray.surfaces) and ray.fields.looks_inside:
            place = first_jump(panel, ray.jumps)
        sheet = ray.bound.sheet(panel, place)
        assert sheet is not None  # some part is a surface
        path = layer(sheet.emissivity, sheet.extinction)
        zero = 0.0 * panel.length
        path.error = [zero, zero, ray.source.tolerance.brightness(path.emission)]
        return over(solved, path)

    result: Path = branch((solved,), passed, layered, last_argument)
    return result
