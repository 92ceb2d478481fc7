"""The walk through a refined curvilinear grid, with fields multilinear between corners of leaves.

Values at corners are chosen such that neighbours of any size agree on what is between them
(`rendering.sources.vertex_values`). In a leaf a field is linear in each of the grid's own
coordinates; along a ray the cubic through four of its values stands for it, as in
`curvilinear.field_walk`.
"""

from __future__ import annotations

import copy
import functools
import operator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr
from ...backend.types import Float, Int, Mask
from ..contract import Corners, Segment
from ..lanes import greater, least, lesser, nearest, trilinear
from ..trees.tree import TreeLookup
from .field_walk import SmoothWalk
from .surfaces import Arithmetic, Surfaces, TurningPoint
from .walk import CurvilinearWalk, SurfaceCursor, SurfaceExit, SurfaceTrack, norm

if TYPE_CHECKING:
    from ...backend.device import Backend


@dataclass
class Leaf:
    """A leaf, one per lane: its number, and corners and sizes in finest units, per family."""

    number: Int
    low: list[Int]
    size: list[Int]


@dataclass
class RefinedCursor(SurfaceCursor):
    """Also the leaf that the ray is in; `ahead` is empty."""

    leaf: Leaf


@dataclass
class RefinedExit(SurfaceExit):
    """Also the leaf that is left, and the one that is entered (`onward`: there is one)."""

    left: Leaf
    entered: Leaf
    onward: Mask


class RefinedWalk(CurvilinearWalk):
    """Rays through a refined spherical or cylindrical grid."""

    grid: Any

    def __init__(self, grid: Any, edges: Any, backend: Backend, stepped: bool = False) -> None:
        super().__init__(grid, edges, backend, stepped)
        self.lookup = TreeLookup(grid.tree, backend)

    def _strides(self, counts: list[int]) -> list[Int]:
        return []  # leaves have numbers of their own

    def _closest(self, track: SurfaceTrack) -> Float:
        return norm(track.point)

    def _standing(
        self, track: SurfaceTrack, count: list[Int], t: Float, inside: Mask
    ) -> RefinedCursor:
        Float, Int = self.backend.Float, self.backend.Int
        place = [Float(0.5)] * 3
        for axis, index in zip(self.axes, self.cells_near(track, count), strict=True):
            place[axis] = Float(index) + 0.5
        cell = self.lookup.find(place, self.lookup.orient(), inside)
        sizes = self.lookup.sizes(cell)
        low = [Int(cell.low[axis]) for axis in self.axes]
        size = [Int(sizes[axis]) for axis in self.axes]
        return RefinedCursor(count, [], t, inside, Leaf(cell.number, low, size))

    def next(self, track: SurfaceTrack, cursor: Any) -> tuple[Segment, RefinedCursor]:
        count, t, family = self._leave(track, cursor)
        inside = cursor.inside & (t < track.leave)
        onward = inside if not self.has_gaps else inside & ~self.in_gap(track, count)
        there = self._standing(track, count, t, inside)
        before = [dr.select(family == n, k - 1, k) for n, k in enumerate(count)]
        leaving = RefinedExit(family, before, t, cursor.leaf, there.leaf, onward)
        begin, end, active = cursor.t - track.arrive, t - track.arrive, self._in_cell(track, cursor)
        return Segment(cursor.leaf.number, t - cursor.t, begin, end, active, leaving), there

    def _leave(self, track: SurfaceTrack, cursor: RefinedCursor) -> tuple[list[Int], Float, Int]:
        last = self._last_counts(track, cursor)
        ahead = self._times(track, last)
        through = nearest(ahead)
        # Rounding may put a wall behind the ray: it has been crossed.
        t = lesser(greater(least(ahead), cursor.t), track.leave)
        crossed = self._number(through)
        if track.bounded or self.stepped:
            short = self.backend.Bool(False)
            if self.stepped:
                part, short = self._cut(track, cursor, t)
                t = dr.select(short, part, t)
            short = short | (t >= track.leave) if track.bounded else short
            through = [own & ~short for own in through]
            crossed = dr.select(short, -1, crossed)
        count = [
            dr.select(own, end + 1, lesser(greater(family.enter(axis, t), k), end))
            for own, family, axis, k, end in zip(
                through, self.families, track.axes, cursor.count, last, strict=True
            )
        ]
        return count, t, crossed

    def _last_counts(self, track: SurfaceTrack, cursor: RefinedCursor) -> list[Int]:
        found = []
        index = self.cells_near(track, cursor.count)
        for n, (family, axis, k) in enumerate(
            zip(self.families, track.axes, cursor.count, strict=True)
        ):
            below = index[n] - cursor.leaf.low[n]
            above = cursor.leaf.size[n] - 1 - below
            rises = family.rises(axis, k)
            onward, back = dr.select(rises, above, below), dr.select(rises, below, above)
            if isinstance(family, TurningPoint):
                # Down to the leaf's lower wall, unless it turns round before.
                far = dr.abs(k)
                found.append(dr.select((k < 0) & (far > back), k + back, far + onward))
            else:
                found.append(k + onward)
        return found

    def entry_corners(self, track: SurfaceTrack, cursor: Any) -> Corners:
        standing = SurfaceExit(self.backend.Int(-1), cursor.count, cursor.t)
        return leaf_corners(self, track, standing, cursor.leaf, cursor.inside)

    def exit_corners(self, track: SurfaceTrack, segment: Segment) -> Corners:
        leaving = segment.exit
        finer = functools.reduce(
            operator.or_,
            [n < o for n, o in zip(leaving.entered.size, leaving.left.size, strict=True)],
        )
        leaf = dr.select(leaving.onward & finer, leaving.entered, leaving.left)
        return leaf_corners(self, track, leaving, leaf, segment.active)


def leaf_corners(
    walk: RefinedWalk, track: SurfaceTrack, leaving: SurfaceExit, leaf: Leaf, active: Mask
) -> Corners:
    """Return the eight vertices of a leaf, and multilinear weights where a ray is."""
    Float = walk.backend.Float
    index = walk.cells_near(track, leaving.count)
    point = walk.point(track, leaving.t)
    corner, strides = walk.grid.vertex_numbers.of(leaf.number, active, walk.backend)
    fractions = []
    for n, family in enumerate(walk.families):
        inner = Float(index[n] - leaf.low[n]) + family.fraction(index[n], point)
        # Where a ray is on a wall, its coordinate is the wall's; the last one may be the first.
        wall = family.vertex(track.axes[n], leaving.count[n]) - leaf.low[n]
        wall = dr.select(wall < 0, wall + family.last_cell + 1, wall)
        f = dr.select(leaving.family == n, Float(wall), inner) / Float(leaf.size[n])
        fractions.append(dr.clip(f, 0.0, 1.0))
    return trilinear(corner, fractions, [strides[axis] for axis in walk.axes])


class RefinedFieldWalk(SmoothWalk, RefinedWalk):
    """Rays through a refined grid that know where in its leaves they are."""

    def __init__(self, grid: Any, edges: tuple[np.ndarray, ...], backend: Backend) -> None:
        super().__init__(grid, edges, backend)
        parts = [float(grid.divisions[axis]) for axis in self.axes]
        self.parts = [backend.opaque(p) for p in parts]
        self.wide = [_over(f, p) for f, p in zip(self.families, parts, strict=True)]

    def place(
        self, track: SurfaceTrack, leaving: RefinedExit, point: list[Float], own: Arithmetic
    ) -> list[Float]:
        Float, leaf = self.backend.Float, leaving.left
        place = [Float(0)] * 3
        for axis, family, parts, low, size in zip(
            self.axes, self.wide, self.parts, leaf.low, leaf.size, strict=True
        ):
            place[axis] = own.stretched(family.fraction(low, point, own), parts / Float(size))
        return place


def _over(family: Surfaces, parts: float) -> Surfaces:
    """Return a family whose fractions are of as many finest cells as a base cell has.

    These are equally wide there, and a power of two: fractions of a leaf lose no digits.
    """
    wide = copy.copy(family)
    wide.inverse_width = family.inverse_width / parts
    wide.widest = family.widest * parts
    return wide
