"""The walk of rays through the dual grid: cells whose corners are the centres of the grid's cells.

Inside a dual cell a field given at cell centres is trilinear, so along a ray it is a cubic. The
outermost layer of dual cells reaches as far beyond the domain's face as the outermost centres lie
within it; rays walk through the inner half of it, where fields are constant across the face.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...backend import dr
from ...backend.types import Float, Int, Mask
from ..box_walk import Side
from ..contract import CellBox, Ray, Segment
from ..straight_chord import StraightChord
from .walk import CartesianCursor, CartesianTrack, CartesianWalk


@dataclass
class DualTrack(CartesianTrack):
    """Also how mirrored fractions become real ones, the first corner, and the ray itself.

    Attributes
    ----------
    sign, offset : list of arrays
        The fraction along an axis is ``offset + sign · mirrored fraction``.
    first_corner : array
        What to add to the mirrored lower vertex to get the lower vertex.
    origin, direction : list of arrays
        The point where distances start, and the way per unit of distance, in the volume's unit.
    """

    sign: list[Any]
    offset: list[Any]
    first_corner: Int
    origin: list[Any]
    direction: list[Any]


class Chord(StraightChord):
    """A segment through a dual cell."""

    @property
    def corner(self) -> Any:
        """Flat number of the cell's lower corner, among the padded centres."""
        return self.walk.backend.UInt(self.segment.exit.vertex + self.track.first_corner)

    def _fractions(self, t: Float) -> list[Any]:
        track = self.track
        mirrored = self.walk.fractions(track, self.segment.exit.index, t)
        return [dr.fma(f, s, o) for f, s, o in zip(mirrored, track.sign, track.offset, strict=True)]


def dual_edges(edges: np.ndarray, multiple: int = 1) -> np.ndarray:
    """Return the centres of cells, and one more on either side, mirrored at the outermost faces.

    More follow at equal distances, until there is a multiple of so many dual cells.
    """
    centers = 0.5 * (edges[1:] + edges[:-1])
    below, above = 2.0 * edges[0] - centers[0], 2.0 * edges[-1] - centers[-1]
    more = np.arange(1, -len(edges) % multiple + 1) * (edges[-1] - edges[-2])
    return np.concatenate([[below], centers, [above], above + more])


class DualWalk(CartesianWalk):
    """Rays through the dual of a `CartesianGrid`."""

    in_cells = False

    def __init__(
        self,
        edges: Any,
        scale: float,
        backend: Any,
        multiple: int = 1,
        *,
        box: CellBox | None = None,
    ) -> None:
        self.cells = [len(e) - 1 for e in edges]
        super().__init__([dual_edges(e, multiple) for e in edges], scale, backend, box=box)
        self.faces = [(backend.wide(e[0]), backend.wide(e[-1])) for e in edges]

    def _ends(self, box: CellBox) -> list[tuple[Any, Any, Any]]:
        # Dual cell i lies between the centres of cells i - 1 and i, the last one beyond them all.
        return [
            tuple(
                dr.opaque(self.backend.Int, k)
                for k in (low, high if high == n else high - 1, max(low - 1, 0))
            )
            for low, high, n in zip(box.low, box.high, self.cells, strict=True)
        ]

    def _held(self, box: CellBox) -> list[int]:
        return [part.stop - part.start + 1 for part in box.with_ghosts]

    def enter(self, ray: Ray) -> tuple[CartesianTrack, CartesianCursor]:
        first, last = self._between_faces(ray)
        if ray.first is not None:
            first = dr.maximum(first, ray.first)
        if ray.last is not None:
            last = dr.minimum(last, ray.last)
        return super().enter(replace(ray, first=first, last=last))

    def _between_faces(self, ray: Ray) -> tuple[Any, Any]:
        """Return the distances at which rays enter and leave the domain; the wrong way if never."""
        Wide = self.backend.Wide
        # These are in the volume's unit, where any number may be a length.
        first, last = Wide(-dr.inf), Wide(dr.inf)
        for axis, origin, direction, (low, high) in zip(
            self.axes, ray.origin, ray.direction, self.faces, strict=True
        ):
            side = axis.side(origin, direction)
            between = (origin >= low) & (origin <= high)
            per_length = side.pace * axis.speed_unit
            arrive = dr.select(side.down, origin - high, low - origin) * per_length
            leave = dr.select(side.down, origin - low, high - origin) * per_length
            never = dr.select(between, Wide(-dr.inf), Wide(dr.inf))
            first = dr.maximum(first, dr.select(side.parallel, never, arrive))
            last = dr.minimum(last, dr.select(side.parallel, Wide(dr.inf), leave))
        return first, last

    def _start(
        self, sides: list[Side], arrive: Float, begin: Float, inside: Mask, bound: Float
    ) -> tuple[DualTrack, Any]:
        track, cursor = super()._start(sides, arrive, begin, inside, bound)
        Float = self.backend.Float
        down = [side.down for side in sides]
        sign = [dr.select(d, Float(-1), 1) for d in down]
        offset = [dr.select(d, Float(1), 0) for d in down]
        first_corner = self.backend.Int(0)
        for is_down, stride in zip(down, self.vertex_strides, strict=True):
            first_corner -= dr.select(is_down, stride, 0)
        here = arrive * self.scale
        origin = [Float(dr.fma(here, side.direction, side.origin)) for side in sides]
        direction = [Float(side.direction * self.scale) for side in sides]
        whole = DualTrack(
            **vars(track),
            sign=sign,
            offset=offset,
            first_corner=first_corner,
            origin=origin,
            direction=direction,
        )
        return whole, cursor

    def chord(self, track: DualTrack, segment: Segment) -> Chord:
        return Chord(self, track, segment)
