"""The walk of rays through a tree's cells, with fields trilinear between the corners of each.

Values at corners are chosen such that neighbours of any size agree on what is between them
(`rendering.interpolants.corner_values`): fields are continuous, and a cubic along a ray in each
cell.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...backend import dr
from ..contract import Ray, Segment
from ..straight_chord import StraightChord
from .corners import choose, fractions
from .lookup import Cell
from .walk import TreeCursor, TreeTrack, TreeWalk


@dataclass
class TreeRayTrack(TreeTrack):
    """Also the ray: where distances start, and the way per distance, in the volume's unit."""

    origin: list[Any]
    direction: list[Any]


class TreeChord(StraightChord):
    """A segment through a cell of a tree."""

    def _fractions(self, t: Any) -> list[Any]:
        mirrored = fractions(self.walk, self.track, self._cell(), t)
        return [
            dr.select(flip != 0, 1.0 - f, f)
            for f, flip in zip(mirrored, self.track.way.flip, strict=True)
        ]

    def _cell(self) -> Cell:
        """Return the cell, which is the one beyond where the segment crosses a hole."""
        leaving, lookup = self.segment.exit, self.walk.lookup
        if not self.walk.holes:
            return leaving.left
        beyond = ~lookup.is_cell(leaving.left) & lookup.is_cell(leaving.entered)
        return choose(beyond & leaving.onward, leaving.entered, leaving.left)


class TreeFieldWalk(TreeWalk):
    """Rays through a tree of Cartesian cells that know where they are."""

    def enter(self, ray: Ray) -> tuple[TreeRayTrack, TreeCursor]:
        """Return the track and the cursor at the point where each ray enters the domain."""
        track, cursor = super().enter(ray)
        Float = self.backend.Float
        here = track.entry * self.scale
        origin = [Float(dr.fma(here, d, o)) for o, d in zip(ray.origin, ray.direction, strict=True)]
        direction = [Float(d * self.scale) for d in ray.direction]
        return TreeRayTrack(**vars(track), origin=origin, direction=direction), cursor

    def chord(self, track: TreeRayTrack, segment: Segment) -> TreeChord:
        """Return a segment as a straight line through its cell."""
        return TreeChord(self, track, segment)
