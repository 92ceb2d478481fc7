"""One axis of a tree of Cartesian cells: from places in the tree to distances along rays.

As along the axes of other Cartesian grids, places are mirrored where rays run down the axis, so
that every ray runs upwards.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...backend import Int, dr, from_host
from ...backend.functions import first_true
from ...backend.types import Float
from ...geometry import is_uniform
from ..box_walk import NEVER, Axis, AxisTrack, Side

if TYPE_CHECKING:
    from ...backend.device import Backend


class TreeAxis(Axis):
    """What both kinds of axis share."""

    def __init__(
        self, edges: np.ndarray, extent: float, top: Float, scale: float, backend: Backend
    ) -> None:
        super().__init__(edges, self._unit(edges, extent, scale), scale, backend)
        self.extent, self.top = backend.opaque(extent), top

    def track(self, side: Side, position: Float) -> AxisTrack:
        """Return the track of rays that are at mirrored `position` where distances start."""
        lead = dr.select(side.parallel, NEVER, -position * side.pace)
        return self._narrowed(position, side.speed, side.pace, lead, self._table(side))

    def _unit(self, edges: np.ndarray, extent: float, scale: float) -> float:
        return scale

    def _table(self, side: Side) -> Int:
        return None

    def _inside(self, place: Float) -> Float:
        return dr.select(place < self.top, place, self.top)


class UniformTreeAxis(TreeAxis):
    """Base cells of equal width; coordinates are counted in the unit of places."""

    def _unit(self, edges: np.ndarray, extent: float, scale: float) -> float:
        return float((edges[-1] - edges[0]) / extent)

    def first_place(self, side: Side, position: Float) -> Float:
        """Return the place at a mirrored position in or around the domain."""
        place = self.backend.Float(position)
        return self._inside(dr.select(place > 0.0, place, 0.0))

    def leaving(self, track: AxisTrack) -> Float:
        """Return the distance at which rays leave the domain."""
        return dr.fma(self.extent, track.pace, track.lead)

    def crossing(self, track: AxisTrack, low: Float, size: Float) -> Float:
        """Return the distance at which the ray leaves a cell."""
        return dr.fma(low, track.pace, dr.fma(size, track.pace, track.lead))

    def beyond(self, track: AxisTrack, t: Float, low: Float) -> Float:
        """Return how far above the lower wall of its cell a ray is at distance `t`, in places."""
        return dr.fma(t, track.speed, track.position) - low

    def place(self, track: AxisTrack, t: Float, reached: Float) -> Float:
        """Return the place of the ray at distance `t`; it has come as far as `reached`."""
        place = dr.fma(t, track.speed, track.position)
        return self._inside(dr.select(place > reached, place, reached))


class RectilinearTreeAxis(TreeAxis):
    """Base cells of any width; coordinates are counted in units of the scale.

    Within a base cell places are proportional to coordinates.
    """

    def __init__(
        self, edges: np.ndarray, extent: float, top: Float, scale: float, backend: Backend
    ) -> None:
        super().__init__(edges, extent, top, scale, backend)
        self.per_base = backend.opaque(extent / self.count)
        self.bases = backend.opaque(self.count / extent)
        # Less than any cell: what lifts a wall's place into the base cell above, though rounded.
        self.lift = backend.opaque(1e-3 if backend.precision == "single" else 1e-12)
        self.total = backend.opaque((edges[-1] - edges[0]) / scale)
        self.last = backend.opaque(self.count - 1.0)
        self.down_table = dr.opaque(backend.UInt, self.count)
        # Per base cell, upwards and mirrored: lower wall, width, and one over it.
        tables = [_cells(walls / scale) for walls in (edges - edges[0], edges[-1] - edges[::-1])]
        self.cells = from_host(backend.Float, np.concatenate(tables).reshape(-1))

    def _table(self, side: Side) -> Int:
        return dr.select(side.down, self.down_table, 0)

    def first_place(self, side: Side, position: Float) -> Float:
        Float, UInt, coordinate = (
            self.backend.Float,
            self.backend.UInt,
            self.backend.Float(position),
        )
        table = self._table(side)
        above = first_true(
            self.count, UInt, lambda k: dr.gather(Float, self.cells, 4 * (table + k)) > coordinate
        )
        base = Float(dr.maximum(self.backend.Int(above) - 1, 0))
        low, _, inverse = self._cell(table, base)
        part = dr.clip((coordinate - low) * inverse, 0.0, 1.0)
        return self._inside((base + part) * self.per_base)

    def leaving(self, track: AxisTrack) -> Float:
        return dr.fma(self.total, track.pace, track.lead)

    def crossing(self, track: AxisTrack, low: Float, size: Float) -> Float:
        base = self._base(low)
        wall, width, _ = self._cell(track.table, base)
        part = dr.fma(low + size, self.bases, -base)
        return dr.fma(dr.fma(part, width, wall), track.pace, track.lead)

    def beyond(self, track: AxisTrack, t: Float, low: Float) -> Float:
        return self.place(track, t, low) - low

    def place(self, track: AxisTrack, t: Float, reached: Float) -> Float:
        base = self._base(reached)
        wall, _, inverse = self._cell(track.table, base)
        part = (dr.fma(t, track.speed, track.position) - wall) * inverse
        place = (base + part) * self.per_base
        return self._inside(dr.select(place > reached, place, reached))

    def _base(self, place: Float) -> Float:
        base = dr.floor(dr.fma(place, self.bases, self.lift))
        return dr.select(base < self.last, base, self.last)

    def _cell(self, table: Int, base: Int) -> tuple[Float, Float, Float]:
        slot = table + self.backend.UInt(base)
        low, width, inverse, _ = dr.gather(self.backend.packet(4), self.cells, slot)
        return low, width, inverse


def _cells(walls: np.ndarray) -> np.ndarray:
    width = np.diff(walls)
    return np.stack([walls[:-1], width, 1.0 / width, np.zeros_like(width)], axis=1)


def make_tree_axis(
    edges: np.ndarray, extent: float, top: Float, scale: float, backend: Backend
) -> UniformTreeAxis | RectilinearTreeAxis:
    """Return the faster kind of axis that the edges allow."""
    kind = UniformTreeAxis if is_uniform(edges) else RectilinearTreeAxis
    return kind(edges, extent, top, scale, backend)


class Spacing:
    """Distances along the axes of a grid of boxes, in units of its scale.

    The grid has `base_edges`, `divisions` (finest cells in each base cell) and `scale`.
    """

    def __init__(self, grid: Any, backend: Backend) -> None:
        kinds = [_Even if is_uniform(edges) else _Uneven for edges in grid.base_edges]
        self.axes = [
            kind(edges / grid.scale, int(parts), backend)
            for kind, edges, parts in zip(kinds, grid.base_edges, grid.divisions, strict=True)
        ]

    def widths(self, middle: list[Float], size: list[Float]) -> list[Float]:
        """Return the widths of boxes, from middles and sizes in finest units."""
        return [s * axis.unit(m) for axis, m, s in zip(self.axes, middle, size, strict=True)]

    def reaches(self, middle: list[Float], size: list[Float]) -> list[list[Float]]:
        """Return how far to look around boxes for second derivatives: once, by their sizes."""
        return [size]

    def turning(self, axis: Int, middle: list[Float], gradient: list[Float]) -> Float:
        """Return by how much a gradient that turns with an axis changes along it: not at all."""
        return 0.0

    def vectors(self, start: list[Float], end: list[Float]) -> list[Float]:
        """Return the vectors between places, neither of which is on a wall of base cells."""
        return [axis.distance(a, b) for axis, a, b in zip(self.axes, start, end, strict=True)]


class _Even:
    """Base cells of equal width."""

    def __init__(self, edges: np.ndarray, parts: int, backend: Backend) -> None:
        width = float(edges[-1] - edges[0]) / ((len(edges) - 1) * parts)
        self.width = dr.opaque(backend.Float, width)

    def unit(self, place: Float) -> Float:
        return self.width

    def distance(self, start: Float, end: Float) -> Float:
        return (end - start) * self.width


class _Uneven:
    """Base cells of any width."""

    def __init__(self, edges: np.ndarray, parts: int, backend: Backend) -> None:
        self.real, self.UInt = backend.Float, backend.UInt
        self.bases = dr.opaque(backend.Float, 1.0 / parts)
        self.parts = dr.opaque(backend.Float, float(parts))
        self.last = dr.opaque(backend.Float, len(edges) - 2.0)
        self.low = from_host(backend.Float, edges[:-1] - edges[0])
        self.widths = from_host(backend.Float, np.diff(edges) / parts)

    def unit(self, place: Float) -> Float:
        return dr.gather(self.real, self.widths, self.UInt(self._base(place)))

    def distance(self, start: Float, end: Float) -> Float:
        bases = [self._base(place) for place in (start, end)]
        first, last = (
            dr.fma(place - base * self.parts, self.unit(place), self._wall(base))
            for place, base in zip((start, end), bases, strict=True)
        )
        # Within a base cell the difference is exact, however small.
        return dr.select(bases[0] == bases[1], (end - start) * self.unit(start), last - first)

    def _base(self, place: Float) -> Float:
        return dr.clip(dr.floor(place * self.bases), 0.0, self.last)

    def _wall(self, base: Int) -> Float:
        return dr.gather(self.real, self.low, self.UInt(base))
