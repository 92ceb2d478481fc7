"""Post-classified without error control: every segment is one panel.

The value of each scalar where the ray leaves a cell is all that is computed: the medium's integrals
between that and the value where it entered are known in closed form. Where the scalars are nearly
linear over cubes of 2, 4 or 8 cells, those are one segment. That takes a half to a sixth of
the time that is taken where errors are looked at, but nobody knows how far it is off: of second
order in the cell size, and blind to what lies between the ends of a segment.
"""

from __future__ import annotations

import functools
import math
from typing import Any

from ..backend import dr
from .contract import Keyed, Solution
from .path import Path, empty_path, layer

# The core of the note: 1.9e-3 of the maximum rms, and 0.9 of the steps that 0.1 takes (1.6e-3).
_COARSENESS = 0.2


class OnePanel(Keyed):
    """Classify what is interpolated, one panel per segment.

    Parameters
    ----------
    coarseness : float
        Segments may be wider than a cell where the medium's scalars are linear but for this
        fraction of the width of its structures, and more where little of those shows.
    """

    name = "post-classified"
    order = 2
    place = "field"
    linear = True
    controlled = False
    reckoned = False

    def __init__(self, coarseness: float = _COARSENESS) -> None:
        self.coarseness = coarseness

    def start(self, source: Any, walk: Any, track: Any, cursor: Any) -> list[Any]:
        """Carry the scalars where the ray is: not known yet."""
        return [source.context.real(math.nan) for _ in source.scalars]

    def leapt(
        self, source: Any, walk: Any, track: Any, cursor: Any, carried: list[Any], moved: Any
    ) -> list[Any]:
        """Forget the scalars of rays that crossed empty space."""
        return [dr.select(moved, math.nan, x) for x in carried]

    def solve(
        self, source: Any, walk: Any, track: Any, segment: Any, carried: list[Any], backward: bool
    ) -> tuple[Solution, list[Any]]:
        """Return the solution of one segment; see `schemes.contract.Scheme`."""
        chord = walk.chord(track, segment)
        corners = source.corners(chord, segment.active)
        stretch = _straight(source, chord, corners, segment.length)
        last = source.values(chord, corners, 1.0)
        for expr, before in zip(source.scalars, carried, strict=True):
            first = dr.if_stmt(
                args=(before,),
                cond=dr.isnan(before),
                true_fn=functools.partial(_fresh, source, expr, chord, corners),
                false_fn=_known,
            )
            stretch.set_scalar(expr, 0.0, first)
            stretch.set_scalar(expr, 1.0, source.context.evaluate(expr, last))
        known = [[stretch.scalar(expr, s) for s in (0.0, 1.0)] for expr in source.scalars]
        visible, _ = source.visible(stretch)
        path = dr.if_stmt(
            args=(known, segment.length),
            cond=visible & segment.active,
            true_fn=functools.partial(_visible, source, chord, corners),
            false_fn=functools.partial(_invisible, source),
        )
        return path, [
            dr.select(segment.active, ends[1], before)
            for ends, before in zip(known, carried, strict=True)
        ]


def _straight(source: Any, chord: Any, corners: Any, length: Any) -> Any:
    """Return a segment's stretch, with the fields along it if the medium looks at them."""
    inside = source.cubics(chord, corners, rough=True) if source.looks_inside else {}
    return source.straight(inside, length)


def _fresh(source: Any, expr: Any, chord: Any, corners: Any, before: Any) -> Any:
    return source.context.evaluate(expr, source.values(chord, corners, 0.0))


def _known(before: Any) -> Any:
    return before


def _invisible(source: Any, known: Any, length: Any) -> Path:
    return empty_path(type(length), source.numbers.emissions, source.numbers.extinctions)


def _visible(source: Any, chord: Any, corners: Any, known: Any, length: Any) -> Path:
    stretch = _straight(source, chord, corners, length)
    for expr, ends in zip(source.scalars, known, strict=True):
        for s, value in zip((0.0, 1.0), ends, strict=True):
            stretch.set_scalar(expr, s, value)
    return solved(source, stretch.panel(0.0, 1.0))


def solved(source: Any, panel: Any) -> Path:
    """Return a panel solved with its mean coefficients."""
    j, alpha = source.means(panel)
    length = panel.length
    return layer([jc * length for jc in j], [a * length for a in alpha])
