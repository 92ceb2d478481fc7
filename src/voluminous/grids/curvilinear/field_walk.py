"""Walks through the dual cells of curvilinear grids, where fields along rays are near to cubics.

Along a ray that passes the axis or the centre at distance q, with u counted from the closest
approach, radii are √(q² + u²) and angles those of the point (u, q): functions with singularities at
u = ±iq. The cubic through four values on a segment of length h is off by about (h/4ρ)⁴, with ρ the
distance of the singularities from it, the ray's least distance from the axis or the centre there.
So h is at most a fraction of ρ, the smaller the less fields may be off: rays that pass far from
both are not cut, those that come near are cut into ever smaller segments.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import dr
from ...backend.types import Float, Int, Mask
from ..contract import Segment
from ..lanes import lesser
from ..straight_chord import StraightChord
from .surfaces import NUMBERS, Arithmetic, SurfaceGrid
from .walk import CurvilinearWalk, SurfaceExit, SurfaceTrack, flat, norm

if TYPE_CHECKING:
    from ...backend.device import Backend

# The longest segment, as a part of its distance from the axis or the centre: √(q² + u²) is then
# off by 6e-6 q at most, and a field of white noise by 4e-4 of its range.
_PART = 0.25
# In ε of the domain: rays count as passing no nearer than that, since places are not known better.
_NEAREST = 64.0
# Slower than this, a ray runs parallel to the axis.
_PARALLEL = 1e-12


class CurvilinearChord(StraightChord):
    """A segment through a dual cell or a leaf, a curve in its coordinates."""

    walk: SmoothWalk

    @property
    def corner(self) -> Int:
        """Flat number of the dual cell's lower corner."""
        return self.walk.corner(self.track, self.segment.exit)

    @property
    def position(self) -> list[Float]:
        return [p * self.walk.length for p in self.point(0.0)]

    @property
    def step(self) -> list[Float]:
        return [self.segment.length * self.walk.length * d for d in self.track.direction]

    def at(self, s: Float) -> tuple[Any, list[Float]]:
        return self, self.place(self.point(s))

    def distance(self, s: Float) -> Float:
        """Return how far along the ray a place of the segment is, s from 0 to 1."""
        end = self.segment.exit.t
        # With all digits near the axis; what is added is zero but for parts of segments.
        end = end + (self.segment.end - (end - self.track.arrive))
        return dr.fma(s - 1.0, self.segment.length, end)

    def place(self, point: list[Float], own: Arithmetic = NUMBERS) -> list[Float]:
        """Return where in its cell a point is, from 0 to 1 along all three axes."""
        return self.walk.place(self.track, self.segment.exit, point, own)

    def point(self, s: Float) -> list[Float]:
        """Return a point of the segment, from the centre, in units of the scale.

        Where one of its ends is on the axis or in the centre, a point next to that.
        """
        passage, end = self.track.passage, self.segment.exit.t
        return self.walk.point(self.track, *passage.beside(self.distance(s), end))


class SmoothWalk(CurvilinearWalk):
    """A walk whose segments end, near the axis and the centre, where fields are near to cubics.

    `part`: the longest segment, as a part of its distance from the axis or the centre; `least`: the
    least such distance that counts; `length`: the grid's scale.
    """

    continuous = True

    def __init__(self, grid: SurfaceGrid, edges: tuple[np.ndarray, ...], backend: Backend) -> None:
        super().__init__(grid, edges, backend, True)
        self.centre = grid.kind == "spherical"
        self.length = backend.opaque(float(grid.scale))
        self.part = backend.opaque(_PART)
        farthest = [float(np.abs(grid.edges[k]).max()) / grid.scale for k in (0, 2)]
        extent = farthest[0] if self.centre else max(farthest)
        self.least = backend.opaque(_NEAREST * float(np.finfo(backend.dtype).eps) * extent)

    def next(self, track: Any, cursor: Any) -> tuple[Segment, Any]:
        """Return the segment through the present cell, and the cursor in the next one.

        On the axis rays meet half planes all at once: there is nothing in cells between these.
        """
        segment, there = super().next(track, cursor)
        return replace(segment, active=segment.active & (segment.length > 0.0)), there

    def chord(self, track: SurfaceTrack, segment: Segment) -> CurvilinearChord:
        """Return a segment through its dual cell or leaf."""
        return CurvilinearChord(self, track, segment)

    def corner(self, track: SurfaceTrack, leaving: SurfaceExit) -> Int:
        """Return the flat number of the lower corner of a dual cell; of dual walks."""
        raise NotImplementedError

    def place(
        self, track: SurfaceTrack, leaving: Any, point: list[Float], own: Arithmetic
    ) -> list[Float]:
        """Return where in a dual cell or leaf a point is, from 0 to 1 along all three axes."""
        raise NotImplementedError

    def _cut(self, track: SurfaceTrack, cursor: Any, t: Float) -> tuple[Float, Mask]:
        begin, most = cursor.t, self._near_axis(track, cursor.t)
        if self.centre:
            # Distances count from the closest approach.
            most = lesser(most, self._longest(norm(track.point), begin))
        turn, end = track.passage.turn, begin + most
        stop = dr.select(track.passage.meets & (begin < turn) & (turn < end), turn, end)
        short = stop < t
        return dr.select(short, stop, t), short

    def _near_axis(self, track: SurfaceTrack, begin: Float) -> Float:
        (x, y), (dx, dy, _) = track.passage.foot, track.direction
        speed = dr.sqrt(dr.fma(dx, dx, dy * dy))
        parallel = speed < _PARALLEL
        inverse = 1.0 / dr.select(parallel, 1.0, speed)
        nearest, away = dr.sqrt(dr.fma(x, x, y * y)), (begin - track.passage.turn) * speed
        longest = self._longest(nearest, away) * inverse
        return dr.select(parallel, dr.inf, longest)

    def _longest(self, nearest: Float, away: Float) -> Float:
        """Return how long segments may be that begin so far behind the closest approach.

        Where it is an axis that the ray meets they are next to nothing: a scheme to which a field
        jumps there sees the jump, and none of what the field does on the segment.
        """
        # On the way there a segment's end is nearest, behind it its beginning is.
        own = dr.select(away < 0.0, -away / (1.0 + self.part), away)
        own = dr.select(own > nearest, own, nearest)
        return self.part * dr.select(own > self.least, own, self.least)


class CurvilinearFieldWalk(SmoothWalk):
    """Rays through a dual grid that know where in its cells they are."""

    in_cells = False

    def corner(self, track: SurfaceTrack, leaving: SurfaceExit) -> Int:
        index = self.cells_near(track, leaving.count)
        return self.backend.UInt(flat(index, self.vertex_strides))

    def place(
        self, track: SurfaceTrack, leaving: SurfaceExit, point: list[Float], own: Arithmetic
    ) -> list[Float]:
        place = [self.backend.Float(0)] * 3
        index = self.cells_near(track, leaving.count)
        for axis, family, i in zip(self.axes, self.families, index, strict=True):
            place[axis] = family.fraction(i, point, own)
        return place


def dual_walls(grid: SurfaceGrid) -> tuple[np.ndarray, ...]:
    """Return the walls of the dual cells of a grid."""
    axes = zip(grid.edges, periodic_axes(grid), strict=True)
    return tuple(dual_edges(edges, periodic) for edges, periodic in axes)


def periodic_axes(grid: Any) -> list[bool]:
    """Return along which axes a grid closes upon itself."""
    return [name == "phi" and grid.is_periodic for name in grid.coordinates]


def dual_edges(edges: np.ndarray, periodic: bool) -> np.ndarray:
    """Return the walls of the dual cells along an axis; a single cell is its own dual."""
    if len(edges) == 2:
        return edges
    centers = 0.5 * (edges[1:] + edges[:-1])
    if periodic:
        return np.append(centers, centers[0] + (edges[-1] - edges[0]))
    return np.concatenate([edges[:1], centers, edges[-1:]])


def dual_values(array: np.ndarray, grid: Any) -> np.ndarray:
    """Return a field at the vertices of the dual grid."""
    for axis, periodic in enumerate(periodic_axes(grid)):
        if array.shape[axis] > 1 and periodic:
            array = np.concatenate([array, np.take(array, [0], axis)], axis)
            continue
        widths = [(0, 0)] * array.ndim
        widths[axis] = (1, 1) if array.shape[axis] > 1 else (0, 1)
        array = np.pad(array, widths, mode="edge")
    return array
