"""Coefficients that are linear along a segment: what second order and Olson-Kunasz share."""

from __future__ import annotations

from typing import Any

from ..backend import dr
from .contract import Keyed, Solution

# Coefficients at one end of a segment: j per emission, α per extinction.
End = tuple[list[Any], list[Any]]


def looked_up(
    source: Any, walk: Any, track: Any, cursor: Any, known: list[Any], moved: Any
) -> list[Any]:
    """Return the coefficients where rays are: looked up anew for those that have moved."""

    def anew(known: list[Any]) -> list[Any]:
        corners = walk.entry_corners(track, cursor)
        return list(source.interpolate(corners, moved & cursor.inside))

    def same(known: list[Any]) -> list[Any]:
        return known

    return list(dr.if_stmt((known,), moved, anew, same))


class Linear(Keyed):
    """Look coefficients up where the ray crosses walls, and solve what lies between.

    They are averaged to vertices and bilinear on walls. The values at one wall are carried along:
    each wall is looked up once.
    """

    order = 2
    place = "vertex"

    def start(self, source: Any, walk: Any, track: Any, cursor: Any) -> list[Any]:
        """Carry the values where the ray is."""
        return list(source.interpolate(walk.entry_corners(track, cursor), cursor.inside))

    def leapt(
        self, source: Any, walk: Any, track: Any, cursor: Any, carried: list[Any], moved: Any
    ) -> list[Any]:
        """Look up the values where rays are that crossed empty space."""
        return looked_up(source, walk, track, cursor, carried, moved)

    def solve(
        self, source: Any, walk: Any, track: Any, segment: Any, carried: list[Any], backward: bool
    ) -> tuple[Solution, list[Any]]:
        """Return the solution of one segment; see `schemes.contract.Scheme`."""
        reached = list(source.interpolate(walk.exit_corners(track, segment), segment.active))
        front, back = (reached, carried) if backward else (carried, reached)
        split = source.numbers.split
        return self.between(split(front), split(back), segment.length), reached

    def between(self, front: End, back: End, length: Any) -> Solution:
        """Return the solution of a segment from the coefficients at its two ends."""
        raise NotImplementedError
