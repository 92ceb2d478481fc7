"""The walk through a refined curvilinear grid, with fields multilinear between corners of leaves.

Values at corners are chosen such that neighbours of any size agree on what is between them
(`rendering.sources.vertex_values`). In a leaf a field is linear in each of the grid's own
coordinates; along a ray the cubic through four of its values stands for it, as in
`curvilinear.field_walk`.
"""

from __future__ import annotations

import copy
import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ...backend import dr
from ...backend.types import Float, Int, Mask
from ..contract import Corners, Segment
from ..trees.tree import TreeLookup
from .approach import dot
from .arithmetic import NUMBERS, Arithmetic
from .crossing import either, later, lesser, nearest
from .field_walk import CurvilinearChord, Smooth, Smoothed
from .radmc3d_substeps import cut
from .surfaces import TurningPoint
from .walk import CurvilinearWalk, SurfaceCursor, SurfaceExit, SurfaceTrack

if TYPE_CHECKING:
    from ...backend.device import Backend


@dataclass
class Leaf:
    """A leaf, one per lane: its number, and corners and sizes in finest units, per family."""

    number: Int
    low: list[Any]
    size: list[Any]


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
    """Rays through a refined spherical or cylindrical grid.

    Parameters
    ----------
    axes : list of int
        Which axis of the tree each family is.
    grid : RefinedCells
    stepped : bool
        Segments end inside leaves where RADMC-3D's sub-steps do (`radmc3d_substeps`).
    """

    def __init__(
        self,
        families: list[Any],
        approach: Any,
        scale: float,
        backend: Backend,
        *,
        axes: list[int],
        grid: Any,
        stepped: bool,
    ) -> None:
        none = [0] * len(families)  # leaves have numbers of their own
        super().__init__(families, none, none, approach, scale, backend)
        self.stepped, self.grid = stepped, grid
        self.axes, self.lookup = axes, TreeLookup(grid.tree, self.backend)

    def _standing(
        self, track: SurfaceTrack, count: list[Any], t: Float, inside: Mask
    ) -> RefinedCursor:
        return RefinedCursor(count, [], t, inside, self._leaf(track, count, inside))

    def _leaf(self, track: SurfaceTrack, count: list[Any], active: Mask) -> Leaf:
        Float, Int = self.backend.Float, self.backend.Int
        place = [Float(0.5)] * 3
        for axis, index in zip(self.axes, self.cells_near(track, count), strict=True):
            place[axis] = Float(index) + 0.5
        cell = self.lookup.find(place, self.lookup.orient(), active)
        sizes = self.lookup.sizes(cell)
        low = [Int(cell.low[axis]) for axis in self.axes]
        size = [Int(sizes[axis]) for axis in self.axes]
        return Leaf(cell.number, low, size)

    def next(self, track: SurfaceTrack, cursor: Any) -> tuple[Segment, RefinedCursor]:
        count, t, family = self._leave(track, cursor)
        inside = cursor.inside & (t < track.leave)
        onward = inside if not self.has_gaps else inside & ~self.in_gap(track, count)
        there = self._standing(track, count, t, inside)
        before = [dr.select(family == n, k - 1, k) for n, k in enumerate(count)]
        leaving = RefinedExit(family, before, t, cursor.leaf, there.leaf, onward)
        begin, end = cursor.t - track.arrive, t - track.arrive
        return Segment(cursor.leaf.number, t - cursor.t, begin, end, cursor.inside, leaving), there

    def _leave(self, track: SurfaceTrack, cursor: RefinedCursor) -> tuple[list[Any], Any, Any]:
        """Return counts and distance where rays leave their leaf, and through which family."""
        last = self._last_counts(track, cursor)
        ahead = self._times(track, last)
        through = nearest(ahead)
        # Rounding may put a wall behind the ray: it has been crossed.
        t = lesser(later(functools.reduce(lesser, ahead), cursor.t), track.leave)
        crossed = self._number(through)
        if track.bounded or self.stepped:
            t, short = self._end_inside(track, cursor, t)
            through = [own & ~short for own in through]
            crossed = dr.select(short, -1, crossed)
        count = [
            dr.select(own, end + 1, self._between(family, axis, k, end, t))
            for own, family, axis, k, end in zip(
                through, self.families, track.axes, cursor.count, last, strict=True
            )
        ]
        return count, t, crossed

    def _end_inside(self, track: SurfaceTrack, cursor: RefinedCursor, t: Float) -> tuple[Any, Any]:
        """Return where segments end, and which do not come to the wall of their leaf."""
        short = self.backend.Bool(False)
        if self.stepped:
            t, short = self._cut(track, cursor, t)
        return t, short | (t >= track.leave) if track.bounded else short

    def _cut(self, track: SurfaceTrack, cursor: RefinedCursor, t: Float) -> tuple[Any, Any]:
        """Return where segments end that may not turn far, and which end before their wall."""
        closest, radius = (dr.sqrt(dot(p, p)) for p in (track.point, self.point(track, cursor.t)))
        part, short = cut(closest, radius, cursor.t, t - cursor.t)
        return dr.select(short, part, t), short

    def _last_counts(self, track: SurfaceTrack, cursor: RefinedCursor) -> list[Any]:
        """Return for each family the count with which rays come to the wall of their leaf."""
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

    def _between(self, family: Any, axis: Int, first: Float, last: Float, t: Float) -> Any:
        count = later(family.enter(axis, t), first)
        return lesser(count, last)

    def entry_corners(self, track: SurfaceTrack, cursor: Any) -> Corners:
        standing = SurfaceExit(self.backend.Int(-1), cursor.count, cursor.t)
        return leaf_corners(self, track, standing, cursor.leaf, cursor.inside)

    def exit_corners(self, track: SurfaceTrack, segment: Segment) -> Corners:
        leaving = segment.exit
        finer = functools.reduce(
            either,
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
    vertices, weights = [corner], [Float(1)]
    for n, family in enumerate(walk.families):
        inner = Float(index[n] - leaf.low[n]) + family.fraction(index[n], point)
        # Where a ray is on a wall, its coordinate is the wall's; the last one may be the first.
        wall = family.vertex(track.axes[n], leaving.count[n]) - leaf.low[n]
        wall = dr.select(wall < 0, wall + family.last_cell + 1, wall)
        f = dr.select(leaving.family == n, Float(wall), inner) / Float(leaf.size[n])
        f = dr.clip(f, 0.0, 1.0)
        vertices += [v + strides[walk.axes[n]] for v in vertices]
        weights = [w * (1.0 - f) for w in weights] + [w * f for w in weights]
    return Corners(vertices, weights)


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

    def __init__(self, grid: Any, walk: RefinedWalk, backend: Backend) -> None:
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
