"""A segment as a straight line through a cell in which fields are trilinear."""

from __future__ import annotations

from typing import Any

from ..backend import dr
from ..backend.functions import horner
from ..backend.types import Float, Int
from .contract import Segment

# Values at the corners of a cube: values[x][y][z].
Values = list[list[list[Float]]]


def trilinear(values: Values, place: list[Float]) -> Float:
    """Return a trilinear function at a place in the unit cube."""
    edges = [
        [horner(place[0], [values[0][b][c], values[1][b][c] - values[0][b][c]]) for c in (0, 1)]
        for b in (0, 1)
    ]
    faces = [horner(place[1], [edges[0][c], edges[1][c] - edges[0][c]]) for c in (0, 1)]
    return horner(place[2], [faces[0], faces[1] - faces[0]])


def trilinear_cubic(values: Values, start: list[Float], run: list[Float]) -> list[Float]:
    """Return a trilinear function along a straight line, as a cubic (power basis)."""
    edges = [
        [_line(values[0][b][c], values[1][b][c], start[0], run[0]) for c in (0, 1)] for b in (0, 1)
    ]
    faces = [_blend(edges[0][c], edges[1][c], start[1], run[1]) for c in (0, 1)]
    return _blend(faces[0], faces[1], start[2], run[2])


def _line(low: Float, high: Float, start: Float, run: Float) -> list[Float]:
    rise = high - low
    return [horner(start, [low, rise]), rise * run]


def _blend(low: list[Float], high: list[Float], start: Float, run: Float) -> list[Float]:
    rise = [b - a for a, b in zip(low, high, strict=True)]
    here = [horner(start, [a, r]) for a, r in zip(low, rise, strict=True)]
    onward = [r * run for r in rise]
    inner = [a + b for a, b in zip(here[1:], onward[:-1], strict=True)]
    return [here[0], *inner, onward[-1]]


class StraightChord:
    """Where a segment runs; a subclass knows the cell.

    What is asked for is computed where it is asked for, each time: what only a branch needs is
    computed in the branch.
    """

    width: Float = None  # it is in a single cell

    def __init__(self, walk: Any, track: Any, segment: Segment) -> None:
        self.walk, self.track, self.segment = walk, track, segment

    @property
    def cell(self) -> Int:
        """Flat number of the cell."""
        return self.segment.cell

    @property
    def start(self) -> list[Float]:
        """Where it enters, as fractions of the cell along each axis."""
        return self._fractions(self.segment.begin)

    @property
    def end(self) -> list[Float]:
        """Where it leaves, as fractions of the cell along each axis."""
        return self._fractions(self.segment.end)

    @property
    def run(self) -> list[Float]:
        """How far it goes, as fractions of the cell along each axis."""
        return [b - a for a, b in zip(self.start, self.end, strict=True)]

    @property
    def position(self) -> list[Float]:
        """Where it enters, in the volume's coordinates."""
        return [
            dr.fma(self.segment.begin, d, o)
            for o, d in zip(self.track.origin, self.track.direction, strict=True)
        ]

    @property
    def step(self) -> list[Float]:
        """How far it goes, in the volume's coordinates."""
        return [self.segment.length * d for d in self.track.direction]

    def cubic(self, values: Values) -> list[Any]:
        """Return a field along the segment, from its values at the corners of the cell."""
        return trilinear_cubic(values, self.start, self.run)

    def at(self, s: Float) -> tuple[Any, list[Float]]:
        return self, [dr.fma(s, b - a, a) for a, b in zip(self.start, self.end, strict=True)]

    def _fractions(self, t: Float) -> list[Float]:
        raise NotImplementedError
