"""The walk of rays through a tree's cells, with fields trilinear between the corners of each.

Values at corners are chosen such that neighbours of any size agree on what is between them
(`rendering.sources.vertex_values`): fields are continuous, and a cubic along a ray in each
cell.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...backend import dr
from ..contract import Ray, Segment
from ..straight_chord import StraightChord
from .corners import fractions
from .tree import Tree
from .walk import TreeCursor, TreeTrack, TreeWalk


@dataclass
class TreeRayTrack(TreeTrack):
    """Also the ray: where distances start, and the way per distance, in the volume's unit."""

    origin: list[Any]
    direction: list[Any]


class TreeChord(StraightChord):
    """A segment through a cell of a tree."""

    def _fractions(self, t: Any) -> list[Any]:
        mirrored = fractions(self.walk, self.track, self.segment.exit.left, t)
        return [
            dr.select(flip != 0, 1.0 - f, f)
            for f, flip in zip(mirrored, self.track.way.flip, strict=True)
        ]


@dataclass
class HoleLanding:
    """Where rays are once none of them is in a hole: see `grids.contract.Landing`."""

    cursor: TreeCursor
    moved: Any
    walk: TreeFieldWalk

    def holds(self, cursor: TreeCursor) -> Any:
        """Return the lanes that are in a cell still."""
        return self.walk.lookup.is_cell(cursor.cell)


class TreeFieldWalk(TreeWalk):
    """Rays through a tree of Cartesian cells that know where they are.

    In holes there are no fields: rays are moved beyond them, and what was known of a field before
    is forgotten. (As segments of no length they had some field, and surfaces were crossed in it.)
    """

    def __init__(self, grid: Any, tree: Tree, backend: Any) -> None:
        super().__init__(grid, tree, backend)
        self.has_gaps = self.holes

    def cross(self, track: TreeRayTrack, cursor: TreeCursor) -> HoleLanding:
        """Return rays where they are in a cell, beyond the holes they were in, or out."""
        moved = self._in_hole(cursor)

        def step(cursor: TreeCursor) -> tuple[TreeCursor]:
            return (self.next(track, cursor)[1],)

        (there,) = dr.while_loop((cursor,), self._in_hole, step, label="holes")
        return HoleLanding(there, moved, self)

    def _in_hole(self, cursor: TreeCursor) -> Any:
        return cursor.inside & ~self.lookup.is_cell(cursor.cell)

    def enter(self, ray: Ray) -> tuple[TreeRayTrack, TreeCursor]:
        track, cursor = super().enter(ray)
        Float = self.backend.Float
        here = track.entry * self.scale
        origin = [Float(dr.fma(here, d, o)) for o, d in zip(ray.origin, ray.direction, strict=True)]
        direction = [Float(d * self.scale) for d in ray.direction]
        return TreeRayTrack(**vars(track), origin=origin, direction=direction), cursor

    def chord(self, track: TreeRayTrack, segment: Segment) -> TreeChord:
        """Return a segment as a straight line through its cell."""
        return TreeChord(self, track, segment)
