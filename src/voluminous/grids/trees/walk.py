"""The walk of rays through the cells of a tree between planes of constant x, y and z.

The place of a ray, and the walls of its cell, are whole numbers of finest units: a crossing is
computed afresh from the wall's number, and the coordinate that crosses is *set*. So no ray leaks,
at any depth, and the lengths of a ray's segments add up to its chord.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ...backend import dr
from ...backend.functions import loop, precision_of, unit_interval
from ...backend.types import Float, Int, Mask
from ...geometry import is_uniform
from ..box_walk import AxisTrack, BoxWalk
from ..contract import Corners, Landing, Ray, Segment, Skip, Track
from ..lanes import bilinear, least, nearest, trilinear
from ..straight_chord import StraightChord
from .axes import make_tree_axis
from .tree import Cell, Orientation, Tree, TreeLookup

if TYPE_CHECKING:
    from ...backend.device import Backend
    from .vertices import LeafGrid

# Rays come in on walls. Nearer to one than this part of a cell they are on it: what rounding mixes
# in of the other side may be larger by many powers of ten, as in the wing of a line.
_ON_WALL = {"single": 1e-6, "double": 1e-11}


@dataclass
class TreeTrack(Track):
    """What is constant along a ray: its axes, and where it leaves.

    `entry`: where distances start, as counted from the ray's origin; `leave`: where the ray leaves,
    or ends; `bounded`: rays may end inside a cell.
    """

    axes: list[AxisTrack]
    sense: Orientation
    entry: Float
    leave: Float
    bounded: bool


@dataclass
class TreeCursor:
    """Where a ray is: in which cell, at which distance."""

    cell: Cell
    t: Float
    inside: Mask


@dataclass
class TreeExit:
    """How a segment leaves its cell.

    `through`: the axis of the wall it leaves by; its sense is that of the ray; `left`, `entered`:
    the cell it leaves, and the one it comes to: where `segment` is a ray's last, its place is
    inside the domain but of no meaning; `onward`: lanes that do enter another; `ends`: lanes that
    end before that wall, where rays may.
    """

    through: list[Mask]
    left: Cell
    entered: Cell
    onward: Mask
    ends: Mask


class TreeWalk(BoxWalk):
    """Rays through a tree of Cartesian cells; see `grids.contract.Walk`.

    `has_gaps`: holes are gaps, and not segments of no length.
    """

    has_gaps, continuous = False, True

    def __init__(self, grid: LeafGrid, tree: Tree, backend: Backend) -> None:
        self.grid, self.backend = grid, backend
        edges, scale = grid.base_edges, grid.scale
        # Along uneven axes distances are known within one base cell at a time.
        stretches = [
            None if is_uniform(e) else int(n) for e, n in zip(edges, grid.divisions, strict=True)
        ]
        self.lookup = TreeLookup(tree, backend, stretches)
        self.axes = [
            make_tree_axis(e, float(n), top, scale, backend)
            for e, n, top in zip(edges, tree.extent, self.lookup.top, strict=True)
        ]
        self.scale, self.to_scale = backend.wide(scale), backend.wide(1.0 / scale)
        self.holes = tree.holes

    def _start(
        self, sides: list[Float], arrive: Float, begin: Float, inside: Mask, bound: Float
    ) -> tuple[TreeTrack, TreeCursor]:
        tracks, place = [], []
        for axis, side in zip(self.axes, sides, strict=True):
            tracks.append(axis.track(side, dr.fma(arrive, side.speed, side.position)))
            position = dr.fma(arrive + begin, side.speed, side.position)
            # The wall it comes in through is known: it must not be found again by arithmetic.
            on_wall = (side.arrive == arrive) & (begin == 0)
            place.append(axis.first_place(side, dr.select(on_wall, 0.0, position)))
        leave = least([axis.leaving(track) for axis, track in zip(self.axes, tracks, strict=True)])
        if bound is not None:
            leave = dr.select(bound < leave, bound, leave)
        sense = self.lookup.orient([side.down for side in sides])
        t = self.backend.Float(begin)
        inside &= t < leave
        cell = self.lookup.find(place, sense, inside)
        track = TreeTrack(tracks, sense, arrive, leave, bound is not None)
        return track, TreeCursor(cell, t, inside)

    def next(self, track: TreeTrack, cursor: TreeCursor) -> tuple[Segment, TreeCursor]:
        cell, size = cursor.cell, self.lookup.sizes(cursor.cell)
        ahead = [
            axis.crossing(t, low, s)
            for axis, t, low, s in zip(self.axes, track.axes, cell.low, size, strict=True)
        ]
        wall, through = least(ahead), nearest(ahead)
        # A wall that rounding puts behind the ray has been crossed: it never runs backwards.
        end = dr.select(wall > cursor.t, wall, cursor.t)
        reached = [
            dr.select(crossed, low + s, low)
            for crossed, low, s in zip(through, cell.low, size, strict=True)
        ]
        inside = (
            (reached[0] < self.axes[0].extent)
            & (reached[1] < self.axes[1].extent)
            & (reached[2] < self.axes[2].extent)
        )
        if track.bounded:
            end = dr.select(end < track.leave, end, track.leave)
            inside &= end < track.leave

        def place() -> list[Float]:
            # One wall at a time: along an edge, or beyond it by rounding, a ray comes to the cell
            # between, in the middle of the last unit of its own, before it comes to the next.
            places = [
                axis.place(t, end, r)
                for axis, t, r in zip(self.axes, track.axes, reached, strict=True)
            ]
            return [
                dr.select(crossed, p, dr.minimum(p, low + s - 0.5))
                for p, crossed, low, s in zip(places, through, cell.low, size, strict=True)
            ]

        entered = self.lookup.entered(cell, through, reached, place, track.sense, inside)
        leaving = TreeExit(through, cell, entered, inside, ~(wall < track.leave))
        number, length, active = cell.number, end - cursor.t, cursor.inside
        if self.holes:
            # A hole is a segment of no length, at the entry of the cell beyond.
            hole, beyond = ~self.lookup.is_cell(cell), inside & self.lookup.is_cell(entered)
            length = dr.select(hole, 0.0, length)
            number = dr.select(hole, dr.select(beyond, entered.number, 0), number)
            active = active & ~hole if self.has_gaps else active
        segment = Segment(number, length, cursor.t, end, active, leaving)
        return segment, TreeCursor(entered, end, inside)

    def entry_corners(self, track: TreeTrack, cursor: TreeCursor) -> Corners:
        base, strides = self._vertices(track, cursor.cell, cursor.inside)
        fractions = self.fractions(track, cursor.cell, cursor.t)
        near = _ON_WALL[precision_of(self.backend.Float)]
        return trilinear(base, [dr.select(f < near, 0.0, f) for f in fractions], strides)

    def exit_corners(self, track: TreeTrack, segment: Segment) -> Corners:
        leaving = segment.exit
        entered = self._entered_is_finer(leaving)
        cell = Cell(
            dr.select(entered, leaving.entered.number, leaving.left.number),
            _select(entered, leaving.entered.low, leaving.left.low),
            _select(entered, leaving.entered.size, leaving.left.size),
        )
        base, strides = self._vertices(track, cell, segment.active)
        f = self.fractions(track, cell, segment.end)
        ahead = dr.select(entered, 0.0, self.backend.Float(1))
        f = [dr.select(crossed, ahead, v) for crossed, v in zip(leaving.through, f, strict=True)]
        if track.bounded:  # it may end inside the cell
            own = self.fractions(track, leaving.left, segment.end)
            return trilinear(base, _select(leaving.ends, own, f), strides)
        for crossed, stride in zip(leaving.through, strides, strict=True):
            base += dr.select(crossed & ~entered, stride, 0)
        return bilinear(base, leaving.through, f, strides)

    def fractions(self, track: TreeTrack, cell: Cell, t: Float) -> list[Float]:
        """Return where in cells rays are at a distance, from 0 to 1 in the sense of the rays."""
        # Sizes along the axes are one and the same array mostly: so is one over it.
        inverse = [1.0 / size for size in self.lookup.sizes(cell)]
        return [
            unit_interval(axis.beyond(own, t, low) * part)
            for axis, own, low, part in zip(self.axes, track.axes, cell.low, inverse, strict=True)
        ]

    def _vertices(self, track: TreeTrack, cell: Cell, active: Mask) -> tuple[Int, list[Int]]:
        """Return the vertices of cells that rays come by first, and the steps to the others.

        In a hole those of any cell: their values are multiplied by a length of zero, but must be
        there.
        """
        number = cell.number
        if self.holes:
            number = dr.select(self.lookup.is_cell(cell), number, 0)
        base, strides = self.grid.vertex_numbers.of(number, active, self.backend)
        signed = []
        for stride, flip in zip(strides, track.sense.flip, strict=True):
            base = base + (stride & flip)  # all bits or none: modulo 2^32, the stride or minus it
            signed.append((stride ^ flip) - flip)
        return base, signed

    def _entered_is_finer(self, leaving: TreeExit) -> Mask:
        old, new = (self.lookup.sizes(cell) for cell in (leaving.left, leaving.entered))
        finer = (new[0] < old[0]) | (new[1] < old[1]) | (new[2] < old[2])
        if self.holes:
            finer = finer & self.lookup.is_cell(leaving.entered)
            finer |= ~self.lookup.is_cell(leaving.left) & self.lookup.is_cell(leaving.entered)
        return leaving.onward & finer


def _select(mask: Mask, first: list[Float], second: list[Float]) -> list[Float]:
    return [dr.select(mask, a, b) for a, b in zip(first, second, strict=True)]


@dataclass
class TreeRayTrack(TreeTrack):
    """Also the ray: where distances start, and the vector per distance, in the volume's unit."""

    origin: list[Float]
    direction: list[Float]


class TreeChord(StraightChord):
    """A segment through a cell of a tree."""

    def _fractions(self, t: Float) -> list[Float]:
        mirrored = self.walk.fractions(self.track, self.segment.exit.left, t)
        return [
            dr.select(flip != 0, 1.0 - f, f)
            for f, flip in zip(mirrored, self.track.sense.flip, strict=True)
        ]


class TreeFieldWalk(TreeWalk):
    """Rays through a tree of Cartesian cells that know where they are.

    In holes there are no fields: rays are moved beyond them, and what was known of a field before
    is forgotten. (As segments of no length they had some field, and surfaces were crossed in it.)
    """

    has_gaps = True

    def skipper(self, track: TreeRayTrack, bricks: Any = None) -> Skip | None:
        def step(cursor: TreeCursor) -> tuple[TreeCursor]:
            return (self.next(track, cursor)[1],)

        def skip(cursor: TreeCursor) -> Landing:
            (there,) = loop((cursor,), self._in_hole, step, label="holes")
            return Landing(there, self._in_hole(cursor), lambda c: self.lookup.is_cell(c.cell))

        return skip if self.holes else None

    def _in_hole(self, cursor: TreeCursor) -> Mask:
        return cursor.inside & ~self.lookup.is_cell(cursor.cell)

    def enter(self, ray: Ray) -> tuple[TreeRayTrack, TreeCursor]:
        track, cursor = super().enter(ray)
        Float = self.backend.Float
        here = track.entry * self.scale
        origin = [Float(dr.fma(here, d, o)) for o, d in zip(ray.origin, ray.direction, strict=True)]
        direction = [Float(d * self.scale) for d in ray.direction]
        return TreeRayTrack(**vars(track), origin=origin, direction=direction), cursor

    def chord(self, track: TreeRayTrack, segment: Segment) -> TreeChord:
        return TreeChord(self, track, segment)
