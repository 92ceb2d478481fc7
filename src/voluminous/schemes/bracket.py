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
from ..backend.types import Float, Mask
from ..expressions.traced_rounding import positive
from ..grids.contract import Segment
from .base import Position, Scheme, Solution
from .panel_bounds import solve_parts
from .path import Path, empty_path, most, over
from .post_classified import next_panel

# No panel is made narrower than this fraction of a segment: at a jump nothing else would end it.
_NARROWEST = 2.0**-24
# The part of the budget that may be spent anywhere.
_SHARE = 0.25


@dataclass
class BracketState:
    """How far a segment is: where, how wide the next panel is, panels tried, what is gathered."""

    begin: Float
    width: Float
    tried: Float
    path: Path


class Bracket(Scheme):
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
    coefficients_at = "field"
    linear = False

    def __init__(self, budget: int, signed: bool) -> None:
        self.budget, self.signed = budget, signed

    def start(self, position: Position, source: Any) -> list[Float]:
        """Carry how much of what is emitted may be seen, and where fields are (not known yet)."""
        return [source.backend.Float(1), *source.unknown()]

    def after_skip(
        self, position: Position, source: Any, carried: list[Float], moved: Mask
    ) -> list[Float]:
        """Forget where fields were beyond empty space."""
        seen, *before = carried
        return [seen, *(dr.select(moved, math.nan, value) for value in before)]

    def after_hidden(self, carried: list[Float], onward: list[Float]) -> list[Float]:
        """Go on with the fields as they are there; what is not seen dims nothing."""
        return [carried[0], *onward[1:]]

    def solve(
        self, segment: Segment, source: Any, carried: list[Float]
    ) -> tuple[Solution, list[Float]]:
        """Return the bounds of one segment."""
        seen, *before = carried
        real = source.backend.Float
        cubics = source.along(segment)
        budget = dr.opaque(real, self.budget)

        def going_on(state: BracketState) -> Float:
            return state.begin < 1.0

        def step(state: BracketState) -> tuple[BracketState]:
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
                BracketState(*next_panel(good, state.begin, state.width, state.width), tried, path),
            )

        count = source.numbers.emissions
        nothing = empty_path(real, count, count)
        # A jump to where the segment begins is a panel of its own, before it.
        begin = dr.select(source.jumps(cubics, before), real(-1), 0)
        begin = dr.select(segment.active, begin, 1)
        state = BracketState(begin, real(1), real(0), nothing)
        (state,) = dr.while_loop((state,), going_on, step, label="bracket")
        after = [
            dr.select(segment.active, there, here)
            for there, here in zip(source.ends(cubics), before, strict=True)
        ]
        return state.path, [seen * most(state.path.transparency), *after]

    def _bounded(self, parts: Any) -> tuple[Path, tuple[Float, Float]]:
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
