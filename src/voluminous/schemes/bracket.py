"""Guaranteed bounds along a ray: post-classified, with intervals in place of numbers.

Coefficients are bracketed over the range of the interpolant on each panel of a segment (Novins,
Arvo & Salesin 1992, *Adaptive error bracketing for controlled-precision volume rendering*), and
panels halved until the bracket is narrow enough, or the budget spent. What is kept of a path are
lower and upper emissions and transparencies, which compose like others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from ..backend import dr
from ..expressions.traced_rounding import positive
from .contract import Solution
from .panel_bounds import solve_parts
from .panels import next_panel
from .path import Path, empty_path, most, over

# No panel is made narrower than this fraction of a segment: at a jump nothing else would end it.
_NARROWEST = 2.0**-24
# The part of the budget that may be spent anywhere.
_SHARE = 0.25


@dataclass
class Progress:
    """How far a segment is: where, how wide the next panel is, panels tried, what is gathered."""

    begin: Any
    width: Any
    tried: Any
    path: Path


class Bracket:
    """Bounds of what post-classified tends to.

    Parameters
    ----------
    budget : int
        About how many panels are tried per segment, at most.
    signed : bool
        The emissivity may be negative: what is negative is kept as emissions of its own.
    """

    name = "bracket"
    order = 2
    place = "field"
    linear = False
    controlled = False
    reckoned = False
    coarseness = 0.0

    def __init__(self, budget: int, signed: bool) -> None:
        self.budget, self.signed = budget, signed

    def start(self, source: Any, walk: Any, track: Any, cursor: Any) -> list[Any]:
        """Carry how much of what is emitted may be seen, and where fields are (not known yet)."""
        return [source.backend.Float(1), *source.unknown()]

    def leapt(
        self, source: Any, walk: Any, track: Any, cursor: Any, carried: list[Any], moved: Any
    ) -> list[Any]:
        """Forget where fields were beyond empty space."""
        seen, *before = carried
        return [seen, *(dr.select(moved, math.nan, value) for value in before)]

    def passed(self, carried: list[Any], onward: list[Any]) -> list[Any]:
        """Go on with the fields as they are there; what is not seen dims nothing."""
        return [carried[0], *onward[1:]]

    def solve(
        self, source: Any, walk: Any, track: Any, segment: Any, carried: list[Any], backward: bool
    ) -> tuple[Solution, list[Any]]:
        """Return the bounds of one segment; see `schemes.contract.Scheme`."""
        seen, *before = carried
        real = source.backend.Float
        cubics = source.cubics(walk.chord(track, segment), segment.active)
        budget = dr.opaque(real, self.budget)

        def going_on(state: Progress) -> Any:
            return state.begin < 1.0

        def step(state: Progress) -> tuple[Progress]:
            courses = source.courses(cubics, segment.length, state.begin, state.width)
            found, gaps = self._bounded(source.parts(courses))
            wrong, dim = (gap * seen for gap in gaps)
            good = ~(wrong > source.tolerance[0]) & ~(dim > source.tolerance[1])
            tried = state.tried + 1.0
            end = state.begin + state.width
            # The budget is spent evenly along the segment, but for a share where it is needed most.
            good |= tried >= budget * (_SHARE + (1.0 - _SHARE) * end)
            good |= (state.width <= _NARROWEST) | (state.begin < 0.0)
            path = dr.select(good, over(state.path, found), state.path)
            return (
                Progress(*next_panel(good, state.begin, state.width, state.width), tried, path),
            )

        count = source.numbers.emissions
        nothing = empty_path(real, count, count)
        # A jump to where the segment begins is a panel of its own, before it.
        begin = dr.select(source.jumps(cubics, before), real(-1), 0)
        begin = dr.select(segment.active, begin, 1)
        state = Progress(begin, real(1), real(0), nothing)
        (state,) = dr.while_loop((state,), going_on, step, label="bracket")
        after = [
            dr.select(segment.active, there, here)
            for there, here in zip(source.ends(cubics), before, strict=True)
        ]
        return state.path, [seen * most(state.path.transparency), *after]

    def _bounded(self, parts: Any) -> tuple[Path, tuple[Any, Any]]:
        emission, transparency = solve_parts(parts)
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
        # In place of depths: how many panels there are, each of which rounds.
        one = type(found[0])(1)
        return Path(found, theta, [one for _ in found]), gaps
