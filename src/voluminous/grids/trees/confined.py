"""The walk of rays through some leaves of a tree, from where they wait to where they leave these.

Rays go on where they stopped: the cell they come to, and the distance, are those of the walk
through the whole tree. So the leaves need not fill a box, rays may come to them more than once, and
what they gather has the same bits in any order of the pieces.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ...backend import dr
from ...backend.functions import loop
from ...backend.types import Int, Mask
from ..contract import CellBox, Landing, Ray, Segment, Skip, Walk
from .tree import NONE
from .walk import TreeCursor


class ConfinedWalk(Walk):
    """Rays through consecutive leaves of a tree; segments number them from the first on.

    The cursor of a ray that has stopped is at the cell where it waits, outside the leaves. Its
    number is `NONE` if the ray has left the domain.
    """

    def __init__(self, whole: Any, box: CellBox) -> None:
        self.whole, self.backend, self.scale = whole, whole.backend, whole.scale
        self.continuous = whole.continuous
        (first,), (last,) = box.low, box.high
        UInt = self.backend.UInt
        self.first, self.most = dr.opaque(UInt, first), dr.opaque(UInt, last - 1 - first)

    def enter(self, ray: Ray) -> tuple[Any, TreeCursor]:
        track, cursor = self.whole.enter(ray)
        if ray.waiting is not None:
            return track, replace(ray.waiting, inside=self._holds(ray.waiting.cell.number))
        if self.whole.holes:

            def beyond(cursor: TreeCursor) -> tuple[TreeCursor]:
                return (self.whole.next(track, cursor)[1],)

            (cursor,) = loop((cursor,), self._in_hole, beyond, label="first holes")
        return track, self._confined(cursor)

    def next(self, track: Any, cursor: TreeCursor) -> tuple[Segment, TreeCursor]:
        segment, onward = self.whole.next(track, cursor)
        # In holes the number may be that of any cell: its values, multiplied by a length of zero,
        # must be there.
        segment.cell = dr.minimum(segment.cell - self.first, self.most)
        return segment, self._confined(onward)

    def skipper(self, track: Any, bricks: Any = None) -> Skip | None:
        skip = self.whole.skipper(track)
        if skip is None:
            return None

        def confined(cursor: TreeCursor) -> Landing:
            landing: Landing = skip(cursor)
            return replace(landing, cursor=self._confined(landing.cursor))

        return confined

    def beyond(self, track: Any, cursor: TreeCursor) -> TreeCursor:
        """Return where rays wait that have passed the leaves; nothing is gathered."""

        def inside(cursor: TreeCursor) -> Mask:
            return cursor.inside

        def step(cursor: TreeCursor) -> tuple[TreeCursor]:
            return (self.next(track, cursor)[1],)

        there: TreeCursor
        (there,) = loop((cursor,), inside, step, label="beyond")
        return there

    def chord(self, track: Any, segment: Segment) -> Any:
        return self.whole.chord(track, segment)

    def _confined(self, cursor: TreeCursor) -> TreeCursor:
        """Stop rays that have come to other cells; of those that are in a hole it is not known."""
        inside = cursor.inside & self._holds(cursor.cell.number)
        number = dr.select(cursor.inside, cursor.cell.number, NONE)
        if self.whole.holes:
            inside |= self._in_hole(cursor)
        return replace(cursor, cell=replace(cursor.cell, number=number), inside=inside)

    def _holds(self, number: Int) -> Mask:
        return number - self.first <= self.most

    def _in_hole(self, cursor: TreeCursor) -> Mask:
        return cursor.inside & ~self.whole.lookup.is_cell(cursor.cell)
