"""Post-classified: fields are interpolated along the ray, and classified there.

Between cell centres a field is trilinear, so along a segment it is a cubic. Where a medium is
smooth along a whole segment, four samples give its integral and a bound of their error
(`smooth_segment`). Elsewhere a segment is cut into panels on which the medium's scalars are nearly
linear, and its integrals known in closed form (`Medium.means`): panels are halved until a panel and
its two halves agree, and what they differ by is the error that is kept (`halving`).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

from ..backend import dr
from .contract import Keyed, Solution
from .halving import attempt
from .panels import next_panel
from .path import Path, empty_path, most, over
from .smooth_segment import smooth_segment

# Panels are not made narrower than this fraction of a segment. With 2^-8 in single precision, three
# surfaces of noise in a 500th of a cell were off by 0.1 of the maximum, in more time; where panels
# at jumps of gates stopped there, in 0.7 of the time, 4 to 28 % of pixels were beyond their error.
_NARROWEST = 2.0**-14
# What is no number in panels as narrow as that is none in narrower ones: of a negative extinction
# pictures of 20 x 20 pixels took minutes until they were refused.
_NO_NUMBER = 2.0**-4


@dataclass
class Progress:
    """How far the halving of one segment is: where, how wide, and what has been gathered."""

    begin: Any
    width: Any
    scalars: list[Any]
    path: Path


class PostClassified(Keyed):
    """Classify what is interpolated, to a tolerance."""

    name = "post-classified"
    order = 2
    place = "field"
    linear = True
    controlled = True
    reckoned = False
    coarseness = 0.0

    def start(self, source: Any, walk: Any, track: Any, cursor: Any) -> list[Any]:
        """Carry the scalars where the ray is (not known yet: NaN), and its transparency."""
        unknown = source.context.real(math.nan)
        return [*(unknown for _ in source.scalars), source.backend.Float(1)]

    def leapt(
        self, source: Any, walk: Any, track: Any, cursor: Any, carried: list[Any], moved: Any
    ) -> list[Any]:
        """Forget the scalars of rays that crossed empty space."""
        *scalars, seen_through = carried
        return [*(dr.select(moved, math.nan, x) for x in scalars), seen_through]

    def passed(self, carried: list[Any], onward: list[Any]) -> list[Any]:
        """Go on with the scalars as they are there; what is not seen dims nothing."""
        return [*onward[:-1], carried[-1]]

    def solve(
        self, source: Any, walk: Any, track: Any, segment: Any, carried: list[Any], backward: bool
    ) -> tuple[Solution, list[Any]]:
        """Return the solution of one segment; see `schemes.contract.Scheme`."""
        *scalars, seen_through = carried
        chord = walk.chord(track, segment)
        cubics = source.cubics(chord, source.corners(chord, segment.active))
        # Closely only where something may show: a shell in the radius takes a sixth of the time so.
        whole = source.stretch(cubics, segment.length, rough=True)
        for expr, before in zip(source.scalars, scalars, strict=True):
            fresh = whole.scalar(expr, 0.0)
            whole.set_scalar(expr, 0.0, dr.select(dr.isnan(before), fresh, before))
        visible, _ = source.visible(whole)
        known = [whole.known(expr) for expr in source.scalars]
        numbers = source.numbers
        nothing = empty_path(source.backend.Float, numbers.emissions, numbers.extinctions, 3)
        path = dr.if_stmt(
            args=(cubics, known, segment.length, seen_through, nothing),
            cond=visible & segment.active,
            true_fn=functools.partial(_visible, source, backward),
            false_fn=_invisible,
        )
        if not backward:
            seen_through = seen_through * most(path.transparency)
        after = [
            dr.select(segment.active, values[-1], before)
            for values, before in zip(known, scalars, strict=True)
        ]
        return path, [*after, seen_through]


def _invisible(cubics: Any, known: Any, length: Any, seen_through: Any, nothing: Path) -> Path:
    return nothing


def _visible(
    source: Any,
    backward: bool,
    cubics: Any,
    known: Any,
    length: Any,
    seen_through: Any,
    nothing: Path,
) -> Path:
    """Return a segment solved at once, or in panels where that is not good enough."""
    whole = _stretch(source, cubics, known, length, rough=source.smooth)
    if source.smooth:
        found, good = smooth_segment(source, whole, seen_through, backward)
        widest = 1.0
    else:
        found, good = attempt(source, whole, seen_through, backward, seen_through < 0.0)
        _, hidden = source.visible(whole)
        good, widest = good & ~hidden, 0.5
    return dr.if_stmt(
        args=(cubics, known, length, seen_through, nothing, found),
        cond=good,
        true_fn=_good_enough,
        false_fn=functools.partial(_in_panels, source, backward, widest),
    )


def _stretch(source: Any, cubics: Any, known: Any, length: Any, *, rough: bool = False) -> Any:
    """Return a segment's stretch with what was computed of it outside of a branch."""
    whole = source.stretch(cubics, length, rough=rough)
    for expr, values in zip(source.scalars, known, strict=True):
        whole.set_known(expr, values)
    return whole


def _good_enough(
    cubics: Any, known: Any, length: Any, seen_through: Any, nothing: Path, fine: Path
) -> Path:
    return fine


def _in_panels(
    source: Any,
    backward: bool,
    widest: float,
    cubics: Any,
    known: Any,
    length: Any,
    seen_through: Any,
    nothing: Path,
    found: Path,
) -> Path:
    """Return a segment solved in panels that are narrow enough.

    The first of them is as wide as `widest` of the segment, if it can be.
    """
    real = type(length)
    whole = _stretch(source, cubics, known, length)

    def going_on(state: Progress) -> Any:
        return state.begin < 1.0

    def step(state: Progress) -> tuple[Progress]:
        part = whole.part(state.begin, state.width)
        last = state.begin + state.width >= 1.0
        for expr, value, values in zip(source.scalars, state.scalars, known, strict=True):
            part.set_scalar(expr, 0.0, value)
            # To the last bit where the next segment begins, lest a crossing be counted twice.
            part.set_scalar(expr, 1.0, dr.select(last, values[-1], part.scalar(expr, 1.0)))
        seen = seen_through if backward else seen_through * most(state.path.transparency)
        least = state.width <= _NARROWEST
        found, good = attempt(source, part, seen, backward, least)
        _, hidden = source.visible(part)
        no_number = dr.isnan(found.error[0] + found.error[1]) & (state.width <= _NO_NUMBER)
        good = (good & ~hidden) | least | no_number
        front, back = (found, state.path) if backward else (state.path, found)
        panel = next_panel(good, state.begin, state.width)
        scalars = [
            dr.select(good, part.scalar(expr, 1.0), value)
            for expr, value in zip(source.scalars, state.scalars, strict=True)
        ]
        return (Progress(*panel, scalars, dr.select(good, over(front, back), state.path)),)

    starts = [values[0] for values in known]
    state = Progress(real(0), real(widest), starts, nothing)
    (state,) = dr.while_loop((state,), going_on, step, label="panels")
    return state.path
