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
from .base import Fields, FieldScheme, FieldSource, Node, Position, Solution
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
# The next panel is twice as wide if the error is below this part of its limit; a quarter of one is
# next whose error is beyond it by this factor (shaded CT: 0.94 of the time of doubles and halves).
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
        ray = _Ray(self, source, source.along(segment), begin)
        nodes = [ray.fields.node(s, culling_only=True) for s in ray.places(width)]
        nodes[0] = nodes[0][0], begin_values(segment, ray.fields, scalars, begin)
        channels, tolerance = source.channels, source.tolerance
        culled = ray.fields.panel(nodes, begin, width, culling_only=True)
        visible, _ = channels.bound.visible(culled)
        nothing = empty_path(source.backend.Float, channels.emissions, channels.extinctions, 3)
        through = dr.detach(through)  # what is accepted has no derivative
        clearest = most(through)
        behind = 1.0 / dr.select(clearest > 1e-6, clearest, 1e-6)
        limits = Limits(tolerance.emission * behind, tolerance.transparency * behind, through)
        values = [scalars for _, scalars in nodes]
        active = segment.active
        tried = _Tried(width, values[-1], active | True, nothing, type(width)(2.0))
        tried = branch(
            (values, limits, tried), visible & active, functools.partial(_tried, ray), last_argument
        )
        good, path, end = tried.good, tried.path, begin + tried.width
        segment.unsolved = active & ~(good & (end >= 1.0))
        through = [a * b for a, b in zip(through, path.transparency, strict=True)]
        pairs = zip(tried.last, values[0], strict=True)
        after = [dr.select(active & good, value, before) for value, before in pairs]
        begin, width = next_panel(good, begin, tried.width, width, tried.step)
        begin = dr.select(segment.unsolved, begin, 0.0)
        return path, [*after, through, begin, dr.select(segment.unsolved, width, 1.0)]


@dataclass
class _Tried:
    """A panel that was tried: its width, its last scalars, and its path where it is `good`.

    `step` is a factor on the width, for the next one.
    """

    width: Float
    last: list[Float]
    good: Mask
    path: Path
    step: Float


@dataclass
class _Ray:
    """Where a ray is in a segment, while the panel that begins there is solved."""

    scheme: PostClassified
    source: FieldSource
    fields: Fields
    begin: Float

    def places(self, width: Float) -> list[Float]:
        """Return the five places of a panel."""
        inner = (dr.fma(width, s, self.begin) for s in PLACES[1:-1])
        return [self.begin, *inner, self.begin + width]


def _tried(ray: _Ray, values: list[list[Float]], limits: Limits, tried: _Tried) -> _Tried:
    with ray.scheme.recording():
        found = _in_detail(ray, values, limits, tried)
    ray.scheme.accepted(found.path, found.good)
    found.path = dr.select(found.good, found.path, tried.path)
    return found


def _in_detail(ray: _Ray, values: list[list[Float]], limits: Limits, tried: _Tried) -> _Tried:
    """Return a panel, up to the first jump of the medium, and where it is accurate enough."""
    fields, begin, width, channels = ray.fields, ray.begin, tried.width, ray.source.channels
    surface_only, jumps, real = all(channels.surfaces), channels.jumps, type(width)
    if records(width):  # scalars that were computed outside have no derivatives
        values = [fields.scalars(s) for s in ray.places(width)]
    nodes = [(fields.node(s)[0], own) for s, own in zip(ray.places(width), values, strict=True)]
    passed = uncounted = begin < 0.0
    if jumps:
        trial = fields.panel(nodes[::2], begin, width)
        count, uncounted = jumps_ahead(trial, jumps)
        passed = count > 0
        # A surface without width that is alone in a panel need not be at its end.
        several = count > (1 if surface_only else 0)

        def cut(width: Float, nodes: list[Node]) -> tuple[Float, list[Node]]:
            behind = _BEHIND[precision_of(real)]
            cut = dr.fma(first_jump(trial, jumps), width, behind)
            width = dr.select(several & (cut < width), cut, width)
            return width, [nodes[0], *map(fields.node, ray.places(width)[1:])]

        width, nodes = branch((width, nodes), several, cut, lambda *same: same)
    least, more, less = width <= _NARROWEST, real(2.0), real(0.5)
    if surface_only:
        solved, good = tried.path, ~uncounted | least
    else:
        panel = fields.panel(nodes, begin, width)
        panel.without_jumps = bool(jumps)
        _, unresolved = channels.bound.visible(panel)
        solved = solve_with_error(ray.source, panel, limits.seen())
        limits = limits.times(dr.select(width > _LEAST_PART, width, _LEAST_PART))
        more = dr.select(limits.times(_EASILY).accept(solved), more, real(1.0))
        less = dr.select(limits.times(_FAR).accept(solved), less, real(0.25))
        good = (limits.accept(solved) & ~unresolved & ~uncounted) | least
        error = PathError(*solved.error)
        good |= dr.isnan(error.emission + error.transparency) & (width <= _NOT_FINITE)
    panel = fields.panel(nodes[::2], begin, width)
    panel.without_jumps = bool(jumps)
    solved = _with_layer(ray, panel, good & passed, solved)
    return _Tried(width, nodes[-1][1], good, solved, dr.select(good, more, less))


def next_panel(
    good: Mask, begin: Float, width: Float, tried: Float, step: Float = 2.0
) -> tuple[Float, Float]:
    """Return beginning and width of the next panel, as fractions of the segment.

    After an accepted panel the width is `step` times as large, if there is room; a rejected one is
    halved, or divided by more. If a jump made the panel narrower than `tried`, the next panel has
    at least that width.
    """
    begin = dr.select(good, begin + width, begin)
    wider = dr.select(step * width > tried, step * width, tried)
    width = dr.select(good, wider, dr.select(step < 1.0, step, 0.5) * width)
    return begin, dr.select(width < 1.0 - begin, width, 1.0 - begin)


def _with_layer(ray: _Ray, panel: Panel, passed: Mask, solved: Path) -> Path:
    channels = ray.source.channels
    if not any(channels.surfaces):
        return solved

    def layered(solved: Path) -> Path:
        place: Float = 1.0
        if all(channels.surfaces) and ray.fields.looks_inside:
            place = first_jump(panel, channels.jumps)
        sheet = channels.bound.sheet(panel, place)
        assert sheet is not None  # some part is a surface
        path = layer(sheet.emissivity, sheet.extinction)
        zero = 0.0 * panel.length
        path.error = [zero, zero, ray.source.tolerance.brightness(path.emission)]
        return over(solved, path)

    result: Path = branch((solved,), passed, layered, last_argument)
    return result
