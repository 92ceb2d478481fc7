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
from ..backend.functions import branch, precision_of, records
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
# After a panel whose error is below this part of its limit the next is twice as wide; one whose error
# is beyond it by this factor is divided by four (shaded CT: 0.94 of the time of halves and doubles).
_EASILY, _FAR = 1 / 16, 32.0
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

    def accepted(self, panel: Path, where: Mask) -> None:
        """Take note of an accepted panel."""

    def start(self, position: Position, source: FieldSource) -> list[Any]:
        """Carry the next panel: its first scalars, what lies in front, its beginning and width.

        Scalars are NaN where they are not computed yet. What lies in front is the transparency per
        extinction. Beginning and width are fractions of the segment.
        """
        unknown: Any = source.context.real(math.nan)
        real = source.backend.Float
        clear: Any = [real(1) for _ in range(source.channels.extinctions)]
        return [*(unknown for _ in source.channels.scalars), clear, real(0), real(1)]

    def after_skip(
        self, position: Position, source: FieldSource, carried: list[Any], moved: Mask
    ) -> list[Any]:
        *scalars, through, begin, width = carried
        return [*(dr.select(moved, math.nan, x) for x in scalars), through, begin, width]

    def solve(
        self, segment: Segment, source: FieldSource, carried: list[Any]
    ) -> tuple[Solution, list[Any]]:
        """Return the solution of the next panel of a segment, nothing where it is too wide.

        A ray goes on to the next segment when its own is solved (`Segment.unsolved`), whatever the
        others do: with a loop over the panels of each segment four of five lanes waited (a head CT
        at 1e-3: 2.08 s instead of 1.24).
        """
        *scalars, through, begin, width = carried
        ray = _Ray(self, source, segment)
        places = [begin, *(dr.fma(width, s, begin) for s in PLACES[1:-1]), begin + width]
        nodes = [ray.fields.node(s, culling_only=True) for s in places]
        nodes[0] = nodes[0][0], begin_values(segment, ray.fields, scalars, begin)
        culled = ray.fields.panel(nodes, begin, width, culling_only=True)
        visible, _ = ray.bound.visible(culled)
        channels, tolerance = source.channels, source.tolerance
        nothing = empty_path(source.backend.Float, channels.emissions, channels.extinctions, 3)
        through = dr.detach(through)  # what is accepted has no derivative
        clearest = most(through)
        behind = 1.0 / dr.select(clearest > 1e-6, clearest, 1e-6)
        limits = Limits(tolerance.emission * behind, tolerance.transparency * behind, through)
        values = [scalars for _, scalars in nodes]
        visible &= segment.active
        tried = _Tried(width, values[-1], ~(visible & False), nothing, type(width)(2.0))
        tried = branch(
            args=(begin, values, limits, tried),
            cond=visible,
            true_fn=functools.partial(_solved, ray),
            false_fn=last_argument,
        )
        good, path = tried.good, tried.path
        segment.unsolved = segment.active & ~(good & (begin + tried.width >= 1.0))
        through = [a * b for a, b in zip(through, path.transparency, strict=True)]
        after = [
            dr.select(segment.active & good, value, before)
            for value, before in zip(tried.last, values[0], strict=True)
        ]
        begin, width = next_panel(good, begin, tried.width, width, tried.step)
        begin = dr.select(segment.unsolved, begin, 0.0)
        return path, [*after, through, begin, dr.select(segment.unsolved, width, 1.0)]


@dataclass
class _Tried:
    """A panel that was tried: its width, its last scalars, and its path where it is `good`."""

    width: Float
    last: list[Float]
    good: Mask
    path: Path
    step: Float


class _Ray:
    """A segment of a ray while it is solved."""

    def __init__(self, scheme: PostClassified, source: FieldSource, segment: Segment) -> None:
        self.scheme, self.source, self.segment = scheme, source, segment
        self.fields, self.surfaces = source.along(segment), source.channels.surfaces
        self.bound = source.channels.bound
        self.jumps = source.channels.jumps

    def inside(self, s: Float) -> dict[str, Float]:
        """Return the fields at a place, if panels need them."""
        return self.fields.at(s) if self.fields.looks_inside else {}

    def solved(
        self, begin: Float, width: Float, nodes: list[Node], limits: Limits
    ) -> tuple[Path, Mask]:
        """Return the solution of a panel without a jump inside, and where it may miss something.

        From five nodes.
        """
        panel = self.fields.panel(nodes, begin, width)
        panel.without_jumps = bool(self.jumps)
        _, unresolved = self.bound.visible(panel)
        return solve_with_error(self.source, panel, limits.seen()), unresolved


def _solved(
    ray: _Ray, begin: Float, values: list[list[Float]], limits: Limits, tried: _Tried
) -> _Tried:
    with ray.scheme.recording():
        found = _in_detail(ray, begin, values, limits, tried)
    ray.scheme.accepted(found.path, found.good)
    found.path = dr.select(found.good, found.path, tried.path)
    return found


def _in_detail(
    ray: _Ray, begin: Float, values: list[list[Float]], limits: Limits, tried: _Tried
) -> _Tried:
    """Return a panel, up to the first jump of the medium, and where it is accurate enough."""
    fields, surface_only, width = ray.fields, all(ray.surfaces), tried.width

    def places(width: Float) -> list[Float]:
        return [begin, *(dr.fma(width, s, begin) for s in PLACES[1:-1]), begin + width]

    if records(ray.segment.length):  # scalars that were computed outside have no derivatives
        values = [fields.scalars(s) for s in places(width)]
    nodes = [(ray.inside(s), own) for s, own in zip(places(width), values, strict=True)]
    passed = uncounted = begin < 0.0
    if ray.jumps:
        trial = fields.panel(nodes[::2], begin, width)
        count, uncounted = jumps_ahead(trial, ray.jumps)
        passed = count > 0
        # A surface without width that is alone in a panel need not be at its end.
        several = count > (1 if surface_only else 0)

        def cut(width: Float, nodes: list[Node]) -> tuple[Float, list[Node]]:
            behind = _BEHIND[precision_of(type(width))]
            cut = dr.fma(first_jump(trial, ray.jumps), width, behind)
            width = dr.select(cut < width, cut, width)
            return width, [nodes[0], *map(fields.node, places(width)[1:])]

        width, nodes = branch((width, nodes), several, cut, _as_they_are)
    least, more, less = width <= _NARROWEST, type(width)(2.0), type(width)(0.5)
    if surface_only:
        solved, good = tried.path, ~uncounted | least
    else:
        solved, unresolved = ray.solved(begin, width, nodes, limits)
        part = dr.select(width > _LEAST_PART, width, _LEAST_PART)
        limits = limits.times(part)
        more = dr.select(limits.times(_EASILY).accept(solved), more, 2.0 * less)
        less = dr.select(limits.times(_FAR).accept(solved), less, 0.5 * less)
        good = (limits.accept(solved) & ~unresolved & ~uncounted) | least
        error = PathError(*solved.error)
        good |= dr.isnan(error.emission + error.transparency) & (width <= _NOT_FINITE)
    panel = fields.panel(nodes[::2], begin, width)
    panel.without_jumps = bool(ray.jumps)
    solved = _with_layer(ray, panel, good & passed, solved)
    return _Tried(width, nodes[-1][1], good, solved, dr.select(good, more, less))


def _as_they_are(*arguments: Any) -> Any:
    return arguments


def next_panel(
    good: Mask, begin: Float, width: Float, tried: Float, step: Float = 2.0
) -> tuple[Float, Float]:
    """Return beginning and width of the next panel, as fractions of the segment.

    After an accepted panel the width is doubled, if there is room; a rejected panel is halved. If
    a jump made the panel narrower than `tried`, the next panel has at least that width.
    """
    begin = dr.select(good, begin + width, begin)
    wider = dr.select(step * width > tried, step * width, tried)
    width = dr.select(good, wider, dr.select(step < 1.0, step, 0.5) * width)
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
