"""A segment as a straight line through a cell in which fields are trilinear."""

from __future__ import annotations

from typing import Any

from ..backend import dr
from .contract import Segment
from .trilinear import Values, trilinear_cubic


class StraightChord:
    """Where a segment runs; a subclass knows the cell.

    What is asked for is computed where it is asked for, each time: what only a branch needs is
    computed in the branch.

    Parameters
    ----------
    walk, track, segment
        The segment, and how it was found. The track has `origin` and `direction`: the point where
        distances start, and the way per unit of distance, in the volume's unit.
    """

    def __init__(self, walk: Any, track: Any, segment: Segment) -> None:
        self.walk, self.track, self.segment = walk, track, segment

    @property
    def cell(self) -> Any:
        """Flat number of the cell."""
        return self.segment.cell

    @property
    def start(self) -> list[Any]:
        """Where it enters, as fractions of the cell along each axis."""
        return self._fractions(self.segment.begin)

    @property
    def end(self) -> list[Any]:
        """Where it leaves, as fractions of the cell along each axis."""
        return self._fractions(self.segment.end)

    @property
    def way(self) -> list[Any]:
        """How far it goes, as fractions of the cell along each axis."""
        return [b - a for a, b in zip(self.start, self.end, strict=True)]

    @property
    def position(self) -> list[Any]:
        """Where it enters, in the volume's coordinates."""
        return [
            dr.fma(self.segment.begin, d, o)
            for o, d in zip(self.track.origin, self.track.direction, strict=True)
        ]

    @property
    def step(self) -> list[Any]:
        """How far it goes, in the volume's coordinates."""
        return [self.segment.length * d for d in self.track.direction]

    def cubic(self, values: Values) -> list[Any]:
        """Return a field along the segment, from its values at the corners of the cell."""
        return trilinear_cubic(values, self.start, self.way)

    def parabola(self, values: Values) -> list[Any]:
        """Return the same: it is exact."""
        return self.cubic(values)

    def _fractions(self, t: Any) -> list[Any]:
        raise NotImplementedError
