"""The walk of rays through the cells of a tree between planes of constant x, y and z.

The place of a ray, and the walls of its cell, are whole numbers of finest units: a crossing is
computed afresh from the wall's number, and the coordinate that crosses is *set*. So no ray leaks,
at any depth, and the lengths of a ray's segments add up to its chord.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...backend import dr
from ...geometry import is_uniform
from ..axes import AxisTrack
from ..box_walk import BoxWalk
from ..cartesian.walk import least, nearest
from ..contract import Corners, Segment
from .axes import make_tree_axis
from .corners import entry_corners, exit_corners
from .lookup import Cell, Orientation, TreeLookup
from .tree import Tree


@dataclass
class TreeTrack:
    """What is constant along a ray: its axes, and where it leaves.

    Attributes
    ----------
    entry : array
        Where distances start, as counted from the ray's origin.
    leave : array
        Where the ray leaves, or ends.
    bounded : bool
        Rays may end inside a cell.
    """

    axes: list[AxisTrack]
    way: Orientation
    entry: Any
    leave: Any
    bounded: bool


@dataclass
class TreeCursor:
    """Where a ray is: in which cell, at which distance."""

    cell: Cell
    t: Any
    inside: Any


@dataclass
class TreeExit:
    """How a segment leaves its cell.

    Attributes
    ----------
    through : list of three arrays of Bool
        The axis of the wall it leaves by; its sense is that of the ray.
    left, entered : Cell
        The cell it leaves, and the one it comes to: where `segment` is a ray's last, its place is
        inside the domain but of no meaning.
    onward : array of Bool
        Lanes that do enter another.
    ends : array of Bool
        Lanes that end before that wall, where rays may.
    """

    through: list[Any]
    left: Cell
    entered: Cell
    onward: Any
    ends: Any


class TreeWalk(BoxWalk):
    """Rays through a tree of Cartesian cells; see `grids.contract.Walk`.

    Parameters
    ----------
    grid : TreeCells
    tree : Tree
        The grid's own, or one with more holes.
    backend : Backend
    """

    leaps = False

    def __init__(self, grid: Any, tree: Tree, backend: Any) -> None:
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
        self, sides: list[Any], arrive: Any, begin: Any, inside: Any, bound: Any
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
        way = self.lookup.orient([side.down for side in sides])
        t = self.backend.Float(begin)
        inside &= t < leave
        cell = self.lookup.find(place, way, inside)
        track = TreeTrack(tracks, way, arrive, leave, bound is not None)
        return track, TreeCursor(cell, t, inside)

    def next(self, track: TreeTrack, cursor: TreeCursor) -> tuple[Segment, TreeCursor]:
        """Return the segment through the present cell, and the cursor in the next one."""
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

        def place() -> list[Any]:
            return [
                axis.place(t, end, r)
                for axis, t, r in zip(self.axes, track.axes, reached, strict=True)
            ]

        entered = self.lookup.entered(cell, through, reached, place, track.way, inside)
        leaving = TreeExit(through, cell, entered, inside, ~(wall < track.leave))
        number, length = cell.number, end - cursor.t
        if self.holes:
            # A hole is a segment of no length, at the entry of the cell beyond.
            hole, beyond = ~self.lookup.is_cell(cell), inside & self.lookup.is_cell(entered)
            length = dr.select(hole, 0.0, length)
            number = dr.select(hole, dr.select(beyond, entered.number, 0), number)
        segment = Segment(number, length, cursor.t, end, cursor.inside, leaving)
        return segment, TreeCursor(entered, end, inside)

    def entry_corners(self, track: TreeTrack, cursor: TreeCursor) -> Corners:
        """Return the eight vertices of the cell and trilinear weights at the cursor."""
        return entry_corners(self, track, cursor)

    def exit_corners(self, track: TreeTrack, segment: Segment) -> Corners:
        """Return the vertices around the end of a segment: four of the wall it leaves through."""
        return exit_corners(self, track, segment)
