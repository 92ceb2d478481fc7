"""The walk through the dual of a curvilinear grid, whose vertices are the centres of its cells.

Between centres a field is linear in each of the grid's own coordinates; beyond the outermost ones
it is constant, but for an azimuth that closes a circle. Along a ray that is no polynomial: it is
replaced by the cubic through four of its values. Rays turn little around the centre or the axis on
a segment (`curvilinear.steps`), so that this is as good as the interpolation itself, and at the
ends of segments it is exact: what a ray sees is continuous.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...backend import dr
from ..contract import Segment
from ..trilinear import Values, cubic_through, parabola_through, trilinear
from .arithmetic import NUMBERS, Arithmetic
from .smooth import Smooth, Smoothed
from .steps import SteppedWalk


@dataclass(frozen=True)
class DualGrid:
    """What the walk through a dual grid is made of."""

    kind: str
    edges: tuple[np.ndarray, ...]
    mirror: bool
    scale: float

    @classmethod
    def of(cls, grid: Any) -> DualGrid:
        """Return the dual of a curvilinear grid."""
        edges = tuple(
            dual_edges(e, periodic)
            for e, periodic in zip(grid.edges, periodic_axes(grid), strict=True)
        )
        return cls(grid.kind, edges, grid.mirror, grid.scale)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of dual cells per axis."""
        return tuple(len(e) - 1 for e in self.edges)


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
        array = _at_walls(array, axis, periodic)
    return array


def _at_walls(array: np.ndarray, axis: int, periodic: bool) -> np.ndarray:
    if array.shape[axis] > 1 and periodic:
        return np.concatenate([array, np.take(array, [0], axis)], axis)
    widths = [(0, 0)] * array.ndim
    widths[axis] = (1, 1) if array.shape[axis] > 1 else (0, 1)
    return np.pad(array, widths, mode="edge")


class CurvilinearChord:
    """A segment through a dual cell, a curve in its coordinates."""

    def __init__(self, walk: CurvilinearFieldWalk, track: Any, segment: Segment) -> None:
        self.walk, self.track, self.segment = walk, track, segment

    @property
    def corner(self) -> Any:
        """Flat number of the cell's lower corner."""
        return self.walk.corner(self._index)

    @property
    def start(self) -> list[Any]:
        """Where it enters, as fractions of the cell along each axis."""
        return self._place(0.0)

    @property
    def end(self) -> list[Any]:
        """Where it leaves, as fractions of the cell along each axis."""
        return self._place(1.0)

    @property
    def position(self) -> list[Any]:
        """Where it enters, in the volume's coordinates."""
        return [p * self.walk.length for p in self.point(0.0)]

    @property
    def step(self) -> list[Any]:
        """How far it goes, in the volume's coordinates."""
        return [self.segment.length * self.walk.length * d for d in self.track.direction]

    def cubic(self, values: Values) -> list[Any]:
        """Return a field along the segment, from its values at the corners of the cell."""
        return cubic_through([trilinear(values, self._place(k / 3)) for k in range(4)])

    def parabola(self, values: Values) -> list[Any]:
        """Return it from three values, for schemes of second order: in 0.9 of their time."""
        return parabola_through([trilinear(values, self._place(k / 2)) for k in range(3)])

    def distance(self, s: Any) -> Any:
        """Return how far along the ray a place of the segment is, s from 0 to 1."""
        end = self.segment.exit.t
        # With all digits near the axis; what is added is zero but for parts of segments.
        end = end + (self.segment.end - (end - self.track.arrive))
        return dr.fma(s - 1.0, self.segment.length, end)

    def place(self, point: list[Any], own: Arithmetic = NUMBERS) -> list[Any]:
        """Return where in its cell a point is, from 0 to 1 along all three axes."""
        return self.walk.place(self._index, point, own)

    def point(self, s: Any) -> list[Any]:
        """Return a point of the segment, from the centre, in units of the scale.

        Where one of its ends is on the axis or in the centre, a point next to that.
        """
        passage, end = self.track.passage, self.segment.exit.t
        return self.walk.point(self.track, *passage.beside(self.distance(s), end))

    def _place(self, s: float) -> list[Any]:
        return self.place(self.point(s))

    @property
    def _index(self) -> list[Any]:
        return self.walk.cells_near(self.track, self.segment.exit.count)


class CurvilinearFieldWalk(Smoothed, SteppedWalk):
    """Rays through a dual grid that know where in its cells they are."""

    in_cells = False

    def __init__(self, *args: Any, axes: list[int], smooth: Smooth, length: float) -> None:
        super().__init__(*args)
        self.axes, self.smooth = axes, smooth
        self.length = self.backend.opaque(length)

    def chord(self, track: Any, segment: Segment) -> CurvilinearChord:
        """Return a segment through its dual cell."""
        return CurvilinearChord(self, track, segment)

    def corner(self, index: list[Any]) -> Any:
        """Return the flat number of the lower corner of a dual cell."""
        return self.backend.UInt(self._flat(index, self.vertex_strides))

    def place(self, index: list[Any], point: list[Any], own: Arithmetic) -> list[Any]:
        """Return where in a dual cell a point is, from 0 to 1 along all three axes."""
        found = [self.backend.Float(0)] * 3
        for axis, family, i in zip(self.axes, self.families, index, strict=True):
            found[axis] = family.fraction(i, point, own)
        return found
