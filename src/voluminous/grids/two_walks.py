"""Two walks through one domain at once: segments end at the walls of both.

The dual cells between centres tell how fields run; the cells themselves tell which of them is
missing. Rays that need both take every piece that lies in one dual cell and in one cell.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from ..backend import dr
from ..backend.types import Float, Int, Mask
from .contract import Landing, Ray, Segment, Skip, Track, Walk


@dataclass
class TwoTracks(Track):
    """What is constant along a ray for each walk; how much later the second one's distances are."""

    first: Any
    second: Any
    later: Float
    entry: Float


@dataclass
class TwoCursors:
    """Where a ray is: at distance t, somewhere in a segment of each walk."""

    first: Any
    second: Any
    t: Float
    inside: Mask


@dataclass
class WalkPiece(Segment):
    """A segment of the first walk, or a part of it, within one cell of the second."""

    own: Int

    @property
    def own_cell(self) -> Int:
        return self.own


class TwoWalks(Walk):
    """A walk whose segments are those of the first, cut at the walls of the second."""

    def __init__(self, first: Any, second: Walk) -> None:
        self.first, self.second, self.scale = first, second, first.scale
        self.continuous = first.continuous

    def skipper(self, track: TwoTracks, bricks: Any = None) -> Skip | None:
        one, other = self.first.skipper(track.first), self.second.skipper(track.second)
        if one is None or other is None:  # gaps of the cells are those of the dual cells
            return None
        skip_first: Skip = one
        skip_second: Skip = other

        def skip(cursor: TwoCursors) -> Landing:
            first, second = skip_first(cursor.first), skip_second(cursor.second)
            here = first.cursor.t - track.first.arrive
            there = second.cursor.t - track.second.arrive + track.later
            t = dr.select(first.moved, dr.maximum(cursor.t, here), cursor.t)
            t = dr.select(second.moved, dr.maximum(t, there), t)
            inside = cursor.inside & first.cursor.inside & second.cursor.inside

            def holds(cursor: TwoCursors) -> Mask:
                return first.holds(cursor.first) & second.holds(cursor.second)

            moved = TwoCursors(first.cursor, second.cursor, t, inside)
            return Landing(moved, first.moved | second.moved, holds)

        return skip

    def enter(self, ray: Ray) -> tuple[TwoTracks, TwoCursors]:
        (track, here), (other, there) = self.first.enter(ray), self.second.enter(ray)
        # Distances count from where a walk's own domain begins: the dual one begins earlier.
        later = here.t - there.t - (track.arrive - other.arrive)
        tracks = TwoTracks(track, other, later, track.entry)
        t = here.t - track.arrive
        return tracks, TwoCursors(here, there, t, here.inside & there.inside)

    def next(self, track: TwoTracks, cursor: TwoCursors) -> tuple[WalkPiece, TwoCursors]:
        whole, onward = self.first.next(track.first, cursor.first)
        cell, beyond = self.second.next(track.second, cursor.second)
        wall = cell.end + track.later
        ends, leaves = whole.end <= wall, wall <= whole.end
        end = dr.select(ends, whole.end, wall)
        end = dr.select(end > cursor.t, end, cursor.t)  # two walls in one place, but for rounding
        parts = {**vars(whole), "length": end - cursor.t, "begin": cursor.t, "end": end}
        moved = TwoCursors(
            dr.select(ends, onward, cursor.first),
            dr.select(leaves, beyond, cursor.second),
            end,
            dr.select(ends, onward.inside, cursor.first.inside)
            & dr.select(leaves, beyond.inside, cursor.second.inside),
        )
        piece = WalkPiece(**parts, own=cell.cell)
        return replace(piece, active=whole.active & cell.active), moved

    def chord(self, track: TwoTracks, segment: Segment) -> Any:
        return self.first.chord(track.first, segment)
