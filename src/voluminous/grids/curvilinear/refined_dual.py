"""The walk through a refined curvilinear grid, with fields multilinear between corners of leaves.

Values at corners are chosen such that neighbours of any size agree on what is between them
(`rendering.sources.vertex_values`). In a leaf a field is linear in each of the grid's own
coordinates; along a ray the cubic through four of its values stands for it, as in
`curvilinear.field_walk`.
"""

from __future__ import annotations

import copy
from typing import Any

from ..contract import Segment
from .arithmetic import NUMBERS, Arithmetic
from .field_walk import CurvilinearChord
from .refined_walk import Leaf, RefinedWalk
from .smooth import Smooth, Smoothed


class RefinedChord(CurvilinearChord):
    """A segment through a leaf, a curve in its coordinates."""

    walk: Any

    def __init__(self, walk: RefinedFieldWalk, track: Any, segment: Segment) -> None:
        own: Any = walk
        super().__init__(own, track, segment)

    @property
    def cell(self) -> Any:
        """Flat number of the leaf."""
        return self.segment.cell

    def place(self, point: list[Any], own: Arithmetic = NUMBERS) -> list[Any]:
        return self.walk.fractions(self.segment.exit.left, point, own)


class RefinedFieldWalk(Smoothed, RefinedWalk):
    """Rays through a refined grid that know where in its leaves they are.

    Parameters
    ----------
    grid : RefinedCells
    walk : RefinedWalk
        The walk through its leaves, whose surfaces it takes over.
    backend : Backend
    """

    def __init__(self, grid: Any, walk: RefinedWalk, backend: Any) -> None:
        super().__init__(
            walk.families,
            walk.approach,
            grid.scale,
            backend,
            axes=walk.axes,
            grid=grid,
            stepped=True,
        )
        self.smooth = Smooth.of(grid, self.backend)
        self.length = self.backend.opaque(float(grid.scale))
        parts = [float(grid.divisions[axis]) for axis in self.axes]
        self.parts = [self.backend.opaque(p) for p in parts]
        self.wide = [_over(f, p) for f, p in zip(self.families, parts, strict=True)]

    def chord(self, track: Any, segment: Segment) -> RefinedChord:
        """Return a segment through its leaf."""
        return RefinedChord(self, track, segment)

    def fractions(self, leaf: Leaf, point: list[Any], own: Arithmetic) -> list[Any]:
        """Return where in leaves points are, from 0 to 1 along all three axes."""
        Float = self.backend.Float
        found = [Float(0)] * 3
        for axis, family, parts, low, size in zip(
            self.axes, self.wide, self.parts, leaf.low, leaf.size, strict=True
        ):
            found[axis] = own.stretched(family.fraction(low, point, own), parts / Float(size))
        return found


def _over(family: Any, parts: float) -> Any:
    """Return a family whose fractions are of as many finest cells as a base cell has.

    These are equally wide there, and a power of two: fractions of a leaf lose no digits.
    """
    wide = copy.copy(family)
    wide.inverse_width = family.inverse_width / parts
    wide.widest = family.widest * parts
    return wide
