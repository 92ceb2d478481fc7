"""Post-classified: fields are interpolated along the ray, and classified there.

Between cell centres a field is trilinear, so along a segment it is a cubic. Where a medium is
smooth along a whole segment, four samples give its integral and a bound of their error
(`smooth_segment`). Elsewhere a segment is cut into panels (`panel_loop`): solved with more samples,
or, with the medium's scalars nearly linear on them, in closed form (`Medium.means`). Those are
halved until a panel and its two halves agree, and what they differ by is the error that is kept
(`halving`).
"""

from __future__ import annotations

import functools
import math
from typing import Any

from ..backend import dr
from ..media.edges import edges_ahead
from .contract import Keyed, Solution
from .halving import attempt
from .in_front import InFront
from .panel_edges import surface_alone
from .panel_loop import in_panels
from .panels import known_stretch
from .path import Path, empty_path
from .smooth_segment import smooth_segment


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
        """Carry the scalars where the ray is (not known yet: NaN), and what is in front."""
        unknown = source.context.real(math.nan)
        real = source.backend.Float
        return [*(unknown for _ in source.scalars), real(1), real(0)]

    def leapt(
        self, source: Any, walk: Any, track: Any, cursor: Any, carried: list[Any], moved: Any
    ) -> list[Any]:
        """Forget the scalars of rays that crossed empty space."""
        *scalars, through, spent = carried
        return [*(dr.select(moved, math.nan, x) for x in scalars), through, spent]

    def passed(self, carried: list[Any], onward: list[Any]) -> list[Any]:
        """Go on with the scalars as they are there; what is not seen dims nothing."""
        return [*onward[:-2], *carried[-2:]]

    def solve(
        self, source: Any, walk: Any, track: Any, segment: Any, carried: list[Any], backward: bool
    ) -> tuple[Solution, list[Any]]:
        """Return the solution of one segment; see `schemes.contract.Scheme`."""
        *scalars, through, spent = carried
        in_front = InFront(through, spent)
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
            args=(cubics, known, segment.length, in_front, nothing),
            cond=visible & segment.active,
            true_fn=functools.partial(_visible, source, backward),
            false_fn=_invisible,
        )
        in_front = in_front.with_stretch(source, path, backward)
        after = [
            dr.select(segment.active, values[-1], before)
            for values, before in zip(known, scalars, strict=True)
        ]
        return path, [*after, in_front.transparency, in_front.spent]


def _invisible(cubics: Any, known: Any, length: Any, in_front: InFront, nothing: Path) -> Path:
    return nothing


def _visible(
    source: Any,
    backward: bool,
    cubics: Any,
    known: Any,
    length: Any,
    in_front: InFront,
    nothing: Path,
) -> Path:
    """Return a segment solved at once, or in panels where that is not good enough."""
    whole = known_stretch(source, cubics, known, length, rough=source.smooth)
    if source.smooth:
        found, good = smooth_segment(source, whole, in_front, backward)
        widest = 1.0 if source.quick else 0.5
    elif source.hollow:
        found, good = surface_alone(source, whole, cubics, known, length, nothing)
        widest = 1.0
    elif source.edges and source.finer:  # how dense it is
        found, _ = smooth_segment(source, whole, in_front, backward)
        good, widest = length < 0.0, 1.0
    else:
        found, good = attempt(source, whole, in_front, backward, length < 0.0)
        _, hidden = source.visible(whole)
        good &= ~hidden
        widest = 0.5
        if source.edges:
            count, _ = edges_ahead(whole, source.edges)
            good, widest = good & (count == 0), 1.0
    return dr.if_stmt(
        args=(cubics, known, length, in_front, nothing, found),
        cond=good,
        true_fn=_good_enough,
        false_fn=functools.partial(in_panels, source, backward, widest),
    )


def _good_enough(
    cubics: Any, known: Any, length: Any, in_front: InFront, nothing: Path, fine: Path
) -> Path:
    return fine
